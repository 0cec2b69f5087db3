"""Balls with the plane near their focus: few squares fill each, most saddles are of rims, yet a fit must begin."""

import numpy as np
import pytest

from correction.fit.scene_fit import fit_scene
from correction.target import Chessboard
from sim.demo.scenes import misalign
from tests.correction.fit.benches import photograph
from tests.tracer.scenes import camera_at
from tracer.bodies import Sphere
from tracer.camera import thin_lens_distance_mm
from tracer.media import medium_called
from tracer.scene.scene import Scene

L_MM, SQUARE_MM = 700.0, 2.5
PLACES = ((0.0, 17.3263, 19.0), (-15.005, -8.6631, 19.0), (15.005, -8.6631, 19.0))
HEIGHTS = ((False, (0.0, -10.0, 10.0, -20.0, 20.0)), (True, (0.0, -10.0, -20.0)))


def three_of_acrylic() -> Scene:
    """Balls of 30 mm, whose focus lies 23 mm behind their centres, 19 mm in front of the plane."""
    camera = camera_at(
        (0.0, 0.0, L_MM), focal_px=thin_lens_distance_mm(85.0, L_MM) / 0.011, sensor_px=(1008, 1008)
    )
    acrylic = medium_called("acrylic")
    assert acrylic is not None
    return Scene(camera, tuple(Sphere(f"ball{k}", place, 15.0, acrylic) for k, place in enumerate(PLACES)))


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", range(6))
def test_a_lab_as_it_was_told_is_fitted(seed: int) -> None:
    nominal = three_of_acrylic()
    truth = misalign(nominal, seed)
    frames = [
        photograph(truth if glass else truth.with_bodies(()), glass, height, 100 * seed + number, SQUARE_MM)
        for glass, heights in HEIGHTS
        for number, height in enumerate(heights, 10 * glass)
    ]
    fit = fit_scene(nominal, frames, Chessboard(SQUARE_MM, 0.4 * SQUARE_MM))
    sigma = dict(zip(fit.names, fit.sigmas.tolist(), strict=True))
    for found, true in zip(fit.scene.spheres, truth.spheres, strict=True):
        off = np.abs(np.subtract(found.centre_mm, true.centre_mm))
        assert np.all(off < 0.01 + 4.0 * np.array([sigma[f"{found.name}.{axis}"] for axis in "xyz"]))
