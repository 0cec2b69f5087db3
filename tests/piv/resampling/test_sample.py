import numpy as np
import pytest
from scipy import ndimage, special

from ground.jit import kernel
from piv.errors import FrameError
from piv.resampling.kernels import bspline, lanes
from piv.resampling.kernels import prefilter as kernels
from piv.resampling.sample import filter_tiles, prefilter, sample, tile_grid


def speckle(shape, dtype, seed=3):
    rng = np.random.default_rng(seed)
    top = np.iinfo(dtype).max if np.issubdtype(dtype, np.integer) else 4095.0
    return (rng.uniform(0, 1, shape) * top).astype(dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(61, 83), (4, 70), (33, 5)])
def test_quintic_equals_scipy_up_to_and_on_the_border(dtype, shape):
    frame = speckle(shape, dtype)
    height, width = shape
    rng = np.random.default_rng(7)
    positions = rng.uniform(0, 1, (4000, 2)) * (width - 1, height - 1)
    positions[:4] = [(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)]
    expected = ndimage.map_coordinates(frame.astype(float), positions[:, ::-1].T, order=5, mode="mirror")
    values = sample(prefilter(frame), positions)
    assert values.dtype == np.float32
    assert np.abs(values - expected).max() <= 3e-6 * float(frame.max())


def test_bilinear_equals_scipy_with_the_same_positions_to_the_last_bits():
    frame = speckle((40, 50), np.uint16)
    positions = np.random.default_rng(1).uniform(0, 1, (30, 20, 2)) * (49, 39)
    expected = ndimage.map_coordinates(frame.astype(float), np.moveaxis(positions[..., ::-1], -1, 0), order=1)
    values = sample(frame, positions, "bilinear")
    assert values.shape == (30, 20)
    assert np.abs(values - expected).max() <= 0.02  # of 65535


def test_positions_are_not_rounded_to_a_fraction_of_a_pixel():
    frame = speckle((20, 20), np.uint16)
    steps = np.linspace(8.0, 9.0, 1025)
    positions = np.stack([steps, np.full_like(steps, 9.3)], -1)
    for method, image in (("bilinear", frame), ("quintic", prefilter(frame))):
        assert len(np.unique(sample(image, positions, method))) > 1000


@pytest.mark.parametrize("degree", range(6))
def test_polynomials_up_to_the_fifth_degree_are_reproduced(degree):
    v, u = np.mgrid[0:100, 0:110]

    def polynomial(x, y):
        x, y = (x - 50) / 40, (y - 45) / 40
        return sum((k + 1) * x**k * y ** (degree - k) for k in range(degree + 1))

    # Values that are small in the middle keep float32 rounding far below the claim.
    coefficients = prefilter(polynomial(u, v).astype(np.float32))
    positions = np.random.default_rng(5).uniform(32, 68, (3000, 2))  # beyond the reach of the mirrored border
    error = sample(coefficients, positions) - polynomial(positions[:, 0], positions[:, 1])
    assert np.abs(error).max() < 1e-5


def particle(u, v, diameter_px, size=41):
    """Pixel-integrated Gaussian, e^-2 diameter; the integral over a pixel is a difference of erf."""
    edges = (np.arange(size + 1) - 0.5)[:, None]
    scale = np.sqrt(2.0) * diameter_px / 4
    along_v = np.diff(special.erf((edges - v) / scale), axis=0)
    along_u = np.diff(special.erf((edges - u) / scale), axis=0)
    return 3000.0 * along_v @ along_u.T


@pytest.mark.parametrize("diameter_px", [2.5, 3.0])
def test_the_centroid_of_a_particle_survives_a_subpixel_shift(diameter_px):
    rng = np.random.default_rng(11)
    errors = []
    rows, columns = np.mgrid[-5:6, -5:6]
    for _ in range(200):
        u, v = rng.uniform(19.5, 20.5, 2)
        shift = rng.uniform(-0.5, 0.5, 2)
        grid = np.stack([20 + columns + shift[0], 20 + rows + shift[1]], -1)
        values = sample(prefilter(particle(u, v, diameter_px).astype(np.float32)), grid).astype(float)
        errors.append((values * grid[..., 0]).sum() / values.sum() - u)
        errors.append((values * grid[..., 1]).sum() / values.sum() - v)
    assert np.sqrt(np.mean(np.square(errors))) <= 0.003


def test_outside_the_frame_is_nan_and_the_outermost_pixel_centres_are_inside():
    frame = speckle((12, 15), np.uint8)
    inside = np.array([[0.0, 0.0], [14.0, 11.0]])
    outside = np.array([[-1e-9, 5], [14.0000001, 5], [5, 11.0000001], [np.nan, 5], [5, np.inf], [-1e30, 5]])
    for method, image in (("bilinear", frame), ("quintic", prefilter(frame))):
        assert np.isnan(sample(image, outside, method)).all()
        assert np.isfinite(sample(image, inside, method)).all()


def test_bits_do_not_depend_on_the_number_of_threads():
    frame = speckle((130, 150), np.uint16)
    positions = np.random.default_rng(2).uniform(0, 129, (70000, 2))
    coefficients = prefilter(frame, threads=1)
    assert np.array_equal(coefficients, prefilter(frame, threads=3))
    assert np.array_equal(sample(coefficients, positions, threads=1), sample(coefficients, positions, threads=3))


def test_prefilter_writes_into_the_given_buffer():
    frame = speckle((30, 31), np.uint16)
    out = np.empty((30, 31), np.float32)
    assert prefilter(frame, out) is out
    assert np.array_equal(out, prefilter(frame))


def test_kernels_as_plain_python_agree_with_the_compiled_ones():
    frame = speckle((9, 10), np.uint8)
    coefficients = prefilter(frame)
    for u, v in [(0.0, 0.0), (4.3, 4.6), (8.9, 7.99), (9.0, 8.0), (-1.0, 2.0)]:
        for function, image in ((bspline.quintic_at, coefficients), (bspline.bilinear_at, frame)):
            assert function.py_func(image, u, v) == pytest.approx(function(image, u, v), rel=1e-5, nan_ok=True)
    line = speckle((30 + 2 * kernels.SPREAD,), np.float32)
    results = []
    for function in (kernels.filter_line, kernels.filter_line.py_func):
        results.append(np.empty(30, np.float32))
        function(line.copy(), line.copy(), results[-1])
    assert np.abs(results[0] - results[1]).max() <= 1e-6 * 4095


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_hand_written_vectors_do_what_their_definitions_say(dtype):
    flat = speckle((200,), dtype)
    coefficients, weights = flat.astype(np.float32), speckle((7,), np.float32) / np.float32(4095)

    @kernel
    def both(flat, coefficients, w, out, pair):
        out[0] = lanes.footprint_sum(coefficients, 7, 20, w[0], (w[1], w[2], w[3], w[4], w[5], w[6]))
        lanes.copy_pair(flat, 11, pair, 1)

    found, pair = np.zeros(1, np.float32), np.zeros(4, dtype)
    both(flat, coefficients, weights, found, pair)
    expected = lanes.footprint_sum(coefficients, 7, 20, weights[0], weights[1:])
    assert found[0] == pytest.approx(expected, rel=1e-6)
    assert pair.tolist() == [0, flat[11], flat[12], 0]
    taps = [bspline.weight_outer, bspline.weight_middle, bspline.weight_inner]
    s = np.float32(0.3)
    beta = [tap(s) for tap in taps] + [tap(np.float32(1) - s) for tap in taps[::-1]]
    assert [np.polyval(column[::-1], 0.3) for column in np.transpose(lanes.TAP_POLYNOMIALS)] == pytest.approx(
        [*beta, 0.0, 0.0], abs=2e-7
    )


def test_a_tile_has_the_same_bits_whether_others_are_filtered_or_not():
    frame, rim = speckle((300, 1100), np.uint16), 2
    shape = (304, 1106)
    tiles = tile_grid(shape)
    assert tiles.shape[:2] == (3, 3)
    whole, some = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    filter_tiles(frame, rim, tiles.reshape(-1, 4), whole)
    filter_tiles(frame, rim, tiles[1, 1:], some)
    top, left, bottom, _ = tiles[1, 1]
    assert np.array_equal(some[top:bottom, left:], whole[top:bottom, left:])
    assert not some[:, :left].any()
    assert np.abs(whole[rim:302, rim:1102] - prefilter(frame)).max() <= 1e-6 * 65535
    assert whole[:2] == pytest.approx(whole[4:2:-1], abs=0.1)  # mirrored at the outermost pixel centres


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (np.zeros((8, 8, 3), np.uint8), "2-D"),
        (np.zeros((3, 8), np.uint8), "at least 4 x 4"),
        (np.zeros((8, 8), np.int32), "int32"),
        (np.array([[0, 1, 2, np.nan]] * 4, np.float32), "4 of 16 pixels"),
        (np.array([[0, 1, 2, np.inf]] * 4), "4 of 16 pixels"),
    ],
)
def test_bad_frames_are_named(frame, words):
    with pytest.raises(FrameError, match=words):
        prefilter(frame)


def test_bad_calls_are_named():
    frame = speckle((8, 8), np.uint8)
    with pytest.raises(FrameError, match="last axis"):
        sample(frame, np.zeros((4, 3)), "bilinear")
    with pytest.raises(FrameError, match="not 'cubic'"):
        sample(frame, np.zeros((4, 2)), "cubic")
    with pytest.raises(FrameError, match="coefficients"):
        sample(frame, np.zeros((4, 2)))
    with pytest.raises(FrameError, match="float32 array of shape"):
        prefilter(frame, np.empty((8, 8)))
