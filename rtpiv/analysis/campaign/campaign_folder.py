"""The folder of a campaign: what was asked, the series of each run, who is at work, and what became of it.

campaign.json    what was asked, by `run`: its runs and how their pairs are evaluated
runs/NAME/       the series of each run, as `rtpiv evaluate` makes it (`rtpiv.analysis.series.series_folder`)
leases/          who works on which chunk (`lease`)
books.jsonl      what was done when, by whom, in how many seconds (`books`): not the same
                 whoever works; nothing is computed from it
kernels.zip      compiled code for workers elsewhere (`kernels_at_hand`); of this kind of computer
slurm/           scripts, logs, tasks and answers of Slurm jobs
index.csv        every chunk with its key and hash, and campaign.nc, the statistics of all runs, by `merge`

Runs are named by where they lie; once they have been moved, `run` is given them again: keys of chunks know no
place, so what was done is kept.  Finished chunks are never replaced by those of another recipe (`campaign_trial`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict  # that of typing cannot be checked before Python 3.12

from daq.errors import RunUnsuitable
from daq.runs.records import MOST_BYTES, STRICT, Text
from ground.plain_file import read_plain
from piv.correlation.settings import PivSettings
from piv.errors import SeriesError
from piv.preprocessing.preparation import Preparation
from rtpiv.analysis.pairs.piv_file import PivChoice
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.options.numbers import DewarpOrder

FILE = "campaign.json"
LAYOUT: Literal[1] = 1
CHUNK_PAIRS = 128  # a minute or more of one core, 40 MB; a power of two, see series_plan
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
            return _CAMPAIGN.validate_json(read_plain(file, MOST_BYTES))
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
    given = {name: tuple(value) if isinstance(value, list) else value for name, value in how["settings"].items()}
    try:
        settings = PivSettings(**given)  # type: ignore[arg-type]  # it checks them by itself
        return PivChoice(settings, None if how["prepare"] is None else Preparation(tuple(how["prepare"])))
    except (TypeError, ValueError) as error:
        raise SeriesError(
            f"its settings are not those of this version ({error})", place=FILE, cure="plan again"
        ) from None
