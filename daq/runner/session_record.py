"""What a session leaves in the run folder of a camera: how it began, how it ended, what is done."""

import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from daq.bench.opened import OpenBench
from daq.cameras.camera import Setting
from daq.errors import BadBalance
from daq.pipeline.lanes import Pipeline
from daq.plans.steps import Step
from daq.runner.camera_session import CameraSession
from daq.runs.conservation import Ledger
from daq.runs.gaps import booked_gaps, numbers_in
from daq.runs.journal import Journal
from daq.runs.run_folder import RunFolder, frame_entries, versions
from daq.runs.run_hash import run_hash
from daq.runs.session_books import doubts, total_ledger
from daq.whole_text import write_json


def begin_session(journal: Journal, hardware: OpenBench, steps_left: int) -> None:
    """Say in the journal that a process begins to work on the run."""
    said_mm = dict(hardware.stage.said_mm)  # of axes whose reference is a person's word
    journal.append(
        "session",
        sync=True,
        utc=utc_now(),
        monotonic_ns=time.monotonic_ns(),
        versions=versions(),
        steps_left=steps_left,
        controllers={name: box.identity for name, box in hardware.stage.controllers.items()},
        **({"said_mm": said_mm} if said_mm else {}),
    )


def write_camera_file(folder: RunFolder, hardware: OpenBench, settings: Mapping[str, Setting]) -> None:
    """Keep what the camera says of itself in this session."""
    count = sum(1 for entry in folder.entries() if entry["kind"] == "session")
    info = hardware.camera.info
    about = {
        "backend": info.backend,
        "vendor": info.vendor,
        "model": info.model,
        "serial": info.serial,
        "address": info.address,
    }
    write_json(folder.path / f"camera_{count}.json", {"info": about, "settings": settings})


def end_session(
    journal: Journal, exposures: CameraSession, pipeline: Pipeline, why: str, error: str
) -> tuple[Ledger, str]:
    """Close the books of a session, with every frame on the disk; return them, and what is in doubt."""
    pipeline.close()
    ledger = exposures.conclude(pipeline.flow.written)
    doubt = "; ".join(exposures.doubts)
    about: dict[str, Any] = {"doubt": doubt} if doubt else {}
    if doubt and why == "finished":
        why, error = BadBalance.__name__, doubt
    journal.append("counts", books=ledger.to_dict(), flow=pipeline.flow.summary(), **about)
    journal.append("end", sync=True, utc=utc_now(), why=why, error=error, **about)
    return ledger, doubt


def done_record(folder: RunFolder, steps: Sequence[Step], caught_up: int) -> dict[str, Any]:
    """Contents of done.json.

    Raises
    ------
    BadBalance
        Frames are missing, or in doubt; the run is not done.
    """
    entries = folder.entries()
    total, sessions = total_ledger(entries)
    present = frame_entries(entries)
    absent = folder.absent(entries)
    gaps = booked_gaps(entries)
    never_came = {number for found in gaps.values() for number in numbers_in(found)}
    if absent or {number for step in steps for number in step.numbers} - never_came != set(present):
        raise BadBalance(f"{len(present)} frames in the journal, {len(absent)} of them without a file")
    if said := doubts(entries):
        raise BadBalance(f"{said[0]}; begin a new run")
    about = [{"step": i, "tag": steps[i].tag, "gaps": found} for i, found in sorted(gaps.items())]
    flows = [entry["flow"] for entry in entries if entry["kind"] == "counts"]
    return {
        "utc": utc_now(),
        "steps": len(steps),
        "frames": len(present),
        "conservation": total.to_dict(),
        "sessions": sessions,
        "corrected_after_the_run": caught_up,
        **({"gaps": about} if about else {}),
        "flow": flows,
        "sha256": run_hash(folder.path, {line["file"]: line["crc32"] for line in present.values()}),
    }


def utc_now() -> str:
    """Now, as records have it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
