"""Plan of a campaign: its runs as chunks, the finished ones among them, and the cost of the rest.

A run is planned anew whenever its chunks are made: keys come from its journal, its scene, the settings and the
versions as they are then; no earlier plan is reused.

A campaign is first planned in a temporary folder (`trial`).  Finished chunks are hours of many computers: those of
another recipe, of another run with the same name, or of a run that is left out are never replaced or orphaned.
More pairs of a run, changed frames and further runs are the same recipe; chunks that they concern are made again,
and the forecast names them.
"""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from correction.grid import grid_of
from correction.maps.correction_map import STORED_BYTES
from daq.atomic_write import copy_whole, why, write_json
from daq.errors import DiskError, RunUnsuitable
from daq.frames.source import is_source
from daq.runs.names import camera_of, is_run, main_run
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import scene_file
from ground.plain_words import quantity
from piv.errors import PairError, SeriesError
from piv.preprocessing.preparation import SLIDING_MINIMUM
from rtpiv.analysis.campaign.campaign_folder import (
    CAMPAIGN_CHUNK_PAIRS,
    FILE,
    LAYOUT,
    CampaignFile,
    CampaignFolder,
    HowAsked,
    choice_of,
)
from rtpiv.analysis.fit_beside import SCENE_FILE
from rtpiv.analysis.pairs.piv_file import PivChoice
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.analysis.series.clean_frames import light_of
from rtpiv.analysis.series.run_series import about_series
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.series_input import SeriesInput, keep_scene, series_input
from rtpiv.analysis.series.series_pairs import CHECKSUMS
from rtpiv.analysis.series.series_plan import ChunkJob, jobs_of
from rtpiv.analysis.series.still_frames import still_of
from rtpiv.analysis.series.workers import worker_processes
from rtpiv.options.numbers import Count, DewarpOrder, Positive
from tracer.scene.scene_file import load_scene

S_PER_MPX = 0.5  # of one core for a pair: 2 s at 4 million pixels
VECTOR_BYTES = 55  # of a chunk's file: 13 float32 and 3 int8 of each pair
PLACE_BYTES = 8  # the same for all its pairs: 2 float32
PIXEL_BYTES = 2
LONG_BYTES = 10_000_000  # of journals: below, processes take longer to start than to read


@dataclass(frozen=True)
class PlannedRun:
    """A run as chunks.

    Parameters
    ----------
    name : str
        Of the run within the campaign.
    given : SeriesInput
        Its pairs and how they are evaluated.
    jobs : tuple of ChunkJob
        All its chunks.
    """

    name: str
    given: SeriesInput
    jobs: tuple[ChunkJob, ...]


@dataclass(frozen=True)
class Forecast:
    """Estimated cost of a run.

    Parameters
    ----------
    name : str
        Of the run.
    pairs, chunks : int
        In all.
    done : int
        Chunks that are there, by their markers.
    again : int
        Finished chunks among the others, whose frames have changed or whose run has grown.
    left_s : float
        Time of one core for the others.
    read_bytes, write_bytes : float
        Raw frames that they read, and what they write.
    """

    name: str
    pairs: int
    chunks: int
    done: int
    again: int
    left_s: float
    read_bytes: float
    write_bytes: float


@dataclass(frozen=True)
class CampaignSettings:
    """Settings of the named runs.

    Parameters
    ----------
    scenes : sequence of path
        One scene.yaml for all runs, or one per run in their order; default: the scene of each run.
    chunk : int, optional
        Pairs per chunk, a power of two (default 128).
    target_clear : path, optional
        Frame of the bare target, for the dewarp.
    dewarp_order : {2, 3, 4, 5}, optional
        Order of the dewarp polynomial (default 2).
    dt_us : float, optional
        Time between the frames of a pair, if the runs do not contain it.
    sigma_limit_px : float, optional
        Mask nodes where the map uncertainty is larger than this.

    Raises
    ------
    PairError
        An order of a dewarp without the bare target.
    """

    scenes: Sequence[Path | str] = ()
    chunk: Count | None = None
    target_clear: Path | str | None = None
    dewarp_order: DewarpOrder | None = None
    dt_us: Positive | None = None
    sigma_limit_px: Positive | None = None

    def __post_init__(self) -> None:
        if self.target_clear is None and self.dewarp_order is not None:
            raise PairError("--dewarp-order is that of --target-clear; give both, or none")


def ask_for(
    folder: CampaignFolder,
    runs: Sequence[Path],
    choice: PivChoice,
    settings: CampaignSettings = CampaignSettings(),
    used: CampaignFolder | None = None,
) -> None:
    """Write campaign.json, and beside each run's series the scene that it is seen through.

    Parameters
    ----------
    folder : CampaignFolder
        Of the campaign.
    runs : sequence of Path
        Flow runs, or external image pairs.
    choice : PivChoice
        How pairs are evaluated.
    settings : CampaignSettings
        Scenes, size of the chunks, dewarp: what holds for these runs.
    used : CampaignFolder, optional
        Whose names of the same runs are kept, and checksums of foreign frames where files have not changed since.

    Raises
    ------
    SeriesError
        Two runs are one, or there are scenes for some runs and not for others.
    RunUnsuitable, ConfigError, DiskError
        What a run or its scene make impossible, or the folder cannot hold.
    """
    if len({os.path.realpath(run) for run in runs}) < len(runs):
        raise SeriesError("a run is named twice; its pairs would count twice")
    scenes = [Path(scene) for scene in settings.scenes]
    if len(scenes) not in (0, 1, len(runs)):
        raise SeriesError(f"{len(scenes)} scenes for {len(runs)} runs; give one for all, or one for each in order")
    for scene in scenes:
        load_scene(scene)
    for run in runs:
        if is_run(run) or not is_source(run):
            continue
        if not scenes:
            raise PairError("what its camera looked through is not known", place=run, cure="give --scene")
        if settings.dt_us is None:
            raise PairError("the time between the frames of a pair is not known", place=run, cure="give --dt-us")
    names = _names(runs, used)
    for place, (name, run) in enumerate(zip(names, runs, strict=True)):
        out = folder.series(name).path
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DiskError(why(error), place=out, cure="choose another folder with -o") from error
        keep_scene(scenes[place if len(scenes) > 1 else 0] if scenes else scene_file(run, out), out)
        if used is not None and (known := used.series(name).path / CHECKSUMS).is_file():
            copy_whole(known, out / CHECKSUMS)
    how: HowAsked = {
        "settings": {n: list(v) if isinstance(v, tuple) else v for n, v in asdict(choice.settings).items()},
        "prepare": None if choice.preparation is None else list(choice.preparation.steps),
        "target_clear": None if settings.target_clear is None else os.path.realpath(settings.target_clear),
        "dewarp_order": settings.dewarp_order or 2,
        "dt_us": settings.dt_us,
        "sigma_limit_px": settings.sigma_limit_px,
        "out_of_plane": asdict(choice.out_of_plane),
    }
    asked: CampaignFile = {
        "layout": LAYOUT,
        "chunk_pairs": settings.chunk or CAMPAIGN_CHUNK_PAIRS,
        "runs": [{"name": name, "path": os.path.realpath(run)} for name, run in zip(names, runs, strict=True)],
        "how": how,
    }
    write_json(folder.path / FILE, asked)


def plan_runs(folder: CampaignFolder) -> Iterator[PlannedRun]:
    """Plan one run after the other, and write down what each consists of, unless that would lose finished chunks.

    All are evaluated on the grid of the first one: cameras of two fits differ a little, and means of vectors need
    one place.

    Raises
    ------
    PairError, RunUnsuitable, RunDamaged, ConfigError, FrameError, BoardError, TargetNotFound, DewarpError
        As `rtpiv.analysis.series.series_input.series_input`.
    SeriesError
        The folder holds finished chunks of another recipe.
    DiskError
        The folder cannot be written to.
    """
    for place in range(len(folder.about["runs"])):
        yield _plan_run(folder, place)


def forecasts(folder: CampaignFolder, processes: int, used: CampaignFolder | None = None) -> list[Forecast]:
    """Plan all runs as `plan_runs` does, long journals on several cores, and say what each asks for.

    What is finished is looked for in `used`, or in `folder` itself.
    """
    used = used or folder
    runs = folder.about["runs"]
    places, found = range(len(runs)), dict[int, Forecast | None]()
    if processes > 1 and sum(_journal_bytes(Path(run["path"])) for run in runs) > LONG_BYTES:
        with worker_processes(min(processes, len(runs))) as pool:
            found = dict(
                zip(places, pool.map(_forecast_of, [folder] * len(runs), places, [used] * len(runs)), strict=True)
            )
    return [found.get(place) or forecast(used, _plan_run(folder, place)) for place in places]


def _journal_bytes(run: Path) -> int:
    try:
        return RunFolder(run).journal_path.stat().st_size
    except OSError:
        return 0


def _forecast_of(folder: CampaignFolder, place: int, used: CampaignFolder) -> Forecast | None:
    """Forecast of one run, in a process of its own; what is wrong with it is said by the one who asked."""
    try:
        return forecast(used, _plan_run(folder, place))
    except Exception:  # it is planned there again, and fails there with its own error
        return None


def _plan_run(folder: CampaignFolder, place: int) -> PlannedRun:
    """Plan one run."""
    about = folder.about
    asked, how = about["runs"][place], about["how"]
    out = folder.series(asked["name"]).path
    recipe = CorrectionRecipe(how["target_clear"], how["dewarp_order"], sigma_limit_px=how["sigma_limit_px"])
    given = series_input(Path(asked["path"]), out, choice_of(how), out / SCENE_FILE, recipe, how["dt_us"])
    first = load_scene(folder.series(about["runs"][0]["name"]).path / SCENE_FILE)
    grid = grid_of(first.in_light_sheet().camera)  # particles are seen where the light is
    if grid != grid_of(given.method.scene.camera):
        given = replace(given, method=replace(given.method, grid=grid))
    background = given.method.preparation.background
    if background == SLIDING_MINIMUM and len(given.given.pairs) < 2:
        raise PairError(f"{asked['path']}: a sliding minimum compares frames of several pairs, and it has one")
    light = light_of(out, background, given.given.pairs, given.given.unseeded)
    still = still_of(out, given.given.pairs, given.method)
    jobs = jobs_of(out, given.given.pairs, given.method, light, about["chunk_pairs"], still)
    said = about_series(Path(asked["path"]).name, given.given, given.method, jobs, about["chunk_pairs"])
    series = SeriesFolder(out)
    if differences := series.unlike(said).differences:
        raise SeriesError(chunks_to_discard(out, series.unlike(said).lost, differences))
    series.begin(said)
    return PlannedRun(asked["name"], given, tuple(jobs))


def chunks_to_discard(folder: Path, chunks: int, differences: Sequence[str]) -> str:
    """Return the reason to refuse a campaign that would replace finished chunks."""
    return (
        f"{folder}: {quantity(chunks, 'finished chunk')} would be made anew: {'; '.join(differences)};"
        " choose another folder with -o, or delete this one"
    )


def forecast(folder: CampaignFolder, planned: PlannedRun) -> Forecast:
    """Count the finished chunks of a run, and estimate the cost of the others."""
    scene, settings = planned.given.method.scene, planned.given.method.settings
    shape = (planned.given.method.grid or grid_of(scene.camera)).shape
    vectors = int(np.prod(settings.result_grid(shape).shape))
    has_map = any((folder.series(planned.name).path / "maps").glob("*.map"))
    map_bytes = 0.0 if has_map else STORED_BYTES * float(np.prod(shape))
    pixels = float(np.prod(scene.camera.shape))
    series = folder.series(planned.name).path  # not that of the jobs, if the plan is a trial
    finished = SeriesFolder(series).chunk_keys()
    left = [job for job in planned.jobs if finished.get(job.number) != job.key]
    pairs = sum(len(job.pairs) for job in left)
    reads = sum(len(job.pairs) + len(job.before) + len(job.after) for job in left)
    return Forecast(
        planned.name,
        len(planned.given.given.pairs),
        len(planned.jobs),
        len(planned.jobs) - len(left),
        sum(job.number in finished for job in left),
        S_PER_MPX * 1e-6 * pixels * pairs,
        2.0 * PIXEL_BYTES * pixels * reads,
        float(vectors * (VECTOR_BYTES * pairs + PLACE_BYTES * len(left))) + map_bytes * bool(left),
    )


def _names(runs: Sequence[Path], used: CampaignFolder | None) -> list[str]:
    """A name for each run: that of `used`, or of its folder and further camera, numbered where several share it.

    Earlier versions named a further camera by its own folder alone; its finished chunks are found by that name.
    """
    try:
        before = {run["path"]: run["name"] for run in used.about["runs"]} if used is not None else {}
    except (RunUnsuitable, SeriesError):  # no campaign yet, or a damaged file
        before = {}
    kept = [before.get(os.path.realpath(run)) for run in runs]
    names: list[str] = []
    for run, known in zip(runs, kept, strict=True):
        if known is not None:
            names.append(known)
            continue
        whole = "-".join(filter(None, (main_run(run).name, camera_of(run))))
        name, number = re.sub(r"[^\w.+-]+", "-", whole).strip("-."), 1
        if not name:
            raise RunUnsuitable(f"{run}: a run needs a folder with a name")
        own = name
        while own in names or own in kept:
            number += 1
            own = f"{name}_{number}"
        names.append(own)
    return names


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
        raise SeriesError(chunks_to_discard(used.path, lost, texts))
