"""The parts of the evaluator against slow, obvious versions of themselves."""

import numpy as np
import pytest
from scipy import ndimage

from piv.correlation.correlate import correlation_planes, workspace
from piv.correlation.deform import deform_pair
from piv.correlation.kernels import deform as piv_deform
from piv.correlation.kernels import fft as piv_fft
from piv.correlation.kernels import median as piv_median
from piv.correlation.kernels import windows as piv_windows
from piv.correlation.outliers import outliers
from piv.correlation.planes import RIDGE, fill_gaps, smooth_field
from piv.correlation.windows import around, interpolate, interpolation_matrix, window_grid
from piv.resampling.kernels.bspline import quintic_at
from piv.resampling.sample import prefilter, sample


def windows(n, size, seed=0):
    return np.random.default_rng(seed).normal(size=(2, n, size, size)).astype(np.float32)


@pytest.mark.parametrize(("n", "size"), [(32, 32), (7, 32), (17, 64), (3, 16), (5, 24), (2, 25)])
def test_correlation_planes_equal_the_definition(n, size):
    a, b = windows(n, size)
    planes = np.empty_like(a)
    correlation_planes(a, b, workspace(size), planes)
    for k in (0, n - 1):
        for dv, du in [(0, 0), (0, 1), (3, -2), (-5, 4), (size // 2, 1)]:
            shifted = np.roll(b[k].astype(float), (-dv, -du), (0, 1))
            assert planes[k, dv, du] == pytest.approx((a[k] * shifted).sum(), abs=2e-5 * size * size)


def test_transform_kernels_as_plain_python():
    a, b = windows(3, 8)
    planes, plain = np.empty_like(a), np.empty_like(a)
    correlation_planes(a, b, workspace(8), planes)
    angle = -2 * np.pi * np.arange(4) / 8
    turn = np.array([np.cos(angle), np.sin(angle)], np.float32)
    # Bit-reversed frequencies 0 4 2 6 1 5 3 7; their negatives 0 4 6 2 7 3 5 1 stand at these indices.
    negative = np.array([0, 1, 3, 2, 7, 6, 5, 4])
    piv_fft.correlate_pairs.py_func(a, b, turn, negative, workspace(8), plain)
    assert np.abs(planes - plain).max() < 1e-4


def test_butterflies_undo_each_other():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 3 * piv_fft.BLOCK)).astype(np.float32)
    first, second = a.copy(), b.copy()
    for apart, together in (
        (piv_fft.butterfly_forward, piv_fft.butterfly_inverse),
        (piv_fft.butterfly_forward.py_func, piv_fft.butterfly_inverse.py_func),
    ):
        apart(a, b, np.float32(0.6), np.float32(0.8))
        together(a, b, np.float32(0.6), np.float32(0.8))
        a /= 2
        b /= 2
        assert np.abs(a - first).max() < 1e-5
        assert np.abs(b - second).max() < 1e-5


@pytest.mark.parametrize("amplitude_px", [0.0, 2.0, 9.0])
def test_deformation_equals_sampling_point_by_point(amplitude_px):
    rng = np.random.default_rng(3)
    frames = rng.uniform(0, 1000, (2, 140, 150)).astype(np.float32)
    coefficients = prefilter(frames[0]), prefilter(frames[1])
    grid = window_grid((140, 150), 32, 0.5)
    y, x = np.meshgrid(grid.y_px, grid.x_px, indexing="ij")

    def field(u, v):  # quadratic: the interpolation between nodes is exact inside
        return np.stack([amplitude_px * (0.3 + (u / 150) * (v / 140)), amplitude_px * (-0.7 + v / 140)], -1)

    valid = np.ones((140, 150), np.float32)
    valid[60:63, 70:90] = 0
    out = deform_pair(coefficients, valid, field(x, y), grid, 0.0)
    v, u = np.mgrid[:140, :150]
    inner = (slice(32, 108), slice(32, 118))
    everything_valid = np.ones((140, 150), bool)
    for result, source, scale in ((out.a, coefficients[0], -0.5), (out.b, coefficients[1], 0.5)):
        positions = np.stack([u, v], -1) + scale * field(u, v)
        expected = sample(source, positions)
        seen = np.isfinite(expected)
        whole = seen & (out.valid > 0.999)
        # of 1000, white noise: the steepest there is
        assert np.abs(result - expected)[inner][whole[inner]].max() < 0.3
        low = np.floor(positions + 1e-4).astype(int)
        for dv in (0, 1):
            for du in (0, 1):
                row, column = np.clip(low[..., 1] + dv, 0, 139), np.clip(low[..., 0] + du, 0, 149)
                everything_valid &= valid[row, column] != 0
    if amplitude_px:
        assert np.array_equal(out.valid[inner] > 0.999, everything_valid[inner])
    assert out.valid.max() == 1


def test_row_kernel_as_plain_python():
    rng = np.random.default_rng(5)
    coefficients = rng.normal(size=(12, 16)).astype(np.float32)
    refined = np.broadcast_to(np.linspace(-1.7, 2.6, 16, dtype=np.float32), (2, 5, 16)).copy()
    cell, weight = np.zeros(12, np.int64), np.full((12, 4), 0.25, np.float32)
    results = []
    for kernel in (piv_deform.deform_rows, piv_deform.deform_rows.py_func):
        out, out_valid = np.zeros((12, 16), np.float32), np.ones((12, 16), np.float32)
        kernel(coefficients, np.ones((12, 16), np.float32), True, refined, cell, weight, np.float32(0.5), 0, 12,
               np.empty((2, 16), np.int32), np.empty((2, 16), np.float32), out, out_valid)  # fmt: skip
        results.append((out, out_valid))
    assert np.abs(results[0][0] - results[1][0]).max() < 1e-5
    assert np.abs(results[0][1] - results[1][1]).max() < 1e-6


def test_runs_of_any_length_are_the_spline_at_their_place():
    rng = np.random.default_rng(6)
    coefficients = rng.normal(size=(20, 90)).astype(np.float32)
    place = np.arange(90, dtype=np.float32)
    refined = np.empty((2, 4, 90), np.float32)
    refined[0], refined[1] = 0.0015 * (place - 30.0) ** 2 - 1.3, 2.2 * np.sin(place / 6.0)  # runs of 1 to 20 px
    cell, weight = np.zeros(20, np.int64), np.full((20, 4), 0.25, np.float32)
    out, out_valid = np.full((20, 90), np.nan, np.float32), np.ones((20, 90), np.float32)
    offset, fraction = np.empty((2, 90), np.int32), np.empty((2, 90), np.float32)
    for row in range(20):
        piv_deform.deform_rows(
            coefficients, out_valid, False, refined, cell, weight, np.float32(1.0), row, row + 1,
            offset, fraction, out, out_valid,
        )  # fmt: skip
        for k in range(90):
            u, v = (start + offset[n, k] + fraction[n, k] for n, start in enumerate((k, row)))
            value = quintic_at(coefficients, u, v)
            assert out[row, k] == pytest.approx(value if value == value else 0.0, abs=2e-5), (row, k)
            assert out_valid[row, k] == (value == value), (row, k)


@pytest.mark.parametrize("size", [40, 700])  # one window, and so many that shares of far ones are next to nothing
def test_a_matrix_interpolates_as_the_spline(size):
    grid = window_grid((size, size), 32, 0.5)
    nodes, places = grid.x_px[: 1 if size == 40 else None], np.arange(0.5, size, 2.0)
    field = np.random.default_rng(3).normal(size=(len(nodes), 5))
    expected = interpolate(field, 0, nodes, places, grid.step_px)
    matrix = interpolation_matrix(nodes, places, grid.step_px)
    assert np.abs(matrix @ field.astype(np.float32) - expected).max() < 1e-5 * np.abs(expected).max()
    assert not ((matrix != 0.0) & (np.abs(matrix) < np.finfo(np.float32).tiny)).any()


def test_windows_lose_the_mean_of_valid_pixels_only():
    rng = np.random.default_rng(7)
    frames = rng.uniform(100, 4000, (2, 40, 40)).astype(np.float32)
    valid = (rng.uniform(size=(40, 40)) > 0.3).astype(np.uint8)
    valid[:8, :8] = 1
    rows, columns = np.array([0, 9, 30]), np.array([0, 4, 30])
    valid[30:38, 30:38] = 0
    for kernel in (piv_windows.cut_windows, piv_windows.cut_windows.py_func):
        a, b = np.empty((2, 3, 8, 8), np.float32)
        count, energy = np.empty(3, np.int64), np.empty(3)
        kernel(*frames, valid, rows, columns, 5, 0.0, np.empty((2, 8), np.float32), count, energy, a, b)
        for n in range(2):
            mask = valid[rows[n] :, columns[n] :][:8, :8] != 0
            parts = [frame[rows[n] :, columns[n] :][:8, :8].astype(float) for frame in frames]
            expected = [np.where(mask, part - part[mask].mean(), 0) for part in parts]
            assert np.abs(a[n] - expected[0]).max() < 2e-3
            assert np.abs(b[n] - expected[1]).max() < 2e-3
            assert count[n] == mask.sum()
            root = np.sqrt((expected[0] ** 2).sum() * (expected[1] ** 2).sum())
            assert energy[n] == pytest.approx(root, rel=1e-5)
        assert (count[2], energy[2], np.abs(a[2]).max()) == (0, 0.0, 0.0)


def test_peak_and_second_peak_of_a_drawn_plane():
    v, u = np.mgrid[:32, :32]

    def bump(height, x, y):
        return height * np.exp(-((u - x) ** 2 + (v - y) ** 2) / 3.0)

    a = bump(1.0, 14.0, 14.0) + bump(0.8, 8.0, 21.0)
    b = bump(1.0, 16.3, 12.6) + bump(0.8, 10.3, 19.6)
    pair = [(w - w.mean()).astype(np.float32)[None] for w in (a, b)]
    planes = np.empty((1, 32, 32), np.float32)
    correlation_planes(*pair, workspace(32), planes)
    local = (planes[0] == ndimage.maximum_filter(planes[0], 3, mode="wrap")) * planes[0]
    heights = np.sort(local[local > 0])[::-1]

    def shared(du, dv):
        """Mean product over the pixels that both windows share at this displacement."""
        row, column = slice(max(0, -dv), 32 - max(0, dv)), slice(max(0, -du), 32 - max(0, du))
        moved = slice(row.start + dv, row.stop + dv), slice(column.start + du, column.stop + du)
        return np.mean(pair[0][0, row, column].astype(float) * pair[1][0][moved])

    def vertex(three):
        square, linear, _ = np.polyfit([-1, 0, 1], np.log(three), 2)
        return -linear / (2 * square)

    for kernel in (piv_windows.find_peaks, piv_windows.find_peaks.py_func):
        out = np.empty((1, 4))
        kernel(planes, *pair, np.array([1.0]), True, np.empty((2, 32), np.float32), out)
        assert out[0, 0] == pytest.approx(2 + vertex([shared(k, -1) for k in (1, 2, 3)]), abs=1e-4)
        assert out[0, 1] == pytest.approx(-1 + vertex([shared(2, k) for k in (-2, -1, 0)]), abs=1e-4)
        assert out[0, 2] == pytest.approx(heights[0], rel=1e-6)
        assert out[0, 3] == pytest.approx(heights[0] / heights[1], rel=1e-5)


def test_three_points_is_exact_for_a_gaussian_and_sane_without_logarithm():
    for kernel in (piv_windows.three_points, piv_windows.three_points.py_func):
        samples = [np.exp(-((k - 0.37) ** 2) / 2.5) for k in (-1, 0, 1)]
        assert kernel(*samples) == pytest.approx(0.37, abs=1e-12)
        assert kernel(-0.5, 1.0, 0.5) == pytest.approx(0.25)
        assert kernel(1.0, 1.0, 1.0) == 0.0
        assert kernel(3.0, 1.0, 0.5) == 0.0
        assert -1.0 <= kernel(0.99, 1.0, 0.01) <= 1.0


def test_median_residual_equals_numpy_medians():
    rng = np.random.default_rng(9)
    field = rng.normal(size=(9, 8, 2))
    usable = rng.uniform(size=(9, 8)) > 0.2
    everything = np.ones((9, 8), bool)
    for kernel in (piv_median.median_residual, piv_median.median_residual.py_func):
        residual = np.full((9, 8), -1.0)
        kernel(field, usable, everything, 2, 0.1, 0.0, 5, 0, 9, np.empty(25), residual)
        for j, i in [(0, 0), (4, 4), (8, 3), (3, 7)]:
            near = usable.copy()
            near[j, i] = False
            near[[k for k in range(9) if abs(k - j) > 2]] = False
            near[:, [k for k in range(8) if abs(k - i) > 2]] = False
            median = np.median(field[near], axis=0)
            spread = np.median(np.abs(field[near] - median), axis=0) + 0.1
            assert residual[j, i] == pytest.approx(np.hypot(*((field[j, i] - median) / spread)))


def test_where_all_neighbours_are_near_nothing_is_sorted_and_nothing_changes():
    """The residual of a vector that is skipped is below the threshold: the median is as near as its neighbours."""
    rng = np.random.default_rng(11)
    field = rng.normal(0, 0.08, (40, 40, 2))
    field[::7, ::7] += rng.normal(0, 0.6, field[::7, ::7].shape)
    usable = rng.uniform(size=(40, 40)) > 0.1
    exact, skipped = np.full((2, 40, 40), np.nan)
    for near, out in ((0.0, exact), (0.3, skipped)):
        piv_median.median_residual(field, usable, usable, 2, 0.1, near, 5, 0, 40, np.empty(25), out)
    was_skipped = skipped == 0.0
    assert 100 < was_skipped.sum() < 1200
    assert exact[was_skipped].max() <= 3.0
    assert np.array_equal(exact[~was_skipped], skipped[~was_skipped], equal_nan=True)
    for j, i in [(0, 0), (20, 20)]:
        assert piv_median.farthest.py_func(field, usable, 2, j, i) == piv_median.farthest(field, usable, 2, j, i)


def test_grid_lines_refined_along_u_equal_the_interpolation():
    rng = np.random.default_rng(12)
    nodes, target = np.arange(6) * 16.0 + 15.5, np.arange(112.0)
    field = rng.normal(size=(4, 6, 2))
    lines, cell, weight = around(field, 1, nodes, target, 16)
    expected = np.moveaxis(interpolate(field, 1, nodes, target, 16), -1, 0)
    for kernel in (piv_deform.refine_lines, piv_deform.refine_lines.py_func):
        out = np.empty((2, 4, 112), np.float32)
        kernel(np.ascontiguousarray(lines), cell, weight, out)
        assert np.abs(out - expected).max() < 1e-6


def test_outliers_are_found_alone_in_clusters_and_at_edges_but_gradients_are_not():
    y, x = np.mgrid[:20, :24]
    field = np.stack([1.5 * y + 0.2 * x, 0.3 * x - 0.9 * y], -1)  # px a node: far beyond epsilon
    field += np.random.default_rng(1).normal(0, 0.01, field.shape)
    everything = np.ones((20, 24), bool)
    assert not outliers(field, everything, 2.0, 0.1).any()
    wrong = np.zeros_like(everything)
    wrong[[5, 5, 6, 12, 0, 19], [5, 6, 5, 12, 10, 23]] = True
    field[wrong] += (7.0, -5.0)
    assert np.array_equal(outliers(field, everything, 2.0, 0.1), wrong)


def test_gaps_are_filled_along_the_gradient():
    y, x = np.mgrid[:16, :16]
    field = np.stack([1.5 * y + 0.2 * x, 0.3 * x - 0.9 * y], -1).astype(float)
    valid = np.hypot(x - 6, y - 8) < 5
    fill, near = fill_gaps(np.where(valid[..., None], field, np.nan), valid)
    assert np.array_equal(fill[valid], field[valid])
    ring = near & ~valid
    assert ring.any()
    assert np.abs(fill[ring] - field[ring]).max() < 0.35  # a nearest value is off by 1.5 and more
    assert np.isfinite(fill).all()
    assert not near[0, 15]


def test_smoothing_keeps_planes_and_damps_noise():
    y, x = np.mgrid[:30, :30]
    plane = np.stack([0.4 * y - 0.2 * x, 0.1 * x], -1)
    valid = np.ones((30, 30), bool)
    valid[10:14, 10:14] = False
    assert np.abs(smooth_field(plane, valid, 1.0) - plane).max() < 0.03
    noise = np.random.default_rng(2).normal(size=(30, 30, 2))
    assert smooth_field(noise, valid, 1.0)[4:-4, 4:-4].std() < 0.45


def test_interpolation_between_nodes_is_exact_for_quadratics_and_continues_linearly():
    nodes = np.arange(24) * 16.0 + 15.5
    inside = np.linspace(nodes[8], nodes[-9], 50)  # what straight ends do has decayed by 0.27 a node
    values = 0.01 * nodes**2 - nodes
    assert interpolate(values, 0, nodes, inside, 16) == pytest.approx(0.01 * inside**2 - inside, abs=1e-4)
    nodes = nodes[:8]
    outside = np.array([0.0, 7.0, 140.0])
    assert interpolate(3 * nodes + 1, 0, nodes, outside, 16) == pytest.approx(3 * outside + 1)
    two = interpolate(np.array([4.0, 6.0]), 0, np.array([15.5, 31.5]), np.array([7.5, 15.5, 23.5, 39.5]), 16)
    assert two == pytest.approx([3.0, 4.0, 5.0, 7.0])
    values = np.random.default_rng(3).normal(size=8)
    assert interpolate(values, 0, nodes, nodes, 16) == pytest.approx(values)
    one = interpolate(np.array([4.0]), 0, np.array([15.5]), np.arange(32.0), 16)
    assert one == pytest.approx(np.full(32, 4.0))


def test_windows_are_centred_in_the_frame():
    grid = window_grid((100, 70), 32, 0.5)
    assert grid.row.tolist() == [2, 18, 34, 50, 66]
    assert grid.column.tolist() == [3, 19, 35]
    assert grid.y_px[0] == 17.5


def test_planes_through_gaps_and_past_edges_are_those_of_least_squares():
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:17, :21].astype(float)
    field = np.stack([3.0 * x - y + rng.normal(size=x.shape), 40.0 + 0.2 * y + rng.normal(size=x.shape)], -1)
    valid = rng.uniform(size=x.shape) > 0.3
    trust = rng.uniform(0.5, 1.5, x.shape)
    found = smooth_field(field, valid, 2.0, 1, trust)
    for j, i in ((0, 0), (8, 10), (16, 3), (5, 20)):
        weight = np.where(valid, trust, 0.0) * np.exp(-((x - i) ** 2 + (y - j) ** 2) / 8.0)
        weight[np.maximum(abs(x - i), abs(y - j)) > 8] = 0.0
        # The ridge is a pull of both slopes to zero.
        design = np.stack([np.ones_like(x), x - i, y - j], -1).reshape(-1, 3)
        moments = (design.T * weight.ravel()) @ design + weight.sum() * RIDGE * np.diag([0.0, 1.0, 1.0])
        for axis in range(2):
            right = (design.T * weight.ravel()) @ field[..., axis].ravel()
            assert found[j, i, axis] == pytest.approx(np.linalg.solve(moments, right)[0], abs=1e-4)
