"""Degraded boards in one count: right, refused and why, wrong in silence; half of them drawn, some flipped.

python -m tests.correction.target.count_degraded 0 500
"""

import re
import sys
from collections import Counter

import numpy as np

from correction.errors import TargetNotFound
from correction.target.board_search import find_board
from tests.correction.target.photographs import (
    BY_HAND,
    DEGRADED,
    degraded,
    drawn_board,
    flipped,
    mirrored,
    photographs,
    turned,
    verdict,
)

FLIPPED = r"mirror|turned by"  # words that name a flipped frame
STRAYS = 0.03  # of the corners of a drawn board, where an edge of something else crosses one of a square
UNKNOWN = 0.2  # of the drawn boards: flipped, and the camera does not know
CAUSES = {  # words of a refusal -> what it takes to be true: one of these was done, or is in the frame
    r"^no (chessboard|grid of dots) in": {
        "noisy",
        "packed",
        "blurred",
        "glaring",
        "dim",
        "hidden",
        "cropped",
        "balls",
    },
    r"but not the \d (discs|large dots)": {"noisy", "packed", "blurred", "glaring", "hidden", "cropped", "balls"},
    r"could be read": {"noisy", "packed", "blurred", "glaring", "dim", "hidden", "cropped", "shrunk", "balls"},
    r"show a disc where": {"flipped"},
    r"between four squares": {"hidden", "cropped", "glaring", "balls"},
    r"too noisy|too blurred|could be fitted": {"noisy", "packed", "blurred", "glaring", "dim", "shrunk"},
    r"may be any of": {"hidden", "cropped", "glaring", "noisy", "plain"},
    r"no such place": {"hidden", "cropped", "glaring", "noisy", "plain"},
    r"so few may be misread": {"noisy", "packed", "blurred", "dim", "shrunk", "flipped"},
    r"do not lie on one smooth view": {"balls"},
}


def judged(seed, usual):
    """Say what came of one degraded board, and about it: what was done, and the words of a refusal."""
    if seed % 2:
        one = usual[seed // 2 % len(usual)]
        off = np.random.default_rng((seed, 7)).uniform(-0.7, 0.7, 2) if seed % 4 == 1 else (0.0, 0.0)
        reach, strays, balls = (1.5 if seed % 4 == 1 else None), 0.0, ""
    else:
        one, reach = drawn_board(seed)
        off, strays, balls = (0.0, 0.0), STRAYS, " balls" if "balls" in one.name else ""
    ways = DEGRADED if seed % 2 else tuple(way for way in DEGRADED if way not in (turned, mirrored))
    one, about = degraded(one, seed, ways)
    rng = np.random.default_rng((seed, 8))
    if not seed % 2 and not one.board.is_plain and rng.random() < UNKNOWN:
        upright, one, about = one, flipped(one, rng), f"{about}, flipped"
        said, more = verdict(one, reach, off, strays)
        if said == "wrong" and not _shows_marks(upright):
            said = "unshown"
        return said, f"{about}{balls}", more
    said, more = verdict(one, reach, off, strays)
    return said, f"{about}{balls}", more


def _shows_marks(one):
    """Whether marks of the board are whole in view; edges alone do not show that a frame is flipped."""
    try:
        return len(find_board(one.image, one.board)) > 0
    except TargetNotFound:
        return False


def count_degraded(seeds):
    """Count verdicts; return them with what is wrong, and refusals whose words name nothing that was done."""
    usual = [one for one in photographs() if one.name not in BY_HAND]
    count, wrong, untrue = Counter(), [], []
    for seed in seeds:
        said, about, more = judged(seed, usual)
        count["drawn" if not seed % 2 else "photograph", said] += 1
        if said == "wrong":
            wrong.append((about, more))
        if said == "refused":
            done = set(re.findall(r"\w+", about))
            if re.search(FLIPPED, more):
                is_true = "flipped" in done
            else:
                is_true = any(re.search(words, more) and causes & done for words, causes in CAUSES.items())
            if not is_true:
                untrue.append((about, more))
    return count, wrong, untrue


if __name__ == "__main__":
    total, wrongs, others = count_degraded(range(*map(int, sys.argv[1:3])))
    print(total)
    print(*(f"WRONG {one}" for one in wrongs), *(f"WORDS {one}" for one in others), sep="\n")
