"""The folder of a campaign: its request, the series of each run, and its state.

campaign.json    the request, written by `run`: its runs and how their pairs are evaluated
runs/NAME/       the series of each run, as `rtpiv evaluate` makes it (`rtpiv.analysis.series.series_folder`)
index.csv        every chunk with its key and hash, and campaign.nc, the statistics of all runs, by `merge`

Runs are found by their paths; once they have been moved, `run` is given them again: keys of chunks do not depend
on places, so finished chunks are kept.  They are never replaced by those of another recipe (`campaign_trial`).

The state is read from markers alone; no run is read and no file hashed.  A chunk is done if its marker has the
planned key and the length of its file.  `run` and `merge` compare hashes as well; that takes as long as reading
the files.
"""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NotRequired

from pydantic import Field, TypeAdapter, with_config
from typing_extensions import TypedDict  # that of typing cannot be checked before Python 3.12

from daq.runs.records import STRICT, Text
from piv.correlation.settings import settings_of
from piv.errors import SeriesError
from piv.preprocessing.preparation import Preparation
from piv.statistics.out_of_plane import OutOfPlane
from rtpiv.analysis.pairs.piv_file import PivChoice
from rtpiv.analysis.series.series_folder import SeriesFolder, marker_of, read_about
from rtpiv.analysis.series.series_plan import chunk_path
from rtpiv.options.numbers import DewarpOrder

FILE = "campaign.json"
LAYOUT: Literal[1] = 1
CAMPAIGN_CHUNK_PAIRS = 128  # a minute or more of one core, 40 MB; a power of two, see series_plan
Positive = Annotated[float, Field(gt=0.0)]


@with_config(STRICT)
class RunAsked(TypedDict):
    """A run of a campaign; its scene and what is known of its fit lie in the folder of its series."""

    name: Annotated[str, Field(pattern=r"^\w[\w.+-]*$", max_length=200)]  # of the folder of its series
    path: Text


@with_config(STRICT)
class HowAsked(TypedDict):
    """Settings of the evaluation of all runs, without their scenes."""

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
        absent = "holds no campaign", "begin with: rtpiv campaign run RUNS"
        return read_about(_CAMPAIGN, self.path / FILE, absent, "name its runs again")

    def series(self, name: str) -> SeriesFolder:
        """Folder of the series of a run."""
        return SeriesFolder(self.path / "runs" / name)


def choice_of(how: HowAsked) -> PivChoice:
    """Return the settings of a request; SeriesError if this version does not know them."""
    try:
        settings = settings_of(how["settings"])
        preparation = None if how["prepare"] is None else Preparation(tuple(how["prepare"]))
        return PivChoice(settings, preparation, OutOfPlane(**how.get("out_of_plane", {})))
    except (TypeError, ValueError) as error:
        raise SeriesError(
            f"its settings are not those of this version ({error})", place=FILE, cure="plan again"
        ) from None


@dataclass(frozen=True)
class RunStatus:
    """State of a run of a campaign.

    Parameters
    ----------
    name : str
        Of the run.
    pairs, chunks : int
        Of its series.
    done_pairs, done : int
        Pairs in finished chunks, and these chunks.
    without_vectors : dict of str to int
        Reasons why pairs of finished chunks have no vectors, each with the number of pairs.
    """

    name: str
    pairs: int
    chunks: int
    done_pairs: int
    done: int
    without_vectors: dict[str, int]


def campaign_status(folder: CampaignFolder) -> list[RunStatus]:
    """Return the state of each run of a campaign.

    Raises
    ------
    RunUnsuitable
        The folder holds no campaign, or one whose runs are not planned.
    SeriesError
        A file of it is damaged.
    """
    return [_run_status(folder, asked["name"]) for asked in folder.about["runs"]]


def _run_status(folder: CampaignFolder, name: str) -> RunStatus:
    series = folder.series(name)
    about = series.about
    markers = [marker_of(chunk_path(series.path, number), key) for number, key in enumerate(about["keys"])]
    done = [marker for marker in markers if marker is not None]
    reasons = Counter(reason for marker in done for reason in marker.failed.values())
    pairs = sum(marker.pairs for marker in done)
    return RunStatus(name, about["pairs"], len(markers), pairs, len(done), dict(reasons))
