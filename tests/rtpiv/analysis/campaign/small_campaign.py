"""A campaign of two small runs, and ways to carry it out."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass

from piv.preprocessing.preparation import Preparation
from rtpiv.analysis.campaign.campaign_folder import CampaignFolder
from rtpiv.analysis.campaign.campaign_plan import CampaignSettings, ask_for, planned_runs
from rtpiv.analysis.pairs.piv_file import PivChoice
from tests.rtpiv.analysis.series.small_series import SETTINGS, flow_run


@dataclass(frozen=True)
class Threads:
    """Workers of this process."""

    slots: int = 2

    is_elsewhere = False

    @contextmanager
    def opened(self):
        with ThreadPoolExecutor(self.slots) as pool:
            yield pool


def two_runs(parent, pairs=(6, 5), **changed):
    """Runs `one` and `two` on the disk."""
    found = []
    for name, count in zip(("one", "two"), pairs, strict=True):
        path = flow_run(parent / f"taken_{name}", count, **changed)
        found.append(path.rename(parent / name))
    return found


def planned(out, runs, *steps, chunk=2, settings=SETTINGS, scenes=()):
    """A campaign in `out` that is planned."""
    folder = CampaignFolder(out)
    preparation = Preparation(steps) if steps else None
    ask_for(folder, runs, PivChoice(settings, preparation), CampaignSettings(scenes, chunk))
    for _ in planned_runs(folder):
        pass
    return folder


def content_of(out):
    """Bytes of every file of a campaign that must not differ, by name."""
    made_again = {"books.jsonl", ".lock", "kernels.zip", "slurm"}
    files = [file for file in sorted(out.rglob("*")) if file.is_file() and not made_again & set(file.parts)]
    return {file.relative_to(out).as_posix(): file.read_bytes() for file in files}
