"""One chunk of a series: raw frames in, a file of vectors out.

`evaluate_chunk` is what a worker runs: a pure function of its job.  Where more
is asked of each pair than its vectors, `evaluate_chunk_closely` says that too, from the same correlation.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from correction.fitted.prepared import PreparedCorrection, PreparedCorrections
from correction.grid import grid_of
from daq.atomic_write import GIVE_AGAIN, disk_errors, write_bytes
from daq.runs.lab_readings import readings_attribute
from piv.correlation.vector_field import ONE_PICTURE, REPEATED
from piv.correlation.windows import WindowGrid
from piv.errors import FrameError, PairError, SeriesError
from piv.files.vector_file import vectors_netcdf
from rtpiv.analysis.pairs.evaluation import (
    Correlated,
    Evaluation,
    PairMethod,
    Task,
    correlate_pair,
    evaluate_correlated,
)
from rtpiv.analysis.pairs.pair_vectors import PairResult, lengths_said, vectors_of_pairs
from rtpiv.analysis.pairs.slanted import viewing_slopes
from rtpiv.analysis.series.clean_frames import clean_frames
from rtpiv.analysis.series.series_folder import Marker, sound_content, write_marker
from rtpiv.analysis.series.series_plan import ChunkJob, Method, SeriesPair, versions_here
from rtpiv.analysis.series.still_frames import still_in


def evaluate_chunk(job: ChunkJob) -> Marker:
    """Evaluate the pairs of a chunk; write its file, then its marker.

    A pair that cannot be evaluated is a row with a reason.

    Parameters
    ----------
    job : ChunkJob
        What to do.

    Raises
    ------
    DiskError
        The file cannot be written.
    FrameError
        Frames of one pulse are of several kinds of number.
    SeriesError
        This process has other code than the one that planned the chunk.
    """
    return _write_chunk(job, [_result(pair, seen) for pair, seen in _correlate_pairs(job)])


Detailed = Evaluation | PairError  # all that was asked of a pair, or why it cannot be had


def evaluate_chunk_closely(job: ChunkJob, how: PairMethod) -> list[tuple[str, Detailed]]:
    """Evaluate the pairs of a chunk and all that is asked of each alone; every pair is correlated once.

    Parameters
    ----------
    job : ChunkJob
        What to do; its file is written unless it is there and sound.
    how : PairMethod
        What is asked of each pair; it is correlated as the job says.

    Returns
    -------
    list of (str, Evaluation or PairError)
        By tag, of the pairs that have vectors.

    Raises
    ------
    DiskError, FrameError
        As `evaluate_chunk`.
    """
    prepared, method = correction_of(job.maps, job.method), job.method
    how = replace(how, settings=method.settings, preparation=method.preparation)
    results, found = [], list[tuple[str, Detailed]]()
    for pair, seen in _correlate_pairs(job):
        results.append(_result(pair, seen))
        if isinstance(seen, str):
            continue
        out, shift_mm = job.folder / pair.tag, how.details.shift_mm
        task = Task(pair.tag, pair.frames, method.scene, out, shift_mm, dt_s=pair.dt_s)
        try:
            found.append((pair.tag, evaluate_correlated(task, prepared, how, seen)))
        except PairError as error:
            found.append((pair.tag, error))
    if sound_content(job.path, job.key) is None:
        _write_chunk(job, results)
    return found


def _correlate_pairs(job: ChunkJob) -> Iterator[tuple[SeriesPair, Correlated | str]]:
    """Each pair of a chunk correlate_pair, or why it is not; SeriesError if this process has other code."""
    _require_the_planned_code(job.method)
    method, still = job.method, still_in(job)
    for pair, a, b in zip(job.pairs, clean_frames(job, 0), clean_frames(job, 1), strict=True):
        if isinstance(a, str) or isinstance(b, str):
            yield pair, a if isinstance(a, str) else str(b)
            continue
        if pair.is_repeated:
            yield pair, REPEATED
            continue
        prepared = correction_of(job.maps, method_of(pair, method))
        try:
            both = prepared.corrector(a), prepared.corrector(b)
            seen = correlate_pair((a, b), both, prepared, method.settings, method.preparation, still)
        except (PairError, FrameError) as error:  # dark frames are alike too, and that they are dark says more
            yield pair, str(error)
            continue
        is_one = pair.crc32[0] == pair.crc32[1]  # of pixels as acquired: each pulse loses a background of its own
        yield pair, ONE_PICTURE if is_one else seen


def _require_the_planned_code(method: Method) -> None:
    """SeriesError where this process, a worker perhaps, computes with other code than the one that planned."""
    planned, here = method.recipe["versions"], versions_here()
    unlike = [
        f"{name} {planned.get(name, 'unknown')} where it was planned, {here[name]} here"
        for name in here
        if planned.get(name) != here[name]  # an older program may have planned, which did not say all
    ]
    if unlike:
        raise SeriesError(
            f"this process has another program than the one that planned its chunk ({'; '.join(unlike)}): it was"
            " replaced meanwhile, or this computer has another; begin again, with one program everywhere"
        )


def _result(pair: SeriesPair, seen: Correlated | str) -> PairResult:
    found = seen if isinstance(seen, str) else seen.field
    return PairResult(pair.tag, found, pair.dt_s, pair.dt_sigma_s, pair.time_s)


def _write_chunk(job: ChunkJob, results: list[PairResult]) -> Marker:
    """Write the file of a chunk from what became of its pairs, then its marker."""
    prepared = correction_of(job.maps, job.method)
    about = {"key": job.key, "scene_hash": job.method.scene.content_hash()} | readings_attribute(job.readings)
    about |= lengths_said(job.method.scene)
    windows, grid = windows_of(prepared, job.method), prepared.corrector.map.grid
    slope = viewing_slopes(prepared.corrector.map, prepared.scene, windows, job.method.settings.window_sigma)
    content = vectors_netcdf(vectors_of_pairs(results, windows, grid, about, slope=slope))
    _keep(job.path, content)
    failed = {each.tag: each.found for each in results if isinstance(each.found, str)}
    return write_marker(job.path, job.key, content, len(results), failed)


def _keep(path: Path, content: bytes) -> None:
    """Write the file of a chunk, atomically, even if others do; DiskError if it cannot be written."""
    with disk_errors(path, GIVE_AGAIN):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, content, among_many=True, cure=GIVE_AGAIN)


def correction_of(maps: Path, method: Method) -> PreparedCorrection:
    """Correction of a series, made or loaded once by each process; DiskError if its map cannot be kept."""
    with disk_errors(maps, GIVE_AGAIN):
        return _corrections(maps).of(
            method.scene, method.dewarp, limit=method.limit, grid=method.grid, view=method.view
        )


def method_of(pair: SeriesPair, method: Method) -> Method:
    """Return the method with the scene that a pair was taken through; frames stay on the grid of the series."""
    if pair.scene is None:
        return method
    return replace(method, scene=pair.scene, grid=method.grid or grid_of(method.scene.camera), limit=None)


def windows_of(prepared: PreparedCorrection, method: Method) -> WindowGrid:
    """Return the windows of a series on its corrected image."""
    return method.settings.result_grid(prepared.corrector.map.grid.shape)


@lru_cache(maxsize=2)
def _corrections(maps: Path) -> PreparedCorrections:
    return PreparedCorrections(maps, kept=1)
