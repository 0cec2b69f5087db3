"""Target frames through an aperture, by the independent renderer: what the pupil does to corners is taken off."""

from dataclasses import replace

import numpy as np
import pytest

from correction.correction_map import build_correction_map
from correction.fit.map_sigma import sigma_at
from correction.fit.measurement import TargetFrame
from correction.fit.result import SceneFit
from correction.fit.scene_fit import fit_scene
from correction.grid import grid_of
from sim.demo.scenes import at_size, misaligned, named_scene
from sim.prints.patterns import Chessboard as Print
from sim.renderer.render import Aperture, render
from sim.renderer.sensor import Sensor
from tests.correction.fit.benches import BOARD, SIZE_PX, SQUARE_MM, map_error_px
from tracer.pupil import Pupil
from tracer.ray_map import build_ray_map
from tracer.scene import Scene

F_MM, FOCUS_MM = 60.0, 500.0


def errors_px(fit: SceneFit, truth: Scene) -> tuple[float, float]:
    """Rms of the map's error behind glass against the chief rays, and of its sigma [corrected px]."""
    grid = grid_of(truth.camera)
    seen = build_correction_map(truth, build_ray_map(truth), grid)
    pixels = seen.pixel[0][seen.behind_glass][::7]
    error = np.linalg.norm(map_error_px(fit.scene, truth, pixels, grid), axis=1)
    here = np.isfinite(error)
    sigma = np.linalg.norm(sigma_at(fit, pixels[here], True), axis=1) / grid.pitch_mm
    return float(np.sqrt(np.mean(error[here] ** 2))), float(np.sqrt(np.mean(sigma**2)))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("f_number", [22.0, 8.0])
def test_the_map_of_frames_through_an_aperture_is_that_of_the_chief_rays(f_number):
    nominal = at_size(named_scene("two_spheres_500"), SIZE_PX)
    truth = misaligned(nominal, 6)
    aperture, print_ = Aperture(F_MM, f_number, FOCUS_MM), Print(SQUARE_MM, 0.4 * SQUARE_MM)
    frames = []
    for glass in (False, True):
        scene = truth if glass else truth.with_bodies(())
        image = render(scene, print_, Sensor(), samples=8, seed=60 + glass, aperture=aperture)
        frames.append(TargetFrame("glass" if glass else "clear", image, glass))
    camera = replace(nominal.camera, pupil=Pupil(aperture.pupil_radius_mm, FOCUS_MM))
    fit = fit_scene(nominal.with_camera(camera), frames, BOARD)
    error, sigma = errors_px(fit, truth)
    blind, _ = errors_px(fit_scene(nominal, frames, BOARD), truth)
    print(f"f/{f_number:g}: map {error:.4f} px, sigma {sigma:.4f}; taken for a pinhole {blind:.4f}")
    print(fit.verdict.sentences)
    assert fit.verdict.is_right
    assert error < 2.0 * sigma
    assert error < max(blind, 0.01)
