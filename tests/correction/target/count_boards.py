"""Drawn boards of all kinds in one count: how many are right, how exactly, refused and why, and wrong in silence.

python -m tests.correction.target.count_boards 0 1000
"""

import re
import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from tests.correction.target.drawn_boards import KINDS, drawn, verdict

EXACT_PX = 0.03  # rms, in each of u and v
REASONS = {  # what a refusal says
    "no lattice": r"no (chessboard|grid of dots) in the frame",
    "taken for another pattern": r"the frame shows",
    "marks not seen": r"but not the \d+ (discs|large dots)|no (disc|large dot) is seen",
    "markers not read": r"markers of the board could be read",
    "another size": r"times as (large|small)|px wide, where|squares across|measure 0",
    "several places": r"may be any of",
    "no number of squares": r"say how many squares",
    "no such place": r"no such place",
    "seen through glass": r"do not lie on one smooth view",
    "blurred": r"blurred|could be fitted",
    "fits twice": r"fits the frame \d+ times",
    "exchanged": r"exchanged",
}


@dataclass
class Count:
    """What came of drawn boards, by kind."""

    said: Counter[tuple[str, str]] = field(default_factory=Counter)
    refused: Counter[tuple[str, str]] = field(default_factory=Counter)
    rms_px: dict[str, list[float]] = field(default_factory=lambda: {kind: [] for kind in KINDS})
    wrong: list[str] = field(default_factory=list)
    numbers: dict[tuple[str, str], list[int]] = field(default_factory=dict)

    def __str__(self) -> str:
        lines = []
        for kind in KINDS:
            rms = np.array(self.rms_px[kind])
            within = np.count_nonzero(rms <= EXACT_PX)
            middle, most = (np.median(rms), rms.max()) if len(rms) else (np.nan, np.nan)
            count = {word: self.said[kind, word] for word in ("right", "refused", "wrong")}
            lines.append(
                f"{kind}: {sum(count.values())} drawn, {count['right']} right ({within} to {EXACT_PX} px rms,"
                f" median {middle:.4f}, worst {most:.4f}), {count['refused']} refused, {count['wrong']} wrong"
            )
            why = [(n, reason) for (of, reason), n in self.refused.items() if of == kind]
            lines += [
                f"    {n} {reason}: {self.numbers[kind, reason][:12]}" for n, reason in sorted(why, reverse=True)
            ]
        return "\n".join([*lines, *(f"WRONG {one}" for one in self.wrong)])


def reason_of(words: str) -> str:
    """Short name of a refusal; its own words where it has none."""
    return next((name for name, pattern in REASONS.items() if re.search(pattern, words)), words)


def count_boards(seeds: Iterable[int]) -> Count:
    """Draw boards by their numbers, look for each, and count."""
    count = Count()
    for seed in seeds:
        one = drawn(seed)
        said, about = verdict(one)
        word = said.split(":")[0]
        count.said[one.kind, word] += 1
        if word == "right":
            count.rms_px[one.kind].append(float(about))
        elif word == "refused":
            reason = reason_of(str(about))
            count.refused[one.kind, reason] += 1
            count.numbers.setdefault((one.kind, reason), []).append(seed)
        else:
            count.wrong.append(f"{said}; {about}")
    return count


if __name__ == "__main__":
    print(count_boards(range(*map(int, sys.argv[1:3]))))
