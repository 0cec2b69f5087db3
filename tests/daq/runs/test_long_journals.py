"""Hours of a flow: a journal of many lines is read in little memory, and says what its lines said."""

import json
import time
import tracemalloc

import pytest

from daq.runs.journal import read_journal
from daq.runs.journal_lines import FrameEntry
from daq.runs.pairs import pairs_of
from daq.runs.run_folder import RunFolder, frame_entries
from daq.runs.seal import add_seal
from tests.daq.small_run import about_run, planned

PLACES = {"target_x": 1.0, "target_y": 2.0, "target_z": 3.0, "rail_z": 500.0}


def frame_line(number):
    """Of a flow at 200 frames/s; every hundredth frame with what a newer version may have added."""
    pair = {"exposure": "AB"[number % 2], "chunk": number // 200, "dt_us": 50.0, "marker": "halves"}
    line = {"kind": "frame", "frame": number, "file": f"frames/{number:06d}.tif", "step": 0, "tag": "flow",
            "crc32": f"{number * 2654435761 % 2**32:08x}", "frame_id": number + 7, "sequence": number,
            "timestamp_ns": 10**9 + 10**7 * (number // 2) + 50_000 * (number % 2), "received_ns": 10**15 + number,
            "exposure_us": 100.0, "bits": 12, "sensor_px": [96, 96], "planned_mm": PLACES, "measured_mm": PLACES,
            "pair": pair}  # fmt: skip
    return line | ({"newer": [number]} if number % 100 == 0 else {})


def long_run(parent, frames):
    step = planned(0, "flow", frames=frames, first_frame=0) | {"group": 2, "dt_us": 50.0}
    folder = RunFolder.create(parent, "flow", about_run([step]))
    with folder.journal_path.open("wb") as file:
        for number in range(frames):
            file.write(add_seal(json.dumps(frame_line(number), separators=(",", ":")).encode()) + b"\n")
    return folder


def test_a_line_reads_as_it_was_written(tmp_path):
    folder = long_run(tmp_path, 202)
    entries = read_journal(folder.journal_path)
    for number, entry in enumerate(entries):
        assert isinstance(entry, FrameEntry)
        assert dict(entry) == frame_line(number)
        assert len(entry) == len(frame_line(number))
        assert entry.get("true_mm") is None
        assert "true_mm" not in entry
        with pytest.raises(KeyError):
            entry["nothing"]
    assert entries[0]["planned_mm"] is entries[201]["planned_mm"]


def test_lines_take_little_memory(tmp_path):
    folder = long_run(tmp_path, 4000)
    folder.entries()
    tracemalloc.start()
    entries = folder.entries()
    held = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert len(entries) == 4000
    assert held / len(entries) < 450  # bytes; as dictionaries 1900


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_million_lines(tmp_path):
    folder = long_run(tmp_path, 1_000_000)
    begun_s = time.process_time()
    entries = folder.entries()
    read_s = time.process_time() - begun_s
    assert read_s < 60.0
    assert len(frame_entries(entries)) == 1_000_000
    assert len(pairs_of(folder.path).pairs) == 500_000
    print(f"{read_s:.1f} s")
