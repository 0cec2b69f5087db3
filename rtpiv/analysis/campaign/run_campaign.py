"""A campaign carried out: what is missing is made, what is sound is kept, whoever works on it.

Whatever ends this program, its workers or their scheduler, the same command goes on: chunks are believed by
marker, key and hash, and everything else is made anew, with the same bytes.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from daq.errors import DiskError
from daq.whole_text import why
from ground.terminal import progress
from rtpiv.analysis.campaign.books import write_book
from rtpiv.analysis.campaign.campaign_folder import CampaignFolder
from rtpiv.analysis.campaign.campaign_plan import PlannedRun, planned_runs
from rtpiv.analysis.campaign.chunk_task import ChunkTask, Outcome
from rtpiv.analysis.campaign.engine import Engine
from rtpiv.analysis.campaign.hand_out import PATIENCE_S, HandOut
from rtpiv.analysis.campaign.kernels_at_hand import pack_kernels
from rtpiv.analysis.series.chunk import correction_of, results_of
from rtpiv.analysis.series.light_file import make_light
from rtpiv.analysis.series.marker import marker_of
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.series_plan import ChunkJob

KERNELS = "kernels.zip"


@dataclass(frozen=True)
class CampaignBooks:
    """What became of the chunks of a campaign in one call.

    Parameters
    ----------
    kept, made : int
        Chunks that were there and sound, and those made now.
    failed : dict of (str, int) to str
        Those that could not be made, by run and number, and why.
    stopped : str
        Why others were not tried any more; empty if all were.
    """

    kept: int
    made: int
    failed: dict[tuple[str, int], str]
    stopped: str


def run_campaign(folder: CampaignFolder, engine: Engine, patience_s: float = PATIENCE_S) -> CampaignBooks:
    """Make what is missing of a campaign.

    Parameters
    ----------
    folder : CampaignFolder
        A planned one.
    engine : Engine
        Whose workers do it.
    patience_s : float
        How long the lease of a chunk may be silent before somebody else makes it.

    Raises
    ------
    RunUnsuitable
        Another client works on this campaign, or it is none.
    RunInterrupted
        The workers end again and again.
    DiskError
        A file of the campaign itself cannot be written.
    PairError, RunDamaged, ConfigError, ...
        As `planned_runs`.
    """
    with SeriesFolder(folder.path).alone():
        kept, made, failed = 0, 0, dict[tuple[str, int], str]()
        kernels = folder.path / KERNELS
        hand_out = HandOut(engine, engine.work(kernels), patience_s)
        pairs = sum(folder.series(asked["name"]).about["pairs"] for asked in folder.about["runs"])
        results = _recorded(folder, hand_out.results(_tasks(folder, kernels if engine.is_elsewhere else None)))
        for task, outcome in _pair_by_pair(results, pairs):
            kept, made = kept + (outcome.what == "kept"), made + (outcome.what == "made")
            if outcome.what == "failed":
                failed[task.name] = outcome.reason
        return CampaignBooks(kept, made, failed, hand_out.stopped)


def _tasks(folder: CampaignFolder, kernels: Path | None) -> Iterator[ChunkTask]:
    """Every chunk as a task, run by run; what the workers of a run share is made before its first chunk."""
    is_warm = False
    for planned in planned_runs(folder):
        missing = [job for job in planned.jobs if marker_of(job.path, job.key) is None]
        if missing:
            _make_shared(planned)
            is_warm = is_warm or _warmed(missing[0], kernels)
        for job in planned.jobs:
            yield ChunkTask(planned.name, job, folder.lease(planned.name, job.number))


def _make_shared(planned: PlannedRun) -> None:
    """Trace the scene once and gather the background once, before any worker asks for them."""
    given, method = planned.given.given, planned.given.method
    background, shape = method.preparation.background, method.scene.camera.shape
    make_light(planned.given.out, background, given.pairs, given.unseeded, shape)
    correction_of(planned.jobs[0].maps, method)


def _warmed(job: ChunkJob, kernels: Path | None) -> bool:
    """Let this process compile, by one pair, what workers would all compile at once; pack it for those elsewhere.

    What is not ready because that pair cannot be evaluated, workers compile themselves.
    """
    for _ in results_of(job, 1):
        pass
    try:
        if kernels is not None:
            pack_kernels(kernels)
    except OSError as error:
        raise DiskError(f"{kernels}: {why(error)}; make room, then give the same command again") from error
    return True


def _recorded(
    folder: CampaignFolder, results: Iterator[tuple[ChunkTask, Outcome]]
) -> Iterator[tuple[ChunkTask, Outcome]]:
    for task, outcome in results:
        if outcome.what == "made" or outcome.what == "failed":
            write_book(
                folder.books,
                {
                    "utc": datetime.now(UTC).isoformat(timespec="seconds"),
                    "run": task.run,
                    "chunk": task.job.number,
                    "key": task.job.key,
                    "what": outcome.what,
                    "pairs": len(task.job.pairs),
                    "seconds": round(outcome.seconds, 3),
                    "host": outcome.host,
                    "pid": outcome.pid,
                    "reason": outcome.reason[:1000],
                },
            )
        yield task, outcome


def _pair_by_pair(results: Iterator[tuple[ChunkTask, Outcome]], pairs: int) -> Iterator[tuple[ChunkTask, Outcome]]:
    """The same with a bar over pairs."""

    def each() -> Iterator[tuple[ChunkTask, Outcome] | None]:
        for result in results:
            yield result
            yield from [None] * (len(result[0].job.pairs) - 1)

    for result in progress(each(), pairs, "pairs"):
        if result is not None:
            yield result
