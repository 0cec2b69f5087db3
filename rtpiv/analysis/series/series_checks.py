"""Plausibility of the vectors of a series: few are valid, they jump, turn round, or are too fast.

A frame that was lost before the files were numbered leaves no gap.  In a time-resolved series the pair across it
has about twice the displacement of the pairs before and after it; in a series of single pairs those behind it are
no pairs, and few of their vectors are valid.  A pair whose frames were exchanged moves the opposite way.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.plain_words import quantity
from piv.correlation.vector_field import ONE_PICTURE, REPEATED, VectorFlag, could_be_measured
from rtpiv.analysis.pairs.plausible import scale_warnings
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.series_plan import ChunkJob, SeriesPair
from tracer.scene.scene import Scene

DOUBLED = (1.6, 2.4)  # times the displacement of the neighbours
STEADY = 0.3  # by how much the neighbours of a doubled pair may differ from each other
LEAST_MOVED_PX = 0.5  # below it noise decides how many times as far a pair moved
FEW_VALID = 0.15  # share of windows; of unlike frames 0.02 to 0.1 are valid
LEAST_UNLIKE = 0.1  # of the pairs: single ones may be blank
MAX_PAIRS_NAMED = 3
MIN_PAIRS = 5  # fewer have no usual way
MAX_COMPARED = 200  # pairs whose median is usual
MAX_REVERSED = 0.25  # of pairs

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SeriesCheck:
    """Warnings about the vectors of a series.

    Parameters
    ----------
    valid_share : float
        Share of windows with valid vectors, of those that see a flow; median of the pairs that could be evaluated.
    warnings : tuple of str
        Sentences.
    """

    valid_share: float
    warnings: tuple[str, ...]


def check_series(folder: SeriesFolder, jobs: Sequence[ChunkJob], scene: Scene, mm_per_px: float) -> SeriesCheck:
    """Look through the vectors of all pairs, chunk by chunk.

    Parameters
    ----------
    folder : SeriesFolder
        Where they lie.
    jobs : sequence of ChunkJob
        Its chunks, all done.
    scene : Scene
        Of the frames.
    mm_per_px : float
        What a pixel of the corrected frames shows.
    """
    pairs, share_of, moved = list[SeriesPair](), list[float](), list[Floats]()
    failed: dict[str, str] = {}
    for job in jobs:
        vectors = folder.vectors(job.number, job.key)
        flags = vectors.fields["flag"]
        failed |= folder.marker(job.number, job.key).failed
        asked = could_be_measured(flags).sum(axis=(1, 2))
        valid = flags == VectorFlag.VALID
        share_of += (valid.sum(axis=(1, 2)) / np.maximum(asked, 1)).tolist()
        both = np.stack([vectors.fields[f"displacement_{axis}"] for axis in "xy"], axis=-1).astype(np.float64)
        moved += list(np.where(valid[..., None], both, np.nan))
        pairs += job.pairs
    evaluated = [share for pair, share in zip(pairs, share_of, strict=True) if pair.tag not in failed]
    share = float(np.median(evaluated)) if evaluated else 1.0
    speeds = [
        np.linalg.norm(one, axis=-1) * 1e-3 * mm_per_px / pair.dt_s
        for pair, one in zip(pairs, moved, strict=True)
        if pair.dt_s is not None
    ]
    speed = np.concatenate([each[np.isfinite(each)] for each in speeds]) if speeds else np.zeros(0)
    warnings = scale_warnings(float(np.median(speed)) if speed.size else 0.0, scene.camera.sensor_px[0], mm_per_px)
    copied = {tag for tag, why in failed.items() if why in (ONE_PICTURE, REPEATED)}
    own = [(pair, one) for pair, one in zip(pairs, share_of, strict=True) if pair.tag not in copied]
    found = (*_jump_warnings(pairs, moved), *_reversal_warnings(pairs, moved), *_unlike_pair_warnings(own))
    return SeriesCheck(share, (*warnings, *found))


def _unlike_pair_warnings(pairs: Sequence[tuple[SeriesPair, float]]) -> tuple[str, ...]:
    """Name the first of several pairs of which few vectors are valid, where most pairs are sound."""
    few = [pair for pair, share in pairs if share < FEW_VALID]
    if not few or len(few) < LEAST_UNLIKE * len(pairs) or np.median([share for _, share in pairs]) < FEW_VALID:
        return ()
    return (
        f"{quantity(len(few), 'pair')} of {len(pairs)} with hardly any valid vector, the first {few[0].names}"
        ": was a frame lost before it? Evaluate the frames from there on apart",
    )


def _jump_warnings(pairs: Sequence[SeriesPair], moved: Sequence[Floats]) -> tuple[str, ...]:
    """Name pairs of a time-resolved series that moved twice as far as those beside them."""
    found = []
    for k in range(1, len(pairs) - 1):
        before, pair, after = pairs[k - 1 : k + 2]
        if before.frames[1] != pair.frames[0] or pair.frames[1] != after.frames[0]:
            continue  # no frame is in two pairs, or one is missing by its number
        beside = 0.5 * (moved[k - 1] + moved[k + 1])
        known = np.isfinite(beside + moved[k]).all(axis=-1)
        square = float((beside[known] ** 2).sum())
        if not known.any() or square < LEAST_MOVED_PX**2 * known.sum():
            continue
        apart = float(((moved[k - 1] - moved[k + 1])[known] ** 2).sum())
        times = float((beside[known] * moved[k][known]).sum()) / square
        if DOUBLED[0] <= times <= DOUBLED[1] and apart <= STEADY**2 * square:
            found.append(pair)
    if not found:
        return ()
    return (
        f"{quantity(len(found), 'pair')} moved twice as far as those before and after ({_some_of(found)}): was a"
        " frame lost before the files were numbered? Leave these frames out",
    )


def _reversal_warnings(pairs: Sequence[SeriesPair], moved: Sequence[Floats]) -> tuple[str, ...]:
    """Name the few pairs whose displacements are everywhere the usual ones with the other sign."""
    some = moved[:: max(1, len(moved) // MAX_COMPARED)]
    seen = np.isfinite(some).any(axis=(0, -1)) if some else np.zeros(0, dtype=bool)
    if len(pairs) < MIN_PAIRS or not seen.any():
        return ()
    usual = np.nanmedian([one[seen] for one in some], axis=0)
    found = []
    for pair, one in zip(pairs, moved, strict=True):
        known = np.isfinite(one[seen] + usual).all(axis=-1)
        square = float((usual[known] ** 2).sum())
        if square >= LEAST_MOVED_PX**2 * max(known.sum(), 1):
            apart = float(((one[seen] + usual)[known] ** 2).sum())
            found += [pair] if apart <= STEADY**2 * square else []
    if not 0 < len(found) <= MAX_REVERSED * len(pairs):  # half of an oscillating flow goes back
        return ()
    return (
        f"{quantity(len(found), 'pair')} moved as far as the others the opposite way ({_some_of(found)}): are"
        " their frames exchanged? Leave these out",
    )


def _some_of(pairs: Sequence[SeriesPair]) -> str:
    """Names of the first few pairs."""
    more = ", ..." if len(pairs) > MAX_PAIRS_NAMED else ""
    return ", ".join(pair.names for pair in pairs[:MAX_PAIRS_NAMED]) + more
