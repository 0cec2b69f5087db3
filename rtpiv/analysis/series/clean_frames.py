"""Raw frames of one pulse of a chunk, in order, without their background; one that cannot be used is a reason.

A sliding minimum looks at the frames around each; any other background is of the whole series, made once for all
its chunks and kept in a file with what it was made from.

A frame that is missing or damaged costs its own pair and nothing else: its neighbours are compared with those that
are there. One whose neighbours are all gone has no background, which costs its own pair again.

While a pair is evaluated the system reads the frames of the next ones into its memory, as each is announced. That
needs no thread, and a worker waits for the disk only where the disk is slower than all workers together.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.errors import RunDamaged
from daq.runs.acquired import read_promised
from ground.plain_file import open_plain
from ground.terminal import progress_if_long
from piv.errors import FrameError, PairError
from piv.preprocessing.pod import pod_patterns, without_patterns
from piv.preprocessing.preparation import MINIMUM, POD, SLIDING_MINIMUM, UNSEEDED
from piv.preprocessing.series_light import series_mean, series_minimum, without_light
from piv.preprocessing.sliding_minimum import DARK_SHARE, REACH_STEPS, without_sliding_minimum
from rtpiv.analysis.series.series_plan import ChunkJob, SeriesPair, digest, versions_here
from rtpiv.analysis.series.shared_file import SharedFile

Frame = NDArray[Any]
AHEAD = 2  # pairs
ALONE = (
    f"no frame within {REACH_STEPS} pairs of it can be read, so that its background is not known; evaluate the run"
    " with --prepare mean, minimum or none to keep it"
)
NOTHING_LEFT = (
    "nothing is left of frame {} when its background, {}, is taken off: the frames that it was made from are the"
    " same picture, or dark; give pairs of different moments, or --prepare none to keep what they share"
)
KIND = "background of a series"
POD_FRAMES = 100  # of a pulse, spread over the series: patterns need no more


def light_of(
    folder: Path, background: str | None, pairs: Sequence[SeriesPair], unseeded: Sequence[SeriesPair]
) -> SharedFile | None:
    """Background file that a series needs, which may not be there yet; None where it needs none.

    Raises
    ------
    PairError
        There is nothing that it could be made from.
    """
    used = _background_pairs(background, pairs, unseeded)
    if used is None:
        return None
    made_from = [versions_here(), background, [p.crc32 for p in used]]
    return SharedFile(folder / "background.npz", digest(made_from))


def make_light(
    folder: Path,
    background: str | None,
    pairs: Sequence[SeriesPair],
    unseeded: Sequence[SeriesPair],
    shape: tuple[int, int],
) -> SharedFile | None:
    """Make the background file of a series, if it has none yet that was made from the same frames.

    Parameters
    ----------
    folder : Path
        Of the series.
    background : str or None
        Step for raw frames, see `piv.preprocessing.preparation`.
    pairs, unseeded : sequence of SeriesPair
        The series, and what the run took without seeding.
    shape : (int, int)
        Rows and columns of a frame.

    Returns
    -------
    SharedFile or None
        None where no background of the whole series is taken off.

    Raises
    ------
    PairError, SeriesError
        Too few frames for this background.
    DiskError
        The file cannot be written.
    """
    light, used = light_of(folder, background, pairs, unseeded), _background_pairs(background, pairs, unseeded)
    if light is None or used is None or background is None:
        return None
    return light.ensure(
        KIND, lambda: {name: _make_background(background, used, pulse, shape) for pulse, name in enumerate("ab")}
    )


def _background_pairs(
    background: str | None, pairs: Sequence[SeriesPair], unseeded: Sequence[SeriesPair]
) -> list[SeriesPair] | None:
    """Pairs whose frames a background is made from; None where none of the whole series is taken off."""
    if background is None or background == SLIDING_MINIMUM:
        return None
    used = list(unseeded if background == UNSEEDED else pairs)
    if background == UNSEEDED and len(used) < 2:
        raise PairError(
            "this run took no pairs without seeding; choose another background, such as sliding-minimum"
        )
    if background == POD and len(used) > POD_FRAMES:
        used = [used[place] for place in np.linspace(0, len(used) - 1, POD_FRAMES).round().astype(int)]
    return used


@lru_cache(maxsize=1)
def load_light(light: SharedFile) -> tuple[NDArray[Any], NDArray[Any]]:
    """Background of pulse A and of pulse B: (H, W), or patterns (r, H, W).

    Raises
    ------
    MapFileError
        The file is missing, damaged, or of another series.
    """
    arrays = light.arrays(KIND)
    return arrays["a"], arrays["b"]


def _make_background(background: str, pairs: list[SeriesPair], pulse: int, shape: tuple[int, int]) -> NDArray[Any]:
    def frame_of(pair: SeriesPair) -> NDArray[Any]:
        return read_promised(pair.frames[pulse], pair.crc32[pulse], shape)

    def sound(pair: SeriesPair) -> NDArray[Any] | None:
        """Frame; None if it is missing or damaged, which is said when its own pair is evaluated."""
        try:
            return frame_of(pair)
        except (FrameError, RunDamaged):
            return None

    if background == POD:
        there = [pair for pair in pairs if sound(pair) is not None]
        return pod_patterns(lambda number: frame_of(there[number]), len(there))
    track = progress_if_long(pairs, len(pairs), f"background of pulse {'AB'[pulse]}")
    frames = (frame for pair in track if (frame := sound(pair)) is not None)
    found: NDArray[Any] = series_minimum(frames) if background == MINIMUM else series_mean(frames)
    return found


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
        for pair in _read_ahead(job.pairs, pulse):
            frame = _read(pair, pulse, shape)
            if light is not None and not isinstance(frame, str):
                frame = without_patterns(frame, light) if background == POD else without_light(frame, light)
                frame = _frame_or_reason(frame, pulse, background)
            yield frame
        return
    near = (*job.before, *job.pairs, *job.after)
    why: dict[int, str] = {}
    clean = without_sliding_minimum(_present(near, pulse, shape, why), dark_share=DARK_SHARE)
    first, last = len(job.before), len(job.before) + len(job.pairs)
    for place, found in enumerate(clean):
        if first <= place < last:
            yield why.get(place, ALONE) if found is None else _frame_or_reason(found, pulse, background)
        elif place >= last:
            return


def _frame_or_reason(clean: Frame, pulse: int, background: str | None) -> Frame | str:
    """A frame without its background, or why that is no frame any more."""
    return clean if clean.any() else NOTHING_LEFT.format("AB"[pulse], background)


def _present(
    pairs: Sequence[SeriesPair], pulse: int, shape: tuple[int, int], why: dict[int, str]
) -> Iterator[Frame | None]:
    """Frames that can be read; of the others the reason is put into `why`."""
    for place, pair in enumerate(_read_ahead(pairs, pulse)):
        frame = _read(pair, pulse, shape)
        if isinstance(frame, str):
            why[place] = frame
            yield None
        else:
            yield frame


def _read_ahead(pairs: Sequence[SeriesPair], pulse: int) -> Iterator[SeriesPair]:
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
