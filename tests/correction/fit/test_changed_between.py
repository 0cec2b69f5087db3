"""Changes between bare frames and those with glass: named, and in sigma."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.adjustment import Adjustment
from correction.fit.judge.result import SceneFit
from correction.fit.solve.moved_board import motion_as_board
from correction.fit.solve.solver import Corners, residuals
from correction.fit.solve.unknowns import unknowns_of
from correction.target import Chessboard
from tests.correction.fit.drawn_labs import map_error, photographed
from tests.correction.fit.drawn_optics import Ball, Lab
from tests.correction.fit.faulty_labs import right
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene

Chi = dict[bool, float]


def lab_of(scene: Scene) -> Lab:
    room = scene.n_ambient
    balls = [
        Ball(s.centre_mm, s.radius_mm, s.medium.n(scene.wavelength_nm) / room) for s in scene.spheres if s.medium
    ]
    return Lab(scene.camera, tuple(balls))


def fitted(seed: int, since: Scene | None = None, truth: Scene | None = None) -> tuple[SceneFit, Chi]:
    """Fit corners of a lab that was otherwise since the bare frames, and how large errors are in sigmas.

    The truth is as it has been since, unless it is given.
    """
    case, rng = right(seed), np.random.default_rng((58, seed))
    since, square = since or case.bare, case.board.square_mm
    truth = truth or since
    board, frames = Chessboard(square, 0.4 * square), []
    for glass, scene in ((False, case.bare.bare()), (True, since)):
        frames.append(photographed(scene, lab_of(scene), board, glass, 0.01, 0.01, rng))
    bench = unknowns_of(case.given, [0.0], FitTable())
    fit = Adjustment().estimate(bench, bench.start, frames, ())
    chi = {}
    for behind in (False, True):
        _, error, sigma = map_error(fit, truth, lab_of(truth), rng, behind)
        chi[behind] = float(np.sqrt(np.mean((error / sigma) ** 2)))
    return fit, chi


def test_camera_and_glass_that_move_against_a_board_are_a_board_that_moves_against_them():
    case = right(3)
    unknowns = unknowns_of(case.given, [0.0], FitTable())
    every = replace(unknowns, names=unknowns.full_names, columns=np.eye(len(unknowns.start)))
    pixels = np.random.default_rng(1).uniform(100.0, 400.0, (200, 2))
    part = residuals(every, np.zeros(len(unknowns.start)), Corners(0, True, pixels, np.zeros_like(pixels), 1.0))
    rate = part.rate[np.isfinite(part.rate).all(axis=(1, 2))]
    both = rate @ motion_as_board(unknowns, unknowns.start) + rate[:, :, unknowns.place(0)]
    assert len(rate) > 100
    np.testing.assert_allclose(both, 0.0, atol=1e-6 * float(np.abs(rate).max()))


@pytest.mark.parametrize("seed", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in range(2, 6))])
def test_a_camera_that_moved_between_frames_is_named_and_in_sigma(seed):
    camera = right(seed).bare.camera
    x, y, z = camera.position_mm
    moved = replace(camera, position_mm=(x + 0.03, y - 0.02, z))
    fit, chi = fitted(seed, right(seed).bare.with_camera(moved))
    assert "camera seem to have moved" in fit.verdict.sentences[0]
    assert 0.8 < chi[False] < 1.25
    assert chi[True] < 1.5


@pytest.mark.parametrize("seed", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in range(2, 6))])
def test_a_lens_that_was_focused_between_frames_is_named_and_in_sigma(seed):
    camera = right(seed).bare.camera
    fit, chi = fitted(seed, right(seed).bare.with_camera(replace(camera, focal_px=1.001 * camera.focal_px)))
    assert "focused or zoomed" in fit.verdict.sentences[0]
    assert 0.8 < chi[False] < 1.25
    assert chi[True] < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 6))
def test_a_board_that_moved_between_frames_is_named_and_in_sigma(seed):
    """Seen from a board that moved, camera and balls have moved the other way; the world has not."""
    truth, by = right(seed).bare, np.array((-0.03, 0.02, 0.0))
    at = (np.array(truth.camera.position_mm) + by).tolist()
    balls = [replace(ball, centre_mm=tuple((np.array(ball.centre_mm) + by).tolist())) for ball in truth.spheres]
    moved = truth.with_camera(replace(truth.camera, position_mm=tuple(at))).with_bodies(balls)
    fit, chi = fitted(seed, moved, truth)
    assert "board or camera seem to have moved" in fit.verdict.sentences[0]
    assert max(chi.values()) < 1.25


def test_a_right_lab_names_nothing():
    fit, chi = fitted(1)
    assert fit.verdict.is_right
    assert max(chi.values()) < 2.0
