"""Plan of a series: pairs in their order, and the chunks that are evaluated apart.

A chunk's file is a function of its job and of nothing else: the raw frames by their checksums, the correction, the
settings, the versions of what computes, our own code among them.  All that goes into `ChunkJob.key`.  A sliding
minimum looks at frames of the chunks before and after, so a job names these too, and no vector depends on where a
series is cut.

Chunks hold 2^m pairs: statistics are merged by a tree over pairs whose upper part is the tree over chunks
(`piv.statistics.merge_tree`).  How many is chosen from the number of pairs alone, not from the cores at hand.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

from correction.fitted.map_sigma import SigmaLimit
from correction.fitted.prepared import content_key
from correction.grid import PlaneGrid
from correction.maps.dewarp import Dewarp
from daq.runs.journal_lines import ReadingRecord
from daq.runs.lab_readings import Shown, reading_statistics
from ground.program_code import code_digest
from piv.correlation.settings import PivSettings
from piv.preprocessing.preparation import SLIDING_MINIMUM, Preparation
from piv.preprocessing.sliding_minimum import REACH_STEPS
from piv.statistics.merge_tree import chunks_of
from piv.statistics.out_of_plane import NOTHING_TOLD, OutOfPlane
from rtpiv.analysis.series.shared_file import SharedFile
from tracer.scene.scene import Scene

LAYOUT = 2
MAX_CHUNK_PAIRS = 16  # about half a minute of one core at 4 million pixels
# At least, where there are pairs for so many: two to eight workers end at nearly the same time
CHUNKS = 8
MIN_SLIDING_PAIRS = REACH_STEPS // 2  # each chunk reads the neighbours as well: of two pairs 4 % of its time
COMPUTES = ("rtpiv", "numpy", "numba", "scipy")
_ANALYSIS = ("rtpiv/analysis/pairs", "rtpiv/analysis/series")
CODE = ("ground", "piv", "tracer", "correction", "daq/frames", "daq/runs", *_ANALYSIS)


def versions_here() -> dict[str, str]:
    """Versions of what computes in this process; of our own code a digest, since many share a version."""
    return {**{name: version(name) for name in COMPUTES}, "code of rtpiv": code_digest(*CODE)}


@dataclass(frozen=True)
class SeriesPair:
    """A pair of a series.

    Parameters
    ----------
    tag : str
        Names it within its run.
    frames : (Path, Path)
        Frame A and frame B as acquired.
    crc32 : (str, str)
        Checksums of their pixels, from the run's journal.
    dt_s : float or None
        Time between them; None if it is not known.
    dt_sigma_s : float or None
        Its standard deviation, if it was measured.
    time_s : float or None
        Since the first pair of the run; None if the camera has no clock.
    gauges : mapping of int to mapping
        What gauges of the lab showed at each step that its frames are of; empty where there are none.
    is_repeated : bool
        Whether both frames are, pixel by pixel, those of an earlier pair.
    scene : Scene, optional
        What the camera looked through, where that is not the scene of its series: a body has moved.
    """

    tag: str
    frames: tuple[Path, Path]
    crc32: tuple[str, str]
    dt_s: float | None
    dt_sigma_s: float | None = None
    time_s: float | None = None
    gauges: Mapping[int, Mapping[str, ReadingRecord]] = field(default_factory=dict, hash=False)
    is_repeated: bool = False
    scene: Scene | None = None

    @property
    def names(self) -> str:
        """Names of the two frames."""
        return " + ".join(frame.name for frame in self.frames)


@dataclass(frozen=True)
class Method:
    """Settings of the evaluation of every pair of a series.

    Parameters
    ----------
    scene : Scene
        What the camera looked through.
    dewarp : Dewarp or None
        Of the camera, if a bare target was given.
    settings : PivSettings
        Of the correlation.
    preparation : Preparation
        What is done to the frames.
    limit : SigmaLimit, optional
        Nodes of which the map is less sure are left out.
    grid : PlaneGrid, optional
        Nodes of the corrected frames, where they are not the camera's own: those of another run.
    out_of_plane : OutOfPlane
        What is known of the velocity through the sheet.
    view : int
        View of places that the camera sees on several paths: 0 the best, 1 the second best alone.
    """

    scene: Scene
    dewarp: Dewarp | None
    settings: PivSettings
    preparation: Preparation
    limit: SigmaLimit | None = None
    grid: PlaneGrid | None = None
    out_of_plane: OutOfPlane = NOTHING_TOLD
    view: int = 0

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """Everything that a vector depends on but its frames, as plain data."""
        return {
            "layout": LAYOUT,
            "versions": versions_here(),
            "correction": content_key(self.scene, self.dewarp, limit=self.limit, grid=self.grid, view=self.view),
            **({"view": self.view} if self.view else {}),
            **({} if self.grid is None else {"grid": asdict(self.grid)}),
            "settings": asdict(self.settings),
            "preparation": list(self.preparation.steps),
        }

    @property
    def content(self) -> dict[str, Any]:
        """The same with the knowledge of out-of-plane motion, on which sigma alone depends."""
        known = {name: value for name, value in asdict(self.out_of_plane).items() if value is not None}
        return {**self.recipe, **({"out_of_plane": known} if known else {})}


@dataclass(frozen=True)
class ChunkJob:
    """Work on one chunk, for any worker that sees the run and the folder of the series.

    Parameters
    ----------
    folder : Path
        Of the series.
    number : int
        Of the chunk.
    method : Method
        How.
    pairs : tuple of SeriesPair
        Pairs of this chunk.
    before, after : tuple of SeriesPair
        Neighbours whose frames a sliding minimum looks at.
    light : SharedFile or None
        Background of the whole series, if one is taken off.
    still : SharedFile or None
        Light that stands still in all its pairs; None: each pair looks for itself.
    """

    folder: Path
    number: int
    method: Method
    pairs: tuple[SeriesPair, ...]
    before: tuple[SeriesPair, ...] = ()
    after: tuple[SeriesPair, ...] = ()
    light: SharedFile | None = None
    still: SharedFile | None = None

    @property
    def path(self) -> Path:
        """File of the chunk."""
        return chunk_path(self.folder, self.number)

    @property
    def maps(self) -> Path:
        """Folder of the correction's maps, which all workers share."""
        return self.folder / "maps"

    @cached_property
    def readings(self) -> dict[str, Shown]:
        """Readings of gauges over the steps of its pairs, each step counted once."""
        steps = {number: records for pair in self.pairs for number, records in pair.gauges.items()}
        return reading_statistics(steps[number] for number in sorted(steps))

    @cached_property
    def key(self) -> str:
        """SHA-256 of all that the chunk's file is a function of."""
        repeated = [pair.tag for pair in self.pairs if pair.is_repeated]
        scenes = [[pair.tag, pair.scene.content_hash()] for pair in self.pairs if pair.scene is not None]
        tree = {
            **self.method.recipe,
            "light": None if self.light is None else self.light.key,
            "still": None if self.still is None else self.still.key,
            "first": self.number,
            "pairs": [[p.tag, p.crc32, p.dt_s, p.dt_sigma_s, p.time_s] for p in self.pairs],
            "near": [[p.crc32 for p in side] for side in (self.before, self.after)],
            **({"readings": self.readings} if self.readings else {}),
            **({"repeated": repeated} if repeated else {}),
            **({"scenes": scenes} if scenes else {}),
        }
        return digest(tree)


def usual_chunk(pairs: int, method: Method) -> int:
    """Return how many pairs a chunk of a series of so many `pairs` holds, a power of two.

    It is the largest with CHUNKS chunks, within MIN_SLIDING_PAIRS (of a sliding minimum) and MAX_CHUNK_PAIRS.
    """
    least = MIN_SLIDING_PAIRS if method.preparation.background == SLIDING_MINIMUM else 1
    return min(MAX_CHUNK_PAIRS, max(least, 1 << ((pairs // CHUNKS).bit_length() - 1) if pairs >= CHUNKS else 1))


def jobs_of(
    folder: Path,
    pairs: Sequence[SeriesPair],
    method: Method,
    light: SharedFile | None,
    chunk: int,
    still: SharedFile | None = None,
) -> list[ChunkJob]:
    """Cut a series into chunks of `chunk` pairs, a power of two."""
    reach = REACH_STEPS if method.preparation.background == SLIDING_MINIMUM else 0
    jobs = []
    for number, part in enumerate(chunks_of(len(pairs), chunk)):
        own, before = tuple(pairs[part.start : part.stop]), tuple(pairs[max(0, part.start - reach) : part.start])
        after = tuple(pairs[part.stop : part.stop + reach])
        jobs.append(ChunkJob(folder, number, method, own, before, after, light, still))
    return jobs


def chunk_path(folder: Path, number: int) -> Path:
    """File of a chunk of a series."""
    return folder / "chunks" / f"{number:05d}.nc"


def digest(tree: Any) -> str:  # noqa: ANN401 - anything JSON can hold
    """SHA-256 of plain data, 64 hex digits."""
    return hashlib.sha256(json.dumps(tree, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
