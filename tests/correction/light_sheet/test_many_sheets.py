"""Sheets off the target's plane, found in 50 simulated pairs: `make sheets` prints how far off, and what it costs.

Added errors are those of the corrected frame behind glass, rms, because the sheet found is not the true one: of
the place of a particle, and of a displacement of 8 px.
"""

from dataclasses import replace

import numpy as np
import pytest

from correction.fitted.prepared import prepare
from correction.light_sheet.double_views import double_views
from correction.light_sheet.forecast import sheet_forecast
from correction.light_sheet.self_calibration import find_sheet
from tests.correction.light_sheet.particle_frames import camera, frames_of
from tracer.light_sheet import LightSheet
from tracer.pupil import Pupil
from tracer.strategies.sensitivity import TARGET, landings

PAIRS, STEP_PX = 50, 8
CASES = [
    ("three_spheres_500", 1008, 0.1, (0.0, 0.0), {}),
    ("three_spheres_500", 1008, 0.3, (0.2, -0.1), {}),
    ("three_spheres_500", 1008, -0.5, (-0.2, 0.2), {}),
    ("three_spheres_500", 1008, 0.3, (0.2, -0.1), {"thickness_mm": 2.0}),
    ("three_spheres_500", 1008, 0.3, (0.2, -0.1), {"per_px": 0.002}),
    ("three_spheres_500", 1008, 0.3, (0.2, -0.1), {"f_number": 22.0}),
    ("three_spheres_500", 1008, -0.2, (-0.1, 0.2), {"f_number": 11.0, "seed": 3}),
    ("pyramid_500", 1008, 0.3, (0.2, -0.1), {}),
    ("pyramid_500", 2016, 0.3, (0.2, -0.1), {}),
    ("two_spheres_500", 1008, 0.3, (0.2, -0.1), {}),
    ("two_spheres_500", 2016, 0.3, (0.2, -0.1), {}),
]


def added_px(scene, found, truth):
    """Added errors (place, displacement) rms behind glass [corrected px]."""
    seen = replace(scene, sheet=found).in_light_sheet()
    corrected = prepare(seen).corrector.map
    rows, columns = np.nonzero(corrected.behind_glass[::4, ::4])
    pixels = corrected.pixel[0, ::4, ::4][rows, columns]
    slope = landings(seen, pixels).rate[:, :, TARGET.index("z") - len(TARGET)]
    x, y = corrected.grid.nodes_mm()[::4, ::4][rows, columns].T
    off = np.full((*corrected.behind_glass[::4, ::4].shape, 2), np.nan)
    off[rows, columns] = slope * (truth.height_mm(x, y) - found.height_mm(x, y))[:, None] / corrected.grid.pitch_mm
    moved = off[:, STEP_PX // 4 :] - off[:, : -STEP_PX // 4]
    return tuple(float(np.sqrt(np.nanmean(np.sum(part**2, axis=-1)))) for part in (off, moved))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("name", "size_px", "z_mm", "tilts_deg", "more"), CASES)
def test_the_sheet_is_found_within_its_sigma(name, size_px, z_mm, tilts_deg, more):
    flow_camera = camera(name, size_px, z_mm, tilts_deg, **more)
    scene = flow_camera.scene
    if flow_camera.aperture is not None:
        lens = flow_camera.aperture
        pupil = Pupil(lens.pupil_radius_mm, lens.focus_mm)
        scene = scene.with_camera(replace(scene.camera, pupil=pupil))
    foreseen = sheet_forecast(scene, double_views(scene, step=2))
    found = find_sheet(scene, frames_of(flow_camera, PAIRS))
    truth = LightSheet(z_mm, *tilts_deg)
    off = np.array(
        [found.sheet.z_mm - z_mm, *np.subtract((found.sheet.tilt_x_deg, found.sheet.tilt_y_deg), tilts_deg)]
    )
    sigma = np.array([found.sheet.sigma_mm, found.sheet.tilt_sigma_deg, found.sheet.tilt_sigma_deg])
    place, moved = added_px(scene, found.sheet, truth)
    print(
        f"\n{name} {size_px} px, z {z_mm:+.1f} mm, tilt {tilts_deg} {more}: off by {off[0]:+.4f} mm,"
        f" {off[1]:+.4f}, {off[2]:+.4f} deg; sigma {sigma[0]:.4f} mm, {sigma[1]:.4f} deg, foreseen"
        f" {foreseen.sigma_mm:.4f}, {foreseen.tilt_sigma_deg:.4f}; thick {found.sheet.thickness_mm};"
        f" added {place:.4f} px, displacement {moved:.4f} px; {list(found.verdicts)}"
    )
    assert (np.abs(off) < 4.0 * sigma).all()
    if foreseen.sigma_mm < 0.005:
        assert abs(off[0]) <= 0.02
        assert np.abs(off[1:]).max() <= 0.02
        assert place <= 0.02
        assert moved <= 0.02
