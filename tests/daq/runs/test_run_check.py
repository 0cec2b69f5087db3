"""`rtpiv check`: a whole run is sound, and each way to damage one is found and named."""

import hashlib
import json
import re
import shutil
import zlib

import pytest
import tifffile

from daq.runs.run_check import check_run
from daq.runs.seal import add_seal, write_record
from rtpiv.command_line.cli import DEVICE, DONE, main
from tests.daq.small_run import make_old


def parts(found):
    """Parts that are not sound."""
    return {finding.part for finding in found.findings if not finding.sound}


def said(found, part):
    return next(finding.said for finding in found.findings if finding.part == part)


def test_a_whole_run_is_sound(whole_run, capsys):
    found = check_run(whole_run.path)
    assert found.is_sound, found.findings
    assert (found.is_done, found.frames, found.faults) == (True, 8, ())
    assert {finding.part for finding in found.findings} == {
        "run.json", "journal", "frames", "other files", "account", "camera", "hash", "displacements"
    }  # fmt: skip
    assert main(["check", str(whole_run.path)]) == DONE
    shown = capsys.readouterr().out
    assert "all 8 are what was written" in shown
    assert "NO" not in shown


def test_the_hash_can_be_computed_by_anybody_from_its_description(whole_run):
    """By hand, with the standard library and a TIFF reader; nothing of daq."""
    path, lines = whole_run.path, {}
    for frame in (path / "frames").iterdir():
        pixels = tifffile.imread(frame).astype("<u2")
        lines[f"frames/{frame.name}"] = f"crc32 {zlib.crc32(pixels.tobytes()):08x}"
    for name in ("run.json", "steps.jsonl", "camera_1.json", "displacements.json"):
        lines[name] = "sha256 " + hashlib.sha256((path / name).read_bytes()).hexdigest()
    text = "".join(f"{lines[name]}  {name}\n" for name in sorted(lines))
    assert json.loads((path / "done.json").read_text())["sha256"] == hashlib.sha256(text.encode()).hexdigest()


def cut_journal(folder):
    """Take the last step's line and the end away, as an editor would: whole lines only."""
    lines = folder.journal_path.read_bytes().splitlines(keepends=True)
    folder.journal_path.write_bytes(b"".join(line for line in lines if b'"kind":"step","step":7' not in line))


def change_digit(path):
    """Another digit in a number that means a length."""
    data = path.read_bytes()
    at = data.index(b'measured_mm":') + data[data.index(b'measured_mm":') :].index(b".") + 2
    path.write_bytes(data[:at] + (b"1" if data[at : at + 1] != b"1" else b"2") + data[at + 1 :])


def other_done(folder, **more):
    """Another done.json, sealed as it should be."""
    done = json.loads((folder.path / "done.json").read_text())
    done.pop("seal")
    write_record(folder.path / "done.json", {**done, **more})


DAMAGES = {
    "frames, hash": lambda run: run.frame_path(2).unlink(),
    "other files": lambda run: shutil.copy(run.frame_path(2), run.frame_path(99)),
    "run.json": lambda run: (run.path / "run.json").write_text((run.path / "run.json").read_text()[:-40]),
    "journal": lambda run: change_digit(run.journal_path),
    "journal, hash": cut_journal,
    "hash, displacements": lambda run: change_digit(run.path / "displacements.json"),
    "hash": lambda run: (run.path / "camera_1.json").write_text("{}"),
    "done.json": lambda run: other_done(run, frames=7),
}


@pytest.mark.parametrize("damaged", DAMAGES)
def test_damage_is_found_where_it_is(done_run, damaged, capsys):
    DAMAGES[damaged](done_run)
    found = check_run(done_run.path)
    assert parts(found) == set(damaged.split(", "))
    assert main(["check", str(done_run.path)]) == DEVICE
    shown = capsys.readouterr()
    assert f"not what was acquired in {damaged}" in shown.err
    assert "Traceback" not in shown.err


def test_every_run_is_looked_at_before_the_verdict(done_run, whole_run, tmp_path, capsys):
    done_run.frame_path(2).unlink()
    assert main(["check", str(done_run.path), str(whole_run.path), str(tmp_path)]) == DEVICE
    shown = capsys.readouterr()
    assert "frames/000002.tif is missing" in " ".join(shown.out.split())
    assert "all 8 are what was written" in shown.out
    assert "isnotarunfolder" in re.sub(r"[\s│]", "", shown.out)  # a table breaks a long path anywhere
    assert str(whole_run.path) not in shown.err


def test_a_hash_of_frames_that_are_damaged_is_not_ok(done_run):
    """It is made of the journal's checksums, which say what the frames were."""
    path = done_run.frame_path(2)
    data = bytearray(path.read_bytes())
    data[-3] ^= 1
    path.write_bytes(data)
    found = check_run(done_run.path)
    assert parts(found) == {"frames", "hash"}
    assert "1 frame is not what it was made from" in said(found, "hash")


def test_the_cache_of_maps_beside_runs_is_no_broken_run(whole_run, tmp_path, capsys):
    """`rtpiv check runs/*` names it as well."""
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "map_0123.npz").write_bytes(b"")
    assert main(["check", str(whole_run.path), str(tmp_path / "maps")]) == DONE
    assert "correction maps" in capsys.readouterr().out
    assert (
        main(["check", str(whole_run.path), str(tmp_path)]) == DEVICE
    )  # any other folder among runs is asked for


def test_what_a_file_says_about_its_frame_is_compared_too(done_run):
    path = done_run.frame_path(2)
    data = path.read_bytes()
    assert data.count(b'"bits": 16') == 1
    path.write_bytes(data.replace(b'"bits": 16', b'"bits": 12'))
    assert "says something else about its bits" in said(check_run(done_run.path), "frames")


def test_a_run_that_is_not_finished_is_no_fault(open_run):
    lines = open_run.journal_path.read_bytes().splitlines(keepends=True)
    steps = [number for number, line in enumerate(lines) if b'"kind":"step"' in line]
    open_run.journal_path.write_bytes(b"".join(lines[: steps[4] + 1]))  # killed in the move to step 5
    for number in (6, 7):
        open_run.frame_path(number).unlink()  # 5 was renamed right before the kill, without its line
    found = check_run(open_run.path)
    assert found.is_sound, found.findings
    assert (found.is_done, found.frames) == (False, 5)
    assert "5 of 8 steps in 1 session; not finished" in said(found, "journal")
    assert "1 of a step that was cut off" in said(found, "other files")


def test_corrected_frames_are_there_where_the_run_says_so(done_run):
    about = dict(done_run.about)
    about["request"]["correct"] = True
    write_record(done_run.path / "run.json", about)
    on_plane = [step["first_frame"] for step in about["steps"] if step["on_plane"]]
    for number in on_plane[1:]:
        done_run.correction_path(number).write_bytes(b"made")
    found = check_run(done_run.path)
    assert parts(found) == {"hash", "corrected"}
    assert f"000000.tif of {len(on_plane)} are missing" in said(found, "corrected")
    done_run.correction_path(0).write_bytes(b"made")
    assert parts(check_run(done_run.path)) == {"hash"}


def test_books_that_do_not_balance_and_doubts_are_faults(done_run):
    from daq.runs.journal import Journal

    journal = Journal(done_run.journal_path)
    journal.append("doubt", doubt="a frame cannot be given to its trigger")
    journal.close()
    found = check_run(done_run.path)
    assert parts(found) == {"account", "hash"}
    assert "cannot be given to its trigger" in said(found, "account")


def test_nothing_is_changed_by_looking(done_run):
    before = {path: path.stat().st_mtime_ns for path in done_run.path.rglob("*")}
    check_run(done_run.path)
    assert {path: path.stat().st_mtime_ns for path in done_run.path.rglob("*")} == before


def test_a_run_folder_of_the_first_layout_is_read_as_it_is(done_run):
    """Without seals and without a hash, as they were before there were any."""
    make_old(done_run)
    found = check_run(done_run.path)
    assert found.is_sound, found.findings
    assert said(found, "done.json") == "made before runs had a hash"


@pytest.mark.parametrize("more", [1, -1])
def test_frames_that_a_session_says_it_wrote_are_counted_in_the_journal(done_run, more):
    """Books that balance by themselves, of another number of frames than there are."""
    lines = done_run.journal_path.read_bytes().splitlines(keepends=True)
    for number, line in enumerate(lines):
        entry = json.loads(line)
        if entry["kind"] == "counts":
            entry.pop("seal")
            entry["books"] = {**entry["books"], "triggered": 8 + more, "written": 8 + more}
            lines[number] = add_seal(json.dumps(entry, separators=(",", ":")).encode()) + b"\n"
    done_run.journal_path.write_bytes(b"".join(lines))
    found = check_run(done_run.path)
    assert "account" in parts(found)
    assert "with 8 frames in the journal" in said(found, "account")
