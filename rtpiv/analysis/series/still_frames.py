"""Light that stands still in all pairs of a series, found once, from raw frames, before any pair is evaluated.

The frames of one pair say less: both pulses may be alike by chance, and of a background that is taken off only the
flicker is left, which does not stand still (`piv.preprocessing.still_light`).  What is found is a mask on the
nodes of the corrected frames, in a file with what it was made from; every chunk has its key in its own.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from correction.maps.corrector import Corrector
from daq.errors import RunDamaged
from daq.runs.acquired import read_promised
from piv.errors import FrameError
from piv.preprocessing.still_light import across_pairs, still_light
from rtpiv.analysis.series.series_plan import ChunkJob, Method, SeriesPair, digest
from rtpiv.analysis.series.shared_file import Arrays, SharedFile

KIND = "light that stands still in a series"
PAIRS = 24  # that are compared, spread over the series
LAYOUT = 2


def still_of(folder: Path, pairs: Sequence[SeriesPair], method: Method) -> SharedFile:
    """File of the mask of a series, which may not be there yet."""
    by = [method.recipe[name] for name in ("versions", "correction")]
    made_from = [LAYOUT, *by, method.recipe.get("grid"), [pair.crc32 for pair in _some(pairs)]]
    return SharedFile(folder / "still.npz", digest(made_from))


def make_still(folder: Path, pairs: Sequence[SeriesPair], method: Method, corrector: Corrector) -> SharedFile:
    """Make the file of the mask, unless it is there; DiskError if it cannot be written."""
    shape, nodes = method.scene.camera.shape, corrector.recovered.shape

    def make() -> Arrays:
        sound = (both for pair in _some(pairs) if (both := _read(pair, shape, corrector)) is not None)
        found = still_light(across_pairs(sound), corrector.recovered)
        return {"still": np.packbits(np.zeros(nodes, bool) if found is None else found), "shape": np.array(nodes)}

    return still_of(folder, pairs, method).ensure(KIND, make)


def still_in(job: ChunkJob) -> NDArray[np.bool_] | None:
    """The mask that the pairs of a chunk share; None if each looks for itself."""
    return None if job.still is None else load_still(job.still)


@lru_cache(maxsize=1)
def load_still(light: SharedFile) -> NDArray[np.bool_]:
    """Mask (h, w), True where light stands still; MapFileError if its file is missing, damaged or of others."""
    arrays = light.arrays(KIND)
    rows, columns = arrays["shape"].tolist()
    return np.unpackbits(arrays["still"], count=rows * columns).reshape(rows, columns).astype(bool)


def _some(pairs: Sequence[SeriesPair]) -> list[SeriesPair]:
    """Pairs that are compared."""
    places = np.linspace(0, len(pairs) - 1, min(len(pairs), PAIRS)).round().astype(int)
    return [pairs[place] for place in places]


def _read(
    pair: SeriesPair, shape: tuple[int, int], corrector: Corrector
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Corrected frames of a pair; None if one is missing or damaged, which is said when the pair is evaluated."""
    try:
        a, b = (corrector(read_promised(pair.frames[k], pair.crc32[k], shape)) for k in range(2))
    except (FrameError, RunDamaged):
        return None
    return a, b
