import math

import numpy as np
import pytest
import tifffile

from correction.target import Chessboard
from correction.target.corners import CornerReason, find_smeared, fraction_saturated, refine_corners
from correction.target.kernels import corner_block, corner_model
from piv.errors import FrameError
from tests.correction.frame_truth import FRAMES, true_projection
from tests.correction.synthetic_board import photographed, soft_board
from tests.correction.target.corner_by_pixel import gradient
from tests.slow_cases import slow_but

SQUARE = 2.5


def affine(matrix, origin):
    """Pixel -> board of an affine view: board = matrix^-1 (pixel - origin)."""
    inverse = np.linalg.inv(matrix)
    return lambda pixels: (pixels - origin) @ inverse.T


def corners_in(matrix, origin, shape, margin):
    index = np.stack(np.meshgrid(np.arange(-60, 61), np.arange(-60, 61)), -1).reshape(-1, 2)
    pixel = index * SQUARE @ np.array(matrix).T + origin
    inside = ((pixel > margin) & (pixel < np.array(shape)[::-1] - 1 - margin)).all(1)
    return index[inside], pixel[inside]


VIEWS = {
    "upright": [[12.4, 0.3], [0.2, -12.4]],
    "turned": [[9.1, 8.0], [8.2, -9.0]],
    "inverted": [[-10.0, 1.0], [0.5, 10.5]],
    "mirrored": [[11.0, 1.0], [1.5, 10.0]],
    "stretched": [[24.0, 4.0], [3.0, -7.0]],
    "sheared": [[12.0, 7.0], [0.0, -10.0]],
    "small": [[4.0, 0.7], [0.6, -4.1]],
}


@pytest.mark.parametrize("name", slow_but(VIEWS, "upright", "sheared"))
def test_noise_free_corners_are_exact_and_noisy_ones_as_good_as_they_say(name):
    matrix, origin, shape = np.array(VIEWS[name]), np.array((150.3, 161.7)), (320, 320)
    clean = soft_board(affine(matrix, origin), shape)
    index, true = corners_in(matrix, origin, shape, 26 if name == "stretched" else 18)
    rng = np.random.default_rng(4)
    start = true + rng.uniform(-0.7, 0.7, true.shape)
    sign = Chessboard().corner_sign(index)
    axes = matrix * SQUARE
    exact = refine_corners(clean, start, axes, sign=sign)
    assert exact.valid.all(), exact.counts()
    assert np.abs(exact.position_px - true).max() < (0.02 if name == "small" else 0.004)
    errors, sigmas = [], []
    for seed in range(4):
        fit = refine_corners(photographed(clean, seed), start, axes, sign=sign)
        assert fit.valid.mean() > 0.99, fit.counts()
        errors.append((fit.position_px - exact.position_px)[fit.valid])
        sigmas.append(fit.sigma_px[fit.valid])
    error, sigma = np.concatenate(errors), np.concatenate(sigmas)
    assert error.std() < 0.02
    assert 0.9 < (error / sigma).std() < 1.15


def test_start_may_be_a_sixth_of_a_square_off():
    matrix, origin, shape = np.array(VIEWS["upright"]), np.array((150.3, 161.7)), (320, 320)
    image = photographed(soft_board(affine(matrix, origin), shape), 1)
    index, true = corners_in(matrix, origin, shape, 22)
    far = true + np.random.default_rng(2).uniform(-5.0, 5.0, true.shape)
    fit = refine_corners(image, far, matrix * SQUARE, sign=Chessboard().corner_sign(index))
    assert fit.valid.mean() > 0.97, fit.counts()
    assert np.abs(fit.position_px - true)[fit.valid].max() < 0.05


def test_bent_edges_and_a_shadow_do_not_pull_on_the_corner():
    """Lattice lines bent by 1.5 px in a square, light falling by 40 % over the image."""
    shape, pitch = (400, 400), 40.0

    def to_board(pixels):
        x, y = (pixels[..., 0] - 203.3) / pitch, (pixels[..., 1] - 196.6) / pitch
        return SQUARE * np.stack((x + 0.02 * y * y + 0.01 * x * y, -y + 0.025 * x * x), -1)

    index = np.stack(np.meshgrid(np.arange(-3, 4), np.arange(-3, 4)), -1).reshape(-1, 2)
    true = np.empty((len(index), 2))
    for n, want in enumerate(index * SQUARE):  # Newton with difference quotients
        p = np.array((203.3 + want[0] / SQUARE * pitch, 196.6 - want[1] / SQUARE * pitch))
        for _ in range(30):
            slope = np.column_stack([(to_board(p + e) - to_board(p - e)) / 0.02 for e in np.eye(2) * 0.01])
            p = p - np.linalg.solve(slope, to_board(p) - want)
        true[n] = p
    light = 1.0 - 0.001 * np.arange(400)[None, :]
    image = soft_board(to_board, shape) * light
    axes = np.array([[pitch, 0.0], [0.0, -pitch]])
    fit = refine_corners(image, true + 0.6, axes, sign=Chessboard().corner_sign(index))
    assert fit.valid.all(), fit.counts()
    assert np.abs(fit.position_px - true).max() < 0.01


@pytest.mark.parametrize("blur_px", [0.6, 1.2, 2.0])
def test_blur_moves_no_corner_whose_edges_bend_and_lean_in_falling_light(blur_px):
    """As near a rim: squares of 30 px, edges at 65 degrees, bent to a radius of 67 px, light falling 2 % a px."""
    shape, origin = (150, 160), np.array((81.3, 74.6))
    inverse = np.linalg.inv([[30.0, 14.0], [2.0, -27.0]])

    def to_board(pixels):
        off = pixels - origin
        x, y = np.moveaxis(off @ inverse.T, -1, 0)
        bend = (off**2).sum(axis=-1) / 120.0
        return SQUARE * np.stack((x + bend * 0.03, y + bend * 0.02), -1)

    frame = soft_board(to_board, shape, blur_px=blur_px, light=lambda pixels: np.exp(-0.02 * pixels[..., 0]))
    axes = np.linalg.inv(inverse)
    fit = refine_corners(frame, origin[None] + 0.4, axes, sign=[-1], window=0.3)
    assert fit.valid.all(), fit.counts()
    assert np.abs(fit.position_px - origin).max() < 0.012


def test_refusals_carry_their_reason():
    matrix, origin, shape = np.array(VIEWS["upright"]), np.array((150.0, 160.0)), (320, 320)
    image = photographed(soft_board(affine(matrix, origin), shape), 3)
    axes, good = matrix * SQUARE, np.array((150.0, 160.0))
    one_off = good + axes[:, 0]
    mask = np.ones(shape, bool)
    mask[:, :100] = False
    starts = np.array([good, (1.0, 160.0), one_off, good - 2 * axes[:, 0], (np.nan, 3.0)])
    fit = refine_corners(image, starts, axes, sign=[-1] * 5, mask=mask)
    expected = [CornerReason.OK, CornerReason.EDGE, CornerReason.INVERTED, CornerReason.MASKED, CornerReason.SMALL]
    assert fit.reason.tolist() == expected
    assert fit.counts() == {"OK": 1, "EDGE": 1, "MASKED": 1, "SMALL": 1, "INVERTED": 1}
    flat = refine_corners(photographed(np.full(shape, 900.0), 5), [good], axes)
    assert not flat.valid[0]
    tiny = refine_corners(image, [good], axes / 12)
    assert tiny.reason[0] == CornerReason.SMALL


def test_windows_shrink_at_the_border_before_a_corner_is_given_up():
    matrix, origin, shape = np.array(VIEWS["upright"]), np.array((5.2, 6.1)), (200, 200)
    image = soft_board(affine(matrix, origin), shape)
    fit = refine_corners(image, [origin + 0.3], matrix * SQUARE, sign=[-1])
    assert fit.valid[0], fit.counts()
    assert np.abs(fit.position_px - origin).max() < 0.03


def test_same_bits_for_any_number_of_threads():
    matrix, origin, shape = np.array(VIEWS["turned"]), np.array((150.3, 161.7)), (320, 320)
    image = photographed(soft_board(affine(matrix, origin), shape), 8)
    _, true = corners_in(matrix, origin, shape, 20)
    true = np.tile(true, (4, 1))
    one, many = (refine_corners(image, true, matrix * SQUARE, threads=n) for n in (1, 4))
    assert np.array_equal(one.position_px, many.position_px)
    assert np.array_equal(one.sigma_px, many.sigma_px)


def test_derivatives_of_the_model_agree_with_differences():
    rng = np.random.default_rng(9)
    p = np.array([0.3, -0.2, 0.1, -1.4, 0.01, -0.02, 0.7, 0.9, 1500.0, 1200.0, 0.003, -0.002, 0.1])
    step = np.array([1e-5] * 8 + [1e-2] * 2 + [1e-6] * 2 + [1e-5])
    row, other, turn = np.empty(13), np.empty(13), np.empty(4)

    def value(q, u, v):
        corner_model.set_turn.py_func(q, turn)
        return gradient(q, turn, u, v, other)

    for u, v in rng.uniform(-4, 4, (60, 2)):
        corner_model.set_turn.py_func(p, turn)
        gradient(p, turn, u, v, row)
        for k in range(13):
            move = np.zeros(13)
            move[k] = step[k]
            slope = (value(p + move, u, v) - value(p - move, u, v)) / (2 * step[k])
            assert row[k] == pytest.approx(slope, rel=2e-4, abs=2e-2)


def drawn_corners(count):
    """Free numbers of some corners, sharp and soft, turned, bent, and pixels (2, LANES) on and off their edges."""
    rng = np.random.default_rng(12)
    for _ in range(count):
        blurs, turn = 10.0 ** rng.uniform(-0.6, 0.5, 2), rng.uniform(-3.0, 3.0)
        angles = turn, turn + rng.choice([-1.0, 1.0]) * rng.uniform(0.9, 2.2)
        p = np.array(
            [*rng.normal(size=2), *angles, *rng.normal(size=2) * 0.02, *blurs, 1500.0, 1200.0, 3e-3, -2e-3, 0.1]
        )
        yield p, rng.uniform(-8.0, 8.0, (2, corner_block.PIXEL_LANES)) * rng.choice([0.2, 1.0, 3.0])


def test_many_pixels_at_once_have_the_derivatives_of_each():
    """To 1e-13 of the largest, of 1200 grey levels: erf and exp here are of the library, there polynomials."""
    turn, row, out = np.empty(4), np.empty(13), np.empty((14, corner_block.PIXEL_LANES))
    for p, pixels in drawn_corners(200):
        corner_model.set_turn(p, turn)
        corner_block.gradients(p, turn, *pixels, out)
        wanted = np.empty_like(out)
        for k, (u, v) in enumerate(pixels.T.tolist()):
            wanted[13, k] = gradient(p, turn, u, v, row)
            wanted[:13, k] = row
        assert (np.abs(out - wanted).max(axis=1) <= 1e-13 * np.abs(wanted).max(axis=1) + 1e-10).all()


def test_polynomials_are_erf_and_exp():
    z = np.linspace(1e-3, corner_model.PLAIN, 5000)
    t = 2.0 * z * z / corner_block.TOP - 1.0
    assert np.abs(np.polyval(corner_block.ERF, t) * z - [math.erf(x) for x in z]).max() < 1e-15
    assert np.abs(np.polyval(corner_block.GAUSS, t) - np.exp(-z * z)).max() < 1e-15


@pytest.mark.parametrize("count", [40, 64, 65, 199])
def test_products_are_those_of_all_pixels_and_of_no_other(count):
    p, _ = next(drawn_corners(1))
    pixels = np.random.default_rng(5).uniform(-6.0, 6.0, (4, count + corner_block.PIXEL_LANES))
    pixels[:, count:] = np.nan
    turn, row, jacobian = np.empty(4), np.empty(13), np.empty((count, 14))
    corner_model.set_turn(p, turn)
    for k in range(count):
        jacobian[k, 13] = pixels[2, k] - gradient(p, turn, pixels[0, k], pixels[1, k], row)
        jacobian[k, :13] = row
    sums, block = np.full((14, 16), np.nan), np.empty((14, corner_block.PIXEL_LANES))
    corner_block.products(p, pixels, count, turn, block, np.zeros((corner_block.PIXEL_LANES, 16)), sums)
    wanted = jacobian.T @ jacobian
    scale = np.sqrt(np.outer(wanted.diagonal(), wanted.diagonal()))
    assert (np.abs(sums[:, :14] - wanted) <= 1e-13 * scale).all()


@pytest.mark.parametrize("squares_px", [12.0, 22.0, 35.0])
def test_a_smeared_corner_is_as_blurred_as_it_is_found_in_a_frame(squares_px):
    turn, way, spread, count = 0.3, 1.0, 0.4, 12
    axes = squares_px * np.array([[np.cos(turn), -np.sin(turn)], [-np.sin(turn), -np.cos(turn)]])
    steps = np.sqrt(12.0) * spread * ((np.arange(count) + 0.5) / count - 0.5)[:, None]
    steps = steps * [np.cos(way), np.sin(way)]
    matrix, shape, origin = axes / SQUARE, (90, 90), np.array([44.8, 45.3])
    light = [soft_board(affine(matrix, origin + step), shape) for step in (np.zeros(2), *steps)]
    alone, seen = (
        refine_corners(image, origin[None] + 0.2, axes[None], window=0.42).blurs_px[0] ** 2
        for image in (light[0], np.mean(light[1:], axis=0))
    )
    share = np.full((count, 1), 1.0 / count)
    own = np.array([np.sqrt(alone.mean())])
    _, blurs = find_smeared(axes[None], np.array([0.42]), own, steps[:, None], share)
    found = blurs[0] ** 2
    np.testing.assert_allclose(found - alone.mean(), seen - alone, atol=0.15 * spread**2)


def test_frames_that_are_none_are_refused():
    with pytest.raises(FrameError, match="NaN"):
        refine_corners(np.full((20, 20), np.nan), [(9, 9)], np.eye(2) * 9)
    with pytest.raises(FrameError, match="mask"):
        refine_corners(np.zeros((20, 20)), [(9, 9)], np.eye(2) * 9, mask=np.ones((3, 3), bool))


def test_saturation_is_seen_only_at_the_full_scale_of_a_camera():
    frame = np.full((10, 10), 1000, np.uint16)
    assert fraction_saturated(frame) == 0.0
    frame[:3] = 4095
    assert fraction_saturated(frame) == pytest.approx(0.3)
    assert fraction_saturated(frame.astype(np.float32)) == 0.0


SUPPLIED = [("two_spheres", "target_clear", 0.0, 0.019)]
MORE = [("one_sphere", "target_clear", 0.0, 0.027)]
MORE += [("two_spheres", f"target_clear_z{z:+d}mm", float(z), 0.0205) for z in (-20, 20)]
SUPPLIED += [pytest.param(*each, marks=pytest.mark.slow) for each in MORE]


@pytest.mark.parametrize(("scene", "name", "plane_z_mm", "limit_px"), SUPPLIED)
def test_supplied_bare_boards(scene, name, plane_z_mm, limit_px):
    path = FRAMES / scene / f"{name}.tif"
    if not path.exists():
        pytest.skip(f"supplied frame {scene}/{name} is not here")
    project, board = true_projection(scene, plane_z_mm), Chessboard()
    index = board.corners_within([(-85, -85), (85, 85)])
    true = project(board.corner_mm(index))
    inside = ((true > 10) & (true < 2005)).all(1)
    index, true = index[inside], true[inside]
    mm = board.corner_mm(index)
    axes = np.stack([project(mm + e) - project(mm - e) for e in np.eye(2) * SQUARE / 2], -1)
    start = true + np.random.default_rng(1).uniform(-0.5, 0.5, true.shape)
    fit = refine_corners(tifffile.imread(path), start, axes, sign=board.corner_sign(index))
    error = (fit.position_px - true)[fit.valid]
    assert fit.valid.mean() > 0.985, fit.counts()
    assert np.abs(error.mean(axis=0)).max() < 0.001
    assert error.std(axis=0).max() < limit_px
