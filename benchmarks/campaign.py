"""A campaign on this machine: what executors and chunks cost, and whether all of them write the same bytes.

    python -m benchmarks.campaign [--pairs 64] [--side 1008] [--executors local:1 local:2 dask:2]
                                  [--chunks 16] [-o FOLDER]

A flow run is written once (`benchmarks.series`: particles behind two balls), its map traced and its kernels
compiled before any clock runs; then a new campaign of it is carried out by every executor with every length of
chunk.  Said are

    wall_s       from the call to the last chunk, processes started and ended, Dask's workers too
    processor_s  of all processes that took part
    largest_MB   resident memory of the largest process
    content      hash of all files but provenance: the same for all lines of one length of chunk
"""

import hashlib
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.options import options
from benchmarks.series import ONE_THREAD, written_run
from correction.fitted.prepared import prepare
from rtpiv.analysis.campaign.campaign_folder import CampaignFolder
from rtpiv.analysis.campaign.campaign_plan import CampaignSettings, ask_for, plan_runs
from rtpiv.analysis.campaign.executors import dask_workers, evaluate_elsewhere
from rtpiv.analysis.campaign.run_campaign import run_campaign
from rtpiv.analysis.pairs.piv_file import piv_choice
from rtpiv.analysis.series.chunk import evaluate_chunk
from rtpiv.analysis.series.workers import worker_processes

PROVENANCE = {".lock"}


def main() -> None:
    """Measure and print."""
    asked = options(__doc__, pairs=64, side=1008, executors=["local:1", "local:2"], chunks=[16], once=[""])
    if all(asked.once):
        _once(Path(asked.once[0]), asked.once[1], int(asked.once[2]))
        return
    with TemporaryDirectory() as own:
        folder = asked.out or Path(own)
        run = next(folder.glob("*_flow"), None) or written_run(folder, asked.pairs, asked.side)
        _prepare(folder / "warm", run)
        for chunk in asked.chunks:
            for executor in asked.executors:
                words = ["benchmarks.campaign", "--once", str(folder), executor, str(chunk)]
                command, own = [sys.executable, "-m", *words], os.environ | ONE_THREAD
                said = subprocess.run(command, check=True, stdout=subprocess.PIPE, env=own).stdout
                print(said.decode().strip().splitlines()[-1], flush=True)


def _prepare(out: Path, run: Path) -> None:
    """Trace the map and compile, so that no line has to."""
    folder = CampaignFolder(out)
    ask_for(folder, [run], piv_choice(), CampaignSettings(chunk=2))
    planned = next(plan_runs(folder))
    prepare(planned.given.method.scene, maps=planned.jobs[0].maps)
    planned.given.still()
    evaluate_chunk(planned.jobs[0])


def _once(folder: Path, words: str, chunk: int) -> None:
    """Carry a new campaign out, and say what it took."""
    kind, _, count = words.partition(":")
    out = folder / f"{kind}_{count}_{chunk}_{time.time_ns()}"
    campaign, run = CampaignFolder(out), next(folder.glob("*_flow"))
    ask_for(campaign, [run], piv_choice(), CampaignSettings(chunk=chunk))
    maps = campaign.series(run.name).path / "maps"
    maps.mkdir(parents=True)
    for file in (folder / "warm" / "runs" / run.name / "maps").iterdir():
        (maps / file.name).hardlink_to(file)
    for _ in plan_runs(campaign):
        pass
    wall_s = time.perf_counter()
    with _executor(kind, int(count)) as executor:
        run_campaign(campaign, executor, evaluate_chunk if kind == "local" else evaluate_elsewhere)
    wall_s = time.perf_counter() - wall_s
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    found = {
        "executor": words,
        "chunk": chunk,
        "wall_s": round(wall_s, 2),
        "processor_s": round(sum(each.ru_utime + each.ru_stime for each in used), 2),
        "largest_MB": round(max(each.ru_maxrss for each in used) / 1024),
        "content": _content(out)[:12],
    }
    print(json.dumps(found))


def _executor(kind: str, count: int) -> AbstractContextManager[Executor]:
    """Return an executor by its name."""
    return _dask(count) if kind == "dask" else worker_processes(count)


@contextmanager
def _dask(count: int) -> Iterator[Executor]:
    """Worker processes of a cluster on this computer, by TCP."""
    from distributed import LocalCluster

    where = {"host": "127.0.0.1", "dashboard_address": None, "worker_dashboard_address": None}
    cluster = LocalCluster(count, threads_per_worker=1, processes=True, protocol="tcp", **where)
    with cluster, dask_workers(cluster.scheduler_address) as executor:
        yield executor


def _content(out: Path) -> str:
    digest = hashlib.sha256()
    for file in sorted(out.rglob("*")):
        if file.is_file() and not PROVENANCE & set(file.parts) and file.parent.name != "maps":
            digest.update(file.relative_to(out).as_posix().encode() + file.read_bytes())
    return digest.hexdigest()


if __name__ == "__main__":
    main()
