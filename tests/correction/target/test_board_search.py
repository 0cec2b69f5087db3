from functools import cache

import numpy as np
import pytest
import tifffile

from correction.errors import TargetNotFound
from correction.target import Chessboard
from correction.target.board_search import find_board, track_board
from correction.target.lattice_growth import find_saddles, grow_patches
from correction.target.smooth_view import as_the_largest_piece_says, on_smooth_map
from piv.errors import FrameError
from tests.correction.frame_truth import FRAMES, nominal_projection, true_projection
from tests.correction.synthetic_board import photographed, soft_board
from tests.slow_cases import slow
from tracer.board import CHIRAL, OLDER

BOARD = Chessboard()
SHAPE = (420, 460)


@cache
def view(turn_deg=3.0, tilt=0.0, barrel=0.0, px_per_mm=9.0, centre=(231.4, 208.7)):
    """Pixel -> board through barrel distortion, perspective, turn; board upright at turn 0."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))

    def to_board(pixels):
        p = (np.asarray(pixels, float) - centre) / 230.0
        p = p * (1.0 + barrel * (p[..., :1] ** 2 + p[..., 1:] ** 2))
        p = p / (1.0 + tilt * p[..., :1])
        x, y = p[..., 0] * 230.0 / px_per_mm, -p[..., 1] * 230.0 / px_per_mm
        return np.stack((c * x + s * y, -s * x + c * y), -1)

    return to_board


@cache
def painted(to_board, **kwargs):
    return soft_board(to_board, SHAPE, discs=BOARD.discs, **kwargs)


def rendered(to_board, seed=0, **kwargs):
    return photographed(painted(to_board, **kwargs), seed)


def miss_mm(found, to_board):
    return np.abs(to_board(found.position_px) - found.plane_mm).max()


@pytest.mark.parametrize("turn_deg", [137.0, *map(slow, (0.0, 31.0, 90.0, 180.0, 269.0))])
def test_any_turn_is_found_with_the_right_index(turn_deg):
    to_board = view(turn_deg)
    found = find_board(rendered(to_board), BOARD)
    assert len(found) > 250
    assert miss_mm(found, to_board) < 0.04 / 9.0 * 2
    along = to_board(found.position_px + found.axes_px[:, :, 0]) - found.plane_mm
    assert np.abs(along - (2.5, 0.0)).max() < 0.1


@pytest.mark.parametrize(
    "how", [{"tilt": -0.2, "barrel": 0.1}, *map(slow, ({"tilt": 0.25}, {"barrel": 0.12}, {"barrel": -0.08}))]
)
def test_perspective_and_distortion(how):
    to_board = view(17.0, **how)
    found = find_board(rendered(to_board, 1), BOARD)
    assert len(found) > 200
    assert miss_mm(found, to_board) < 0.012


def test_a_board_that_ends_inside_the_frame():
    to_board = view(12.0)
    image = soft_board(to_board, SHAPE, discs=BOARD.discs)
    here = to_board(np.stack(np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0])), -1))
    outside = (np.abs(here) > 11.25).any(-1)
    found = find_board(photographed(np.where(outside, 1500.0, image), 2), BOARD)
    assert miss_mm(found, to_board) < 0.01
    assert 60 <= len(found) <= 81
    assert np.abs(found.index).max() == 4


def test_dirt_and_a_hand_over_a_part_of_the_board():
    to_board = view(-8.0)
    image = rendered(to_board, 3).astype(float)
    image[250:420, 300:460] = 700.0
    rng = np.random.default_rng(5)
    for u, v in rng.uniform(10, 410, (25, 2)).astype(int):
        image[v : v + 4, u : u + 4] = 200.0
    found = find_board(image.astype(np.uint16), BOARD)
    error = np.abs(to_board(found.position_px) - found.plane_mm).max(axis=1) * 9.0
    assert len(found) > 120
    assert np.median(error) < 0.02
    assert error.max() < 0.6  # a spot on an edge moves that corner, not its index


def test_a_mask_keeps_everything_out_of_it():
    to_board = view()
    mask = np.ones(SHAPE, bool)
    mask[:, 330:] = False
    found = find_board(rendered(to_board), BOARD, mask)
    assert found.position_px[:, 0].max() < 328
    with pytest.raises(FrameError, match="mask"):
        find_board(rendered(to_board), BOARD, mask[:-1])


@pytest.mark.parametrize(("east", "north"), [(17.5, -10.0), slow(4.0, -4.0), slow(0.0, 0.0), slow(5.0, 0.0)])
def test_discs_put_a_prediction_right_that_is_squares_off(east, north):
    to_board = view(2.0)

    def predict(points):
        return (231.4, 208.7) + 9.0 * (points[:, :2] + np.array((east, north))) * (1.0, -1.0)

    found = track_board(rendered(to_board), BOARD, predict)
    assert miss_mm(found, to_board) < 0.01


@pytest.mark.parametrize("turn_deg", [slow(0.0), 90.0, slow(180.0), slow(270.0)])
def test_without_discs_in_view_the_prediction_decides(turn_deg):
    base = view(turn_deg)
    shift = np.array((40.0, -35.0))
    image = rendered(lambda pixels: base(pixels) + shift, 4)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))

    def predict(points):  # half a millimetre and one degree off
        x, y = (points[:, :2] - shift + np.array((0.5, -0.4))).T
        x, y = x - 0.017 * y, y + 0.017 * x
        return np.column_stack((231.4 + 9.0 * (c * x - s * y), 208.7 - 9.0 * (s * x + c * y)))

    found = track_board(image, BOARD, predict)
    assert len(found) > 250
    assert np.abs(base(found.position_px) + shift - found.plane_mm).max() < 0.01
    with pytest.raises(TargetNotFound, match="discs"):
        find_board(image, BOARD)


def test_squares_of_another_size_than_described_are_named_with_their_size():
    """A lab's board, described as the usual one: the camera tells how large it is."""

    def predict(points):
        return (231.4, 208.7) + 5.6 * points[:, :2] * (1.0, -1.0)

    with pytest.raises(
        TargetNotFound,
        match=r"22\.\d px wide, 1\.6\d* times as large .* of 2\.5 mm \(14\.0 px\).*square_mm \(about 4\.0",
    ):
        track_board(rendered(view()), BOARD, predict)


def test_a_prediction_out_of_the_frame_is_said():
    with pytest.raises(TargetNotFound, match="nominal camera"):
        track_board(rendered(view()), BOARD, lambda points: np.full((len(points), 2), np.nan))


@pytest.mark.parametrize(
    ("image", "word"),
    [
        (np.full(SHAPE, 800, np.uint16), "no chessboard"),
        (photographed(np.full(SHAPE, 900.0), 1), "no chessboard"),
        (np.random.default_rng(1).uniform(0, 255, SHAPE).astype(np.uint8), "no chessboard"),
    ],
)
def test_frames_without_a_board(image, word):
    with pytest.raises(TargetNotFound, match=word):
        find_board(image, BOARD)


def test_particles_are_no_board():
    rng = np.random.default_rng(6)
    image = np.zeros(SHAPE)
    v, u = np.mgrid[0:13, 0:13] - 6
    for x, y in rng.integers(10, 400, (4000, 2)):
        image[y - 6 : y + 7, x - 6 : x + 7] += 900 * np.exp(-(u**2 + v**2) / 1.2)
    with pytest.raises(TargetNotFound, match="no chessboard"):
        find_board(photographed(image, 2), BOARD)


def test_wrong_boards_are_named():
    to_board = view(5.0)
    plain = photographed(soft_board(to_board, SHAPE), 1)
    with pytest.raises(TargetNotFound, match="discs"):
        find_board(plain, BOARD)
    with pytest.raises(TargetNotFound, match="exchanged"):
        find_board((3400 - rendered(to_board).astype(int)).astype(np.uint16), BOARD)
    with pytest.raises(TargetNotFound, match=r"discs measure 0\.[34]\d squares across"):
        find_board(rendered(to_board), Chessboard(disc_mm=0.5))


def test_white_paper_at_full_scale_moves_no_corner():
    to_board = view(5.0)
    overexposed = np.clip(rendered(to_board).astype(int) * 2, 0, 4095).astype(np.uint16)
    found = find_board(overexposed, BOARD)
    assert len(found) > 250
    assert miss_mm(found, to_board) < 0.012


@pytest.mark.parametrize(("counts", "blur_px"), [slow(8.0, 0.7), (12.0, 0.7), slow(4.0, 2.5), (8.0, 2.5)])
def test_noise_and_soft_edges_do_not_break_the_lattice(counts, blur_px):
    """Counts of noise of a contrast of 140, in squares of 60 px."""
    to_board = view(4.0, px_per_mm=24.0)
    image = soft_board(to_board, SHAPE, discs=BOARD.discs, blur_px=blur_px, low=60.0, high=200.0)
    noise = np.random.default_rng(3).normal(0.0, counts, SHAPE)
    found = find_board(np.clip(np.rint(image + noise), 0, 255).astype(np.uint8), BOARD)
    assert len(found) >= 36
    assert miss_mm(found, to_board) < 0.3 / 24.0


def test_a_frame_of_nan_is_a_frame_error():
    with pytest.raises(FrameError):
        find_board(np.full(SHAPE, np.nan, np.float32), BOARD)


def test_growth_takes_no_saddle_twice_and_keeps_kinds_alternating():
    patch = grow_patches(find_saddles(rendered(view(23.0, barrel=0.1))))[0]
    assert len({tuple(p) for p in patch.position_px.tolist()}) == len(patch.index)
    assert len({tuple(i) for i in patch.index.tolist()}) == len(patch.index)
    parity = np.where(patch.index.sum(axis=1) % 2 == 0, 1, -1)
    assert len(set((parity * patch.sign).tolist())) == 1


@pytest.mark.parametrize(
    ("scene", "least", "limit_px"), [("one_sphere", 3000, 0.027), ("two_spheres", 4200, 0.019)]
)
@pytest.mark.slow
def test_supplied_boards_without_and_with_a_start(scene, least, limit_px):
    path = FRAMES / scene / "target_clear.tif"
    if not path.exists():
        pytest.skip(f"supplied frame {scene}/target_clear is not here")
    image, project = tifffile.imread(path), true_projection(scene)
    found = find_board(image, BOARD)
    tracked = track_board(image, BOARD, nominal_projection(scene))
    error = found.position_px - project(found.plane_mm)
    assert len(found) > least
    assert np.abs(error).max() < 0.12
    assert error.std(axis=0).max() < limit_px
    assert np.array_equal(found.index, tracked.index)


@pytest.mark.parametrize("scene", ["one_sphere", "two_spheres"])
def test_glass_left_in_front_is_never_counted_as_bare_board(scene):
    path = FRAMES / scene / "target_glass.tif"
    if not path.exists():
        pytest.skip(f"supplied frame {scene}/target_glass is not here")
    image, project = tifffile.imread(path), true_projection(scene)
    with pytest.raises(TargetNotFound, match=r"glass|discs"):
        find_board(image, BOARD)
    found = track_board(image, BOARD, nominal_projection(scene))
    error = np.abs(found.position_px - project(found.plane_mm)).max(axis=1)
    assert len(found) > {"one_sphere": 850, "two_spheres": 3700}[scene]
    assert np.mean(error < 0.2) > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("name", ["target_clear_z-20mm", "target_clear_z+20mm"])
def test_supplied_z_stack(name):
    path = FRAMES / "two_spheres" / f"{name}.tif"
    if not path.exists():
        pytest.skip(f"supplied frame two_spheres/{name} is not here")
    found = find_board(tifffile.imread(path), BOARD)
    error = found.position_px - true_projection("two_spheres", float(name[14:-2]))(found.plane_mm)
    assert len(found) > 3800
    assert np.abs(error.mean(axis=0)).max() < 0.001
    assert error.std(axis=0).max() < 0.0205


def test_no_corner_lies_on_any_map():
    """A small frame in which nothing of the board is found is for the caller to refuse, in words."""
    none = np.zeros((0, 2))
    assert on_smooth_map(none.astype(int), none, np.zeros((0, 2, 2))).shape == (0,)


@pytest.mark.parametrize(("off", "kept"), [(0.0, True), (0.02, True), (0.06, False), (0.3, False)])
def test_a_corner_at_the_end_of_the_lattice_is_judged_by_the_others(off, kept):
    """No polynomial may bend itself to a corner that nothing stands beside."""
    index = np.array([(i, j) for i in range(8) for j in range(8)] + [(8, 8)])
    position = 16.0 * index + 0.1 * index**2
    position[64, 1] += 16.0 * off
    axes = np.broadcast_to(16.0 * np.eye(2), (len(index), 2, 2))
    assert on_smooth_map(index, position, axes).tolist() == [True] * 64 + [kept]


@pytest.mark.parametrize(("off", "kept"), [(0.0, True), (0.15, False), (0.27, False)])
def test_a_piece_in_a_hole_of_the_lattice_is_judged_by_what_is_around(off, kept):
    """As a ball shows it that happens to stand so that squares are as wide behind it as beside it."""
    index = np.array([(i, j) for i in range(12) for j in range(12)])
    inside = ((index > 4) & (index < 8)).all(axis=1)
    position = 16.0 * index + 0.02 * index**2
    position[inside, 0] += 16.0 * off
    axes = np.broadcast_to(16.0 * np.eye(2), (len(index), 2, 2))
    assert as_the_largest_piece_says(index, position, axes).tolist() == (~inside | kept).tolist()


@pytest.mark.parametrize(("off", "kept"), [(0.0, True), (0.1, True), (0.7, False)])
def test_a_piece_of_lattice_apart_counts_where_the_largest_says(off, kept):
    index = np.array([(i, j) for i in range(8) for j in range(8)] + [(i, j) for i in (10, 11) for j in (2, 3, 4)])
    position = 12.0 * index + 0.05 * index**2
    position[64:, 0] += 12.0 * off
    axes = np.broadcast_to(12.0 * np.eye(2), (len(index), 2, 2))
    assert as_the_largest_piece_says(index, position, axes).tolist() == [True] * 64 + [kept] * 6
    assert as_the_largest_piece_says(index[:0], position[:0], axes[:0]).shape == (0,)


TURNS = {
    "mirror": lambda image: image[:, ::-1],
    "upside down": lambda image: image[::-1],
    "turned by half": lambda image: image[::-1, ::-1],
    "turned by a quarter": lambda image: np.rot90(image),
    "diagonal mirror": lambda image: image.T,
}


@cache
def square_frame(discs):
    return photographed(soft_board(view(2.0), (440, 440), discs=discs), 0)


@pytest.mark.parametrize("how", TURNS)
@pytest.mark.parametrize("discs", [OLDER, CHIRAL])
def test_a_turned_or_mirrored_board_is_named(how, discs):
    """Four discs tell a mirror image from a turn; three do not, and a diagonal mirror looks upright to them."""
    board = Chessboard(discs=discs)
    image = square_frame(discs)
    mirrored = "mirror" in how or how == "upside down"

    def predict(points):
        return (219.0, 221.0) + 9.0 * points[:, :2] * (1.0, -1.0)

    if how == "diagonal mirror" and discs == OLDER:
        pytest.skip("nothing in the frame shows it")
    words = (
        "seen in a mirror: set ReverseX"
        if mirrored and discs == CHIRAL
        else r"turned by [+-](90|180|88|92|178) degrees"
    )
    with pytest.raises(TargetNotFound, match=words) as refused:
        track_board(np.ascontiguousarray(TURNS[how](image)), board, predict, reach=6.0)
    asked = "look the same in a mirror" in str(refused.value)
    assert asked == (discs == OLDER and how != "turned by half")


def test_new_prints_and_old_ones_are_read_by_files_of_both():
    old, new = Chessboard(), Chessboard(discs=CHIRAL)
    assert old.is_mirror_symmetric
    assert not new.is_mirror_symmetric
    print_ = photographed(soft_board(view(5.0), SHAPE, discs=CHIRAL), 0)
    assert miss_mm(find_board(print_, old), view(5.0)) < 0.01
    assert miss_mm(find_board(print_, new), view(5.0)) < 0.01
    with pytest.raises(TargetNotFound, match=r"3 of the 4 discs .*leave discs out of board.yaml"):
        find_board(rendered(view(5.0)), new)
