"""What a fit to corners is worth whose lines on paper lie off, in every frame alike."""

import numpy as np
import pytest
import scipy

from correction.fit.solve.print_errors import OnPrint, _mean_between, print_errors

FRAMES, SIDE, LINE, DRAWS = 4, 20, 0.01, 40
PER_SQUARE = np.array([[60.0, 8.0], [-5.0, 55.0]])  # sigmas a square: edges of 20 px, found to a third of a pixel


def corners():
    index = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), -1).reshape(-1, 2)
    return index - SIDE // 2


def fitted(rng, line, point):
    """Draw frames of one print, fit them; how far the numbers are off in sigmas that know nothing, and in ours."""
    index = corners()
    x, y = rng.normal(0.0, line, (2, SIDE))
    off = np.column_stack((x[index[:, 0]], y[index[:, 1]])) + rng.normal(0.0, point, index.shape)
    frames = []
    for height in range(FRAMES):
        i, j = index.T / SIDE
        rate = np.zeros((len(index), 2, 4))  # moved along both, nearer, turned
        rate[:, 0, 0] = rate[:, 1, 1] = 1.0
        rate[:, :, 2] = (1.0 + 0.1 * height) * np.column_stack((i, j))
        rate[:, :, 3] = np.column_stack((-j, i))
        value = off @ PER_SQUARE.T + rng.normal(0.0, 1.0, index.shape)
        frames.append((value, rate))
    rates, values = (np.concatenate([f[k].reshape(len(index) * 2, -1) for f in frames]) for k in (1, 0))
    covariance = np.linalg.inv(rates.T @ rates)
    found = covariance @ rates.T @ values[:, 0]
    left = [value - rate @ found for value, rate in frames]
    per_square = np.broadcast_to(PER_SQUARE, (len(index), 2, 2))
    printed = print_errors(
        [
            OnPrint(index, np.full(len(index), ""), height, rest, per_square, rate)
            for height, (rest, (_, rate)) in enumerate(zip(left, frames, strict=True))
        ]
    )
    own = np.mean(np.square(left)) * covariance  # a fit has all errors of its corners in their sigmas
    ours = own + covariance @ printed.spread @ covariance
    return found / np.sqrt(np.diag(covariance)), found / np.sqrt(np.diag(ours)), printed


@pytest.mark.parametrize(
    ("line", "point", "too_small"), [(0.0, 0.0, 0.9), (LINE, 0.0, 2.0), (0.0, LINE, 1.2), (LINE, 0.5 * LINE, 2.0)]
)
def test_sigma_knows_what_the_lines_and_points_of_a_print_do(line, point, too_small):
    rng = np.random.default_rng(8)
    drawn = [fitted(rng, line, point) for _ in range(DRAWS)]
    before, now = (np.sqrt(np.mean(np.square([one[k] for one in drawn]))) for k in (0, 1))
    assert 0.85 < now < 1.2
    assert before > too_small * now
    lines = np.sqrt(np.mean([np.square(one[2].lines) for one in drawn]))
    points = np.sqrt(np.mean([np.square(one[2].points) for one in drawn]))
    assert lines == pytest.approx(line, rel=0.15, abs=0.05 * LINE)
    assert points == pytest.approx(point, rel=0.3, abs=0.05 * LINE)


def test_what_stands_out_is_said_and_what_does_not_is_not():
    rng = np.random.default_rng(2)
    assert str(fitted(rng, 0.0, 0.0)[2]) == ""
    assert "lines of the print lie off by" in str(fitted(rng, LINE, 0.0)[2])


def test_a_ball_whose_numbers_follow_the_print_hides_nothing():
    """Few corners, seen sharply, that a fit has brought onto their places, say nothing of the print."""
    index, rng = corners(), np.random.default_rng(5)
    off = LINE * rng.normal(size=(2, SIDE))
    value = np.column_stack((off[0][index[:, 0]], off[1][index[:, 1]])) @ PER_SQUARE.T + rng.normal(
        size=index.shape
    )
    per_square, rate = np.broadcast_to(PER_SQUARE, (len(index), 2, 2)), np.zeros((len(index), 2, 1))
    beside = OnPrint(index, np.full(len(index), ""), 0, value, per_square, rate)
    near = (np.abs(index) < 4).all(axis=1)
    way = np.full(np.count_nonzero(near), "ball")
    through = OnPrint(index[near], way, 0, 0.1 * value[near], -8.0 * per_square[near], rate[near])
    alone, both = (print_errors(frames).lines for frames in ([beside], [beside, through]))
    assert alone == pytest.approx(both)
    assert np.mean(both) == pytest.approx(LINE, rel=0.25)


def test_what_pixels_do_to_corners_on_the_same_place_in_two_frames_is_not_the_prints():
    """Corners beside the glass lie on the same pixels with and without it, those behind it on others."""
    index, rng = corners(), np.random.default_rng(6)
    beside, through = np.full(len(index), ""), np.full(len(index), "ball")
    per_square, rate = np.broadcast_to(PER_SQUARE, (len(index), 2, 2)), np.ones((len(index), 2, 1))
    near = (np.abs(index) < 7).all(axis=1)
    for of_print in (True, False):
        alike = 2.0 * LINE * rng.normal(size=index.shape) @ PER_SQUARE.T
        bare, clear, glass = (rng.normal(size=index.shape) + alike * shared for shared in (1.0, 1.0, of_print))
        frames = [
            OnPrint(index, beside, 0, bare, per_square, rate),
            OnPrint(index[~near], beside[~near], 0, clear[~near], per_square[~near], rate[~near]),
            OnPrint(index[near], through[near], 0, glass[near], per_square[near], rate[near]),
        ]
        found = print_errors(frames)
        first, second = (found.points, found.pixels) if of_print else (found.pixels, found.points)
        assert np.mean(first) == pytest.approx(2.0 * LINE, rel=0.25)
        assert np.mean(second) < 0.4 * np.mean(first)


@pytest.mark.parametrize(
    ("low", "high"),
    [(-1.0, 2.0), (-0.0, 0.3), (-9.0, -4.0), (3.0, 3.5), (45.0, 50.0), (-60.0, -50.0), (-50.0, 50.0)],
)
def test_the_mean_of_what_lies_between_is_that_of_scipy(low, high):
    exact = scipy.stats.truncnorm.mean(low, high)
    assert _mean_between(low, high) == pytest.approx(exact, rel=1e-9, abs=1e-15)
    assert low <= exact <= high
