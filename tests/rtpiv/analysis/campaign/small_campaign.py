"""A campaign of two small runs, and ways to carry it out."""

from concurrent.futures import ThreadPoolExecutor

from piv.preprocessing.preparation import Preparation
from rtpiv.analysis.campaign.campaign_folder import CampaignFolder
from rtpiv.analysis.campaign.campaign_plan import CampaignSettings, ask_for, plan_runs
from rtpiv.analysis.campaign.run_campaign import run_campaign
from rtpiv.analysis.pairs.piv_file import PivChoice
from tests.rtpiv.analysis.series.small_series import SETTINGS, flow_run


def carried_out(folder, count=1):
    """What `count` threads make of a campaign."""
    with ThreadPoolExecutor(count) as executor:
        return run_campaign(folder, executor)


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
    for _ in plan_runs(folder):
        pass
    return folder


def content_of(out):
    """Bytes of every file of a campaign that must not differ, by name."""
    made_again = {".lock"}
    files = [file for file in sorted(out.rglob("*")) if file.is_file() and not made_again & set(file.parts)]
    return {file.relative_to(out).as_posix(): file.read_bytes() for file in files}
