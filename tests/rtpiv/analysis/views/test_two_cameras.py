"""Forecast for two cameras: against stereo by hand, what was measured, and balls that are moved and traced."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.views import scene_at
from correction.grid import grid_of
from correction.light_sheet.double_views import double_views
from rtpiv.analysis.views.figures import NOISE_PX
from rtpiv.analysis.views.two_cameras import (
    LOCATION_PX,
    best_places,
    double_view_forecast,
    sentences_of,
    two_cameras,
)
from rtpiv.command_line.cli import DONE, main
from rtpiv.verbs.trace import trace
from tracer.bodies import translate_by
from tracer.camera import look_at
from tracer.scene.scene_file import dump_scene, load_scene
from tracer.strategies.trace import trace as rays_of


def test_without_glass_it_is_stereo():
    first = scene_at("none", -20.0, 504)
    found = two_cameras(first, scene_at("none", 20.0, 504))
    assert found.union > 0.99
    assert found.with_w > 0.95
    # A pixel shows 1 / cos 20 more of the plane from aside; w = (u_2 - u_1) / 2 tan 20.
    camera, angle = first.camera, np.deg2rad(20.0)
    pixel_mm = np.linalg.norm(camera.position_mm) / camera.focal_px / np.cos(angle)
    by_hand = NOISE_PX * pixel_mm / grid_of(camera).pitch_mm * np.sqrt(2.0) / (2.0 * np.tan(angle))
    assert found.sigma_w_px == pytest.approx(by_hand, rel=0.02)
    assert found.balls == {}


def test_two_balls_are_as_they_were_measured():
    """`python -m benchmarks.views two`: all recovered, 64 to 75 % with w; a place scatters by 3 to 5 um a pair."""
    found = two_cameras(scene_at("two", 0.0, 504), scene_at("two", 15.0, 504))
    assert found.union == pytest.approx(1.0, abs=0.01)
    assert 0.6 < found.with_w < 0.8
    assert 0.12 < found.sigma_w_px < 0.2
    for name, least in found.least_um.items():
        sigma = 1e3 * np.sqrt(np.diag(found.balls[name]))
        assert 1.5 < sigma[:2].min() <= sigma[:2].max() < 5.0
        assert 2.0 * sigma[:2].max() < least < 4.0 * sigma[:2].max()
    assert "smallest detectable knock halfway through 100 pairs" in found.sentences[1]


def test_the_best_places_beat_the_others():
    found = best_places(scene_at("pyramid", 0.0, 252), (-15, 0, 15))
    shares = [(pair.with_w, pair.union) for pair in found]
    assert shares == sorted(shares, reverse=True)
    assert max(found, key=lambda pair: pair.union).degrees == (-15, 15)
    assert max(union for _, union in shares) == pytest.approx(0.39, abs=0.02)  # as `mean --join` counted it
    assert len(found) < 3


def test_particles_seen_twice_tell_a_ball_as_far_as_rays_move():
    """The worst direction of the second ball, by finite differences of traced rays."""
    scene = scene_at("three", 0.0, 252)
    scene = scene.with_bodies([replace(ball, radius_mm=ball.radius_mm - 1e-3) for ball in scene.spheres])
    views = double_views(scene, step=6)
    found = double_view_forecast(scene, views)
    assert "smallest detectable move since its calibration" in " ".join(sentences_of(found))
    sigma = 1e3 * np.sqrt(np.diag(found["sphere2"]))
    rates = []
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-4
        moved = scene.with_bodies(
            [body.moved(translate_by(tuple(step))) if body.name == "sphere2" else body for body in scene.bodies]
        )
        off = [
            rays_of(moved, pixel).plane_mm - rays_of(scene, pixel).plane_mm
            for pixel in (views.first_px, views.second_px)
        ]
        rates.append((off[1] - off[0]) / 1e-4)
    rate = np.stack(rates, axis=-1)
    # Noise across the disparity alone: its height hides what lies along it where parallax is large.
    across = np.stack((-views.towards[:, 1], views.towards[:, 0]), axis=-1)
    across_rate = np.einsum("ni,nij->nj", across, rate)
    good = np.isfinite(across_rate).all(axis=1) & (np.abs(across_rate).max(axis=1) < 10.0)
    least_mm = 0.5**0.5 * LOCATION_PX * views.pitch_mm  # of a picture as fine as a corrected pixel, two frames
    particles = 0.03 * views.step**2
    normal = particles * across_rate[good].T @ across_rate[good] / (2.0 * least_mm**2)
    by_hand = 1e3 * np.sqrt(np.diag(np.linalg.inv(normal)))
    assert (sigma < 1.5 * by_hand).all()  # both directions tell more
    assert (sigma > 0.1 * by_hand)[:2].all()


@pytest.mark.draws
def test_compare_and_trace_say_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("rtpiv.verbs.compare.best_places", lambda scene: best_places(scene, (-15, 15)))
    words = ["compare", "--lenses-mm", "60", "--distances-mm", "500", "--balls-mm", "50", "--counts", "2"]
    words += ["--sensor-px", "252", "252", "--pixel-pitch-um", "88", "--cameras", "2", "--no-pictures"]
    assert main([*words, "-o", str(tmp_path)]) == DONE
    assert "-15, +15" in capsys.readouterr().out
    left, right = (load_scene(tmp_path / "scenes" / f"pair-{k}.yaml") for k in (1, 2))
    place = right.camera.position_mm
    assert left.camera.position_mm == pytest.approx((-place[0], 0.0, place[2]))
    assert right.camera.rotation == pytest.approx(np.array(look_at(place, (0.0, 0.0, 0.0))))
    (tmp_path / "right.yaml").write_text(dump_scene(right))
    trace(left, tmp_path / "traced", pictures=False, beside=tmp_path / "right.yaml")
    assert "two cameras: " in capsys.readouterr().out
