"""Files of a run: journal, raw frames, names; torn, full, hostile."""

import json
import os
import shutil
import subprocess
import sys
import zlib

import numpy as np
import pytest
import tifffile

from daq.errors import DiskError, RunDamaged, RunUnsuitable
from daq.runs import raw_frame
from daq.runs.journal import Journal, read_journal
from daq.runs.raw_frame import checksum, read_raw, write_raw
from daq.runs.run_folder import RunFolder, frame_entries, steps_on_disk


def test_torn_last_line_is_ignored_and_cut_off(tmp_path):
    path = tmp_path / "steps.jsonl"
    journal = Journal(path)
    journal.append("discard", frames=[0])
    journal.append("discard", frames=[1], sync=True)
    journal.close()
    whole = path.read_bytes()
    first = whole.index(b"\n") + 1
    for cut in range(1, len(whole) - first):
        path.write_bytes(whole[:-cut])
        assert [entry["frames"] for entry in read_journal(path)] == [[0]]
        again = Journal(path)
        again.append("discard", frames=[7])
        again.close()
        assert [entry["frames"] for entry in read_journal(path)] == [[0], [7]]


def test_a_line_of_which_a_full_disk_took_a_part_never_stands_before_another(tmp_path, monkeypatch):
    """Room may come back while a session ends: what it says then must not be glued to the torn line."""
    journal = Journal(tmp_path / "steps.jsonl")
    journal.append("discard", frames=[0])
    write = os.write

    def full(descriptor, data):
        if len(data) > 10:
            return write(descriptor, bytes(data)[:10])
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(DiskError, match="No space left"):
        journal.append("discard", frames=[1])
    monkeypatch.undo()
    journal.append("discard", frames=[2])
    journal.close()
    assert [entry["frames"] for entry in read_journal(tmp_path / "steps.jsonl")] == [[0], [2]]


def test_two_processes_never_work_on_one_run(tmp_path):
    journal = Journal(tmp_path / "steps.jsonl")
    with pytest.raises(RunUnsuitable, match="another process works on this run"):
        Journal(tmp_path / "steps.jsonl")
    journal.close()
    Journal(tmp_path / "steps.jsonl").close()


def test_damage_in_the_middle_is_refused(tmp_path):
    path = tmp_path / "steps.jsonl"
    path.write_text('{"kind": "discard", "frames": [0]}\n{"kind": \n{"kind": "discard", "frames": [1]}\n')
    with pytest.raises(RunDamaged, match=r"steps\.jsonl:2"):
        read_journal(path, has_seals=False)


def test_discarded_frames_do_not_count(tmp_path):
    entries = [
        {"kind": "frame", "frame": 0, "step": 0}, {"kind": "frame", "frame": 1, "step": 0},
        {"kind": "discard", "frames": [1]},
        {"kind": "frame", "frame": 1, "step": 0, "again": True}, {"kind": "step", "step": 0},
    ]  # fmt: skip
    assert frame_entries(entries)[1]["again"]
    assert steps_on_disk(entries) == {0}


def test_a_step_of_which_a_frame_was_discarded_later_is_not_finished_until_it_was_taken_again():
    first = [{"kind": "frame", "frame": n, "step": n // 2} for n in range(4)]
    entries = [*first, {"kind": "step", "step": 0}, {"kind": "step", "step": 1}]
    assert steps_on_disk(entries) == {0, 1}
    entries.append({"kind": "discard", "frames": [2, 3]})
    assert steps_on_disk(entries) == {0}
    entries += first[2:]
    assert steps_on_disk(entries) == {0}
    entries.append({"kind": "step", "step": 1})
    assert steps_on_disk(entries) == {0, 1}


def test_checksum_is_that_of_the_bytes_row_by_row():
    pixels = np.arange(12, dtype=np.uint16).reshape(3, 4)
    expected = zlib.crc32(b"".join(value.to_bytes(2, "little") for row in pixels.tolist() for value in row))
    assert checksum(pixels) == f"{expected:08x}"
    assert checksum(pixels.T) != checksum(pixels)


def test_raw_frame_survives_and_any_reader_reads_it(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 4095, (33, 21)).astype(np.uint16)
    write_raw(tmp_path / "000001.tif", pixels, {"step": 3})
    back, about = read_raw(tmp_path / "000001.tif")
    assert np.array_equal(back, pixels)
    assert about == {"step": 3, "crc32": checksum(pixels), "sensor_px": [21, 33]}
    assert np.array_equal(tifffile.imread(tmp_path / "000001.tif"), pixels)
    assert [path.name for path in tmp_path.iterdir()] == ["000001.tif"]


def test_raw_frames_are_never_overwritten(tmp_path):
    path = tmp_path / "a.tif"
    write_raw(path, np.zeros((4, 4), np.uint16), {})
    with pytest.raises(DiskError, match="never overwritten"):
        write_raw(path, np.ones((4, 4), np.uint16), {})
    assert read_raw(path)[0].max() == 0


def test_a_full_disk_is_named_and_leaves_no_half_file(tmp_path, monkeypatch):
    def full(*_arguments, **_options):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(raw_frame.tifffile, "imwrite", full)
    with pytest.raises(DiskError, match=r"a\.tif: No space left on device; make room"):
        write_raw(tmp_path / "a.tif", np.zeros((4, 4), np.uint16), {})
    assert list(tmp_path.iterdir()) == []


def test_run_json_is_there_before_anything_else(tmp_path):
    folder = RunFolder.create(tmp_path / "runs", "my plan/../x", {"name": "x"})
    assert folder.path.parent == tmp_path / "runs"
    assert "/" not in folder.path.name
    assert ".." not in folder.path.name
    assert json.loads((folder.path / "run.json").read_text())["name"] == "x"
    second = RunFolder.create(tmp_path / "runs", "my plan/../x", {"name": "y"})
    assert second.path != folder.path


@pytest.mark.parametrize("name", ["../../etc/passwd", "/etc/passwd", "frames/../../x"])
def test_names_from_a_journal_stay_inside(tmp_path, name):
    folder = RunFolder.create(tmp_path, "p", {})
    with pytest.raises(RunUnsuitable, match="outside the run"):
        folder.inside(name)


def test_no_run_folder_no_resume(tmp_path):
    with pytest.raises(RunUnsuitable, match="is not a run folder"):
        RunFolder.open(tmp_path)
    (tmp_path / "run.json").write_text('{"layout": 99}')
    with pytest.raises(RunUnsuitable, match=r"layout 99, known are \(1, 2\)"):
        RunFolder.open(tmp_path)


def test_what_a_killed_program_left_is_swept_after_a_day_and_nothing_else(tmp_path):
    run = RunFolder.create(tmp_path, "shift", {}).path
    hexadecimal = "0123456789abcdef" * 2
    left = tmp_path / f".{run.name}.{hexadecimal}.part"
    young = tmp_path / f".{run.name}_1.{hexadecimal}.part"
    with_frame = tmp_path / f".{run.name}_2.{hexadecimal}.part"
    theirs = tmp_path / ".20260101T000000Z_own.part"
    linked = tmp_path / f".{run.name}_3.{hexadecimal}.part"
    for folder in (left, young, with_frame, theirs):
        shutil.copytree(run, folder)
    (with_frame / "frames" / "000000.tif").write_bytes(b"a frame")
    linked.symlink_to(theirs, target_is_directory=True)
    for folder in (run, left, with_frame, theirs):
        os.utime(folder, (1.7e9, 1.7e9))
    os.utime(linked, (1.7e9, 1.7e9), follow_symlinks=False)
    RunFolder.create(tmp_path, "shift", {})
    assert not left.exists()
    assert all(folder.exists() for folder in (run, young, with_frame, theirs, linked))
    assert linked.is_symlink()


KILLED = """
import itertools, os, sys
from pathlib import Path
from daq.runs.run_folder import RunFolder

CHANGES = ("os.mkdir", "os.rename", "open", "os.remove", "os.rmdir")


def make_and_remove(runs, last):
    calls = itertools.count(1)

    def ended_at(event, _):
        if event in CHANGES and next(calls) == last:
            os._exit(9)

    sys.addaudithook(ended_at)
    RunFolder.create(runs, "shift", {"name": "shift"}, {"side": {"name": "side"}}).remove_if_empty()
    os._exit(0)


for last in range(1, 300):
    if not (child := os.fork()):
        make_and_remove(Path(sys.argv[1]) / str(last), last)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, 9), code
    if code == 0:
        break
"""


@pytest.mark.posix("os.fork")
def test_a_run_that_is_seen_can_be_opened_whenever_its_program_was_killed(tmp_path):
    """Killed before each change of the disk in turn: what is named as a run has run.json, and its cameras have."""
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=True)
    found = [path for runs in tmp_path.iterdir() for path in runs.glob("2*_shift")]
    for path in found:
        assert json.loads((path / "run.json").read_text())["cameras"] == ["side"]
        assert json.loads((path / "cameras" / "side" / "run.json").read_text())["name"] == "side"
    assert found
    last = max(int(runs.name) for runs in tmp_path.iterdir())
    assert last > 10
    assert list((tmp_path / str(last)).iterdir()) == []
