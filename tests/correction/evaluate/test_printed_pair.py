"""A real PIV pair "printed" on the plane and seen through two balls: corrected, the flow must be the same."""

import numpy as np
import pytest

from correction.evaluate.regions import regions_of
from correction.maps.correction_map import build_correction_map
from correction.maps.corrector import Corrector
from piv.files.frame_file import read_frame
from sim.renderer.patterns import Image
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.piv.fixed_windows import evaluate_pair
from tests.supplied import ROOT
from tracer.scene.scene_file import load_scene
from tracer.strategies.ray_map import build_ray_map

PAIRS = ROOT.parent / "shared" / "piv_pairs"


@pytest.mark.slow
@pytest.mark.parametrize(
    "names", [("pivch2001A_1.tif", "pivch2001A_2.tif"), ("pivlab_karman_01.bmp", "pivlab_karman_02.bmp")]
)
def test_printed_pair_through_two_balls(names):
    """Within 0.1 px rms, every vector counted, of the direct evaluation in the same windows."""
    paths = [PAIRS / name for name in names]
    if not all(path.is_file() for path in paths):
        pytest.skip("the public PIV pairs are not beside this checkout")
    prints = [_even(read_frame(path).astype(np.float32)) for path in paths]
    scene = load_scene(ROOT / "examples" / "two_spheres_500.yaml")
    cmap = build_correction_map(scene, build_ray_map(scene))
    frames = [
        render(scene, Image(p / 255.0, cmap.grid.pitch_mm), Sensor(blur_px=0.0), samples=4, seed=3 + k)
        for k, p in enumerate(prints)
    ]
    corrector = Corrector(cmap)
    through = evaluate_pair(corrector(frames[0]), corrector(frames[1]), corrector.recovered)
    direct = evaluate_pair(*(_centred(p, cmap.grid.shape) for p in prints))
    known = regions_of(through, cmap, scene).middle & through.valid & direct.valid
    assert known.sum() > 600
    difference = np.stack((through.u_px - direct.u_px, through.v_px - direct.v_px), axis=-1)[known]
    rms, robust = np.sqrt(np.mean(difference**2)), np.sqrt(np.median(difference**2)) / 0.6745
    print(
        f"{names[0]}: rms {rms:.4f} px, from the median {robust:.4f} px, largest {np.abs(difference).max():.2f} px"
    )
    assert rms <= 0.1
    assert np.abs(np.median(difference, axis=0)).max() < 0.02


def _even(frame):
    """Without its last row or column where it is odd: then its middle lies between pixels, as that of the view."""
    return frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2]


def _centred(frame, shape):
    """The print where the corrected frame shows it, NaN around."""
    whole = np.full(shape, np.nan, np.float32)
    top, left = ((side - part) // 2 for side, part in zip(shape, frame.shape, strict=True))
    whole[top : top + frame.shape[0], left : left + frame.shape[1]] = frame
    return whole
