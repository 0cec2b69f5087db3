"""A sphere that has moved is found and named by particles seen twice; spheres that stand still raise no alarm."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import SheetError
from correction.light_sheet.double_views import double_views
from correction.self_check import moved_sphere
from correction.self_check.moved_sphere import RunningCheck, check_spheres, judge_pairs
from correction.self_check.seen_twice import SeenTwice
from sim.demo.scenes import at_size, demo_scene
from tests.correction.alignment.drawn import moved as glass_moved
from tests.correction.light_sheet.particle_frames import GAP_MM, camera, frames_of, moved
from tracer.light_sheet import LightSheet

NAMES = ("near", "middle", "far")
PAIRS, PARTICLES = 50, 40


def particles(rng, move_mm=(0.0,) * 9, height_mm=0.1, shared_mm=0.0, each=PARTICLES):
    """Particles seen twice, made by numbers: sensitivities at random, noise that pairs may have in common."""
    count = PAIRS * each
    by_sphere, by_height = rng.normal(0.0, 1.0, (count, 2, 9)), rng.normal(0.0, 0.3, (count, 2))
    pair = np.repeat(np.arange(PAIRS), each)
    noise = rng.normal(0.0, 0.05, (count, 2)) + by_sphere[:, :, 3] * rng.normal(0.0, shared_mm, PAIRS)[pair, None]
    apart = by_sphere @ np.array(move_mm) + by_height * height_mm + noise
    weight = np.broadcast_to(np.eye(2) / 0.05**2, (count, 2, 2))
    return SeenTwice(pair, rng.uniform(-40.0, 40.0, (count, 2)), apart, weight, by_sphere, by_height)


def test_alarms_are_as_rare_as_stated(monkeypatch):
    monkeypatch.setattr(moved_sphere, "FLOOR_MM", np.zeros(3))
    rng = np.random.default_rng(3)
    checks = [judge_pairs(NAMES, particles(rng, shared_mm=0.01, each=8), PAIRS, LightSheet()) for _ in range(50)]
    rate = np.mean([bool(replace(check, false_alarms=0.2).likely_moves) for check in checks])
    assert 0.0 < rate < 0.2 + 2.0 * np.sqrt(0.2 * 0.8 / 50)  # for any of three spheres


@pytest.mark.slow
def test_a_thousand_checks_of_spheres_that_stand_still():
    rng = np.random.default_rng(4)
    assert not any(
        judge_pairs(NAMES, particles(rng, shared_mm=0.01), PAIRS, LightSheet()).likely_moves for _ in range(1000)
    )


@pytest.mark.parametrize(("sphere", "axis"), [(0, 0), (1, 1), (2, 0)])
def test_the_sphere_that_moved_is_named(sphere, axis):
    move = np.zeros(9)
    move[3 * sphere + axis] = 0.02
    found = judge_pairs(NAMES, particles(np.random.default_rng(sphere), move), PAIRS, LightSheet())
    assert [one.name for one in found.likely_moves] == [NAMES[sphere]]
    np.testing.assert_allclose(found.likely_moves[0].move_mm, move[3 * sphere : 3 * sphere + 3], atol=0.008)
    assert f"{NAMES[sphere]} has moved" in found.sentence


def test_of_what_no_particle_tells_nothing_is_said():
    seen = particles(np.random.default_rng(7))
    by_sphere = seen.by_sphere.copy()
    by_sphere[:, :, 6:] = 0.0
    found = judge_pairs(NAMES, replace(seen, by_sphere=by_sphere), PAIRS, LightSheet())
    assert not found.likely_moves
    assert "they tell nothing of far" in found.sentence
    few = replace(seen, **{name: value[:50] for name, value in vars(seen).items()})
    assert "too few to tell" in judge_pairs(NAMES, few, PAIRS, LightSheet()).sentence


def drawn_flow():
    """A scene, and pairs of frames with particles where it shows them twice."""
    scene = glass_moved(at_size(demo_scene("three_spheres_500"), 400), glass_mm=(0.0, 0.0, GAP_MM))
    views = double_views(scene, step=2)
    rng = np.random.default_rng(1)
    rows, columns = np.indices(scene.camera.shape)

    def frame():
        light = rng.normal(40.0, 2.0, scene.camera.shape)
        for number in rng.choice(len(views.kind), 40, replace=False):
            for u, v in (views.first_px[number], views.second_px[number]):
                near = np.s_[max(round(v) - 4, 0) : round(v) + 5, max(round(u) - 4, 0) : round(u) + 5]
                light[near] += 500.0 * np.exp(-0.5 * ((columns[near] - u) ** 2 + (rows[near] - v) ** 2) / 0.85**2)
        return light.astype(np.float32)

    return scene, [(frame(), frame()) for _ in range(16)]


@pytest.fixture(scope="module")
def drawn():
    scene, pairs = drawn_flow()
    return scene, lambda: iter(pairs)


@pytest.mark.slow
def test_frames_tell_which_sphere_has_moved(drawn):
    scene, pairs = drawn
    assert not check_spheres(scene, pairs).likely_moves
    found = check_spheres(moved(scene, 1, (0.04, 0.0, 0.0)), pairs)
    assert [one.name for one in found.likely_moves] == ["sphere2"]
    assert found.likely_moves[0].move_mm[0] == pytest.approx(-0.04, abs=0.012)


@pytest.mark.slow
def test_frames_on_several_cores_tell_the_same_to_the_last_bit(drawn, monkeypatch):
    scene, pairs = drawn
    found = []
    for threads in ("1", "4"):
        monkeypatch.setenv("RTPIV_THREADS", threads)
        found.append(check_spheres(scene, lambda: iter(list(pairs())[:10])))
    one, four = ([move.move_mm.tobytes() for move in each.moves] for each in found)
    assert (one, found[0].particles) == (four, found[1].particles)
    assert one


def test_a_running_check_says_the_same(drawn):
    scene, pairs = drawn
    check = RunningCheck(moved(scene, 1, (0.04, 0.0, 0.0)), most_pairs=14)
    assert check.found.pairs == 0
    for frame_a, frame_b in pairs():
        check.add(frame_a, frame_b)
    assert check.found.pairs == 14
    assert [one.name for one in check.found.likely_moves] == ["sphere2"]


def test_few_pairs_are_refused(drawn):
    scene, pairs = drawn
    with pytest.raises(SheetError, match="give 10 or more"):
        check_spheres(scene, lambda: iter(list(pairs())[:4]))


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("seed", [14, 15])
def test_rendered_particles_name_a_sphere_that_moved_by_20_um(seed):
    flow_camera = camera("three_spheres_500", 600, seed=seed)
    scene, pairs = flow_camera.scene, frames_of(flow_camera, PAIRS)
    still = check_spheres(scene, pairs)
    assert not still.likely_moves
    assert "they tell nothing of sphere1" in still.sentence
    for number, step in (
        (1, (0.02, 0.0, 0.0)),
        (1, (0.0, -0.02, 0.0)),
        (2, (0.0, 0.02, 0.0)),
        (2, (-0.02, 0.0, 0.0)),
    ):
        found = check_spheres(moved(scene, number, step), pairs)
        print(seed, number, step, found.sentence)
        assert [one.name for one in found.likely_moves] == [f"sphere{number + 1}"]
        np.testing.assert_allclose(found.likely_moves[0].move_mm[:2], -np.array(step[:2]), atol=0.008)
