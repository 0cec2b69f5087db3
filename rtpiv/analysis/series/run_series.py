"""A series evaluated: what is missing is made, what is there and sound is kept.

Whatever ends this program, the same command goes on where it stopped: chunks that are whole stay, and the files of
the others come out with the same bytes as if nothing had happened.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from ground.plain_words import counted
from ground.rows import thread_count
from ground.terminal import console, progress
from piv.errors import PairError, SeriesError
from piv.preprocessing.preparation import SLIDING_MINIMUM
from rtpiv.analysis.series.chunk import correction_of, evaluate_chunk
from rtpiv.analysis.series.clean_frames import make_light
from rtpiv.analysis.series.series_folder import SeriesFile, SeriesFolder, sound_content
from rtpiv.analysis.series.series_pairs import PairsOfSeries
from rtpiv.analysis.series.series_plan import CHUNK_PAIRS, ChunkJob, Method, jobs_of
from rtpiv.analysis.series.workers import carried_out, worker_processes


@dataclass(frozen=True)
class SeriesBooks:
    """What became of the pairs of a series.

    Parameters
    ----------
    folder : SeriesFolder
        Where it lies.
    pairs : int
        Pairs asked for.
    kept : int
        Of them those that an earlier call had evaluated.
    failed : dict of str to str
        Pairs without vectors by tag, and why.
    """

    folder: SeriesFolder
    pairs: int
    kept: int
    failed: dict[str, str]


def run_series(
    name: str,
    out: Path,
    given: PairsOfSeries,
    method: Method,
    workers: int | None = None,
    chunk: int = CHUNK_PAIRS,
    executor: Executor | None = None,
) -> SeriesBooks:
    """Evaluate a series into a folder.

    Parameters
    ----------
    name : str
        Of the run.
    out : Path
        Folder of the series.
    given : PairsOfSeries
        Its pairs.
    method : Method
        How each is evaluated.
    workers : int, optional
        Processes; default one a core.
    chunk : int
        Pairs a chunk, a power of two; no vector depends on it.
    executor : Executor, optional
        Whose workers are used instead, for instance those of a cluster that sees both folders.

    Raises
    ------
    PairError, SeriesError
        Too few pairs for the background, or none gave a vector; or the folder holds chunks of another run.
    DiskError
        A file cannot be written; what is whole stays.
    RunUnsuitable
        Another process evaluates into this folder.
    """
    if method.preparation.background == SLIDING_MINIMUM and len(given.pairs) < 2:
        raise PairError(
            "a sliding minimum compares frames of several pairs, and the run has one; use --prepare none"
        )
    folder = SeriesFolder(out)
    with folder.alone():
        shape = method.scene.camera.shape
        light = make_light(out, method.preparation.background, given.pairs, given.unseeded, shape)
        jobs = jobs_of(out, given.pairs, method, light, chunk)
        about = about_series(name, given, method, jobs, chunk)
        _announce(folder, about)
        folder.begin(about)
        missing = [job for job in jobs if sound_content(job.path, job.key) is None]
        if missing:
            correction_of(missing[0].maps, method)  # traced once, before any worker asks for it
            own = executor is None and len(missing) > 1 and (workers or thread_count()) > 1
            count = min(workers or thread_count(), len(missing))
            with worker_processes(count) if own else nullcontext(executor) as pool:
                done = _pair_by_pair(carried_out(evaluate_chunk, missing, pool))
                for _ in progress(done, sum(len(job.pairs) for job in missing), "pairs"):
                    pass
        reasons = _failures(folder, jobs)
    if len(reasons) == len(given.pairs):
        raise PairError(f"no pair gave a vector; the first: {next(iter(reasons.values()))}")
    kept = len(given.pairs) - sum(len(job.pairs) for job in missing)
    return SeriesBooks(folder, len(given.pairs), kept, reasons)


def _announce(folder: SeriesFolder, about: SeriesFile) -> None:
    """Say which finished chunks will be replaced and why; SeriesError if they are of another run."""
    unlike = folder.unlike(about)
    if not unlike.lost:
        return
    finished = counted(unlike.lost, "finished chunk")
    if unlike.run not in (None, about["run"]):
        raise SeriesError(
            f"{folder.path}: holds {finished} of another run, {unlike.run}; choose another folder with -o"
        )
    why = "; ".join(unlike.differences) or "its frames, or the times between them, are others"
    console().print(f"{folder.path}: {finished} will be made again: {why}", style="bold red")


def _pair_by_pair(done: Iterator[ChunkJob]) -> Iterator[str]:
    for job in done:
        yield from (pair.tag for pair in job.pairs)


def _failures(folder: SeriesFolder, jobs: Sequence[ChunkJob]) -> dict[str, str]:
    reasons: dict[str, str] = {}
    for job in jobs:
        reasons |= folder.marker(job.number, job.key).failed
    return reasons


def about_series(
    name: str, given: PairsOfSeries, method: Method, jobs: Sequence[ChunkJob], chunk: int
) -> SeriesFile:
    """What series.json says of the series of a run, cut into chunks of `chunk` pairs."""
    return {
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
