"""Damaged numbers in the records of a run: one sentence with file and line, exit 3, never a traceback.

Every record is sealed again after it was spoilt, so that it is the types that have to find it.
"""

import json
import time

import numpy as np
import pytest

from daq.errors import RunDamaged
from daq.runs.displacement import read_displacements
from daq.runs.done_file import read_done
from daq.runs.frame_check import orphan_files
from daq.runs.journal import Journal
from daq.runs.raw_frame import write_raw
from daq.runs.run_check import check_run
from daq.runs.run_folder import RunFolder
from daq.runs.seal import add_seal
from rtpiv.command_line.cli import DEVICE, main
from tests.daq.small_run import about_run, keep_frame, planned
from tests.loops import loop_over

NAN, HUGE = float("nan"), 10**30
GONE = object()  # a key that is taken out


def spoil(tree, place, value):
    """Put a value at a place (keys and indices) of a tree."""
    for part in place[:-1]:
        tree = tree[part]
    if value is GONE:
        del tree[place[-1]]
    else:
        tree[place[-1]] = value


def one_sentence(caught, *words):
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 500
    for word in words:
        assert word in text, text


LINES = [  # kind of line, place in it, value
    ("frame", ["frame"], "abc"), ("frame", ["frame"], NAN), ("frame", ["frame"], -1), ("frame", ["frame"], HUGE),
    ("frame", ["frame"], 10**40), ("frame", ["frame"], 1.5), ("frame", ["frame"], True),
    ("frame", ["frame"], None), ("frame", ["frame"], GONE), ("frame", ["frame"], 99), ("frame", ["frame"], [1]),
    ("frame", ["step"], 8), ("frame", ["step"], "0"), ("frame", ["step"], 1),
    ("frame", ["file"], "../../../etc/passwd"), ("frame", ["file"], "/etc/passwd"),
    ("frame", ["file"], "frames/000001.tif"), ("frame", ["file"], GONE), ("frame", ["file"], 5),
    ("frame", ["crc32"], "0123456"), ("frame", ["crc32"], "0123456g"), ("frame", ["crc32"], 1234567),
    ("frame", ["crc32"], "01234567\n"), ("frame", ["crc32"], GONE),
    ("frame", ["measured_mm"], "0.5"), ("frame", ["measured_mm", "target_x"], NAN),
    ("frame", ["measured_mm", "target_x"], "1.0"), ("frame", ["measured_mm", "target_x"], float("inf")),
    ("frame", ["measured_mm", "target_x"], 1e300), ("frame", ["planned_mm"], GONE),
    ("frame", ["tag"], "../up"), ("frame", ["bits"], 0), ("frame", ["timestamp_ns"], -5),
    ("frame", ["kind"], "fram"), ("frame", ["kind"], GONE), ("frame", ["kind"], 5), ("frame", ["kind"], "session"),
    ("step", ["step"], "abc"), ("step", ["step"], 8), ("step", ["step"], -1), ("step", ["measured_mm"], GONE),
    ("session", ["steps_left"], "x"), ("session", ["versions"], 5), ("session", ["utc"], GONE),
    ("session", ["controllers", "rail"], 5),
    ("counts", ["books"], {}), ("counts", ["books", "written"], "many"), ("counts", ["books", "written"], -1),
    ("counts", ["books", "written"], HUGE), ("counts", ["flow"], GONE), ("counts", ["flow", "skipped_live"], "no"),
    ("end", ["why"], GONE), ("end", ["error"], 5),
]  # fmt: skip


@pytest.mark.parametrize("sealing", [True, False])
def test_a_spoilt_line_is_refused_with_its_number(open_run, sealing):
    """Sealed lines of today, and those without seals of the first layout."""
    text = open_run.journal_path.read_text()
    if not sealing:
        tree = json.loads((open_run.path / "run.json").read_text())
        tree.pop("seal")
        (open_run.path / "run.json").write_text(json.dumps(tree | {"layout": 1}))

    @loop_over("kind, place, value", LINES)
    def check(kind, place, value):
        lines = [json.loads(line) for line in text.splitlines()]
        number = next(index for index, line in enumerate(lines) if line["kind"] == kind)
        for line in lines:
            line.pop("seal")
        spoil(lines[number], place, value)
        records = [json.dumps(line, separators=(",", ":")).encode() for line in lines]
        open_run.journal_path.write_bytes(
            b"".join((add_seal(record) if sealing else record) + b"\n" for record in records)
        )
        with pytest.raises(RunDamaged) as caught:
            RunFolder(open_run.path).entries()
        one_sentence(caught, f"steps.jsonl:{number + 1}: ", "restore the file from a copy")

    check()


@pytest.mark.parametrize(
    "text", [b"[]", b'"x"', b"5", b"null", b"{}", b"", b"[" * 100_000, b'{"kind":' * 50_000, b"\xff\xfe"]
)
def test_a_line_that_is_no_record_is_refused(open_run, text):
    lines = open_run.journal_path.read_bytes().splitlines(keepends=True)
    open_run.journal_path.write_bytes(b"".join([lines[0], text + b"\n", *lines[1:]]))
    with pytest.raises(RunDamaged) as caught:
        open_run.entries()
    one_sentence(caught, "steps.jsonl:2: ")


@pytest.mark.parametrize("digits", [400, 4000, 40_000])
def test_numbers_of_any_length_are_refused_in_a_short_sentence(open_run, digits):
    lines = open_run.journal_path.read_bytes().splitlines(keepends=True)
    line = add_seal(b'{"kind":"discard","frames":[' + b"9" * digits + b"]}")
    open_run.journal_path.write_bytes(b"".join([lines[0], line + b"\n", *lines[1:]]))
    with pytest.raises(RunDamaged) as caught:
        open_run.entries()
    one_sentence(caught, "steps.jsonl:2: ")


def test_a_discard_of_frames_that_the_plan_does_not_have(open_run):
    with open_run.journal_path.open("ab") as file:
        file.write(add_seal(b'{"kind":"discard","frames":[3,8]}') + b"\n")
    with pytest.raises(RunDamaged, match="discards frame 8, and the plan has 8"):
        open_run.entries()


RUN = [
    (["steps"], GONE), (["steps"], {}), (["steps", 1, "first_frame"], "1"), (["steps", 1, "first_frame"], 7),
    (["steps", 1, "frames"], 0), (["steps", 1, "frames"], HUGE), (["steps", 1, "index"], 0),
    (["steps", 1, "tag"], "../../x"), (["steps", 1, "tag"], ""), (["steps", 1, "view"], "sideways"),
    (["steps", 1, "reference"], 50), (["steps", 1, "reference"], -1), (["steps", 1, "on_plane"], 1),
    (["square_mm"], "2.5"), (["square_mm"], NAN), (["square_mm"], 0), (["square_mm"], GONE),
    (["request"], {}), (["request", "bench"], 5), (["request", "simulate"], "yes"),
    (["request", "method"], "cubic"), (["request", "live_queue"], 0), (["request", "surprise"], 1),
    (["hashes"], ["a"]), (["hashes", "plan"], 5),
    (["scene"], None), (["name"], 5), (["layout"], "2"), (["layout"], GONE), (["layout"], 2.5),
]  # fmt: skip


def test_a_spoilt_run_file_is_refused_with_its_key(open_run):
    path = open_run.path / "run.json"
    original = path.read_text()

    @loop_over("place, value", RUN)
    def check(place, value):
        tree = json.loads(original)
        tree.pop("seal")
        spoil(tree, place, value)
        path.write_bytes(add_seal(json.dumps(tree, indent=1).encode()))
        with pytest.raises(RunDamaged) as caught:
            _ = open_run.about
        if value is not GONE and place[0] != "layout" and place[-1] not in ("index", "first_frame", "reference"):
            assert ".".join(map(str, place)) in str(caught.value)
        one_sentence(caught, "run.json", "restore the file from a copy")

    check()


DONE = [
    (["conservation"], GONE), (["conservation", "written"], "8"), (["conservation", "written"], NAN),
    (["conservation", "lost"], GONE), (["flow"], {}), (["flow", 0, "latency_ms"], {"p50": 1.0}),
    (["flow", 0, "corrected_live"], -1), (["sha256"], "0" * 63), (["sha256"], 5), (["frames"], HUGE),
    (["sessions", 0, "conservation"], 5), (["utc"], 5),
]  # fmt: skip


def test_a_spoilt_done_file_is_refused(done_run):
    path = done_run.path / "done.json"
    original = path.read_text()

    @loop_over("place, value", DONE)
    def check(place, value):
        tree = json.loads(original)
        tree.pop("seal")
        spoil(tree, place, value)
        path.write_bytes(add_seal(json.dumps(tree, indent=1).encode()))
        with pytest.raises(RunDamaged) as caught:
            read_done(done_run)
        one_sentence(caught, "done.json:", "restore the file from a copy")
        assert not check_run(done_run.path).is_sound

    check()


MOVED = [
    (["tag"], "../../x"), (["tag"], "other"), (["tag"], GONE), (["frames"], [0]), (["frames"], ["0", "1"]),
    (["frames"], [0, 99]), (["frames"], [-1, 1]), (["frames"], [0, HUGE]), (["measured_mm"], [0.0, 0.0]),
    (["measured_mm", 1], NAN), (["measured_mm", 1], "0.5"), (["measured_mm"], GONE), (["commanded_mm"], None),
    (["true_mm"], "x"),
]  # fmt: skip


def test_a_spoilt_displacement_is_refused_with_its_line(done_run, tmp_path, capsys):
    path = done_run.path / "displacements.json"
    original = path.read_text().splitlines()

    @loop_over("place, value", MOVED)
    def check(place, value):
        tree = json.loads(original[2].removesuffix(","))
        tree.pop("seal")
        spoil(tree, place, value)
        spoilt = add_seal(json.dumps(tree).encode()).decode() + ","
        path.write_text("\n".join([*original[:2], spoilt, *original[3:]]) + "\n")
        with pytest.raises(RunDamaged) as caught:
            read_displacements(done_run)
        one_sentence(caught, "displacements.json", "restore the file from a copy")

    check()
    assert main(["evaluate", str(done_run.path), "-o", str(tmp_path / "out")]) == DEVICE
    assert "displacements.json" in capsys.readouterr().err


def test_a_displacement_that_was_cut_out_is_missed(done_run):
    path = done_run.path / "displacements.json"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *lines[2:]]) + "\n")
    with pytest.raises(RunDamaged, match="its 3 entries are not the 4 of the plan"):
        read_displacements(done_run)


@pytest.mark.parametrize("verb", ["resume", "check", "report", "calibrate", "evaluate"])
@pytest.mark.parametrize("name", ["run.json", "steps.jsonl"])
def test_every_verb_says_it_in_one_sentence(open_run, name, verb, tmp_path, capsys):
    path = open_run.path / name
    data = path.read_bytes()
    path.write_bytes(
        data.replace(b'"first_frame": 3', b'"first_frame": "3"').replace(b'"frame":3,', b'"frame":"abc",')
    )
    assert path.read_bytes() != data
    out = ["-o", str(tmp_path / "out")] if verb in ("calibrate", "evaluate") else []
    assert main([verb, str(open_run.path), *out]) == DEVICE
    shown = capsys.readouterr()
    assert name in shown.out + shown.err
    assert "Traceback" not in shown.err


@pytest.mark.parametrize(("unknown", "strange"), [(64, 0), (65, 65)])
def test_many_frames_of_a_stream_without_lines_are_never_removed(tmp_path, unknown, strange):
    """All of one step: a power cut takes the lines of a moment, damage takes more."""
    folder = RunFolder.create(tmp_path, "stream", about_run([planned(0, frames=200)]))
    pixels = np.zeros((4, 4), np.uint16)
    journal = Journal(folder.journal_path)
    for number in range(100):
        keep_frame(folder, journal, number, pixels)
    journal.close()
    for number in range(100, 100 + unknown):
        write_raw(folder.frame_path(number), pixels, {})
    found = orphan_files(folder, folder.about["steps"], folder.entries())
    assert len(found.strange) == strange
    assert len(found.cut_off) == unknown - strange
    assert ("and 60 more" in found.sentence) == bool(strange)


def test_frames_of_several_steps_without_lines_are_never_removed(open_run, capsys):
    """A journal that lost its end looks like a run that was killed early; its frames are still the run's."""
    lines = open_run.journal_path.read_bytes().splitlines(keepends=True)
    steps = [number for number, line in enumerate(lines) if b'"kind":"step"' in line]
    open_run.journal_path.write_bytes(b"".join(lines[: steps[2] + 1]))
    before = sorted((open_run.path / "frames").iterdir())
    assert main(["acquire", "--resume", str(open_run.path), "--home"]) == DEVICE
    assert "frames/ holds 000003.tif, 000004.tif" in capsys.readouterr().err
    assert sorted((open_run.path / "frames").iterdir()) == before
    assert "other files" in {finding.part for finding in check_run(open_run.path).findings if not finding.sound}


def test_a_seal_that_is_broken_is_found_before_the_record_is_taken_apart(tmp_path):
    """A damaged run.json of 60 MB took eight seconds to be refused."""
    folder = RunFolder.create(tmp_path, "a", about_run([planned(0, "a")]))
    path = folder.path / "run.json"
    whole = path.read_bytes()
    at = whole.index(b'"steps"')
    path.write_bytes(
        whole[:at] + b'"steps_": [' + b'{"a": [1, 2, {"b": "c"}]}, ' * 2_000_000 + b"0],\n " + whole[at:]
    )
    begun_s = time.process_time()
    with pytest.raises(RunDamaged, match="does not agree with its seal"):
        RunFolder.open(folder.path)
    assert time.process_time() - begun_s < 2.0
