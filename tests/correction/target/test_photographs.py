"""Boards in photographs taken by others are found, where OpenCV sees them, and none is put in another place."""

import cv2
import numpy as np
import pytest

from correction.target.board_search import track_board
from tests.correction.target.count_degraded import count_degraded
from tests.correction.target.photographs import BY_HAND, photographs


@pytest.mark.parametrize("every", [8, pytest.param(1, marks=pytest.mark.slow)])
def test_every_photograph_is_found_where_opencv_sees_it(every):
    for one in [*photographs(every), *(one for one in photographs() if every > 1 and one.name in BY_HAND)]:
        found = track_board(one.image, one.board, one.predict)
        # Under a lamp's reflex eight corners look like no crossing of edges; OpenCV finds nothing in that frame.
        assert len(found) == (46 if one.name in BY_HAND else 54), one.name
        places = np.array([one.corners[i, j] for i, j in found.index.tolist()])
        size = tuple(side - 1 for side in one.board.squares)
        off = np.linalg.norm(found.position_px - places, axis=1)
        assert off.max() < 0.5, (one.name, off.max())
        if one.image.shape[1] < 1000:  # it takes seconds of large frames
            sectors = cv2.findChessboardCornersSB(one.image, size, flags=cv2.CALIB_CB_ACCURACY)[1]
            away = np.linalg.norm(found.position_px[:, None] - sectors.reshape(-1, 2), axis=2)
            off = np.minimum(off, away.min(axis=1))
        assert np.median(off) < (0.13 if one.name in BY_HAND else 0.1), (one.name, np.median(off))


@pytest.mark.parametrize(
    ("first", "last", "least"), [(31018, 31026, 4), pytest.param(40000, 40500, 340, marks=pytest.mark.slow)]
)
def test_no_degraded_board_is_put_in_another_place_and_refusals_name_what_was_done(first, last, least):
    count, wrong, untrue = count_degraded(range(first, last))
    print(f"\n{count}")
    assert not wrong
    assert not untrue
    assert count["photograph", "right"] + count["drawn", "right"] > least, count
