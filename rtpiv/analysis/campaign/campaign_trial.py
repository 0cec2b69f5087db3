"""A campaign tried before it touches its folder: what it would cost, and whether it fits what is finished there.

A trial is planned in a folder of its own.  Finished chunks are hours of many computers: those of another recipe,
of another run with the same name, or of a run that is left out are never replaced or orphaned.  More pairs of a
run, changed frames and further runs are no other recipe; chunks that they concern are made again, and the forecast
says so.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from daq.atomic_write import copy_whole
from daq.errors import RunUnsuitable
from piv.errors import SeriesError
from rtpiv.analysis.campaign.campaign_folder import FILE, CampaignFolder
from rtpiv.analysis.campaign.campaign_plan import Forecast, forecasts, would_be_lost
from rtpiv.analysis.fit_beside import SCENE_FILE
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.series_input import keep_scene
from rtpiv.analysis.series.series_pairs import CHECKSUMS


@contextmanager
def trial(
    used: CampaignFolder, ask: Callable[[CampaignFolder], None], processes: int
) -> Iterator[tuple[CampaignFolder, list[Forecast]]]:
    """Plan a campaign in a temporary folder, and compare it with what the folder that it is meant for holds.

    Parameters
    ----------
    used : CampaignFolder
        The folder that it is meant for, which is only read.
    ask : callable
        Writes what is asked into the folder of the trial, by `ask_for`.
    processes : int
        That read long journals.

    Yields
    ------
    (CampaignFolder, list of Forecast)
        The trial, which can be adopted, and what each run asks for.

    Raises
    ------
    SeriesError
        Chunks are finished that this campaign would lose; the message says what differs.
    PairError, ConfigError, ...
        As `ask_for` and `plan_runs`.
    """
    with TemporaryDirectory(prefix="rtpiv-plan-") as scratch:
        tried = CampaignFolder(Path(scratch))
        ask(tried)
        found = forecasts(tried, processes, used)
        _require_same(tried, used)
        yield tried, found


def adopt(tried: CampaignFolder, used: CampaignFolder) -> None:
    """Make a trial the campaign of its folder; DiskError if that cannot be written to."""
    for asked in tried.about["runs"]:
        source, series = tried.series(asked["name"]).path, used.series(asked["name"])
        series.path.mkdir(parents=True, exist_ok=True)
        keep_scene(source / SCENE_FILE, series.path)
        if (source / CHECKSUMS).is_file():
            copy_whole(source / CHECKSUMS, series.path / CHECKSUMS)
        series.begin(SeriesFolder(source).about)
    copy_whole(tried.path / FILE, used.path / FILE)


def _require_same(tried: CampaignFolder, used: CampaignFolder) -> None:
    """Refuse a campaign that would lose finished chunks."""
    lost, differences = 0, dict[str, list[str]]()
    try:
        before = used.about
        paths = {run["name"]: run["path"] for run in before["runs"]}
        was_us, now_us = before["how"]["dt_us"], tried.about["how"]["dt_us"]
    except (RunUnsuitable, SeriesError):  # none, or damaged: the chunks of its runs are compared all the same
        paths, was_us, now_us = {}, None, None
    asked = {run["name"]: run["path"] for run in tried.about["runs"]}
    for folder in sorted((used.path / "runs").glob("*/")):
        name, series = folder.name, SeriesFolder(folder)
        if name not in asked:
            said, count = ["left out"], len(series.chunk_keys())
        else:
            unlike = series.unlike(tried.series(name).about)
            said, count = list(unlike.differences), unlike.lost
            if was_us != now_us:
                said.append(f"dt_us {was_us} there, {now_us} now")
            if not (said or unlike.kept) and paths.get(name) not in (None, asked[name]):
                said.append(f"other frames, those of {asked[name]}")
        if count:
            lost += count if said else 0
            for each in said:
                differences.setdefault(each, []).append(name)
    if differences:
        texts = [f"{', '.join(names)}: {text}" for text, names in differences.items()]
        raise SeriesError(would_be_lost(used.path, lost, texts))
