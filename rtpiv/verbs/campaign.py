"""`rtpiv campaign`: evaluate and average many runs, on one computer or a cluster."""

import shlex
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, Unpack

from daq.errors import RunUsageError
from ground.plain_words import quantity
from ground.rows import thread_count
from ground.terminal import console
from rtpiv.analysis.campaign.campaign_folder import FILE, CampaignFolder, RunStatus, campaign_status
from rtpiv.analysis.campaign.campaign_plan import CampaignSettings, Forecast, adopt, ask_for, trial
from rtpiv.analysis.campaign.executors import dask_workers, evaluate_elsewhere
from rtpiv.analysis.campaign.merge import (
    INDEX,
    STATISTICS,
    CampaignMean,
    merge_campaign,
    require_finished,
    statistics_of,
)
from rtpiv.analysis.campaign.run_campaign import run_campaign
from rtpiv.analysis.pairs.piv_file import PivOptions, piv_choice
from rtpiv.analysis.series.chunk import evaluate_chunk
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.workers import worker_processes
from rtpiv.options.numbers import Count
from rtpiv.verbs.paths import Named, paths_of
from rtpiv.verbs.results import results_in
from rtpiv.verbs.show import show_campaign, show_forecasts

Action = Literal["plan", "run", "status", "merge"]
AS_EACH_RUN = CampaignSettings()  # each run as it was taken
STRANGERS = 2.0  # sigma: more, and the runs did not see one flow


@dataclass(frozen=True)
class Workers:
    """Workers of a campaign; by default all cores of this computer.

    Parameters
    ----------
    workers : int, optional
        Processes of this computer (default one per core).
    scheduler : str, optional
        Address of a Dask scheduler whose workers evaluate the runs, such as tcp://10.0.0.1:8786.
    """

    workers: Count | None = None
    scheduler: str | None = None

    def executor(self) -> AbstractContextManager[Executor | None]:
        """Return the executor of these workers; RunUsageError if options exclude each other."""
        if self.workers is not None and self.scheduler is not None:
            raise RunUsageError("--workers and --scheduler exclude each other; give one")
        if self.scheduler is not None:
            return dask_workers(self.scheduler)
        count = self.workers or thread_count()
        return nullcontext() if count < 2 else worker_processes(count)

    @property
    def is_elsewhere(self) -> bool:
        """True if other programs start the workers."""
        return self.scheduler is not None


def campaign(
    action: Action,
    runs: Sequence[Named] = (),
    /,
    out: Named = "campaign",
    settings: CampaignSettings = AS_EACH_RUN,
    workers: Workers = Workers(),
    **options: Unpack[PivOptions],
) -> list[Forecast] | list[RunStatus] | CampaignMean:
    """Evaluate many runs on this computer or on others, and average them.

    ``plan`` forecasts time and disk space and writes nothing, ``run`` evaluates the missing chunks, ``status``
    shows the progress, ``merge`` averages.  Each may be interrupted at any time and repeated.  Files have the same
    bytes for any executor and any number of interruptions.  In a folder with finished chunks another recipe,
    another scene or fewer runs are refused.

    Parameters
    ----------
    action : {"plan", "run", "status", "merge"}
        What to do.
    runs : sequence of path
        Flow runs, for ``plan`` and for the first ``run``; later calls read them from the folder.
    out : path
        Folder of the campaign, under the same path on all workers.
    settings : CampaignSettings
        Settings of the named runs.
    workers : Workers
        Workers of ``run``.
    **options
        Settings of the correlation, see `rtpiv.analysis.pairs.piv_file.PivOptions`.

    Returns
    -------
    list of Forecast, list of RunStatus, or CampaignMean
        Forecast of each run for ``plan``, the statistics for ``merge``, else the progress of each run.

    Raises
    ------
    Unfinished
        Of ``run``, ``status`` and ``merge``: chunks are missing.
    SeriesError, RunUsageError
        What was asked contradicts itself or would lose finished chunks, or a file of the campaign is damaged.
    PairError, ConfigError, FrameError, BoardError, TargetNotFound, DewarpError, RunUnsuitable, RunDamaged
        As for `evaluate`.
    DiskError
        The folder of the campaign cannot be written to.
    RunInterrupted
        A worker was killed; the same command resumes.
    """
    folder, screen = CampaignFolder(Path(out)), console()
    asked = settings != AS_EACH_RUN or any(value is not None for value in options.values())
    if runs and action not in ("plan", "run"):
        raise RunUsageError(f"{action} takes no runs, as the campaign stores its own; give its folder with -o")
    for path in paths_of(runs):
        if (path / FILE).exists():
            raise RunUsageError("is a campaign", place=path, cure=f"give its own folder with -o {path}")
    if not runs and asked:
        raise RunUsageError("scenes and settings belong to runs; name the runs as well")
    if not runs and action == "plan":
        raise RunUsageError("name the runs that are to be planned")
    with ExitStack() as held:
        if action in ("run", "merge"):
            held.enter_context(results_in(folder.path))
        if runs:
            ask = partial(
                ask_for, runs=paths_of(runs), choice=piv_choice(**options), settings=settings, used=folder
            )
            with trial(folder, ask, thread_count()) as (tried, found):
                show_forecasts(screen, found)
                if action == "plan":
                    return found
                with SeriesFolder(folder.path).lock():
                    adopt(tried, folder)
        if action == "merge":
            merged = merge_campaign(folder)
            _show_merged(folder, merged)
            return merged
        if action == "run":
            with workers.executor() as executor:
                evaluate = evaluate_elsewhere if workers.is_elsewhere else evaluate_chunk
                kept, made = run_campaign(folder, executor, evaluate)
            screen.print(f"{quantity(made, 'chunk')} made, {kept} {'was' if kept == 1 else 'were'} there")
        states = campaign_status(folder)
        show_campaign(screen, states)
        require_finished(folder, states)
        if action == "run":
            screen.print(f"average with: rtpiv campaign merge -o {shlex.quote(str(folder.path))}")
        return states


def _show_merged(folder: CampaignFolder, merged: CampaignMean, camera: str = "") -> None:
    screen = console()
    of_camera = f" of the camera {camera}" if camera else ""
    screen.print(
        f"{quantity(merged.mean.used, 'pair')} in the mean{of_camera}, {len(merged.mean.left_out)} left out"
    )
    for warning in merged.mean.warnings:
        screen.print(warning, style="bold red")
    for name, apart in merged.apart.items():
        if apart > STRANGERS:
            text = f"{name} differs from the mean of all by {apart:.1f} sigma (rms): another flow, or another view"
            screen.print(text, style="bold red")
    screen.print(
        f"wrote {folder.path / (statistics_of(camera) if camera else STATISTICS)} and {folder.path / INDEX}"
    )
    for name, beside in merged.cameras.items():
        _show_merged(folder, beside, name)
