"""Whole calibrations of frames that show what the scene file does not say, rendered by optics of another hand."""

import numpy as np
import pytest

from correction.board import Chessboard
from correction.fit.map_sigma import sigma_at
from correction.fit.measurement import TargetFrame
from correction.fit.scene_fit import fit_scene
from correction.grid import grid_of
from sim.demo.scenes import at_size, misaligned, named_scene
from sim.prints.patterns import Chessboard as Print
from sim.renderer.sensor import SILENT, Sensor
from tests.correction.fit.drawn_labs import map_error
from tests.correction.fit.drawn_optics import Ball, Lab, shown_mm

SIZE_PX = 1008
SQUARE_MM = 3.5
BLOCK = 16
BENT = (4e-5, 0.0, -2e-5)  # 1/mm: 0.1 mm over the view


def photographed(lab: Lab, glass: bool, sensor: Sensor, samples: int = 4) -> TargetFrame:
    """A frame of the board: samples x samples rays a pixel, on a grid that is shifted from pixel to pixel."""
    rng = np.random.default_rng(7 + glass)
    board = Print(SQUARE_MM, 0.4 * SQUARE_MM)
    light = np.zeros((SIZE_PX, SIZE_PX), np.float32)
    grid = np.stack(np.meshgrid(np.arange(samples), np.arange(samples)), axis=-1).reshape(-1, 2) / samples
    for first in range(0, SIZE_PX, BLOCK):
        rows, columns = np.mgrid[first : first + BLOCK, 0:SIZE_PX]
        middle = np.stack((columns, rows), axis=-1).reshape(-1, 1, 2)
        pixels = middle - 0.5 + (grid + rng.uniform(0.0, 1.0, (len(middle), 1, 2))) % 1.0
        with np.errstate(invalid="ignore"):
            points, _ = shown_mm(lab, pixels.reshape(-1, 2))
        seen = np.isfinite(points[:, 0])
        value = np.zeros(len(points), np.float32)
        value[seen] = board.reflectance(points[seen])
        light[first : first + BLOCK] = value.reshape(BLOCK, SIZE_PX, -1).mean(axis=2)
    image = sensor.expose(light, seed=3 + glass)
    return TargetFrame("target_glass" if glass else "target_clear", image, glass)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("sensor", [SILENT, Sensor()], ids=["clean", "noisy"])
@pytest.mark.parametrize("fault", ["", "ellipsoid", "bent board"])
def test_the_verdict_is_right_and_the_sigma_holds_the_error(fault, sensor):
    nominal = at_size(named_scene("two_spheres_500"), SIZE_PX)
    truth = misaligned(nominal, 6)
    shape = np.diag([0.025, -0.025, 0.0]) if fault == "ellipsoid" else np.zeros((3, 3))
    room = truth.n_ambient
    balls = tuple(
        Ball(s.centre_mm, s.radius_mm, s.medium.n(truth.wavelength_nm) / room, shape * (number == 1))
        for number, s in enumerate(truth.spheres)
    )
    bend = BENT if fault == "bent board" else (0.0, 0.0, 0.0)
    frames = [
        photographed(Lab(truth.camera, balls if glass else (), bend), glass, sensor) for glass in (False, True)
    ]
    fit = fit_scene(nominal, frames, Chessboard(SQUARE_MM, 0.4 * SQUARE_MM))
    verdict = fit.verdict
    pixels, error = map_error(fit, truth, Lab(truth.camera, balls), np.random.default_rng(0))
    sigma = sigma_at(fit, pixels, True) / grid_of(truth.camera).pitch_mm
    size, said = np.sqrt(np.mean(error**2)), np.sqrt(np.mean(sigma**2))
    covered = np.mean(np.abs(error) < sigma)
    print(
        f"\n{fault or 'right'}: {verdict.sentences[0]}; map {size:.4f} px, sigma {said:.4f}, covers {covered:.2f}"
    )
    print(verdict.ways, [(one.neighbours, one.independent) for one in verdict.correlation.values()])
    words = {
        "": "the model is right",
        "ellipsoid": "the ball `sphere2` is not the sphere",
        "bent board": "not flat",
    }
    assert words[fault] in verdict.sentences[0]
    assert bool(verdict.alarms) == bool(fault)
    assert size < 2.0 * said
    assert covered > 0.4
