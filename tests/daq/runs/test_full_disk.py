"""A disk that is really full: a small one, mounted for a process of its own."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

WORK = """
import sys
from pathlib import Path
import numpy as np
from daq.errors import DiskError
from daq.runs.journal import Journal, read_journal
from daq.runs.raw_frame import checksum, read_raw, write_raw
from daq.atomic_write import write_json

folder, frame, whole = Path(sys.argv[1]), np.full((128, 128), 7, np.uint16), 0
places = {"planned_mm": {}, "measured_mm": {}}
facts = {"step": 0, "tag": "t", "crc32": checksum(frame), "frame_id": 1, "sequence": 0, "timestamp_ns": 5,
         "received_ns": 6, "exposure_us": None, "bits": 12, **places}
journal = Journal(folder / "steps.jsonl")
try:
    while True:
        write_raw(folder / f"{whole}.tif", frame, facts)
        journal.append("frame", frame=whole, file=f"{whole}.tif", **facts)
        whole += 1
except DiskError as error:
    print(error)
assert 5 < whole < 20, whole
assert not list(folder.glob("*.part"))
for number in range(whole):
    assert (read_raw(folder / f"{number}.tif")[0] == frame).all()
(folder / "ballast").write_bytes(b"")
try:
    with (folder / "ballast").open("ab", buffering=0) as ballast:
        while ballast.write(b"0" * 512):
            pass
except OSError:
    pass
try:
    write_json(folder / "big.json", ["0" * 4000])
except DiskError as error:
    print(error)
try:
    for _ in range(2000):
        journal.append("end", utc="now", why="x", error="x" * 1000)
except DiskError as error:
    print(error)
try:
    journal.close()
finally:
    (folder / "ballast").unlink()
again = Journal(folder / "steps.jsonl")
again.append("session", utc="now", versions={}, steps_left=1)
again.close()
entries = read_journal(folder / "steps.jsonl")
assert entries[-1]["kind"] == "session"
assert [entry["frame"] for entry in entries if entry["kind"] == "frame"] == list(range(whole))
"""


def test_what_was_acknowledged_is_whole_and_the_rest_is_said(tmp_path):
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-rm", "true"], check=False).returncode:
        pytest.skip("this machine gives ordinary users no mounts of their own")
    (tmp_path / "work.py").write_text(WORK)
    (disk := tmp_path / "disk").mkdir()
    script = f"mount -t tmpfs -o size=500k tmpfs {disk} && exec {sys.executable} {tmp_path}/work.py {disk}"
    done = subprocess.run(
        ["unshare", "-rm", "sh", "-c", script], env=os.environ | {"PYTHONPATH": str(Path.cwd())},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    assert len(said) == 3, said
    for line in said:
        assert re.search("(No space left on device|the disk is full.*); make room", line)
