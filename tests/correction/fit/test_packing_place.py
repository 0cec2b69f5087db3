"""Packings that stand elsewhere than their file has them, in frames of the simulator's own optics."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.fit.seen.packing_place import rigid_motion
from correction.fit.solve.unknowns import unknowns_of
from correction.target import Chessboard
from rtpiv.templates.files import scene_of
from rtpiv.templates.lab import Lab
from sim.demo.scenes import at_size, misalign
from tests.correction.fit.benches import photograph
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene

SIDE_MM = 2.5
TOUCHING = FitTable(contact_mm=0.02)


def tube() -> Scene:
    """A tube with two rings of four balls in contact."""
    lab = Lab(arrangement="tube", layers=2, plane=2.0, balls=8, ball_mm=15.0, gap_mm=5.0, lens_mm=35.0)
    return at_size(scene_of(lab), 640)


@lru_cache(maxsize=2)
def photographed(seed: int) -> tuple[Scene, tuple[TargetFrame, TargetFrame]]:
    """The tube as it stands, and its frames."""
    truth = misalign(tube(), seed, is_packed=True)
    clear = photograph(truth.bare(), False, 0.0, seed, SIDE_MM)
    return truth, (clear, photograph(truth, True, 0.0, seed + 1, SIDE_MM))


def moved(scene: Scene, shift_mm: tuple[float, ...], turn_mrad: tuple[float, ...]) -> Scene:
    """All bodies moved and turned as one."""
    turn, middle = Rotation.from_rotvec(1e-3 * np.array(turn_mrad)), scene.sphere_table()[:, :3].mean(axis=0)

    def place(point: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (middle + turn.apply(np.array(point) - middle) + shift_mm).tolist()
        return x, y, z

    return scene.with_bodies([body.moved(place) for body in scene.bodies])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "shift_mm", "turn_mrad"),
    [(3, (1.2, 0.0, 0.0), (0.0, 0.0, 0.0))],
)
def test_a_tube_is_calibrated_from_a_file_that_has_it_elsewhere(
    seed: int, shift_mm: tuple[float, ...], turn_mrad: tuple[float, ...]
) -> None:
    truth, frames = photographed(seed)
    fit = fit_scene(moved(tube(), shift_mm, turn_mrad), frames, Chessboard(SIDE_MM, 0.4 * SIDE_MM), TOUCHING)
    off = np.subtract([ball.centre_mm for ball in fit.scene.spheres], [ball.centre_mm for ball in truth.spheres])
    assert np.sqrt(np.mean(off[:, :2] ** 2)) < 0.03
    assert np.sqrt(np.mean(off[:, 2] ** 2)) < 0.1


def test_a_rigid_motion_takes_balls_and_tube_along() -> None:
    """Against a rotation matrix; the tube along its own axis is where it was, which no ray shows."""
    scene = tube()
    unknowns = unknowns_of(scene, [0.0], TOUCHING)
    rigid = rigid_motion(unknowns, 1.0)
    full = rigid.full(np.array((0.5, -0.3, 0.2, 0.1, -0.2, 0.3)))
    found, wanted = unknowns.scene_at(full), moved(scene, (0.5, -0.3, 0.2), (1.0, -2.0, 3.0))
    centres: Callable[[Scene], np.ndarray] = lambda one: one.sphere_table()[:, :3]  # noqa: E731
    assert np.abs(centres(found) - centres(wanted)).max() < 1e-3
    (one,), (other,) = ([body for body in each.bodies if body.room] for each in (found, wanted))
    start, end = np.array(one.capsule.start_mm), np.array(one.capsule.end_mm)
    axis = (end - start) / np.linalg.norm(end - start)
    for point in other.capsule[:2]:
        assert np.linalg.norm(np.cross(np.array(point) - start, axis)) < 2e-3
