"""Boards in photographs taken by others are found, where OpenCV sees them, and none is put in another place."""

from collections import Counter

import cv2
import numpy as np
import pytest

from correction.target.board_search import track_board
from tests.correction.target.photographs import BY_HAND, degraded, photographs, verdict


def test_every_photograph_is_found_where_opencv_sees_it():
    for one in photographs():
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


def counted(seeds):
    """Count what becomes of degraded photographs, half of them with a camera that is up to a square off."""
    usual, count, wrong = [one for one in photographs() if one.name not in BY_HAND], Counter(), []
    for seed in seeds:
        one, about = degraded(usual[seed % len(usual)], seed)
        off = np.random.default_rng((seed, 7)).uniform(-0.7, 0.7, 2) if seed % 2 else (0.0, 0.0)
        said, more = verdict(one, 1.5 if seed % 2 else None, off)
        count[said] += 1
        if said == "wrong":
            wrong.append((about, more))
    return count, wrong


def test_no_degraded_photograph_is_put_in_another_place():
    count, wrong = counted(range(15))
    assert not wrong
    assert count["right"] > 9, count


@pytest.mark.slow
def test_of_five_hundred_degraded_photographs_none_is_put_in_another_place():
    count, wrong = counted(range(500))
    print(f"\n{count}")
    assert not wrong
    assert count["right"] > 380, count
