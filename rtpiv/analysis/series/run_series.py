"""A series evaluated: what is missing is made, what is there and sound is kept.

Whatever ends this program, the same command goes on where it stopped: chunks that are whole stay, and the files of
the others come out with the same bytes as if nothing had happened.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TypeVar

from ground.plain_words import quantity
from ground.terminal import console
from piv.errors import PairError, SeriesError
from piv.files.vector_file import Vectors
from piv.preprocessing.preparation import SLIDING_MINIMUM
from rtpiv.analysis.pairs.evaluation import Evaluation, PairMethod
from rtpiv.analysis.pairs.pair_vectors import join_vectors
from rtpiv.analysis.pairs.piv_file import LEAST_VALID
from rtpiv.analysis.series.chunk import Detailed, correction_of, evaluate_chunk, evaluate_chunk_closely
from rtpiv.analysis.series.series_checks import check_series
from rtpiv.analysis.series.series_folder import SeriesFile, SeriesFolder, sound_content
from rtpiv.analysis.series.series_input import SeriesInput
from rtpiv.analysis.series.series_pairs import PairsOfSeries
from rtpiv.analysis.series.series_plan import ChunkJob, Method
from rtpiv.analysis.series.series_view import SeriesView
from rtpiv.analysis.series.workers import carry_out_with_progress, workers_for

R = TypeVar("R")


@dataclass(frozen=True)
class Evaluated:
    """Pairs that were evaluated.

    Parameters
    ----------
    pairs : int
        How many were asked for.
    failed : mapping of str to str
        Those without vectors by name, and why.
    details : tuple of Evaluation
        What is known of single pairs beyond their vectors: of two frames, of pairs that a stage moved, and of
        every pair where that was asked for (tracks, a known shift).
    series : SeriesFolder, optional
        Where the vectors of pairs that are a time apart lie.
    kept : int
        Pairs that an earlier call had evaluated.
    warnings : tuple of str
        What the vectors of a series say against its scale, its times or its order.
    valid_share : float
        Share of the windows with a valid vector, median of the pairs; 1 where that was not asked.
    names : mapping of str to str
        Names of the frames of a pair of a series whose own name does not tell them.
    """

    pairs: int
    failed: Mapping[str, str] = field(default_factory=dict)
    details: tuple[Evaluation, ...] = ()
    series: SeriesFolder | None = None
    kept: int = 0
    warnings: tuple[str, ...] = ()
    valid_share: float = 1.0
    names: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def vectors(self) -> Vectors:
        """Vectors of all pairs as one dataset (t, y, x); of a long series read its chunks one by one instead."""
        if self.series is None:
            return join_vectors([detail.vectors for detail in self.details])
        keys = self.series.about["keys"]
        return join_vectors([self.series.vectors(number, key) for number, key in enumerate(keys)])

    @property
    def reasons(self) -> list[tuple[str, str]]:
        """Pairs without vectors by the names of their frames, and why."""
        return [(self.names.get(tag, tag), why) for tag, why in self.failed.items()]

    @property
    def has_few_valid(self) -> bool:
        """Return whether so few windows have a valid vector that these may be no pairs."""
        return self.valid_share < LEAST_VALID

    @property
    def summary(self) -> str:
        """Number of pairs with vectors, in a line."""
        done = f"{self.pairs - len(self.failed)} of {quantity(self.pairs, 'pair')} have vectors"
        if not self.has_few_valid:
            return done
        share = f"{100.0 * self.valid_share:.0f} %"
        return f"only {share} of the windows have a valid vector, so these may be no pairs; {done}"

    def __str__(self) -> str:
        """Return the summary, and a line for each pair that is known in detail."""
        return "\n".join((self.summary, *map(str, self.details)))

    def _repr_html_(self) -> str:
        """Show a notebook how many pairs have vectors, and these."""
        return f"<p>{self.summary}</p>{self.vectors._repr_html_()}"


def run_series(
    series: SeriesInput,
    workers: int | None = None,
    chunk: int | None = None,
    executor: Executor | None = None,
    closely: PairMethod | None = None,
    on_pair: Callable[[str, Detailed], None] = lambda tag, found: None,
) -> Evaluated:
    """Evaluate a series into its folder.

    Parameters
    ----------
    series : SeriesInput
        Its pairs, how each is evaluated, and where.
    workers : int, optional
        Processes; default one a core.
    chunk : int
        Pairs a chunk, a power of two, default `SeriesInput.chunk`; no vector depends on it.
    executor : Executor, optional
        Whose workers are used instead, for instance those of a cluster that sees both folders.
    closely : PairMethod, optional
        What else is asked of each pair; its sigma is that of the series.
    on_pair : callable
        Given that of each pair by its tag, or why it cannot be had, as chunks become ready, in any order.

    Raises
    ------
    PairError, SeriesError
        Too few pairs for the background, or none gave a vector, or few windows did; or the folder holds chunks of
        another run.
    DiskError
        A file cannot be written; what is whole stays.
    RunUnsuitable
        Another process evaluates into this folder.
    """
    given, method, name = series.given, series.method, series.name
    if method.preparation.background == SLIDING_MINIMUM and len(given.pairs) < 2:
        raise PairError(
            "a sliding minimum compares frames of several pairs, and the run has one; use --prepare none"
        )
    folder = SeriesFolder(series.out)
    with folder.lock():
        chunk = chunk or series.chunk
        jobs = series.jobs(chunk)
        about = about_series(name, given, method, jobs, chunk)
        _announce(folder, about)
        folder.begin(about)
        missing = [job for job in jobs if sound_content(job.path, job.key) is None]
        if closely is None:
            _carry_out(evaluate_chunk, missing, workers, executor)
        else:
            asked = replace(closely, sigma=SeriesView(series.out).sigma)

            def take(found: list[tuple[str, Detailed]]) -> None:
                for tag, one in found:
                    on_pair(tag, _with_readings(given, tag, one))

            _carry_out(partial(evaluate_chunk_closely, how=asked), jobs, workers, executor, take)
        reasons = _failures(folder, jobs)
    if len(reasons) == len(given.pairs):
        raise PairError(f"no pair gave a vector; the first: {next(iter(reasons.values()))}")
    grid = correction_of(jobs[0].maps, method).corrector.map.grid
    check = check_series(folder, jobs, method.scene, grid.pitch_mm)
    if check.valid_share < series.least_valid:
        first = next(pair for pair in given.pairs if pair.tag not in reasons)
        raise PairError(
            f"only {100.0 * check.valid_share:.0f} % of the windows have a valid vector, median of pairs:"
            f" {first.names}, and the others like them, are no pairs, or show no particles, or move too"
            " far",
            place=series.run,
            cure="name pairs by --second, by @2-3,4-5 behind the name or by --both, or set a larger"
            " --first-window"
            + ("; or keep these vectors with --least-valid 0" if check.valid_share > 0.0 else ""),
        )
    kept = len(given.pairs) - sum(len(job.pairs) for job in missing)
    names = {pair.tag: pair.names for pair in given.pairs if pair.tag not in pair.frames[0].name}
    return Evaluated(
        len(given.pairs),
        reasons,
        series=folder,
        kept=kept,
        warnings=check.warnings,
        valid_share=check.valid_share,
        names=names,
    )


def _with_readings(given: PairsOfSeries, tag: str, found: Detailed) -> Detailed:
    """The same with what gauges showed meanwhile, which no worker knows."""
    if not isinstance(found, Evaluation) or tag not in given.readings_of:
        return found
    return replace(found, task=replace(found.task, readings=given.readings_of[tag]))


def _carry_out(
    work: Callable[[ChunkJob], R],
    jobs: Sequence[ChunkJob],
    workers: int | None,
    executor: Executor | None,
    take: Callable[[R], object] = lambda result: None,
) -> None:
    """Do the jobs, on several cores if there are several, with a bar over pairs; `take` what each gives."""
    if not jobs:
        return
    correction_of(jobs[0].maps, jobs[0].method)  # traced once, before any worker asks for it
    with workers_for(len(jobs), workers, executor) as pool:
        for result in carry_out_with_progress(work, jobs, pool):
            take(result)


def _announce(folder: SeriesFolder, about: SeriesFile) -> None:
    """Say which finished chunks will be replaced and why; SeriesError if they are of another run."""
    unlike = folder.unlike(about)
    if not unlike.lost:
        return
    finished = quantity(unlike.lost, "finished chunk")
    if unlike.run not in (None, about["run"]):
        raise SeriesError(
            f"{folder.path}: holds {finished} of another run, {unlike.run}; choose another folder with -o"
        )
    why = "; ".join(unlike.differences) or "its frames, or the times between them, are others"
    console().print(f"{folder.path}: {finished} will be made again: {why}", style="bold red")


def _failures(folder: SeriesFolder, jobs: Sequence[ChunkJob]) -> dict[str, str]:
    reasons: dict[str, str] = {}
    for job in jobs:
        reasons |= folder.marker(job.number, job.key).failed
    return reasons


def about_series(
    name: str, given: PairsOfSeries, method: Method, jobs: Sequence[ChunkJob], chunk: int
) -> SeriesFile:
    """Return the contents of series.json for the series of a run, cut into chunks of `chunk` pairs."""
    said: SeriesFile = {
        "run": name,
        "pairs": len(given.pairs),
        "alone": given.alone,
        "glass": given.glass,
        "glass_place_mm": given.glass_place_mm,
        "dewarped": method.dewarp is not None,
        "chunk_pairs": chunk,
        "keys": [job.key for job in jobs],
        "content": method.content,
        "shown": given.pairs[len(given.pairs) // 2].tag,
    }
    if given.readings:
        said["readings"] = dict(given.readings)
    return said
