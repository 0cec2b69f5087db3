"""A real PIV pair "printed" on the plane and seen through two balls: corrected, the flow must be the same."""

from pathlib import Path

import numpy as np
import pytest

from correction.correction_map import build_correction_map
from correction.corrector import Corrector
from correction.evaluate.piv import evaluate_pair
from correction.evaluate.regions import regions_of
from correction.frame_file import read_frame
from sim.patterns import Image
from sim.renderer import render
from sim.sensor import Sensor
from tests.supplied import ROOT
from tracer.ray_map import build_ray_map
from tracer.scene_file import load_scene

KARMAN = ("pivlab_karman_01.bmp", "pivlab_karman_02.bmp")
PAIRS = ROOT.parent / "shared" / "piv_pairs"


@pytest.mark.slow
@pytest.mark.parametrize(
    "names", [("pivch2001A_1.tif", "pivch2001A_2.tif"), ("pivlab_karman_01.bmp", "pivlab_karman_02.bmp")]
)
def test_printed_pair_through_two_balls(names):
    paths: list[Path] = [PAIRS / name for name in names]
    if not all(path.is_file() for path in paths):
        pytest.skip("the public PIV pairs are not beside this checkout")
    prints = [read_frame(path).astype(np.float32) for path in paths]
    scene = load_scene(ROOT / "examples" / "two_spheres_500.yaml")
    cmap = build_correction_map(scene, build_ray_map(scene))
    pitch = cmap.grid.pitch_mm
    frames = [
        render(scene, Image(np.clip(p / 255.0, 0.0, 1.0), pitch), Sensor(blur_px=0.0), samples=4, seed=3 + k)
        for k, p in enumerate(prints)
    ]
    corrector = Corrector(cmap)
    through = evaluate_pair(corrector(frames[0]), corrector(frames[1]), corrector.recovered)
    height, width = prints[0].shape
    left, top = (cmap.grid.shape[1] - width) / 2.0, (cmap.grid.shape[0] - height) / 2.0
    direct = evaluate_pair(*prints)
    middle = regions_of(through, cmap, scene).middle & through.valid
    u = _at(direct.x_px + left, direct.y_px + top, np.where(direct.valid, direct.u_px, np.nan), through)
    v = _at(direct.x_px + left, direct.y_px + top, np.where(direct.valid, direct.v_px, np.nan), through)
    known = middle & np.isfinite(u) & np.isfinite(v)
    assert known.sum() > 300
    difference = np.stack((through.u_px - u, through.v_px - v), axis=-1)[known]
    assert np.sqrt(np.median(difference**2)) / 0.6745 < 0.1
    assert np.abs(np.median(difference, axis=0)).max() < 0.02


def _at(x, y, values, field):
    """Bilinear interpolation of values on (y, x) at the windows of `field`; NaN outside or next to NaN."""
    from scipy.interpolate import RegularGridInterpolator

    grid = np.stack(np.meshgrid(field.y_px, field.x_px, indexing="ij"), axis=-1)
    return RegularGridInterpolator((y, x), values, bounds_error=False, fill_value=np.nan)(grid)
