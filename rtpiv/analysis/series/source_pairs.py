"""Pairs of frames that no run of ours has recorded, as a series: their checksums are taken here, once.

A run's journal says what its frames were when they were taken; of other frames nobody knows.  So each is read when
the series is first planned, and its checksum is the one it must have from then on: it is part of the keys of its
chunk.  The list is kept in the folder of the series and asked again as long as size and time of a file stay.
"""

import json
from pathlib import Path

from daq.atomic_write import write_text
from daq.frames.named_frame import checksum_of
from daq.frames.source import FrameSource, source_of
from ground.plain_file import read_plain
from ground.terminal import progress_if_long
from piv.errors import PairError
from rtpiv.analysis.series.series_pairs import PairsOfSeries
from rtpiv.analysis.series.series_plan import SeriesPair

FILE = "checksums.jsonl"
MOST_BYTES = 1_000_000_000
Known = dict[str, tuple[int, int, str]]  # by name of the frame: bytes and time of its file, checksum


def pairs_of_source(
    path: Path, out: Path, shape: tuple[int, int], dt_us: float | None, timed: bool = True
) -> PairsOfSeries:
    """Collect the pairs of a source.

    Parameters
    ----------
    path : Path
        See `daq.frames.source`.
    out : Path
        Folder of the series.
    shape : (int, int)
        Rows and columns of its frames.
    dt_us : float or None
        Time between the frames of a pair.
    timed : bool
        Refuse pairs of which it is not known; else these have displacements.

    Raises
    ------
    PairError
        The time is not known though it must be, or there is no pair.
    FrameError
        The source cannot be read.
    DiskError
        The list of checksums cannot be written.
    """
    if dt_us is None and timed:
        raise PairError(f"{path}: the time between the frames of a pair is not known; say it with --dt-us")
    source = source_of(path)
    known, now = _known(out / FILE), Known()
    pairs = []
    places = source.pairs()
    for number, *frames in progress_if_long(places, len(places), "checksums of pairs"):
        for frame in frames:
            now[str(frame)] = _fresh(source, frame, known, shape)
        first, second = frames
        sums = now[str(first)][2], now[str(second)][2]
        pairs.append(
            SeriesPair(f"frames_{2 * number:06d}", (first, second), sums, None if dt_us is None else 1e-6 * dt_us)
        )
    if now != known:
        write_text(out / FILE, "".join(json.dumps([name, *facts]) + "\n" for name, facts in now.items()))
    return PairsOfSeries(tuple(pairs), (), source.alone(), glass=True, usual_background=len(pairs) > 1)


def _fresh(source: FrameSource, frame: Path, known: Known, shape: tuple[int, int]) -> tuple[int, int, str]:
    """Facts of a frame, read only if its file has changed; of one without a file there is nothing to read."""
    try:
        file = source.file_of(frame).stat()
    except OSError:
        return 0, 0, ""
    before = known.get(str(frame))
    if before is not None and before[:2] == (file.st_size, file.st_mtime_ns):
        return before
    return file.st_size, file.st_mtime_ns, checksum_of(frame, shape)


def _known(path: Path) -> Known:
    """The list of an earlier call; empty if there is none, or if it is damaged."""
    try:
        lines = [json.loads(line) for line in read_plain(path, MOST_BYTES).splitlines()]
        return {str(name): (int(size), int(time_ns), str(crc32)) for name, size, time_ns, crc32 in lines}
    except (OSError, ValueError, TypeError):
        return {}
