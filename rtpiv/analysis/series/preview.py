"""One pair of a series looked at: its frame A after every step, and all that can be asked of a pair alone."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from piv.correlation.pair import evaluate_pair
from piv.correlation.vector_field import VectorField
from piv.errors import PairError
from piv.preprocessing.preparation import CORRECTED, RAW, Preparation
from rtpiv.analysis.pairs.evaluation import Evaluation, PairMethod, Task, evaluate_task
from rtpiv.analysis.pictures.before_after import BeforeAfter, before_after
from rtpiv.analysis.pictures.rasters import embedded, grey
from rtpiv.analysis.series.chunk import correction_of
from rtpiv.analysis.series.clean_frames import clean_frames
from rtpiv.analysis.series.series_plan import ChunkJob

DARKEST, BRIGHTEST = 1.0, 99.7  # percentiles of a frame that are shown black and white


@dataclass(frozen=True)
class Preview:
    """A pair of a series.

    Parameters
    ----------
    tag : str
        Names it.
    dt_s : float or None
        Time between its frames, if it is known.
    seen : BeforeAfter
        Frame A as acquired, after each step, and the mask.
    steps : tuple of (str, str)
        What each step is called, and what it does.
    field : VectorField
        Its vectors.
    grid : PlaneGrid
        Scale of the corrected image.
    """

    tag: str
    dt_s: float | None
    seen: BeforeAfter
    steps: tuple[tuple[str, str], ...]
    field: VectorField
    grid: PlaneGrid


def preview(job: ChunkJob) -> Preview | None:
    """Look at the one pair of a job; None if it has no vectors."""
    method = job.method
    prepared = correction_of(job.maps, method)
    corrector = prepared.corrector
    (pair,), (a,), (b,) = job.pairs, clean_frames(job, 0), clean_frames(job, 1)
    bare = replace(job, method=replace(method, preparation=Preparation()), light=None)
    (raw,) = clean_frames(bare, 0)
    if isinstance(raw, str) or isinstance(a, str) or isinstance(b, str):
        return None
    corrected, second = corrector(a), corrector(b)
    one, two = (method.preparation.finished(frame, corrector.recovered) for frame in (corrected, second))
    field = evaluate_pair(one, two, corrector.recovered, method.settings)
    seen = before_after(raw, corrected, corrector, method.scene)
    pictures: list[tuple[str, NDArray[Any]]] = [("as acquired", raw)]
    background = method.preparation.background
    if background is not None:
        pictures.append(("without background", a))
    if raw.shape != corrected.shape:
        pictures = []
    pictures.append(("corrected", corrected))
    for name in method.preparation.steps:
        if name in CORRECTED:
            corrected = Preparation((name,)).finished(corrected, corrector.recovered)
            pictures.append((name, corrected))
    layers = [(name, embedded(grey(picture, _limits(picture)))) for name, picture in pictures]
    named = {**RAW, **CORRECTED}
    steps = tuple((name, named[name]) for name in method.preparation.steps)
    mask = [layer for layer in seen.layers if layer[0] == "mask"]
    return Preview(pair.tag, pair.dt_s, replace(seen, layers=(*layers, *mask)), steps, field, corrector.map.grid)


def evaluated_closely(job: ChunkJob, how: PairMethod) -> Evaluation:
    """Evaluate the one pair of a job, which has vectors, as a pair alone is: routes, tracks, errors.

    Its frames are those of the series, without their background.

    Raises
    ------
    PairError
        The frames cannot give what was asked.
    """
    (pair,), (a,), (b,) = job.pairs, clean_frames(job, 0), clean_frames(job, 1)
    if isinstance(a, str) or isinstance(b, str):
        raise PairError(a if isinstance(a, str) else str(b))
    out, shift_mm = job.folder / pair.tag, how.details.shift_mm
    task = Task(pair.tag, pair.frames, job.method.scene, out, shift_mm, dt_s=pair.dt_s)
    how = replace(how, settings=job.method.settings, preparation=job.method.preparation)
    return evaluate_task(task, correction_of(job.maps, job.method), how, (a, b))


def _limits(frame: NDArray[Any]) -> tuple[float, float]:
    known = frame[np.isfinite(frame)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, (DARKEST, BRIGHTEST))
    return float(low), float(max(high, low + 1e-6))
