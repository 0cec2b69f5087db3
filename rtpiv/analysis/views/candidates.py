"""Arrangements of the lenses, distances and balls of a lab, and those of them on the Pareto front.

All arrangements of a question are computed, on all cores.

An arrangement is beaten if another shows at least as much with usable error, at least as surely, and in at least
as much light, and is better in one of these, counted in steps: figures within one step are no reason to prefer
one.  What is not beaten is the Pareto front: the only choice that is left is what to give up.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, as_completed
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TypeVar

from daq.errors import RunUsageError
from ground.rows import thread_count
from ground.terminal import progress_if_long
from rtpiv.analysis.series.workers import worker_processes
from rtpiv.analysis.views.figures import ViewFigures, view_figures, with_sigma
from rtpiv.options.numbers import Count, Length, Positive
from rtpiv.templates.arrangement import most_balls
from rtpiv.templates.lab import Lab
from tracer.errors import SceneError

MAX_COMBINATIONS = 5000  # combinations: half a minute


@dataclass(frozen=True)
class ViewQuestion:
    """Camera, and alternatives to compare.

    Parameters
    ----------
    lenses_mm : sequence of float
        Focal lengths.
    distances_mm : sequence of float
        Distances from the lens to the plane.
    balls_mm : sequence of float
        Diameters of balls.
    counts : sequence of int
        Numbers of balls.
    arrangements : sequence of str
        Arrangements of the balls: behind, beside, triangle, pyramid ...
    glasses : sequence of str
        Materials of the balls: acrylic, borosilicate, BK7 ..., or a refractive index.
    gaps_mm : sequence of float
        Distances from the plane to the lowest ball.
    sensor_px : (int, int)
        Width and height of the camera's frames.
    pixel_pitch_um : float
        Size of a pixel.
    wavelength_nm : float
        Wavelength of the light.

    Raises
    ------
    RunUsageError
        More than `MAX_COMBINATIONS` combinations.
    """

    lenses_mm: Sequence[Positive]
    distances_mm: Sequence[Positive]
    balls_mm: Sequence[Positive]
    counts: Sequence[Count] = (1, 2, 3)
    arrangements: Sequence[str] = ("behind",)
    glasses: Sequence[str] = ("BK7",)
    gaps_mm: Sequence[Length] = (0.0,)
    sensor_px: tuple[Count, Count] = (2016, 2016)
    pixel_pitch_um: Positive = 11.0
    wavelength_nm: Positive = 532.0

    def __post_init__(self) -> None:
        if self.combinations > MAX_COMBINATIONS:
            raise RunUsageError(
                f"{self.combinations} combinations are more than {MAX_COMBINATIONS}; ask for fewer at a time"
            )

    @property
    def combinations(self) -> int:
        """Number of combinations, impossible ones included."""
        lengths = len(self.lenses_mm) * len(self.distances_mm) * len(self.balls_mm) * len(self.gaps_mm)
        return lengths * len(self.counts) * len(self.arrangements) * len(self.glasses)

    def labs(self) -> tuple[list[Lab], list[str]]:
        """Return what can be built, and of the rest why not; an arrangement that has no such number is no rest."""
        found, refused = [], []
        choices = (self.arrangements, self.counts, self.glasses, self.balls_mm, self.gaps_mm)
        for shape, count, glass, ball_mm, gap_mm in product(*choices):
            for distance_mm, lens_mm in product(self.distances_mm, self.lenses_mm):
                try:
                    lab = Lab(
                        sensor_px=(self.sensor_px[0], self.sensor_px[1]),
                        pixel_pitch_um=self.pixel_pitch_um,
                        lens_mm=lens_mm,
                        distance_mm=distance_mm,
                        arrangement=shape,
                        balls=count,
                        ball_mm=ball_mm,
                        gap_mm=gap_mm,
                        glass=glass,
                        wavelength_nm=self.wavelength_nm,
                    )
                except RunUsageError as error:
                    if count in most_balls(shape):
                        refused.append(str(error))
                    continue
                found.append(lab)
        return found, list(dict.fromkeys(refused))


Block = tuple[list[ViewFigures], list[str]]  # figures, and why what is missing cannot be

Given = TypeVar("Given")
Made = TypeVar("Made")

WORTH_A_PROCESS = 60  # arrangements: starting one costs as much
BLOCK = 20  # arrangements at a time
AREA_STEP, NOISE_STEP, LIGHT_STEP = 0.01, 0.1, 0.25


@dataclass(frozen=True)
class Candidates:
    """Result of a comparison.

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
        for figures, reasons in progress_if_long(_run_work(work, blocks, pool), len(blocks), "arrangements"):
            found += figures
            refused |= dict.fromkeys(reasons)
        views = sorted(found, key=_merit, reverse=True)
        best = pareto_front(views)
        first = min(sure, len(best))
        sigmas = list(progress_if_long(_run_work(with_sigma, best[:first], pool), first, "sigma of their maps"))
        known = {view.lab: view for view in sigmas}
    return Candidates(
        [known.get(view.lab, view) for view in views], [known.get(view.lab, view) for view in best], list(refused)
    )


def pareto_front(views: Sequence[ViewFigures]) -> list[ViewFigures]:
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


def _run_work(work: Callable[[Given], Made], given: Sequence[Given], pool: Executor | None) -> Iterator[Made]:
    """Yield the result of each job, as it comes."""
    if pool is None:
        return map(work, given)
    return (future.result() for future in as_completed([pool.submit(work, one) for one in given]))


def _merit(view: ViewFigures) -> tuple[float, ...]:
    """Sort key: what shows most first, then what is lit best, then names."""
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
