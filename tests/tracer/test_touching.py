"""Balls whose measured places overlap: moved apart by what is known of each, or refused."""

import numpy as np
import pytest

from ground.errors import ConfigError
from tracer.scene.scene_file import load_scene

HEAD = """camera: {focal_px: 2000.0, sensor_px: [800, 600], position_mm: [0.0, 0.0, 400.0]}
fit: {spheres: {centre_mm: 1.0}, named: {fixed: {centre_mm: 0.0}, sure: {centre_mm: 0.1}}}
glasses: {glass: {n: 1.5}}
bodies:
"""


def scene_of(tmp_path, balls):
    """Load a scene of balls (name, x, y, z) of radius 8 mm."""
    path = tmp_path / "scene.yaml"
    rows = [
        f"  - {{kind: sphere, name: {n}, centre_mm: [{x}, {y}, {z}], radius_mm: 8.0, material: glass}}"
        for n, x, y, z in balls
    ]
    path.write_text(HEAD + "\n".join(rows) + "\n")
    return {ball.name: np.array(ball.centre_mm) for ball in load_scene(path).spheres}


@pytest.mark.parametrize(
    ("second", "expected"),
    [("b", (0.11, 0.11)), ("sure", (0.22 / 1.01, 0.22 * 0.01 / 1.01)), ("fixed", (0.22, 0.0))],
)
def test_touching_balls_share_their_overlap_by_their_variances(tmp_path, capfd, second, expected):
    found = scene_of(tmp_path, [("a", 0.0, 0.0, 8.0), (second, 15.78, 0.0, 8.0)])
    steps = [np.linalg.norm(found["a"] - (0.0, 0.0, 8.0)), np.linalg.norm(found[second] - (15.78, 0.0, 8.0))]
    assert steps == pytest.approx(expected, abs=1e-4)
    assert np.linalg.norm(found["a"] - found[second]) == pytest.approx(16.0, abs=1e-4)
    assert "moved apart within the sigma of their centres: a by 0." in " ".join(capfd.readouterr().err.split())


def test_a_heap_measured_to_a_fifth_of_a_millimetre_is_accepted(tmp_path):
    rng = np.random.default_rng(4)
    rows = [(16.0 * i + 8.0 * (j % 2), 13.8564 * j, 8.0) for i in range(3) for j in range(3)]
    rows += [(16.0 * i + 8.0, 4.6188, 8.0 + 13.0639) for i in range(2)]
    measured = np.array(rows) + rng.normal(0.0, 0.2, (len(rows), 3))
    found = scene_of(tmp_path, [(f"n{k}", *np.round(place, 2)) for k, place in enumerate(measured)])
    places = np.array(list(found.values()))
    gaps = np.linalg.norm(places[:, None] - places, axis=2)[np.triu_indices(len(places), 1)]
    assert gaps.min() > 16.0 - 1e-5
    assert places[:, 2].min() > 8.0 - 1e-5
    assert np.linalg.norm(places - measured, axis=1).max() < 0.8


@pytest.mark.parametrize("second", [("b", 13.0, 0.0, 8.0), ("a2", 0.0, 0.0, 8.0)])
def test_balls_that_their_priors_do_not_part_are_refused(tmp_path, second):
    with pytest.raises(ConfigError, match="overlap by"):
        scene_of(tmp_path, [("a", 0.0, 0.0, 8.0), second])


def test_many_overlaps_are_one_sentence_about_the_deepest(tmp_path):
    """A radius that is wrong in every row makes each contact an overlap."""
    line = [(f"b{k}", x, 0.0, 8.0) for k, x in enumerate((0.0, 13.0, 25.0, 38.0))]
    with pytest.raises(ConfigError) as refusal:
        scene_of(tmp_path, line)
    (problem,) = refusal.value.problems
    assert "'b1' and 'b2' overlap by 4 mm, the deepest of 3 overlapping pairs" in problem.text


def test_a_scene_without_overlaps_is_left_alone(tmp_path, capfd):
    found = scene_of(tmp_path, [("a", 0.0, 0.0, 8.0), ("b", 16.0, 0.0, 8.0)])
    assert found["b"].tolist() == [16.0, 0.0, 8.0]
    assert "moved" not in capfd.readouterr().err
