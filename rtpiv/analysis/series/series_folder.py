"""The folder of a series: what it consists of, its chunks, and one process at work in it.

series.json   what was asked, the key of every chunk: on the disk before the first of them
scene.yaml    what the camera looked through; fit.npz, what its fit is unsure of, if there was one
chunks/       00042.nc vectors, 00042.json their marker
maps/         correction maps that all workers share; can be made again at any time
background.npz   if one of the whole series was taken off
still.npz     where light stands still in all pairs: walls and reflections, which belong to no window
mean.nc       statistics, by `rtpiv mean`

The marker of a chunk says what its file was made from, and the hash of its bytes.  A file without a marker is
none: the marker is written last.  Existence alone proves nothing, so each reader of a chunk compares both hashes.
"""

import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from math import isclose
from pathlib import Path
from typing import Annotated, Any, NotRequired, TypeVar

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError, with_config
from pydantic.dataclasses import dataclass as checked
from typing_extensions import TypedDict  # that of typing cannot be checked before Python 3.12

from daq.atomic_write import OTHER_FOLDER, disk_errors, write_json
from daq.errors import RunUnsuitable
from daq.runs.lab_readings import Shown
from daq.runs.records import MAX_RECORD_BYTES, STRICT, Count, Sha, Tag, Text, Way
from ground.file_lock import hold
from ground.plain_file import read_plain
from piv.errors import SeriesError
from piv.files.vector_file import Vectors, read_vectors
from rtpiv.analysis.pairs.pair_vectors import ChunkContent, read_chunk
from rtpiv.analysis.series.series_plan import chunk_path

T = TypeVar("T")
FILE = "series.json"
MEAN = "mean.nc"
_OURS = re.compile(r"(?P<number>[0-9]{5,9})\.(nc|json)(\.[0-9a-f]{32})?(?P<part>\.part)?")
MARKER_BYTES = 10_000_000
CHUNK_BYTES = 2_000_000_000


@checked(frozen=True, config=ConfigDict(strict=True, extra="forbid"))
class Marker:
    """Key, hash and failures of a chunk's file.

    Parameters
    ----------
    key : str
        Of the job that it was made by, see `ChunkJob.key`.
    sha256 : str
        Of its bytes.
    size : int
        How many these are: what is cut short is seen without reading it.
    pairs : int
        Pairs in it.
    failed : dict of str to str
        Those of them without vectors, by tag, and why.
    """

    key: Sha
    sha256: Sha
    size: Count
    pairs: Count
    failed: dict[str, str]


_MARKER: TypeAdapter[Marker] = TypeAdapter(Marker)


def marker_path(path: Path) -> Path:
    """Marker of a chunk's file."""
    return path.with_suffix(".json")


def write_marker(path: Path, key: str, content: bytes, pairs: int, failed: dict[str, str]) -> Marker:
    """Mark the chunk's file at `path`, which holds `content`, as whole; DiskError if that cannot be written."""
    marker = Marker(key, hashlib.sha256(content).hexdigest(), len(content), pairs, failed)
    write_json(marker_path(path), asdict(marker), among_many=True)
    return marker


def marker_of(path: Path, key: str | None = None) -> Marker | None:
    """Marker of a chunk's file that is of this key (or any) and as long as the file; its bytes are not read."""
    try:
        marker = _MARKER.validate_json(read_plain(marker_path(path), MARKER_BYTES))
        size = path.stat().st_size
    except (OSError, ValidationError):
        return None
    return marker if key in (None, marker.key) and marker.size == size else None


def sound_content(path: Path, key: str) -> tuple[Marker, bytes] | None:
    """Marker and bytes of a chunk's file; None if it is missing, of another key, or not what was written."""
    marker = marker_of(path, key)
    try:
        content = read_plain(path, CHUNK_BYTES)
    except OSError:
        return None
    is_sound = marker is not None and marker.sha256 == hashlib.sha256(content).hexdigest()
    return (marker, content) if marker is not None and is_sound else None


@with_config(STRICT)
class SeriesFile(TypedDict):
    """A whole series.json."""

    run: Text
    pairs: Annotated[int, Field(ge=1, le=1_000_000_000)]
    alone: Count  # frames that lost their partner
    glass: bool
    glass_place_mm: Way  # off the place in the scene file
    dewarped: bool
    chunk_pairs: Count
    keys: list[Sha]
    content: dict[str, Any]  # settings, preparation, correction, versions
    shown: Tag  # a pair for pictures
    readings: NotRequired[dict[Text, Shown]]  # of gauges of the lab, over the steps of the pairs


_SERIES: TypeAdapter[SeriesFile] = TypeAdapter(SeriesFile)


def read_about(adapter: TypeAdapter[T], file: Path, absent: tuple[str, str], cure: str) -> T:
    """Read the file that says what a folder is.

    Parameters
    ----------
    adapter : TypeAdapter
        Its types.
    file : Path
        The file.
    absent : (str, str)
        What is wrong with a folder without it, and the cure.
    cure : str
        For a file that is damaged.

    Raises
    ------
    RunUnsuitable
        There is none.
    SeriesError
        It is damaged.
    """
    try:
        return adapter.validate_json(read_plain(file, MAX_RECORD_BYTES))
    except FileNotFoundError:
        raise RunUnsuitable(absent[0], place=file.parent, cure=absent[1]) from None
    except OSError as error:
        raise SeriesError(f"cannot be read ({error.strerror})", place=file, cure=cure) from None
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]["msg"]
        raise SeriesError(f"is damaged ({problem})", place=file, cure=cure) from None


@dataclass(frozen=True)
class Unlike:
    """Finished chunks that a series would replace, and why.

    Parameters
    ----------
    lost, kept : int
        Chunks whose key is not that of the series, and those whose key is.
    run : str, optional
        Whose they are, if any is lost.
    differences : tuple of str
        What of the recipe is another one; empty if only frames have changed, or pairs were added.
    """

    lost: int
    kept: int
    run: str | None = None
    differences: tuple[str, ...] = ()


def _differences(before: SeriesFile, now: SeriesFile) -> tuple[str, ...]:
    """Return the differences between two recipes, in the words of options and files."""
    sides = tuple(
        {
            "chunk_pairs": each["chunk_pairs"],
            **each["content"].get("settings", {}),
            "prepare": ",".join(each["content"].get("preparation", [])) or "none",
            **each["content"].get("versions", {}),
        }
        for each in (before, now)
    )
    names = dict.fromkeys((*sides[0], *sides[1]))
    found = [
        f"{name} {_plain(sides[0].get(name))} there, {_plain(sides[1].get(name))} now"
        for name in names
        if _plain(sides[0].get(name)) != _plain(sides[1].get(name))
    ]
    views = [[each["content"].get("correction"), each["content"].get("grid")] for each in (before, now)]
    if _plain(views[0]) != _plain(views[1]):
        found.append("another scene, fit, bare target or limit of sigma")
    if before["content"].get("layout") != now["content"].get("layout"):
        found.append("another layout of its files")
    return tuple(found)


def _plain(value: object) -> str:
    """Text of a value that may have been through JSON, where tuples are lists."""
    text = json.dumps(value).strip('"')
    return text.replace("[", "(").replace("]", ")") if isinstance(value, list | tuple) else text


@dataclass(frozen=True)
class SeriesFolder:
    """A series on the disk."""

    path: Path

    @property
    def about(self) -> SeriesFile:
        """Contents of series.json.

        Raises
        ------
        RunUnsuitable
            The folder is no series.
        SeriesError
            The file is damaged.
        """
        absent = f"is no series (it has no {FILE})", "evaluate a flow run first"
        return read_about(_SERIES, self.path / FILE, absent, "evaluate the run again")

    def chunk_keys(self) -> dict[int, str]:
        """Keys of the finished chunks in the folder by their number, whatever series they belong to."""
        found = {}
        for file in sorted((self.path / "chunks").glob("*.nc")):
            marker = marker_of(file) if file.stem.isdecimal() else None
            if marker is not None:
                found[int(file.stem)] = marker.key
        return found

    def agrees_with_dt(self, dt_s: float | None) -> bool:
        """Return whether the vectors there are of frames this time apart; True where there are none yet."""
        for number, key in self.chunk_keys().items():
            try:
                fields = self.chunk(number, key).fields
            except SeriesError:
                continue
            for field in fields:
                return isclose(field.dt_s or 0.0, dt_s or 0.0)  # of displacements there is none
        return True

    def unlike(self, about: SeriesFile) -> "Unlike":
        """Compare the finished chunks of the folder with a series that is to be evaluated into it."""
        wanted, finished = about["keys"], self.chunk_keys()
        lost = {n for n, key in finished.items() if n >= len(wanted) or wanted[n] != key}
        if not lost:
            return Unlike(0, len(finished))
        try:
            before = self.about
        except (RunUnsuitable, SeriesError):
            return Unlike(len(lost), len(finished) - len(lost), None, (f"{FILE} is missing or damaged",))
        return Unlike(len(lost), len(finished) - len(lost), before["run"], _differences(before, about))

    def begin(self, about: SeriesFile) -> None:
        """Write series.json; remove what a killed worker left and what is no longer part of the series.

        That is chunks beyond its end, and the mean of chunks that will be made anew.  Nothing else is touched.
        """
        if self.unlike(about).lost:
            (self.path / MEAN).unlink(missing_ok=True)
        write_json(self.path / FILE, about)
        for file in (self.path / "chunks").glob("*"):
            ours = _OURS.fullmatch(file.name)
            if ours is not None and (ours["part"] or int(ours["number"]) >= len(about["keys"])):
                file.unlink()

    def marker(self, number: int, key: str) -> Marker:
        """Marker of a chunk that must be there; SeriesError as `chunk`."""
        return self._sound(number, key)[0]

    def chunk(self, number: int, key: str) -> ChunkContent:
        """Read a chunk that must be there.

        Raises
        ------
        SeriesError
            It is missing, was made otherwise, or is not what was written.
        """
        return read_chunk(self._sound(number, key)[1])

    def vectors(self, number: int, key: str) -> Vectors:
        """The same as one dataset; SeriesError as `chunk`."""
        return read_vectors(self._sound(number, key)[1])

    def _sound(self, number: int, key: str) -> tuple[Marker, bytes]:
        found = sound_content(chunk_path(self.path, number), key)
        if found is None:
            raise SeriesError(
                f"{chunk_path(self.path, number)}: is missing, damaged or made with other settings; "
                "give rtpiv evaluate again, it makes only what is missing"
            )
        return found

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Keep other processes from evaluating into this folder.

        Raises
        ------
        RunUnsuitable
            Another process does.
        DiskError
            The folder cannot be written to.
        """
        with disk_errors(self.path, OTHER_FOLDER):
            self.path.mkdir(parents=True, exist_ok=True)
            lock = (self.path / ".lock").open("ab")
        with lock as file:
            try:
                hold(file)
            except BlockingIOError:
                raise RunUnsuitable(f"{self.path}: another process evaluates into it; let it finish") from None
            yield


@dataclass(frozen=True)
class Chunks:
    """All chunks of a series in order, read and checked one by one, as often as they are gone through."""

    folder: SeriesFolder
    keys: tuple[str, ...]

    @classmethod
    def of(cls, path: Path) -> "Chunks":
        """Chunks of the series in a folder; raises as `SeriesFolder.about`."""
        folder = SeriesFolder(path)
        return cls(folder, tuple(folder.about["keys"]))

    def __iter__(self) -> Iterator[ChunkContent]:
        for number, key in enumerate(self.keys):
            yield self.folder.chunk(number, key)
