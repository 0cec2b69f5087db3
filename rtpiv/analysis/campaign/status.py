"""How a campaign stands, and the record of what was done in it.

The state comes from the campaign's own folder alone: markers, leases, records; no run is read and no file hashed.
A chunk is done if its marker is of the key that was planned and as long as its file.  `run` and `merge` compare
hashes as well; that takes as long as reading the files.

The record (``books.jsonl``) has a line for each try of a chunk: provenance, and from what it is known how long
the rest takes.  The client writes it, one line after the other.  A line that a crash has torn is passed over:
nothing is computed from these lines, and a chunk is believed by its marker alone.
"""

import json
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict  # that of typing cannot be checked before Python 3.12

from daq.atomic_write import why
from daq.errors import DiskError
from daq.runs.records import STRICT, Count, Sha
from ground.plain_file import open_plain
from rtpiv.analysis.campaign.campaign_folder import CampaignFolder
from rtpiv.analysis.campaign.lease import read_lease
from rtpiv.analysis.series.series_folder import marker_of
from rtpiv.analysis.series.series_plan import chunk_path

LONGEST_LINE = 100_000


@with_config(STRICT)
class BookLine(TypedDict):
    """One try of one chunk."""

    utc: str
    run: str
    chunk: Count
    key: Sha
    what: Literal["made", "failed"]
    pairs: Annotated[int, Field(ge=1)]
    seconds: Annotated[float, Field(ge=0.0)]
    host: str
    pid: Count
    reason: str


_LINE: TypeAdapter[BookLine] = TypeAdapter(BookLine)


def read_books(path: Path) -> Iterator[BookLine]:
    """Lines that can be read, in the order in which they were written."""
    try:
        with open_plain(path) as stream:
            while line := stream.readline(LONGEST_LINE):
                try:
                    yield _LINE.validate_json(line)
                except ValidationError:
                    continue
    except OSError:
        return


def write_book(path: Path, line: BookLine) -> None:
    """Append a line; DiskError if it cannot be written."""
    try:
        with path.open("ab+") as stream:
            if stream.tell() > 0:
                stream.seek(-1, 2)
                if stream.read(1) != b"\n":  # torn by a crash
                    stream.write(b"\n")
            stream.write(json.dumps(line).encode() + b"\n")
    except OSError as error:
        raise DiskError(why(error), place=path, cure="make room, then give the same command again") from error


@dataclass(frozen=True)
class AtWork:
    """Somebody who works on a chunk."""

    chunk: int
    host: str
    pid: int
    silent_s: float  # since the last pair that was ready


@dataclass(frozen=True)
class RunStatus:
    """How a run of a campaign stands.

    Parameters
    ----------
    name : str
        Of the run.
    pairs, chunks : int
        Of its series.
    done_pairs, done : int
        Of these, those in chunks that are done, and these chunks.
    running : tuple of AtWork
        Chunks that somebody works on.
    failed : dict of int to str
        Chunks that could not be made when they were tried last, and why.
    without_vectors : dict of str to int
        Why pairs of chunks that are done have no vectors, and how many.
    """

    name: str
    pairs: int
    chunks: int
    done_pairs: int
    done: int
    running: tuple[AtWork, ...]
    failed: dict[int, str]
    without_vectors: dict[str, int]

    @property
    def is_whole(self) -> bool:
        """Whether nothing is missing."""
        return self.done == self.chunks


def campaign_status(folder: CampaignFolder) -> list[RunStatus]:
    """How each run of a campaign stands.

    Raises
    ------
    RunUnsuitable
        The folder holds no campaign, or one whose runs are not planned.
    SeriesError
        A file of it is damaged.
    """
    names = [asked["name"] for asked in folder.about["runs"]]
    failed: dict[str, dict[int, str]] = {name: {} for name in names}
    for line in read_books(folder.books):
        of_run = failed.get(line["run"], {})
        of_run.pop(line["chunk"], None)
        if line["what"] == "failed":
            of_run[line["chunk"]] = line["reason"]
    now_ns = _now_ns(folder.path)
    return [_of_run(folder, name, failed[name], now_ns) for name in names]


def _of_run(folder: CampaignFolder, name: str, failed: dict[int, str], now_ns: int) -> RunStatus:
    series = folder.series(name)
    about = series.about
    done, done_pairs, running = set[int](), 0, list[AtWork]()
    reasons: Counter[str] = Counter()
    for number, key in enumerate(about["keys"]):
        marker = marker_of(chunk_path(series.path, number), key)
        if marker is not None:
            done.add(number)
            done_pairs += marker.pairs
            reasons.update(marker.failed.values())
            continue
        held = read_lease(folder.lease(name, number))
        if held is not None and not held.is_gone:
            running.append(AtWork(number, held.host, held.pid, max(0.0, (now_ns - held.beat_ns) * 1e-9)))
    left = {number: why for number, why in failed.items() if number not in done and number < len(about["keys"])}
    return RunStatus(
        name, about["pairs"], len(about["keys"]), done_pairs, len(done), tuple(running), left, dict(reasons)
    )


def _now_ns(folder: Path) -> int:
    """The time of the disk on which leases are touched, which need not be that of this computer."""
    try:
        with tempfile.NamedTemporaryFile(dir=folder) as probe:
            return Path(probe.name).stat().st_mtime_ns
    except OSError:  # of somebody else, whom we may only look at
        return folder.stat().st_mtime_ns
