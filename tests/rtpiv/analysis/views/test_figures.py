"""What arrangements would show: against the published table, the tracer's own parts, and drawn scenes."""

from dataclasses import replace

import numpy as np
import pytest

from correction.maps.correction_map import build_correction_map
from daq.errors import RunUsageError
from rtpiv.analysis.views.candidates import ViewQuestion, candidates_of, pareto_front
from rtpiv.analysis.views.figures import ViewFigures, view_figures, with_sigma
from rtpiv.templates.files import scene_of, scene_text
from rtpiv.templates.lab import Lab
from tracer.pupil import Pupil
from tracer.scene.scene_file import load_scene
from tracer.strategies.blur import pupil_views
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.trace import trace

IMAGER = {"sensor_px": (2016, 2016), "pixel_pitch_um": 11.0, "gap_mm": 0.0, "glass": "1.53"}
TABLE_1 = [  # balls, diameter, L, f -> FOV_in, FOV_total [%] of Martins et al. (2018), ideally arranged
    (1, 100.0, 1000.0, 105.0, 3.9, 24.2),
    (1, 100.0, 500.0, 60.0, 5.5, 24.9),
    (1, 100.0, 250.0, 35.0, 10.5, 26.4),
    (2, 50.0, 500.0, 60.0, 134.0, 97.2),
    (3, 50.0, 500.0, 60.0, 14.4, 27.8),
]
PAIR = Lab(balls=2, ball_mm=50.0, lens_mm=60.0, distance_mm=500.0, **IMAGER)


@pytest.mark.parametrize(("balls", "ball_mm", "distance_mm", "lens_mm", "inside", "total"), TABLE_1)
def test_the_published_table_comes_from_the_question(balls, ball_mm, distance_mm, lens_mm, inside, total):
    asked = ViewQuestion((lens_mm,), (distance_mm,), (ball_mm,), (balls,), glasses=("1.53",))
    (lab,), refused = asked.labs()
    assert not refused
    found = view_figures(lab, 22.0, 0.1)
    assert 100.0 * found.inside == pytest.approx(inside, abs=0.2 if inside < 100.0 else 0.5)
    assert 100.0 * found.total == pytest.approx(total, abs=0.2)
    if min(lab.field_mm) > 1.3 * ball_mm:  # the camera sees all of what the ball hides
        hidden = (found.total - (1.0 - np.pi / 4.0)) / (np.pi / 4.0)
        assert found.recovered == pytest.approx(hidden, abs=0.02)


@pytest.mark.parametrize(
    "lab",
    [
        Lab(),
        Lab(balls=5, arrangement="pyramid", support_mm=8.0, glass="BK7", lens_mm=35.0),
        replace(PAIR, gap_mm=4.0),
    ],
)
def test_the_scene_is_that_of_the_file(tmp_path, lab):
    (tmp_path / "scene.yaml").write_text(scene_text(lab))
    assert scene_of(lab).content_hash() == load_scene(tmp_path / "scene.yaml").content_hash()


def behind(lab: Lab) -> np.ndarray:
    """Pixels that show places spread evenly over what is seen through glass."""
    small = scene_of(replace(lab, sensor_px=(252, 252), pixel_pitch_um=88.0))
    found = build_correction_map(small, build_ray_map(small))
    return ((found.pixel[0][found.behind_glass] + 0.5) * 8.0 - 0.5)[::11]


def test_blur_is_that_of_traced_parts_of_the_pupil():
    scene = scene_of(PAIR)
    traced = pupil_views(scene, Pupil(60.0 / 44.0, 500.0), behind(PAIR)).of_particles()
    assert view_figures(PAIR, 22.0, 0.1).blur_px == pytest.approx(np.nanmedian(traced.width_px), rel=0.1)


def test_a_wider_aperture_gives_light_and_takes_sharpness():
    closed, opened = (view_figures(PAIR, f_number, 0.1) for f_number in (22.0, 11.0))
    assert opened.light == pytest.approx(4.0 * closed.light, rel=1e-9)
    assert opened.blur_px == pytest.approx(2.0 * closed.blur_px, rel=1e-9)
    assert opened.noise_px > 1.5 * closed.noise_px
    assert opened.usable < closed.usable
    assert opened.recovered == closed.recovered


def test_what_the_camera_does_not_see_is_not_recovered():
    whole, band = (view_figures(replace(PAIR, sensor_px=(2016, side)), 22.0, 1.0) for side in (2016, 320))
    width_mm, height_mm = 55.9, 320.0 / PAIR.px_per_mm  # of what the balls hide; of the frame
    half = height_mm / width_mm
    disc = (half * np.sqrt(1.0 - half**2) + np.arcsin(half)) * 2.0 / np.pi  # band through the middle of a disc
    assert 0.3 < band.recovered < whole.recovered * disc  # less: the glass shows part of the band elsewhere


def test_a_ball_that_is_off_moves_the_picture_as_a_moved_ball_does():
    scene, pixel, moved = scene_of(PAIR), behind(PAIR), []
    for number, ball in enumerate(scene.bodies):
        (x, y, z), bodies = ball.centre_mm, list(scene.bodies)
        for centre in ((x + 0.01, y, z), (x, y + 0.01, z)):
            bodies[number] = replace(ball, centre_mm=centre)
            off = trace(scene.with_bodies(bodies), pixel).plane_mm - trace(scene, pixel).plane_mm
            moved.append(np.linalg.norm(off, axis=1))
    expected = np.nanmedian(np.max(moved, axis=0)) * PAIR.px_per_mm
    assert view_figures(PAIR, 22.0, 0.1).sensitivity_px == pytest.approx(expected, rel=0.03)


def test_the_unbeaten_are_those_that_nobody_beats_and_nothing_is_said_of_what_shows_nothing():
    def made(usable: float, noise: float, light: float) -> ViewFigures:
        return ViewFigures(PAIR, None, None, usable, usable, 1.0, 1.0, noise, 0.1, 0.1, 80.0, light)

    wide, sharp, bright = made(0.9, 0.1, 1.0), made(0.5, 0.02, 1.0), made(0.5, 0.1, 8.0)
    worse, alike, none = made(0.5, 0.1, 1.0), made(0.9, 0.1001, 1.0), made(0.0, float("nan"), float("nan"))
    assert pareto_front([wide, alike, sharp, worse, bright, none]) == [wide, sharp, bright]


def test_two_balls_in_a_row_come_first_and_what_cannot_be_is_said():
    asked = ViewQuestion((60.0,), (500.0, 90.0), (50.0,), (1, 2, 3, 40), ("row", "triangle"))
    labs, refused = asked.labs()
    found = candidates_of(labs, 22.0, 0.1, 1)
    first = found.best[0].lab
    assert (first.balls, first.arrangement, first.distance_mm) == (2, "behind", 500.0)
    assert found.best[0].sigma_px < found.best[0].unsaid_px
    assert any("the lens begins" in reason or "inside" in reason for reason in [*refused, *found.refused])
    with pytest.raises(RunUsageError, match="more than 5000"):
        ViewQuestion([*range(10, 110)], [*range(200, 300)], (50.0,))


def test_sigma_of_the_map_falls_with_the_size_of_the_frame_and_grows_where_no_light_is_said():
    near = with_sigma(view_figures(replace(PAIR, glass="BK7"), 22.0, 0.1))
    small = with_sigma(
        view_figures(replace(PAIR, glass="BK7", sensor_px=(1008, 1008), pixel_pitch_um=22.0), 22.0, 0.1)
    )
    assert 1e-4 < near.sigma_px < 0.02
    assert near.unsaid_px > 20.0 * near.sigma_px
    assert small.sigma_px > 0.75 * near.sigma_px  # in pixels twice as wide
