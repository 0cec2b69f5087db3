"""A part of a sweep of the ensemble correlation: the pairs of some chunks, summed into one file.

As with chunks, a part's file is a function of its job.  A sum of float32 depends on the order of adding, so parts
are cut by the number of pairs alone and added in order: no worker shows in any bit.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.atomic_write import why
from daq.errors import DiskError
from ground.errors import MapFileError
from ground.map_file import load_arrays, save_arrays
from piv.correlation.windows import WindowGrid
from piv.errors import FrameError, PairError, SeriesError
from piv.statistics.ensemble import EnsembleSums
from piv.statistics.sweep import Sweep
from rtpiv.analysis.pairs.pair_vectors import SeriesField
from rtpiv.analysis.series.chunk import correction_of, windows_of
from rtpiv.analysis.series.clean_frames import clean_frames
from rtpiv.analysis.series.mean_flow import left_out_because
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.series_plan import ChunkJob, digest

KIND = "sums of an ensemble correlation"
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PartJob:
    """Work on one part of a sweep.

    Parameters
    ----------
    frames : ChunkJob
        Its pairs with their neighbours, as for a chunk; `number` is that of the part.
    chunks : tuple of (int, str)
        Chunks that hold the vectors of these pairs: number and key.
    sweep : Sweep
        What all parts share.
    round : int
        Of the sweeps, from 1.
    usual_share : float
        Share of measured vectors that is usual in the series.
    """

    frames: ChunkJob
    chunks: tuple[tuple[int, str], ...]
    sweep: Sweep
    round: int
    usual_share: float

    @property
    def path(self) -> Path:
        """File of the part."""
        return self.frames.folder / "ensemble" / f"sweep{self.round}_{self.frames.number:03d}.npz"

    @cached_property
    def key(self) -> str:
        """SHA-256 of all that the file is a function of."""
        sweep = [self.sweep.field_px.tobytes().hex(), self.sweep.energy_px2.tobytes().hex()]
        numbers = [self.sweep.spread_px2, self.sweep.reach_px, self.round, self.usual_share]
        return digest([self.frames.key, list(self.chunks), sweep, numbers])


def sum_part(job: PartJob) -> None:
    """Add up the pairs of a part and write its file, unless it is there.

    Raises
    ------
    SeriesError
        A chunk with the vectors of these pairs is missing or damaged.
    DiskError
        The file cannot be written.
    """
    if part_sums(job) is not None:
        return
    method = job.frames.method
    prepared = correction_of(job.frames.maps, method)
    corrector, windows = prepared.corrector, windows_of(prepared, method)
    sums, folder = EnsembleSums(job.sweep), SeriesFolder(job.frames.folder)
    fields = (field for number, key in job.chunks for field in folder.chunk(number, key).fields)
    frames = zip(fields, clean_frames(job.frames, 0), clean_frames(job.frames, 1), strict=True)
    for field, a, b in frames:
        if left_out_because(field, job.usual_share) or isinstance(a, str) or isinstance(b, str):
            continue
        try:
            one, two = (method.preparation.finished(corrector(frame), corrector.recovered) for frame in (a, b))
            sums.add(one, two, corrector.recovered, _own_field(field, job.sweep, windows))
        except (PairError, FrameError):
            continue  # it gave vectors, so this does not happen; if it does, one pair is not worth the sweep
    job.path.parent.mkdir(parents=True, exist_ok=True)
    try:
        save_arrays(job.path, KIND, {"key": job.key}, sums.to_arrays())
    except OSError as error:
        raise DiskError(f"{job.path}: {why(error)}; make room, then give the same command again") from error


def part_sums(job: PartJob) -> EnsembleSums | None:
    """Sums of a part; None if its file is missing, damaged or was made otherwise."""
    try:
        header, arrays = load_arrays(job.path, KIND)
        return EnsembleSums.from_arrays(arrays) if header.get("key") == job.key else None
    except (MapFileError, SeriesError):
        return None


def image_vectors(field: SeriesField) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Displacements and sigma (ny, nx, 2) [px], v DOWN and rows from the top, and which were measured."""
    down: NDArray[Any] = np.array((1.0, -1.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        px_per_m_s = field.displacement_px / field.velocity_m_s
    scale = float(np.nanmedian(px_per_m_s)) if np.isfinite(px_per_m_s).any() else np.nan
    vectors, sigma = field.displacement_px[::-1] * down, field.sigma_m_s[::-1] * scale
    good = field.valid[::-1] & np.isfinite(sigma).all(axis=-1) & np.isfinite(vectors).all(axis=-1)
    return vectors, sigma, np.asarray(good)


def _own_field(field: SeriesField, sweep: Sweep, windows: WindowGrid) -> Floats:
    vectors, sigma, good = image_vectors(field)
    known = good[..., None]
    return sweep.of_pair(np.where(known, vectors, 0.0), np.where(known, sigma, 1.0), good, windows)
