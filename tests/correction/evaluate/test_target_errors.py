"""Several corrections of one frame of the target: what they have in common is measured once, to the same bits."""

import numpy as np
import pytest

from correction.evaluate import target_error as measured_in
from correction.evaluate.target_error import target_error, target_errors
from correction.fitted.prepared import prepare
from correction.target import Chessboard
from tests.correction.synthetic_board import soft_board
from tracer.scene.scene_file import load_scene

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
