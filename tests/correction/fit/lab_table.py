"""Is the map as good as its sigma says? Many labs, right ones and wrong ones, one row each.

    python -m tests.correction.fit.lab_table corners --labs 300 --workers 16 -o labs.csv
    python -m tests.correction.fit.lab_table rendered --labs 300 --workers 16 -o labs.csv
    python -m tests.correction.fit.lab_table benches --labs 5 --workers 16 -o benches.csv
    python -m tests.correction.fit.lab_table faults --labs 300 --workers 16 -o faults.csv

The corners of the first err as fitted corners of rendered frames do (`drawn_labs`); the others are photographed by
the independent renderer and fitted: strangers, every second one right, and each named bench so many times
(`rendered_labs`); the last have one fault each (`faulty_labs`), every seventh none, and count whether the words
are those of the fault.  A row has what the fit said and, behind glass and beside it, the map's error, its sigma,
chi (root mean square of error over sigma), the share of errors within one sigma and, of drawn corners, the chance
of such a chi.  At the end the rows are
summed by kind: chi counts each lab once there, since the errors of one lab belong together.
"""

import argparse
import csv
import re
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from correction.errors import CorrectionError
from correction.fit.judge.result import SceneFit
from correction.fit.judge.weakness import weaknesses
from tests.correction.fit import drawn_labs, faulty_labs, rendered_labs
from tests.correction.fit.strangers import stranger

KNOWN_PX = 0.1  # larger sigmas are what a scene leaves open, and come from what was believed beforehand
SILENT = 2.5  # chi from which a lab without an alarm is wrong in silence, if it is COSTLY_PX off as well
COSTLY_PX = 0.02
SILENTLY_OFF = 0.003  # share of nodes that may show another place: those on the very rim
FIRST = 71000
FAULTY, RIGHT = "faults", 7  # every so many of these labs have no fault


@dataclass(frozen=True)
class Row:
    """One lab."""

    kind: str
    fault: str
    seed: int
    said: str = ""  # right, alarm, refused or error
    off: float = float("nan")
    behind_px: float = float("nan")
    behind_sigma_px: float = float("nan")
    behind_chi: float = float("nan")
    behind_covered: float = float("nan")
    behind_chance: float = float("nan")  # of an error as large if sigma is right (`drawn_labs.chance_of`)
    beside_px: float = float("nan")
    beside_sigma_px: float = float("nan")
    beside_chi: float = float("nan")
    beside_covered: float = float("nan")
    beside_chance: float = float("nan")
    seconds: float = float("nan")
    is_named: bool = False  # among the words are those of the fault
    words: str = ""

    @property
    def is_silent(self) -> bool:
        """Wrong, and nothing says so."""
        regions = ((self.behind_px, self.behind_chi), (self.beside_px, self.beside_chi))
        beyond = any(off > COSTLY_PX and chi > SILENT for off, chi in regions)
        return self.said == "right" and (beyond or self.off > SILENTLY_OFF)


def fitted(row: Row) -> Row:
    """Draw, fit and judge the lab of a row."""
    began = time.process_time()
    try:
        if row.kind == "corners":
            drawn = drawn_labs.drawn_lab(row.seed, row.fault, draw=stranger)
            fit, off = drawn.fit, 0.0
            behind, beside = (drawn.error_px, drawn.sigma_px), drawn.beside[1:]
            seen = {"behind": (drawn.pixels, drawn.error_px), "beside": drawn.beside[:2]}
            chances = {
                f"{region}_chance": drawn_labs.chance_of(fit, *each, region == "behind")
                for region, each in seen.items()
                if len(each[0]) > 10
            }
            row = replace(row, **chances)
        elif row.kind == FAULTY:
            case = faulty_labs.faulty(row.fault, row.seed)
            photos = tuple(case.frames(row.seed))
            lab = rendered_labs.compared(
                rendered_labs.Photographed(case.given, case.glass, case.board, photos, case.priors)
            )
            fit, behind, beside, off = lab.fit, lab.behind, lab.beside, lab.off
        else:
            lab = rendered_labs.compared(rendered_labs.photographed(row.kind, row.seed, row.fault))
            fit, behind, beside, off = lab.fit, lab.behind, lab.beside, lab.off
        row = replace(row, said="right" if fit.verdict.is_right else "alarm", off=off, words=_words(fit))
        row = replace(row, **_errors("behind", *behind), **_errors("beside", *beside))
    except CorrectionError as refusal:
        row = replace(row, said="refused", words=str(refusal))
    except Exception as error:  # a row of the table, and none of the others lost
        row = replace(row, said="error", words=f"{type(error).__name__}: {error}")
    if row.kind == FAULTY and row.said in ("alarm", "refused"):
        sought = faulty_labs.faulty(row.fault, row.seed).words
        row = replace(row, is_named=any(re.search(words, row.words) for words in sought))
    return replace(row, seconds=time.process_time() - began)


def _words(fit: SceneFit) -> str:
    light = [weak.sentence for weak in weaknesses(fit) if "light" in weak.sentence]
    return " | ".join((*fit.verdict.sentences, *light))


def _errors(region: str, error: NDArray[np.float64], sigma: NDArray[np.float64]) -> dict[str, float]:
    known = sigma.max(axis=1, initial=0.0) < KNOWN_PX
    if known.sum() <= 10:
        return {}
    error, sigma = error[known], sigma[known]
    named = {
        "px": np.sqrt(np.mean(error**2)),
        "sigma_px": np.sqrt(np.mean(sigma**2)),
        "chi": np.sqrt(np.mean((error / sigma) ** 2)),
        "covered": np.mean(np.abs(error) < sigma),
    }
    return {f"{region}_{name}": round(float(value), 5) for name, value in named.items()}


def asked(what: str, labs: int, first: int) -> list[Row]:
    """Rows to be filled."""
    if what == "benches":
        return [Row(name, "", first + n) for n in range(labs) for name in rendered_labs.BENCHES]
    if what == FAULTY:
        every = ["", *faulty_labs.KINDS]
        order = [
            every[0] if n % RIGHT == 0 else every[1 + (n - n // RIGHT - 1) % (len(every) - 1)] for n in range(labs)
        ]
        return [Row(what, fault, first + n) for n, fault in enumerate(order)]
    kind, faults = {
        "corners": ("corners", ("index", "ball off", "lens term", "bent board")),
        "rendered": ("stranger", ("stray",)),
    }[what]
    return [Row(kind, "" if n % 2 == 0 else faults[n // 2 % len(faults)], first + n) for n in range(labs)]


def summed(rows: Iterable[Row]) -> str:
    """One line a kind and fault."""
    lines, rows = [], list(rows)
    for kind, fault in dict.fromkeys((row.kind, row.fault) for row in rows):
        own = [row for row in rows if (row.kind, row.fault) == (kind, fault)]
        said = {word: sum(row.said == word for row in own) for word in ("right", "alarm", "refused", "error")}
        silent = [row.seed for row in own if row.is_silent]
        lines.append(
            f"{kind:17s} {fault or 'right':29s} {len(own):4d}: "
            + ", ".join(f"{count} {word}" for word, count in said.items())
            + "; "
            + (f"named {sum(row.is_named for row in own)}; " if kind == FAULTY and fault else "")
            + "; ".join(_region(name, own) for name in ("behind", "beside"))
            + f"; wrong in silence {silent}"
        )
    return "\n".join(lines)


def _region(name: str, rows: list[Row]) -> str:
    px, chi, covered = (
        np.array([getattr(row, f"{name}_{what}") for row in rows if np.isfinite(getattr(row, f"{name}_chi"))])
        for what in ("px", "chi", "covered")
    )
    if not len(chi):
        return f"{name}: none"
    return (
        f"{name}: {np.median(px):.4f} px, chi {np.sqrt(np.mean(chi**2)):.2f} (median {np.median(chi):.2f},"
        f" {chi.min():.2f} to {chi.max():.2f}), covered {np.mean(covered):.2f}"
    )


def main() -> None:
    """Fit so many labs, each row written as it is found."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("what", choices=("corners", "rendered", "benches", FAULTY))
    ask.add_argument("--labs", type=int, default=20)
    ask.add_argument("--first", type=int, default=FIRST)
    ask.add_argument("--workers", type=int, default=1)
    ask.add_argument("--seconds", type=float, default=float("inf"), help="begin no lab after so long")
    ask.add_argument("-o", "--out", type=Path, default=Path("labs.csv"))
    given = ask.parse_args()
    rows: list[Row] = []
    until = time.monotonic() + given.seconds
    with given.out.open("w", newline="") as file, ProcessPoolExecutor(given.workers) as pool:
        table = csv.DictWriter(file, [one.name for one in fields(Row)])
        table.writeheader()
        waiting = {pool.submit(fitted, row) for row in asked(given.what, given.labs, given.first)}
        for done in as_completed(waiting):
            if done.cancelled():
                continue
            rows.append(done.result())
            table.writerow(asdict(rows[-1]))
            file.flush()
            if time.monotonic() > until:
                for one in waiting:
                    one.cancel()
    print(summed(rows))
    sys.exit(any(row.is_silent or row.said == "error" for row in rows))


if __name__ == "__main__":
    main()
