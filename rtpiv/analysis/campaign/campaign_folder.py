"""The folder of a campaign: what was asked, the series of each run, who is at work, and how it stands.

campaign.json    what was asked, by `run`: its runs and how their pairs are evaluated
runs/NAME/       the series of each run, as `rtpiv evaluate` makes it (`rtpiv.analysis.series.series_folder`)
leases/          who works on which chunk (`chunk_task`)
books.jsonl      what was done when, by whom, in how many seconds, a line for each try of a chunk: not the same
                 whoever works; nothing is computed from it, and a line that a crash has torn is passed over
kernels.zip      compiled code for workers elsewhere (`worker_setup`); of this kind of computer
slurm/           scripts, logs, tasks and answers of Slurm jobs
index.csv        every chunk with its key and hash, and campaign.nc, the statistics of all runs, by `merge`

Runs are named by where they lie; once they have been moved, `run` is given them again: keys of chunks know no
place, so what was done is kept.  Finished chunks are never replaced by those of another recipe (`campaign_trial`).

How it stands is read from markers, leases and records alone; no run is read and no file hashed.  A chunk is done
if its marker is of the key that was planned and as long as its file.  `run` and `merge` compare hashes as well;
that takes as long as reading the files.
"""

import json
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NotRequired

from pydantic import Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict  # that of typing cannot be checked before Python 3.12

from daq.atomic_write import why
from daq.errors import DiskError, RunUnsuitable
from daq.runs.records import MAX_RECORD_BYTES, STRICT, Count, Sha, Text
from ground.plain_file import open_plain, read_plain
from piv.correlation.settings import settings_of
from piv.errors import SeriesError
from piv.preprocessing.preparation import Preparation
from piv.statistics.out_of_plane import OutOfPlane
from rtpiv.analysis.campaign.chunk_task import read_lease
from rtpiv.analysis.pairs.piv_file import PivChoice
from rtpiv.analysis.series.series_folder import SeriesFolder, marker_of
from rtpiv.analysis.series.series_plan import chunk_path
from rtpiv.options.numbers import DewarpOrder

FILE = "campaign.json"
LAYOUT: Literal[1] = 1
CHUNK_PAIRS = 128  # a minute or more of one core, 40 MB; a power of two, see series_plan
LONGEST_LINE = 100_000  # of the record
Positive = Annotated[float, Field(gt=0.0)]


@with_config(STRICT)
class RunAsked(TypedDict):
    """A run of a campaign; its scene and what is known of its fit lie in the folder of its series."""

    name: Annotated[str, Field(pattern=r"^\w[\w.+-]*$", max_length=200)]  # of the folder of its series
    path: Text


@with_config(STRICT)
class HowAsked(TypedDict):
    """How the pairs of all runs are evaluated, beside their scenes."""

    settings: dict[str, int | float | bool | list[int] | None]  # of PivSettings
    prepare: list[str] | None
    target_clear: str | None
    dewarp_order: DewarpOrder
    dt_us: Positive | None
    sigma_limit_px: Positive | None
    out_of_plane: NotRequired[dict[str, float | None]]  # of OutOfPlane


@with_config(STRICT)
class CampaignFile(TypedDict):
    """A whole campaign.json."""

    layout: Literal[1]
    chunk_pairs: Annotated[int, Field(ge=1, le=65536)]
    runs: Annotated[list[RunAsked], Field(min_length=1)]
    how: HowAsked


_CAMPAIGN: TypeAdapter[CampaignFile] = TypeAdapter(CampaignFile)


@dataclass(frozen=True)
class CampaignFolder:
    """A campaign on the disk."""

    path: Path

    @property
    def about(self) -> CampaignFile:
        """Contents of campaign.json.

        Raises
        ------
        RunUnsuitable
            The folder holds no campaign.
        SeriesError
            The file is damaged.
        """
        file = self.path / FILE
        try:
            return _CAMPAIGN.validate_json(read_plain(file, MAX_RECORD_BYTES))
        except FileNotFoundError:
            raise RunUnsuitable(
                "holds no campaign", place=self.path, cure="begin with: rtpiv campaign run RUNS"
            ) from None
        except OSError as error:
            raise SeriesError(
                f"cannot be read ({error.strerror})", place=file, cure="name its runs again"
            ) from None
        except ValidationError as error:
            problem = error.errors(include_url=False)[0]["msg"]
            raise SeriesError(f"is damaged ({problem})", place=file, cure="name its runs again") from None

    def series(self, name: str) -> SeriesFolder:
        """Folder of the series of a run."""
        return SeriesFolder(self.path / "runs" / name)

    def lease(self, name: str, number: int) -> Path:
        """File that says who works on a chunk."""
        return self.path / "leases" / f"{name}-{number:05d}.json"

    @property
    def books(self) -> Path:
        """What was done, a line each."""
        return self.path / "books.jsonl"


def choice_of(how: HowAsked) -> PivChoice:
    """How pairs are evaluated, as it was asked; SeriesError if that cannot be."""
    try:
        settings = settings_of(how["settings"])
        preparation = None if how["prepare"] is None else Preparation(tuple(how["prepare"]))
        return PivChoice(settings, preparation, OutOfPlane(**how.get("out_of_plane", {})))
    except (TypeError, ValueError) as error:
        raise SeriesError(
            f"its settings are not those of this version ({error})", place=FILE, cure="plan again"
        ) from None


@with_config(STRICT)
class ProgressLine(TypedDict):
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


_LINE: TypeAdapter[ProgressLine] = TypeAdapter(ProgressLine)


def read_progress(path: Path) -> Iterator[ProgressLine]:
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


def write_progress(path: Path, line: ProgressLine) -> None:
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
    for line in read_progress(folder.books):
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
