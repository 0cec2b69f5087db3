"""All arrangements of a question, computed on all cores, and which of them no other beats.

An arrangement is beaten if another shows at least as much with usable error, at least as surely, and in at least
as much light, and is better in one of these, counted in steps: figures within one step are no reason to prefer
one.  What nobody beats is the Pareto front: the only choice that is left is what to give up.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, as_completed
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from daq.errors import RunUsageError
from ground.rows import thread_count
from ground.terminal import progress_if_long
from rtpiv.analysis.series.workers import worker_processes
from rtpiv.analysis.views.figures import ViewFigures, view_figures, with_sigma
from rtpiv.templates.lab import Lab
from tracer.errors import SceneError

Block = tuple[list[ViewFigures], list[str]]  # figures, and why what is missing cannot be

Given = TypeVar("Given")
Made = TypeVar("Made")

WORTH_A_PROCESS = 60  # arrangements: starting one costs as much
BLOCK = 20  # arrangements at a time
AREA_STEP, NOISE_STEP, LIGHT_STEP = 0.01, 0.1, 0.25


@dataclass(frozen=True)
class Candidates:
    """What was found.

    Parameters
    ----------
    views : list of ViewFigures
        All that can be built, what shows most first.
    best : list of ViewFigures
        Those that no other beats; the first ones with the sigma of their maps.
    refused : list of str
        Why the others cannot be built.
    """

    views: list[ViewFigures]
    best: list[ViewFigures]
    refused: list[str]


def candidates_of(labs: Sequence[Lab], f_number: float, error_px: float, sure: int) -> Candidates:
    """Figures of all arrangements that can be built.

    Parameters
    ----------
    labs : sequence of Lab
        The arrangements.
    f_number, error_px : float
        See `view_figures`.
    sure : int
        Of how many of the best the sigma of the map is wanted as well; it takes ten times as long as all the rest.
    """
    work = partial(_of_block, f_number=f_number, error_px=error_px)
    blocks = [labs[first : first + BLOCK] for first in range(0, len(labs), BLOCK)]
    with worker_processes(thread_count()) if len(labs) > WORTH_A_PROCESS else nullcontext() as pool:
        found: list[ViewFigures] = []
        refused: dict[str, None] = {}
        for figures, reasons in progress_if_long(_made(work, blocks, pool), len(blocks), "arrangements"):
            found += figures
            refused |= dict.fromkeys(reasons)
        views = sorted(found, key=_merit, reverse=True)
        best = unbeaten(views)
        first = min(sure, len(best))
        sigmas = list(progress_if_long(_made(with_sigma, best[:first], pool), first, "sigma of their maps"))
        known = {view.lab: view for view in sigmas}
    return Candidates(
        [known.get(view.lab, view) for view in views], [known.get(view.lab, view) for view in best], list(refused)
    )


def unbeaten(views: Sequence[ViewFigures]) -> list[ViewFigures]:
    """Those that no other beats, in the order given; of those that are alike the first."""
    first: dict[tuple[int, ...], ViewFigures] = {}
    for view in views:
        if view.usable > 0.0 and math.isfinite(view.noise_px):
            first.setdefault(_steps(view), view)
    return [view for steps, view in first.items() if not any(_beats(other, steps) for other in first)]


def _of_block(labs: Sequence[Lab], f_number: float, error_px: float) -> Block:
    found, refused = [], []
    for lab in labs:
        try:
            found.append(view_figures(lab, f_number, error_px))
        except (RunUsageError, SceneError) as error:
            refused.append(str(error))
    return found, refused


def _made(work: Callable[[Given], Made], given: Sequence[Given], pool: Executor | None) -> Iterator[Made]:
    """What the work makes of each, as it comes."""
    if pool is None:
        return map(work, given)
    return (future.result() for future in as_completed([pool.submit(work, one) for one in given]))


def _merit(view: ViewFigures) -> tuple[float, ...]:
    """What to show first: what shows most, then what is lit best; the names settle the rest."""
    lab = view.lab
    said = (lab.balls, lab.ball_mm, lab.gap_mm, lab.lens_mm, lab.distance_mm)
    return (round(view.usable, 4), round(view.recovered, 4), -view.noise_px, view.light, *said)


def _steps(view: ViewFigures) -> tuple[int, ...]:
    """Area, accuracy and light in steps; the more the better."""
    return (
        round(view.usable / AREA_STEP),
        -round(math.log(view.noise_px) / math.log(1.0 + NOISE_STEP)),
        round(math.log(view.light) / math.log(1.0 + LIGHT_STEP)),
    )


def _beats(other: tuple[int, ...], steps: tuple[int, ...]) -> bool:
    return other != steps and all(mine <= its for mine, its in zip(steps, other, strict=True))
