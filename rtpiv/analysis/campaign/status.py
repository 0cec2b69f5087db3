"""How a campaign stands, from its own folder alone: markers, leases, books; no run is read and no file hashed.

A chunk is done if its marker is of the key that was planned and as long as its file.  `run` and `merge` compare
hashes as well; that takes as long as reading the files.
"""

import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from rtpiv.analysis.campaign.books import read_books
from rtpiv.analysis.campaign.campaign_folder import CampaignFolder
from rtpiv.analysis.campaign.lease import read_lease
from rtpiv.analysis.series.marker import marker_of
from rtpiv.analysis.series.series_plan import chunk_path


@dataclass(frozen=True)
class AtWork:
    """Somebody who works on a chunk."""

    chunk: int
    host: str
    pid: int
    silent_s: float  # since the last pair that was ready


@dataclass(frozen=True)
class RunStatus:
    """How a run of a campaign stands.

    Parameters
    ----------
    name : str
        Of the run.
    pairs, chunks : int
        Of its series.
    done_pairs, done : int
        Of these, those in chunks that are done, and these chunks.
    running : tuple of AtWork
        Chunks that somebody works on.
    failed : dict of int to str
        Chunks that could not be made when they were tried last, and why.
    without_vectors : dict of str to int
        Why pairs of chunks that are done have no vectors, and how many.
    """

    name: str
    pairs: int
    chunks: int
    done_pairs: int
    done: int
    running: tuple[AtWork, ...]
    failed: dict[int, str]
    without_vectors: dict[str, int]

    @property
    def is_whole(self) -> bool:
        """Whether nothing is missing."""
        return self.done == self.chunks


def campaign_status(folder: CampaignFolder) -> list[RunStatus]:
    """How each run of a campaign stands.

    Raises
    ------
    RunUnsuitable
        The folder holds no campaign, or one whose runs are not planned.
    SeriesError
        A file of it is damaged.
    """
    names = [asked["name"] for asked in folder.about["runs"]]
    failed: dict[str, dict[int, str]] = {name: {} for name in names}
    for line in read_books(folder.books):
        of_run = failed.get(line["run"], {})
        of_run.pop(line["chunk"], None)
        if line["what"] == "failed":
            of_run[line["chunk"]] = line["reason"]
    now_ns = _now_ns(folder.path)
    return [_of_run(folder, name, failed[name], now_ns) for name in names]


def _of_run(folder: CampaignFolder, name: str, failed: dict[int, str], now_ns: int) -> RunStatus:
    series = folder.series(name)
    about = series.about
    done, done_pairs, running = set[int](), 0, list[AtWork]()
    reasons: Counter[str] = Counter()
    for number, key in enumerate(about["keys"]):
        marker = marker_of(chunk_path(series.path, number), key)
        if marker is not None:
            done.add(number)
            done_pairs += marker.pairs
            reasons.update(marker.failed.values())
            continue
        held = read_lease(folder.lease(name, number))
        if held is not None and not held.is_gone:
            running.append(AtWork(number, held.host, held.pid, max(0.0, (now_ns - held.beat_ns) * 1e-9)))
    left = {number: why for number, why in failed.items() if number not in done and number < len(about["keys"])}
    return RunStatus(
        name, about["pairs"], len(about["keys"]), done_pairs, len(done), tuple(running), left, dict(reasons)
    )


def _now_ns(folder: Path) -> int:
    """The time of the disk on which leases are touched, which need not be that of this computer."""
    try:
        with tempfile.NamedTemporaryFile(dir=folder) as probe:
            return Path(probe.name).stat().st_mtime_ns
    except OSError:  # of somebody else, whom we may only look at
        return folder.stat().st_mtime_ns
