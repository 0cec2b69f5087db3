"""Raw frames of one pulse of a chunk, in order, without their background; one that cannot be used is a reason.

A frame that is missing or damaged costs its own pair and nothing else: its neighbours are compared with those that
are there. One whose neighbours are all gone has no background, which costs its own pair again.

While a pair is evaluated the system reads the frames of the next ones into its memory: it is told which. That
needs no thread, and a worker waits for the disk only where the disk is slower than all workers together.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from daq.errors import RunDamaged
from daq.runs.acquired import read_promised
from ground.plain_file import open_plain
from piv.errors import FrameError
from piv.preprocessing.pod import without_patterns
from piv.preprocessing.preparation import POD, SLIDING_MINIMUM
from piv.preprocessing.series_light import without_light
from piv.preprocessing.sliding_minimum import DARK_SHARE, REACH_STEPS, without_sliding_minimum
from rtpiv.analysis.series.light_file import load_light
from rtpiv.analysis.series.series_plan import ChunkJob, SeriesPair

Frame = NDArray[Any]
AHEAD = 2  # pairs
ALONE = (
    f"no frame within {REACH_STEPS} pairs of it can be read, so that its background is not known; evaluate the run"
    " with --prepare mean, minimum or none to keep it"
)


def clean_frames(job: ChunkJob, pulse: int) -> Iterator[Frame | str]:
    """Frames (H, W) of pulse 0 (A) or 1 (B) for every pair of a job, each as it is or without background.

    Yields
    ------
    ndarray or str
        Or the reason why there is none.
    """
    shape, background = job.method.scene.camera.shape, job.method.preparation.background
    if background != SLIDING_MINIMUM:
        light = None if job.light is None else load_light(job.light)[pulse]
        for pair in _announced(job.pairs, pulse):
            frame = _read(pair, pulse, shape)
            if light is not None and not isinstance(frame, str):
                frame = without_patterns(frame, light) if background == POD else without_light(frame, light)
            yield frame
        return
    near = (*job.before, *job.pairs, *job.after)
    why: dict[int, str] = {}
    clean = without_sliding_minimum(_present(near, pulse, shape, why), dark_share=DARK_SHARE)
    first, last = len(job.before), len(job.before) + len(job.pairs)
    for place, found in enumerate(clean):
        if first <= place < last:
            yield why.get(place, ALONE) if found is None else found
        elif place >= last:
            return


def _present(
    pairs: Sequence[SeriesPair], pulse: int, shape: tuple[int, int], why: dict[int, str]
) -> Iterator[Frame | None]:
    """Frames that can be read; of the others the reason is put into `why`."""
    for place, pair in enumerate(_announced(pairs, pulse)):
        frame = _read(pair, pulse, shape)
        if isinstance(frame, str):
            why[place] = frame
            yield None
        else:
            yield frame


def _announced(pairs: Sequence[SeriesPair], pulse: int) -> Iterator[SeriesPair]:
    """Pairs in order; of each the system has heard AHEAD pairs before that its frame will be wanted."""
    for place, pair in enumerate(pairs):
        for later in pairs[place + 1 if place == 0 else place + AHEAD : place + 1 + AHEAD]:
            _announce(later.frames[pulse])
        yield pair


def _announce(path: Path) -> None:
    """Let the system read a file ahead; where it cannot, or there is none, the reader finds out by itself."""
    if not hasattr(os, "posix_fadvise"):
        return
    with suppress(OSError), open_plain(path) as stream:
        os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_WILLNEED)


def _read(pair: SeriesPair, pulse: int, shape: tuple[int, int]) -> Frame | str:
    try:
        return read_promised(pair.frames[pulse], pair.crc32[pulse], shape)
    except (FrameError, RunDamaged) as error:
        return str(error)
