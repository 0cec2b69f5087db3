"""The ensemble correlation of a series: sweeps over all its pairs, each begun with what is known by then.

The first sweep begins with the mean of vectors, the second with what the first has found.  Sums of all pairs are
one state, so memory does not grow with their number; parts of a sweep lie on the disk until the sweep is done.

A part of a sweep is the pairs of some chunks, summed into one file, which as that of a chunk is a function of its
job.  A sum of float32 depends on the order of adding, so parts are cut by the number of pairs alone and added in
order: no worker shows in any bit.
"""

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from daq.atomic_write import GIVE_AGAIN, disk_errors
from ground.errors import MapFileError
from ground.map_file import load_arrays, save_arrays
from ground.terminal import progress
from piv.correlation.prepare import prepare_pair
from piv.correlation.windows import WindowGrid
from piv.errors import FrameError, PairError, SeriesError
from piv.statistics.ensemble import EnsembleSums
from piv.statistics.ensemble_field import EnsembleField, ensemble_field, next_sweep
from piv.statistics.sweep import Sweep, sweep_with
from rtpiv.analysis.pairs.pair_vectors import SeriesField
from rtpiv.analysis.series.chunk import correction_of, windows_of
from rtpiv.analysis.series.clean_frames import clean_frames
from rtpiv.analysis.series.mean_flow import UNTIMED_DT_S, MeanFlow, exclusion_reason, image_field
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.series_input import SeriesInput
from rtpiv.analysis.series.series_plan import MAX_CHUNK_PAIRS, ChunkJob, digest
from rtpiv.analysis.series.still_frames import still_in
from rtpiv.analysis.series.workers import run_jobs, workers_for

Floats = NDArray[np.float64]
KIND = "sums of an ensemble correlation"
PARTS = 8  # of a sweep at least, where there are pairs for so many
SWEEPS = 2  # over all pairs
LEAST_SHARE = 0.25  # of the pairs that must have a vector where the first sweep believes their mean
SAME_DT = 0.01  # relative
SUMMED = 0.0  # weights of windows that are sums of cells: none
LEVEL_PX = 32  # side of the windows in which frames are brought to one level


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
        arrays = self.sweep.field_px, self.sweep.energy_px2, self.sweep.solid
        sweep = [values.tobytes().hex() for values in arrays]
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
    still = still_in(job.frames)
    seen = corrector.recovered if still is None else corrector.recovered & ~still
    sums, folder = EnsembleSums(job.sweep), SeriesFolder(job.frames.folder)
    fields = (field for number, key in job.chunks for field in folder.chunk(number, key).fields)
    frames = zip(fields, clean_frames(job.frames, 0), clean_frames(job.frames, 1), strict=True)
    for field, a, b in frames:
        if exclusion_reason(field, job.usual_share) or isinstance(a, str) or isinstance(b, str):
            continue
        try:
            one, two = (method.preparation.apply(corrector(frame), corrector.recovered) for frame in (a, b))
            sums.add(one, two, seen, _own_field(field, job.sweep, windows))
        except (PairError, FrameError):
            continue  # it gave vectors, so this does not happen; if it does, one pair is not worth the sweep
    job.path.parent.mkdir(parents=True, exist_ok=True)
    with disk_errors(job.path, GIVE_AGAIN):
        save_arrays(job.path, KIND, {"key": job.key}, sums.to_arrays())


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


@dataclass(frozen=True, eq=False)
class EnsembleFlow:
    """Mean flow by ensemble correlation; rows from the lowest y up, u to the right, v UP, in m/s.

    Parameters
    ----------
    x_mm, y_mm : (nx,), (ny,) float64
        Places, both rising.
    px_per_m_s : float
        Displacement [px] of 1 m/s.
    windows : WindowGrid
        Where the vectors lie on the corrected image, whose rows go down.
    mean_m_s, sigma_m_s : (ny, nx, 2) float64
        Mean velocity and its random standard uncertainty, for independent pairs.
    stresses_m2_s2, stress_sigma_m2_s2 : (ny, nx, 3) float64
        Reynolds stresses R_uu, R_vv, R_uv, free of the noise of correlation, and their uncertainty.
    correlation : (ny, nx) float64
        Share of particles that stay.
    pairs : int
        Pairs in the sums.
    dt_sigma_share : float
        Standard uncertainty of dt over dt, one factor for all vectors; NaN if it was not measured.
    """

    x_mm: Floats
    y_mm: Floats
    px_per_m_s: float
    windows: WindowGrid
    mean_m_s: Floats
    sigma_m_s: Floats
    stresses_m2_s2: Floats
    stress_sigma_m2_s2: Floats
    correlation: Floats
    pairs: int
    dt_sigma_share: float = float("nan")
    is_timed: bool = True
    length: str = "mm"


def ensemble_flow(
    given: SeriesInput,
    mean: MeanFlow,
    window_px: int,
    workers: int | None = None,
    executor: Executor | None = None,
) -> EnsembleFlow:
    """Mean flow of a series by ensemble correlation.

    Parameters
    ----------
    given : SeriesInput
        The series, whose vectors are evaluated.
    mean : MeanFlow
        Their mean, with which it begins.
    window_px : int
        Side of the windows: 8, 16 or 32.
    workers : int, optional
        Processes; default one a core.
    executor : Executor, optional
        Whose workers are used instead.

    Raises
    ------
    SeriesError
        Pairs of different dt, no mean to begin with, fewer than two pairs, or windows of another side.
    DiskError, RunInterrupted
        As `run_series`.
    """
    dts = np.array([pair.dt_s or UNTIMED_DT_S for pair in given.given.pairs], np.float64)
    if np.ptp(dts) > SAME_DT * dts.mean():
        raise SeriesError("ensemble correlation adds displacements of one dt, and this run has several")
    prepared = correction_of(given.out / "maps", given.method)
    windows = windows_of(prepared, given.method)
    shape = prepared.corrector.map.grid.shape
    field = image_field(mean.mean_m_s, mean.sigma_m_s, mean.px_per_m_s, windows)
    known = mean.count[::-1, :, None] > LEAST_SHARE * mean.used
    vectors = np.where(known, np.stack((field.u_px, field.v_px), axis=-1), np.nan)
    stresses = mean.stresses_m2_s2[::-1] * mean.px_per_m_s**2
    sweep = sweep_with(shape, vectors, stresses, windows, _spread_px2(given, mean))
    found: EnsembleField | None = None
    for number in range(1, SWEEPS + 1):
        sums = _run_sweep(given, mean, sweep, number, workers, executor)
        found = ensemble_field(sums, window_px)
        if number < SWEEPS:
            sweep = next_sweep(found, sweep)
    assert found is not None
    if prepared.height_change is not None:
        bias, sigma_px = prepared.height_change.bias_px(found.mean_px, found.grid, SUMMED)
        unresolved = np.hypot(found.resolution_px, sigma_px)
        found = replace(found, mean_px=found.mean_px - bias, resolution_px=unresolved)
    on_plane = _on_plane(found, prepared.corrector.map.grid, float(dts.mean()))
    return replace(on_plane, dt_sigma_share=mean.dt_sigma_share, is_timed=mean.is_timed, length=mean.length)


def _run_sweep(
    given: SeriesInput, mean: MeanFlow, sweep: Sweep, number: int, workers: int | None, executor: Executor | None
) -> EnsembleSums:
    """Sums of one sweep over all pairs; its parts' files are removed."""
    jobs = _parts(given, mean, sweep, number)
    with workers_for(len(jobs), workers, executor) as pool:
        done = run_jobs(sum_part, jobs, pool)
        for _ in progress(done, len(jobs), f"ensemble correlation, sweep {number}"):
            pass
    total: EnsembleSums | None = None
    for job in jobs:
        part = part_sums(job)
        if part is None:
            raise SeriesError(f"{job.path}: is not what was written; give the same command again")
        total = part if total is None else total.merge_with(part)
    assert total is not None
    for job in jobs:
        job.path.unlink(missing_ok=True)
    return total


def _parts(given: SeriesInput, mean: MeanFlow, sweep: Sweep, number: int) -> list[PartJob]:
    pairs = given.given.pairs
    chunk = given.chunk
    length = max(chunk, MAX_CHUNK_PAIRS)
    while length * PARTS < len(pairs):
        length *= 2
    chunks, parts = given.jobs(chunk), given.jobs(length)
    per = length // chunk
    return [
        PartJob(
            part,
            tuple((job.number, job.key) for job in chunks[part.number * per : (part.number + 1) * per]),
            sweep,
            number,
            mean.usual_share,
        )
        for part in parts
    ]


def _spread_px2(given: SeriesInput, mean: MeanFlow) -> float:
    """Variance of a particle image in the pair nearest to the middle of the series that is used."""
    left_out = {tag for tag, _ in mean.left_out}
    jobs = [job for job in given.jobs(1) if job.pairs[0].tag not in left_out]
    job = jobs[len(jobs) // 2]
    corrector = correction_of(job.maps, job.method).corrector
    frames = [next(clean_frames(job, pulse)) for pulse in (0, 1)]
    if isinstance(frames[0], str) or isinstance(frames[1], str):
        raise SeriesError(f"{job.pairs[0].tag}: its frames have changed since they were evaluated; check the run")
    one, two = (
        job.method.preparation.apply(corrector(frame), corrector.recovered)
        for frame in frames
        if not isinstance(frame, str)
    )
    return prepare_pair(one, two, corrector.recovered, LEVEL_PX).spread_px2


def _on_plane(found: EnsembleField, grid: PlaneGrid, dt_s: float) -> EnsembleFlow:
    origin_mm, pitch_mm = grid.origin_mm, grid.pitch_mm
    px_per_m_s = 1e3 * dt_s / pitch_mm
    up = np.array((1.0, -1.0))
    turned = np.array((1.0, 1.0, -1.0))  # v up: R_uv changes its sign
    return EnsembleFlow(
        x_mm=origin_mm[0] + found.grid.x_px * pitch_mm,
        y_mm=(origin_mm[1] - found.grid.y_px * pitch_mm)[::-1],
        px_per_m_s=px_per_m_s,
        windows=found.grid,
        mean_m_s=(found.mean_px * up / px_per_m_s)[::-1],
        sigma_m_s=(np.hypot(found.sigma_px, found.resolution_px[..., None]) / px_per_m_s)[::-1],
        stresses_m2_s2=(found.stress_px2 * turned / px_per_m_s**2)[::-1],
        stress_sigma_m2_s2=(found.stress_sigma_px2 / px_per_m_s**2)[::-1],
        correlation=found.correlation[::-1],
        pairs=found.pairs,
    )
