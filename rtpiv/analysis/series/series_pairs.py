"""Pairs that belong into one series: in order, a time apart, of one view and one exposure.

A run's journal says what its frames were when they were taken; of frames that no run of ours has recorded nothing
does.  So each of these is read when the series is first planned, and its checksum is the one it must have from
then on: it is part of the keys of its chunk.  The list is kept in the folder of the series and asked again as long
as size and time of a file stay.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isclose
from pathlib import Path

from daq.atomic_write import write_text
from daq.bench.elements import Vector
from daq.frames.named_frame import checksum_of
from daq.frames.source import FrameSource, source_of
from daq.runs.glass_place import glass_place_mm
from daq.runs.journal import Entry
from daq.runs.lab_readings import Shown
from daq.runs.pairs import FramePair, RunPairs
from daq.runs.run_folder import RunFolder
from ground.plain_file import read_plain
from ground.terminal import progress_if_long
from piv.errors import PairError
from rtpiv.analysis.series.series_plan import SeriesPair

CHECKSUMS = "checksums.jsonl"
MAX_CHECKSUM_BYTES = 1_000_000_000  # of the list of checksums
Known = dict[str, tuple[int, int, str]]  # by name of the frame: bytes and time of its file, checksum
# Of a stream: a background found in so few holds light of particles, so none is taken off unasked
FEW_PAIRS = 10
READ_BACK = 1e-6  # relative; of an exposure that has not been changed


@dataclass(frozen=True)
class PairsOfSeries:
    """Pairs of a run for a series.

    Parameters
    ----------
    pairs : tuple of SeriesPair
        In order.
    unseeded : tuple of SeriesPair
        Those taken before the seeding was opened.
    alone : int
        Frames that lost their partner.
    glass : bool
        Taken through the glass.
    glass_place_mm : (float, float, float)
        By how much that stood off its place in the scene file.
    usual_background : bool
        Whether a background is taken off unless the person says otherwise.
    readings : mapping of str to Shown
        What gauges of the lab showed over the steps of the pairs, by their names.
    readings_of : mapping of str to mapping
        The same over the steps of one pair, by its tag; empty where there are no gauges.
    """

    pairs: tuple[SeriesPair, ...]
    unseeded: tuple[SeriesPair, ...]
    alone: int
    glass: bool
    glass_place_mm: Vector = (0.0, 0.0, 0.0)
    usual_background: bool = True
    readings: Mapping[str, Shown] = field(default_factory=dict)
    readings_of: Mapping[str, Mapping[str, Shown]] = field(default_factory=dict)

    @property
    def is_timed(self) -> bool:
        """Return whether the time between the frames is known, so that vectors are velocities."""
        return all(pair.dt_s is not None for pair in self.pairs)


def is_moved(found: RunPairs) -> bool:
    """Return whether a stage moved the particles by a measured displacement; else frames are a time apart."""
    return any(pair.measured_mm is not None for pair in found.pairs)


def is_one_series(found: RunPairs) -> bool:
    """Return whether pairs are a time apart and of one view, so that they are evaluated together."""
    return not is_moved(found) and len({pair.glass for pair in found.pairs}) == 1


def is_flow(found: RunPairs) -> bool:
    """Return whether the frames of all pairs are a known time apart, so that they have velocities."""
    return not is_moved(found) and all(pair.dt_s is not None for pair in found.pairs)


def pairs_of_series(run: Path, found: RunPairs, dt_us: float | None = None, timed: bool = True) -> PairsOfSeries:
    """Collect the pairs of a series.

    Parameters
    ----------
    run : Path
        The run.
    found : RunPairs
        Its pairs.
    dt_us : float, optional
        Time between the frames of a pair, for a run that does not know it.
    timed : bool
        Refuse pairs of which it stays unknown; else these have displacements.

    Raises
    ------
    PairError
        The time between the frames is not known though it must be, or contradicts the run's; views or exposures
        are mixed; or there is no pair with seeding.
    """
    entries = {folder_name(entry): entry for entry in found.lines.values()}
    seeded = [pair for pair in found.pairs if not pair.is_background]
    if not seeded:
        raise PairError(f"{run}: holds no pair that was taken with seeding; resume the run first")
    views = {pair.glass for pair in found.pairs}
    if len(views) > 1:
        raise PairError(
            f"{run}: has pairs through the glass and without it; a series is of one view, take two runs"
        )
    _same_exposure(run, found.pairs, entries)
    made = {
        pair.tag: replace(_series_pair(run, pair, entries, dt_us, timed), gauges=found.readings_during(pair))
        for pair in found.pairs
    }
    pairs = mark_repeated([made[pair.tag] for pair in seeded])
    unseeded = tuple(made[pair.tag] for pair in found.pairs if pair.is_background)
    glass = views.pop()
    frames = [pair.frames[0] for pair in found.pairs] if glass else []
    lit_by_pulses = any("dt_us" in step for step in RunFolder(run).about["steps"])
    background = len(pairs) > (1 if lit_by_pulses else FEW_PAIRS)
    place_mm = glass_place_mm(run, frames, found.lines)
    apart = {pair.tag: found.statistics_during([pair]) for pair in seeded} if found.readings else {}
    shown = found.statistics_during(seeded)
    return PairsOfSeries(pairs, unseeded, len(found.alone), glass, place_mm, background, shown, apart)


def folder_name(entry: Entry) -> str:
    """Name of a frame's file, by which a pair finds its line."""
    return str(entry["file"]).rpartition("/")[2]


def dt_of(run: Path, pair: FramePair, dt_us: float | None) -> float | None:
    """Time between the frames of a pair [s], by the run or as given; PairError if these contradict each other."""
    given_s = None if dt_us is None else dt_us * 1e-6
    if pair.dt_s is not None and given_s is not None and not isclose(pair.dt_s, given_s, rel_tol=0.01):
        raise PairError(
            f"{run}: the frames of {pair.tag} are {1e6 * pair.dt_s:g} us apart by the run, and {dt_us:g} us by "
            "--dt-us; leave that out"
        )
    return pair.dt_s if pair.dt_s is not None else given_s


def _series_pair(
    run: Path, pair: FramePair, entries: dict[str, Entry], dt_us: float | None, timed: bool
) -> SeriesPair:
    dt_s = dt_of(run, pair, dt_us)
    if dt_s is None and timed:
        raise PairError(
            f"{run}: the time between the frames of {pair.tag} is not known, as the camera has no clock; "
            "say it with --dt-us"
        )
    first, second = (entries[path.name]["crc32"] for path in pair.frames)
    return SeriesPair(pair.tag, pair.frames, (first, second), dt_s, pair.dt_sigma_s, pair.time_s)


def mark_repeated(pairs: Sequence[SeriesPair]) -> tuple[SeriesPair, ...]:
    """Mark pairs whose two pictures an earlier pair has already: counted twice, they make a mean too certain."""
    earlier, marked = set[tuple[str, str]](), list[SeriesPair]()
    for pair in pairs:
        a, b = pair.crc32
        marked.append(replace(pair, is_repeated=bool(a and b) and a != b and pair.crc32 in earlier))
        earlier.add(pair.crc32)
    return tuple(marked)


def _same_exposure(run: Path, pairs: tuple[FramePair, ...], entries: dict[str, Entry]) -> None:
    """Refuse pairs of different exposure: their backgrounds and grey levels have nothing in common."""
    for pulse, name in enumerate("AB"):
        known: tuple[float, str] | None = None
        for pair in pairs:
            exposed_us = entries[pair.frames[pulse].name]["exposure_us"]
            if exposed_us is None:
                continue
            known = known or (exposed_us, pair.tag)
            if not isclose(known[0], exposed_us, rel_tol=READ_BACK):
                raise PairError(
                    f"{run}: exposure {name} of {pair.tag} took {exposed_us:g} us and that of {known[1]} "
                    f"{known[0]:g} us; evaluate pairs of one exposure, from a run of their own"
                )


def pairs_of_source(path: Path, out: Path, shape: tuple[int, int], dt_us: float | None) -> PairsOfSeries:
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
        Time between the frames of a pair; without it they have displacements.

    Raises
    ------
    PairError
        There is no pair.
    FrameError
        The source cannot be read.
    DiskError
        The list of checksums cannot be written.
    """
    source = source_of(path)
    known, now = _read_checksums(out / CHECKSUMS), Known()
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
        write_text(out / CHECKSUMS, "".join(json.dumps([name, *facts]) + "\n" for name, facts in now.items()))
    alone = source.count_unpaired()
    return PairsOfSeries(mark_repeated(pairs), (), alone, glass=True, usual_background=len(pairs) > 1)


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


def _read_checksums(path: Path) -> Known:
    """The list of an earlier call; empty if there is none, or if it is damaged."""
    try:
        lines = [json.loads(line) for line in read_plain(path, MAX_CHECKSUM_BYTES).splitlines()]
        return {str(name): (int(size), int(time_ns), str(crc32)) for name, size, time_ns, crc32 in lines}
    except (OSError, ValueError, TypeError):
        return {}
