"""How far the shape of balls is doubted: as far as residuals say, whatever else has followed them."""

import numpy as np
import pytest
import scipy

from correction.fit.solve.ball_shape import SHAPES, ShapeRates
from correction.fit.solve.considered import LARGEST_UM, SCALES, SIZES_MM, ShapeRoot, likely_scale

FREE, SHAPE = 6, 10


def equations(size: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix and gradient of 400 corners whose balls are out of round by a share of LARGEST_UM."""
    rng = np.random.default_rng(seed)
    rates = 3.0 * rng.normal(size=(800, FREE + SHAPE))
    rates[:, FREE:] += rates[:, :FREE] @ rng.normal(size=(FREE, SHAPE))  # what is free does much the same
    left = rng.normal(size=800) - rates[:, FREE:] @ (size * rng.normal(size=SHAPE))
    return rates.T @ rates, rates.T @ left


@pytest.mark.parametrize("size", [0.1, 0.3, 0.9])
def test_the_size_of_shapes_is_found(size):
    found = [likely_scale(*equations(size, seed), SHAPE) for seed in range(20)]
    assert np.exp(np.mean(np.log(found))) == pytest.approx(size, rel=0.3)


def test_round_balls_are_hardly_doubted_and_foretold_so():
    """Corners tell of 1/90 of LARGEST_UM; without corners the middle of all sizes stands."""
    found = [likely_scale(*equations(0.0, seed), SHAPE) for seed in range(20)]
    assert np.mean(found) < 0.01
    assert likely_scale(equations(0.0, 0)[0], None, SHAPE) == pytest.approx(
        np.exp(np.mean(np.log(found))), rel=0.3
    )
    nothing = np.zeros((FREE + SHAPE, FREE + SHAPE))
    assert likely_scale(nothing, np.zeros(FREE + SHAPE), SHAPE) == pytest.approx(np.sqrt(SCALES[0] * SCALES[-1]))
    assert likely_scale(nothing, None, 0) == 1.0


def test_the_largest_shape_has_its_rms_over_the_ball():
    rng = np.random.default_rng(1)
    shape = np.tensordot(SIZES_MM * rng.normal(size=(4000, len(SHAPES))), np.array(SHAPES), axes=1)
    way = rng.normal(size=(4000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    height_um = 1e3 * np.einsum("ni,nij,nj->n", way, shape, way)
    assert np.sqrt(np.mean(height_um**2)) == pytest.approx(LARGEST_UM, rel=0.05)


def test_shapes_seen_in_other_axes_are_the_same_shapes():
    axes = scipy.spatial.transform.Rotation.random(random_state=np.random.default_rng(2)).as_matrix()
    root = ShapeRoot(("a", "b"), np.random.default_rng(3).normal(size=(10, 7)))
    for before, after in zip(root.root.reshape(2, 5, 7), root.rotate(axes).root.reshape(2, 5, 7), strict=True):
        one, other = (np.tensordot(part.T, np.array(SHAPES), axes=1) for part in (before, after))
        np.testing.assert_allclose(axes @ one @ axes.T, other, atol=1e-12)


def test_a_frame_that_shows_no_corner_has_no_derivatives():
    nothing = ShapeRates(np.zeros((0, 1), np.int64), np.zeros((0, 2, 1, 5)))
    assert nothing.by_each([0, 1]).shape == (0, 2, 10)
