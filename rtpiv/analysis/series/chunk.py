"""One chunk of a series: raw frames in, a file of vectors out.

`evaluate_chunk` is what a worker runs: a pure function of its job, whoever calls it and however often.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from correction.fitted.prepared import PreparedCorrection, PreparedCorrections
from daq.atomic_write import sync_folder, why
from daq.errors import DiskError
from ground.whole_file import whole_file
from piv.correlation.pair import evaluate_pair
from piv.correlation.vector_field import VectorField
from piv.correlation.windows import WindowGrid, window_grid
from piv.errors import FrameError, PairError
from piv.files.vector_file import vectors_netcdf
from rtpiv.analysis.pairs.pair_vectors import PairResult, vectors_of_pairs
from rtpiv.analysis.series.clean_frames import clean_frames
from rtpiv.analysis.series.series_folder import Marker, write_marker
from rtpiv.analysis.series.series_plan import ChunkJob, Method


def evaluate_chunk(job: ChunkJob, each_pair: Callable[[], object] | None = None) -> Marker:
    """Evaluate the pairs of a chunk; write its file, then its marker.

    A pair that cannot be evaluated is a row with a reason.

    Parameters
    ----------
    job : ChunkJob
        What to do.
    each_pair : callable, optional
        Called when the correction is there, and after each pair: whoever waits sees that somebody is at work.

    Raises
    ------
    DiskError
        The file cannot be written.
    FrameError
        Frames of one pulse are of several kinds of number.
    """
    prepared = correction_of(job.maps, job.method)
    results = []
    if each_pair is not None:
        each_pair()
    for result in results_of(job, len(job.pairs)):
        results.append(result)
        if each_pair is not None:
            each_pair()
    about = {"key": job.key, "scene_hash": job.method.scene.content_hash()}
    windows, grid = windows_of(prepared, job.method), prepared.corrector.map.grid
    content = vectors_netcdf(vectors_of_pairs(results, windows, grid, about))
    _keep(job.path, content)
    failed = {each.tag: each.found for each in results if isinstance(each.found, str)}
    return write_marker(job.path, job.key, content, len(results), failed)


def results_of(job: ChunkJob, most: int) -> Iterator[PairResult]:
    """What becomes of the first `most` pairs of a chunk, one after the other; nothing is written."""
    prepared = correction_of(job.maps, job.method)
    frames = zip(job.pairs, clean_frames(job, 0), clean_frames(job, 1), strict=True)
    for pair, a, b in islice(frames, most):
        found = _vectors(a, b, prepared, job.method)
        yield PairResult(pair.tag, found, pair.dt_s, pair.dt_sigma_s, pair.time_s)


def _keep(path: Path, content: bytes) -> None:
    """Write the file of a chunk, atomically, even if others do; DiskError if it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path, among_many=True) as stream:
            stream.write(content)
        sync_folder(path.parent)
    except OSError as error:
        raise DiskError(f"{path}: {why(error)}; make room, then give the same command again") from error


def correction_of(maps: Path, method: Method) -> PreparedCorrection:
    """Correction of a series, made or loaded once by each process; DiskError if its map cannot be kept."""
    try:
        return _corrections(maps).of(method.scene, method.dewarp, limit=method.limit, grid=method.grid)
    except OSError as error:
        raise DiskError(f"{maps}: {why(error)}; make room, then give the same command again") from error


def windows_of(prepared: PreparedCorrection, method: Method) -> WindowGrid:
    """Where the vectors of a series lie on its corrected image."""
    settings = method.settings
    return window_grid(prepared.corrector.map.grid.shape, settings.windows_px[-1], settings.overlap)


@lru_cache(maxsize=2)
def _corrections(maps: Path) -> PreparedCorrections:
    return PreparedCorrections(maps, kept=1)


def _vectors(
    a: NDArray[Any] | str, b: NDArray[Any] | str, prepared: PreparedCorrection, method: Method
) -> VectorField | str:
    """Vectors of a pair of clean raw frames, or why there are none."""
    if isinstance(a, str) or isinstance(b, str):
        return a if isinstance(a, str) else str(b)
    corrector = prepared.corrector
    try:
        one, two = (method.preparation.finished(corrector(frame), corrector.recovered) for frame in (a, b))
        return evaluate_pair(one, two, corrector.recovered, method.settings)
    except (PairError, FrameError) as error:
        return str(error)
