"""Supports go with the balls that they hold, and never stand in one."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.adjustment import feasible_scene
from correction.fit.camera_stage import turn_scene
from correction.fit.solve.contact import HELD_MM
from correction.fit.solve.unknowns import unknowns_of
from sim.demo.scenes import demo_scene
from tracer.bodies import Rod, Sphere
from tracer.media import MEDIA
from tracer.scene.fit_section import FitTable

BALLS = (
    Sphere("left", (-25.0, 0.0, 26.0), 20.0, MEDIA["N-BK7"]),
    Sphere("right", (25.0, 0.0, 26.0), 20.0, MEDIA["N-BK7"]),
)
HOLDS_RIGHT = Rod("holds right", (25.0, -24.0, 26.0), (25.0, -90.0, 26.0), 4.0)
FAR = Rod("far", (-90.0, -90.0, 10.0), (90.0, -90.0, 10.0), 4.0)


def scene_of(*supports: Rod):
    return demo_scene("two_spheres_500").with_bodies([*BALLS, *supports])


def fitted(scene, **steps):
    """The legal scene of a fit that moved numbers such as right_y by steps [mm]."""
    unknowns = unknowns_of(scene, [0.0], FitTable())
    full = unknowns.start.copy()
    for name, step in steps.items():
        full[unknowns.full_names.index(name.replace("_", "."))] += step
    return {body.name: body for body in feasible_scene(unknowns, full)[0].bodies}


@pytest.mark.parametrize("step_mm", [(1.2, -0.8, 0.5), (-0.3, 2.5, -1.0), (0.0, -1.5, 0.0)])
def test_a_rod_that_touches_its_ball_makes_its_step(step_mm):
    bodies = fitted(scene_of(HOLDS_RIGHT, FAR), right_x=step_mm[0], right_y=step_mm[1], right_z=step_mm[2])
    rod = bodies["holds right"]
    np.testing.assert_allclose(rod.start_mm, np.add(HOLDS_RIGHT.start_mm, step_mm), atol=1e-9)
    np.testing.assert_allclose(rod.end_mm, np.add(HOLDS_RIGHT.end_mm, step_mm), atol=1e-9)
    assert bodies["far"] == FAR


def test_a_ball_that_grew_pushes_its_rod_down_and_no_more():
    rod = fitted(scene_of(HOLDS_RIGHT), right_radius=0.02)["holds right"]
    np.testing.assert_allclose(rod.start_mm, (25.0, -24.02, 26.0), atol=1e-5)


def test_a_ball_that_comes_near_moves_what_is_in_its_way_aside():
    apart = replace(HOLDS_RIGHT, start_mm=(25.0, -24.0 - HELD_MM - 0.5, 26.0))
    assert fitted(scene_of(apart), right_y=-5.0)["holds right"] == apart
    moved = fitted(scene_of(apart), right_y=-6.0)
    assert moved["holds right"].start_mm[1] == pytest.approx(apart.start_mm[1] - 0.5, abs=1e-5)


def test_between_two_balls_and_above_the_plane():
    """A rod that both balls and the plane press on: the scene must still be one."""
    low = Rod("low", (0.0, -60.0, 4.0), (0.0, 60.0, 4.0), 4.0)
    bodies = fitted(scene_of(low), left_x=1.6, right_x=-1.6, left_z=-4.0, right_z=-4.0)
    assert bodies["low"].lowest_mm > -1e-6


def test_a_turned_bench_keeps_its_supports_clear():
    close = tuple(replace(ball, centre_mm=(*ball.centre_mm[:2], 20.0)) for ball in BALLS)
    under = Rod("under", (25.0, -24.0, 20.0), (25.0, -90.0, 20.0), 4.0)
    scene = scene_of().with_bodies([*close, under])
    angle = np.deg2rad(2.0)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    assert {body.name for body in turn_scene(scene, turn).bodies} == {"left", "right", "under"}


def test_a_turned_bench_looks_the_same_to_its_camera():
    """Balls, rods and camera turn together, as a board that hangs askew makes all of them turn before it."""
    scene = scene_of(HOLDS_RIGHT)
    scene = scene.with_bodies(
        [body.moved(lambda at: (*at[:2], at[2] + 40.0)) for body in scene.bodies]
    )  # clear of it
    about_z, about_y = np.deg2rad((20.0, 2.0))
    turn = np.array([[np.cos(about_z), -np.sin(about_z), 0], [np.sin(about_z), np.cos(about_z), 0], [0, 0, 1]])
    turn = turn @ [[np.cos(about_y), 0, np.sin(about_y)], [0, 1, 0], [-np.sin(about_y), 0, np.cos(about_y)]]

    def seen_mm(scene):
        balls = [body.centre_mm for body in scene.spheres]
        ends = [at for body in scene.bodies if isinstance(body, Rod) for at in (body.start_mm, body.end_mm)]
        return (np.array([*balls, *ends]) - scene.camera.position_mm) @ scene.camera.rotation_matrix.T

    after = turn_scene(scene, turn)
    np.testing.assert_allclose(after.spheres[0].centre_mm, turn @ (-25.0, 0.0, 66.0), atol=1e-9)
    np.testing.assert_allclose(seen_mm(after), seen_mm(scene), atol=1e-9)
