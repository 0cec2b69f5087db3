"""Carry a campaign out: evaluate every missing chunk by the workers of an executor.

A campaign is a series per run.  Chunks are recognised by marker, key and hash alone, so that the same command
resumes after any interruption, with the same bytes.  The first chunk that cannot be written ends the command: a
full disk does not become empty by trying.
"""

from collections.abc import Callable
from concurrent.futures import Executor

from rtpiv.analysis.campaign.campaign_folder import CampaignFolder
from rtpiv.analysis.campaign.campaign_plan import plan_runs
from rtpiv.analysis.series.chunk import correction_of, evaluate_chunk
from rtpiv.analysis.series.series_folder import SeriesFolder, sound_content
from rtpiv.analysis.series.series_plan import ChunkJob
from rtpiv.analysis.series.workers import carry_out_with_progress


def run_campaign(
    folder: CampaignFolder, executor: Executor | None, evaluate: Callable[[ChunkJob], object] = evaluate_chunk
) -> tuple[int, int]:
    """Evaluate what is missing of a campaign.

    Parameters
    ----------
    folder : CampaignFolder
        A planned one.
    executor : Executor, optional
        Its workers evaluate the chunks; without one this process does.
    evaluate : callable
        Called by a worker with each chunk.

    Returns
    -------
    (int, int)
        Number of chunks that were there and sound, and of those made now.

    Raises
    ------
    RunUnsuitable
        Another process works on this campaign, or it is none.
    RunInterrupted
        A worker was killed.
    DiskError
        A file cannot be written.
    PairError, RunDamaged, ConfigError, ...
        As `plan_runs`.
    """
    with SeriesFolder(folder.path).lock():
        kept, missing = 0, list[ChunkJob]()
        for planned in plan_runs(folder):
            jobs = [job for job in planned.jobs if sound_content(job.path, job.key) is None]
            kept += len(planned.jobs) - len(jobs)
            missing += jobs
            if jobs:  # what all workers of a run share is made once, before they ask for it
                planned.given.light()
                planned.given.still()
                correction_of(jobs[0].maps, planned.given.method)
        for _ in carry_out_with_progress(evaluate, missing, executor):
            pass
        return kept, len(missing)
