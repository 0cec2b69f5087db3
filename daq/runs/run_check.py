"""A whole run checked against itself: records, frames, accounts, hash, corrected frames.

Every part says in one sentence whether it is sound.  What a run that is not finished may lack is no fault: a step
that was cut off leaves frames that `resume` takes again.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from daq.errors import DaqError, RunDamaged
from daq.runs.clock_map import clock_maps
from daq.runs.displacement import read_displacements
from daq.runs.done_file import DoneFile, read_done, run_hash
from daq.runs.frame_accounting import ambiguities, total_accounting
from daq.runs.frame_check import NAMED, FrameFault, Track, frame_faults, name_faults, no_tracking, orphan_files
from daq.runs.gaps import gaps_by_step, numbers_in
from daq.runs.journal import Entry
from daq.runs.run_file import SEALED_FROM, RunFile
from daq.runs.run_folder import RunFolder, frame_entries, steps_on_disk
from ground.plain_words import quantity


@dataclass(frozen=True, slots=True)
class Finding:
    """One part of a run: whether it is sound, and what there is to say."""

    part: str
    sound: bool
    said: str


@dataclass(frozen=True)
class RunCheck:
    """Result of checking a run.

    Parameters
    ----------
    path : Path
        The run.
    is_done : bool
        Whether it is finished.
    frames : int
        Frames that the journal acknowledges; 0 if it cannot be read.
    faults : tuple of FrameFault
        Those of them that are missing or damaged.
    findings : tuple of Finding
        Every part that could be looked at.
    """

    path: Path
    is_done: bool
    frames: int
    faults: tuple[FrameFault, ...]
    findings: tuple[Finding, ...]

    @property
    def is_sound(self) -> bool:
        """True if every part is."""
        return all(finding.sound for finding in self.findings)


def check_run(path: Path, track: Track = no_tracking) -> RunCheck:
    """Check a run; nothing is changed, and nothing is raised for what is wrong with it.

    Parameters
    ----------
    path : Path
        Its folder.
    track : Track, optional
        Shows how many frames have been read.
    """
    folder = RunFolder(path)
    try:
        about = folder.about
    except DaqError as error:
        return RunCheck(path, folder.is_done, 0, (), (Finding("run.json", False, str(error)),))
    findings = [Finding("run.json", True, f"layout {about['layout']}, {quantity(len(about['steps']), 'step')}")]
    try:
        entries = folder.entries()
    except DaqError as error:
        findings.append(Finding("journal", False, str(error)))
        return RunCheck(path, folder.is_done, 0, (), tuple(findings))
    present = frame_entries(entries)
    faults = frame_faults(folder, present, track)
    findings += [
        _journal(about, entries, folder.is_done),
        _frames(len(present), faults),
        _unknown(folder, about, entries),
        _books(entries, len(present)),
        *_clock(entries),
        *_end(folder, about, entries, len(faults)),
    ]
    return RunCheck(path, folder.is_done, len(present), tuple(faults), tuple(findings))


def _journal(about: RunFile, entries: list[Entry], is_done: bool) -> Finding:
    finished, present, gaps = steps_on_disk(entries), frame_entries(entries), gaps_by_step(entries)
    for step in about["steps"]:
        numbers = range(step["first_frame"], step["first_frame"] + step["frames"])
        never_came = numbers_in(gaps.get(step["index"], ()))
        missing = [n for n in numbers if n not in present and n not in never_came]
        if step["index"] in finished and missing:
            return Finding("journal", False, f"finished step {step['index']} has no line for frame {missing[0]}")
    lines = [entry["frame"] for entry in entries if entry["kind"] == "frame"]
    discarded = sum(len(entry["frames"]) for entry in entries if entry["kind"] == "discard")
    if len(lines) - discarded != len(present):
        said = f"{len(lines)} lines of frames and {discarded} discarded, but {len(present)} frames"
        return Finding("journal", False, said)
    total = len(about["steps"])
    # it ends once it has settled
    is_alignment = all(step["tag"].startswith("look_") for step in about["steps"])
    if is_done and len(finished) < (1 if is_alignment else total):
        return Finding("journal", False, f"has {len(finished)} of {total} steps, and done.json says that all are")
    sessions = sum(entry["kind"] == "session" for entry in entries)
    rest = "" if is_done else "; not finished, rtpiv acquire --resume goes on"
    return Finding(
        "journal", True, f"{len(finished)} of {quantity(total, 'step')} in {quantity(sessions, 'session')}{rest}"
    )


def _clock(entries: list[Entry]) -> Iterator[Finding]:
    """Finding on the camera's clock and temperature, where it reports them."""
    maps = clock_maps(entries)
    celsius = [entry["celsius"] for entry in entries if entry["kind"] == "camera" and "celsius" in entry]
    said = [f"clock {found.sentence}" for found in maps]
    said += [f"{min(celsius):.1f} to {max(celsius):.1f} C"] if celsius else []
    if said:
        yield Finding("camera", True, "; ".join(said))


def _frames(count: int, faults: list[FrameFault]) -> Finding:
    if not faults:
        return Finding("frames", True, f"all {count} are what was written")
    cure = "restore them from a copy, or repeat their steps with rtpiv acquire --resume --retake"
    return Finding(
        "frames", False, f"{len(faults)} of {count} are not what was written: {name_faults(faults)}; {cure}"
    )


def _unknown(folder: RunFolder, about: RunFile, entries: list[Entry]) -> Finding:
    found = orphan_files(folder, about["steps"], entries)
    if found.strange:
        return Finding("other files", False, found.sentence)
    said = f"{len(found.cut_off)} of a step that was cut off; resume takes it again" if found.cut_off else "none"
    return Finding("other files", True, said)


def _books(entries: list[Entry], frames: int) -> Finding:
    total, _ = total_accounting(entries)
    if said := ambiguities(entries):
        return Finding("account", False, "; ".join(said))
    if total.imbalance or total.written != frames:
        return Finding("account", False, f"{total.sentence()}, with {frames} frames in the journal")
    return Finding("account", True, total.sentence())


def _end(folder: RunFolder, about: RunFile, entries: list[Entry], faults: int) -> Iterator[Finding]:
    """Findings that only a finished run has."""
    if not folder.is_done:
        return
    done: DoneFile | None = None
    try:
        done = read_done(folder)
    except RunDamaged as error:
        yield Finding("done.json", False, str(error))
    if done is not None:
        yield _check_end(folder, about, entries, done, faults)
    if any(step["reference"] is not None for step in about["steps"]):
        yield _displacements(folder)
    if about["request"]["correct"]:
        yield _check_correction(folder, about, entries)


def _check_end(folder: RunFolder, about: RunFile, entries: list[Entry], done: DoneFile, faults: int) -> Finding:
    present = frame_entries(entries)
    total, _ = total_accounting(entries)
    if done["frames"] != len(present) or done["conservation"] != total.to_dict():
        return Finding("done.json", False, "counts other frames than the journal")
    if "sha256" not in done:
        is_old = about["layout"] < SEALED_FROM
        return Finding("done.json", is_old, "made before runs had a hash" if is_old else "the hash is missing")
    try:
        now = run_hash(folder.path, {entry["file"]: entry["crc32"] for entry in present.values()})
    except RunDamaged as error:
        return Finding("hash", False, str(error))
    if now != done["sha256"]:
        return Finding("hash", False, f"is {now[:16]}..., and was {done['sha256'][:16]}... when the run ended")
    if faults:  # the hash is that of the checksums in the journal
        said = f"that of the records agrees, but {quantity(faults, 'frame')} {'is' if faults == 1 else 'are'} not"
        return Finding("hash", False, f"{said} what it was made from")
    return Finding("hash", True, now)


def _displacements(folder: RunFolder) -> Finding:
    try:
        return Finding("displacements", True, f"{len(read_displacements(folder))}, as planned")
    except DaqError as error:
        return Finding("displacements", False, str(error))


def _check_correction(folder: RunFolder, about: RunFile, entries: list[Entry]) -> Finding:
    never_came = numbers_in(gap for gaps in gaps_by_step(entries).values() for gap in gaps)
    wanted = [
        folder.correction_path(number)
        for step in about["steps"]
        if step["on_plane"]
        for number in range(step["first_frame"], step["first_frame"] + step["frames"])
        if number not in never_came
    ]
    missing = [path.name for path in wanted if not path.is_file() or not path.stat().st_size]
    if missing:
        more = f" and {len(missing) - NAMED} more" if len(missing) > NAMED else ""
        said = f"{', '.join(missing[:NAMED])}{more} of {len(wanted)} are missing; make them with rtpiv correct"
        return Finding("corrected", False, said)
    return Finding("corrected", True, f"all {len(wanted)} are there")
