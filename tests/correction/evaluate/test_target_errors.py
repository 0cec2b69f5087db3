"""Several corrections of one frame of the target: what they have in common is measured once, to the same bits."""

import numpy as np
import pytest

from correction.evaluate import target_error as measured_in
from correction.evaluate.claims import claim_of, independent_share
from correction.evaluate.regions import regions_of
from correction.evaluate.target_error import target_error, target_errors
from correction.fitted.prepared import prepare
from correction.maps.correction_map import build_correction_map
from correction.maps.corrector import Corrector
from correction.target import Chessboard
from piv.files.frame_file import read_frame
from sim.renderer.patterns import Image
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.synthetic_board import soft_board
from tests.piv.fixed_windows import evaluate_pair
from tests.supplied import ROOT
from tracer.scene.scene_file import load_scene
from tracer.strategies.ray_map import build_ray_map

BOARD = Chessboard()
SCENE = """
camera: {{focal_px: 2400.0, sensor_px: [{size}, {size}], position_mm: [0.0, 0.0, 500.0]}}
bodies: [{{name: ball, kind: sphere, centre_mm: [{x}, 0.0, 12.0], radius_mm: 8.0, material: N-BK7}}]
"""


def made(folder, x_mm, size=280):
    """A board as the correction of a scene with a ball at x shows it, with noise of its own behind glass."""
    (folder / "scene.yaml").write_text(SCENE.format(x=x_mm, size=size))
    corrector = prepare(load_scene(folder / "scene.yaml")).corrector
    grid = corrector.map.grid
    noise = np.random.default_rng(3).normal(0.0, 5.0, grid.shape)
    frame = soft_board(grid.to_mm, grid.shape) + noise
    frame[corrector.map.branch[0] != 0] += x_mm * noise[corrector.map.branch[0] != 0]
    return np.where(corrector.recovered, frame, np.nan).astype(np.float32), corrector


def test_common_corners_are_measured_once_and_to_the_same_bits(monkeypatch, tmp_path):
    frames = [made(tmp_path, x_mm) for x_mm in (-4.0, -3.0, 4.0)]
    alone = [target_error(*each, BOARD) for each in frames]
    asked = []

    def counted(image, board, index, *more, **options):
        asked.append(len(index))
        return refined(image, board, index, *more, **options)

    refined = measured_in.refine_marks
    monkeypatch.setattr(measured_in, "refine_marks", counted)
    together = target_errors(frames, BOARD)
    assert asked[0] > 100
    assert 0 < asked[1] < 0.5 * asked[0]  # only the neighbourhood of the ball
    assert asked[1] < asked[2] < asked[0]  # the ball stands on the other side
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one.corners_px, other.corners_px)
        assert np.array_equal(one.errors_px, other.errors_px)
        assert one.to_dict() == other.to_dict()


@pytest.mark.parametrize("odd_bright", [True, False])
def test_which_squares_of_a_plain_board_are_bright_is_seen(tmp_path, odd_bright):
    frame, plain = made(tmp_path, -4.0), Chessboard(discs=(), odd_bright=odd_bright)
    assert target_error(*frame, plain).to_dict() == target_error(*frame, BOARD).to_dict()


def test_frames_of_another_size_have_nothing_in_common(tmp_path):
    one, other = made(tmp_path, -4.0), made(tmp_path, -4.0, size=200)
    assert target_errors([one, other], BOARD)[1].to_dict() == target_error(*other, BOARD).to_dict()


# A real PIV pair "printed" on the plane and seen through two balls: corrected, the flow must be the same.


PAIRS = ROOT.parent / "shared" / "piv_pairs"


@pytest.mark.slow
@pytest.mark.parametrize(
    "names", [("pivch2001A_1.tif", "pivch2001A_2.tif"), ("pivlab_karman_01.bmp", "pivlab_karman_02.bmp")]
)
def test_printed_pair_through_two_balls(names):
    """Within 0.1 px rms, every vector counted, of the direct evaluation in the same windows."""
    paths = [PAIRS / name for name in names]
    if not all(path.is_file() for path in paths):
        pytest.skip("the public PIV pairs are not beside this checkout")
    prints = [_even(read_frame(path).astype(np.float32)) for path in paths]
    scene = load_scene(ROOT / "examples" / "two_spheres_500.yaml")
    cmap = build_correction_map(scene, build_ray_map(scene))
    frames = [
        render(scene, Image(p / 255.0, cmap.grid.pitch_mm), Sensor(blur_px=0.0), samples=4, seed=3 + k)
        for k, p in enumerate(prints)
    ]
    corrector = Corrector(cmap)
    through = evaluate_pair(corrector(frames[0]), corrector(frames[1]), corrector.recovered)
    direct = evaluate_pair(*(_centred(p, cmap.grid.shape) for p in prints))
    known = regions_of(through, cmap, scene).middle & through.valid & direct.valid
    assert known.sum() > 600
    difference = np.stack((through.u_px - direct.u_px, through.v_px - direct.v_px), axis=-1)[known]
    rms, robust = np.sqrt(np.mean(difference**2)), np.sqrt(np.median(difference**2)) / 0.6745
    print(
        f"{names[0]}: rms {rms:.4f} px, from the median {robust:.4f} px, largest {np.abs(difference).max():.2f} px"
    )
    assert rms <= 0.1
    assert np.abs(np.median(difference, axis=0)).max() < 0.02


def _even(frame):
    """Without its last row or column where it is odd: then its middle lies between pixels, as that of the view."""
    return frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2]


def _centred(frame, shape):
    """The print where the corrected frame shows it, NaN around."""
    whole = np.full(shape, np.nan, np.float32)
    top, left = ((side - part) // 2 for side, part in zip(shape, frame.shape, strict=True))
    whole[top : top + frame.shape[0], left : left + frame.shape[1]] = frame
    return whole


# The test of a sigma: how often chance alone makes it fail.


def rms(rng, sigma, count, share):
    """Rms of vectors of which blocks have the same error, as overlapping windows nearly have."""
    alone = max(1, round(count * share))
    return float(np.sqrt(np.mean(rng.normal(0.0, sigma, (alone, 2)) ** 2)))


def test_windows_that_overlap_count_by_the_part_that_is_their_own():
    assert independent_share(16, 32) == 0.25
    assert independent_share(48, 32) == 1.0


def test_a_sigma_is_held_to_its_claim():
    rng = np.random.default_rng(8)
    right = [claim_of(rms(rng, 1.0, 200, 0.25), 1.0, 200, 0.25) for _ in range(400)]
    assert right.count("as claimed") > 370
    assert claim_of(2.0, 1.0, 200, 0.25) == "too small"
    assert claim_of(0.5, 1.0, 200, 0.25) == "too large"
    assert claim_of(1.05, 1.0, 10**6, 0.25) == "as claimed"  # 5 % is no fault
    assert claim_of(2.0, 1.0, 3, 0.25) == "too few vectors"
    assert claim_of(np.nan, 1.0, 300, 0.25) == "too few vectors"
