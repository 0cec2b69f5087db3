"""A dialogue that was recorded answers as a box of the simulated bench, and what is said otherwise is named.

What stands for hardware while it is recorded is a simulated bench behind real ports; the recording is then changed
by hand where a test needs a box that no emulator is.
"""

import errno
import io
import os
import re
import shutil
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from daq.bench.bench_file import load_bench
from daq.bench.rehearsal import Rehearsal
from daq.plans.forecast import frames_s, simulation_s
from daq.plans.plan import load_plan
from ground.errors import ConfigError
from ground.rows import thread_count
from rtpiv.verbs.acquire import LiveFrames, acquire
from sim.bench import SimulatedBench
from sim.event_log import read_event_log
from sim.expected import STEP_S
from sim.rehearsed import Rehearsed
from stages import dialogue
from stages.dialogue import VARIABLE, read_dialogue
from stages.errors import PortUnavailable, StageError
from tests.daq.flow_bench import write_flow
from tests.daq.small_bench import EXAMPLES, write_bench

pytest_plugins = ("pytester",)
FLOW = (
    'devices:\n  flow: {kind: reading, unit: l/min, port: /dev/ttyFLOW, ask: "RATE?\\n", find: "rate ([0-9.]+)"}\n'
)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A bench on which an axis may be moved before the others are homed."""
    file = write_bench(tmp_path_factory.mktemp("bench"), side_px=96)
    tree = yaml.safe_load(file.read_text())
    del tree["keep_out"]
    file.write_text(yaml.safe_dump(tree, sort_keys=False))
    return file


def use(bench, x_mm=2.0):
    bench.home("target_x")
    bench.move(target_x=x_mm)
    return bench.where(), bench.stage.controllers["target"].identity


@pytest.fixture(scope="module")
def said(path, tmp_path_factory):
    """What was said to the controller of the target while the script ran at the bench, and what the script saw."""
    folder = tmp_path_factory.mktemp("said")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, str(folder))
        with Rehearsed(path, seed=3) as bench:
            seen = use(bench)
    files = sorted(folder.iterdir())
    assert len(files) == len(load_bench(path).table.stages.controllers)
    return next(file for file in files if file.name.startswith("sim-target")), seen


def replay(path, recording, script=use, **more):
    """Run a script against a recording: what it has seen, what has differed, and the error if it came to one."""
    bench = Rehearsed(path, recorded={"target": recording}, seed=3, **more)
    seen = error = None
    with bench:
        try:
            seen = script(bench)
        except StageError as caught:
            error = caught
    return seen, bench.event_log().differs, error


def changed(recording, folder, edit):
    """A copy of a recording, edited: `edit` gets the list of its lines."""
    copy = folder / "target.txt"
    lines = recording.read_text().splitlines()
    edit(lines)
    copy.write_text("\n".join(lines) + "\n")
    return copy


def place_of(recording, words):
    """Number of the line, 0 first, in which the host says this first."""
    said = [word for word in read_dialogue(recording) if word.by == ">" and words in word.data]
    return said[0].line - 1


def test_the_same_script_hears_the_same_again(path, said):
    recording, seen = said
    true_mm = []

    def script(bench):
        again = use(bench)
        true_mm.append(bench.true_mm()["target_x"])
        return again

    again, differs, error = replay(path, recording, script)
    assert (again, differs, error) == (seen, [], None)
    assert true_mm == [pytest.approx(2.0, abs=0.1)]  # the world moves by the same words


def test_answers_are_those_of_the_recording_and_not_of_the_emulator(path, said, tmp_path):
    """A box that no emulator is: its identity is another."""
    recording, (_, identity) = said
    old, new = b"C-663".hex(" "), b"C-LAB".hex(" ")
    assert old in recording.read_text()

    def other(lines):
        lines[:] = [line.replace(old, new) if line.startswith("<") else line for line in lines]

    (_, told), differs, error = replay(path, changed(recording, tmp_path, other))
    assert told == identity.replace("C-663", "C-LAB") != identity
    assert (differs, error) == ([], None)


def test_what_is_said_otherwise_is_named_with_both_and_the_line(path, said):
    recording, _ = said
    seen, differs, error = replay(path, recording, lambda bench: use(bench, x_mm=2.5))
    move = next(word for word in read_dialogue(recording) if b"MOV" in word.data and b"52.0" in word.data)
    assert seen is None
    assert f"{recording}:{move.line}: 'MOV 1 52.5" in str(error)
    assert "was said, 'MOV 1 52.0" in str(error)
    assert len(differs) == 1
    assert differs[0].startswith(f"target: {recording}:")
    assert len(str(error).splitlines()) == 1


def test_what_is_not_said_any_more_is_named(path, said):
    recording, _ = said
    _, differs, error = replay(path, recording, lambda bench: bench.home("target_x"))
    assert error is None
    assert len(differs) == 1
    assert differs[0].endswith("and has not been said")


def test_late_answers_come_as_late_as_they_were(path, said, tmp_path):
    def slow(lines):
        at = place_of(said[0], b"*IDN?")
        lines[at + 1] = lines[at + 1].split(" +")[0] + " +0.400000"

    took_s = []

    def script(bench):
        took_s.append(bench.event_log().of_kind("told")[-1].time_s)
        return use(bench)

    for recording in (said[0], changed(said[0], tmp_path, slow)):
        assert replay(path, recording, script)[1] == []
    assert took_s[1] - took_s[0] == pytest.approx(0.4, abs=0.05)


# ---- readings --------------------------------------------------------------------------------------


def test_a_reading_answers_in_its_own_words(path, tmp_path):
    folder = tmp_path / "bench"
    shutil.copytree(path.parent, folder)
    bench_file = folder / "bench.yaml"
    text = bench_file.read_text()
    assert "\ndevices:" not in text
    bench_file.write_text(text + FLOW)
    recording = tmp_path / "flow.txt"
    ask, answer = b"RATE?\n".hex(" "), b"rate 4.25\r\n".hex(" ")
    recording.write_text(f"@ 9600\n> {ask}\n< {answer} +0.02\n> {ask}\n")
    with Rehearsed(bench_file, recorded={"flow": str(recording)}) as bench:
        gauge = bench.device("flow")
        assert gauge.reading().value == 4.25
        assert "no answer in time" in gauge.reading().missing
        assert bench.event_log().differs == []
        assert "behind the end of the recording" in gauge.reading().missing
    assert "behind the end" in bench.event_log().differs[0]


def test_a_fault_of_a_reading_strikes_the_reading(path, tmp_path):
    folder = tmp_path / "bench"
    shutil.copytree(path.parent, folder)
    with (folder / "bench.yaml").open("a") as file:
        file.write(FLOW)
    with Rehearsed(folder / "bench.yaml", [{"what": "unplug", "of": "flow", "at_s": 0.1}]) as bench:
        bench.home("target_x")
        assert bench.event_log().faults == ["unplug of flow at 0.1 s"]
        assert bench.device("flow").reading().missing


# ---- what is refused -------------------------------------------------------------------------------

GOOD = "@ 9600\n> 3f\n< 31\n"
WRONG = [
    ("target", None, "cannot be read"),
    ("target", "@ 9600\n> 3f\n< 3g\n", ":3: this is no line of a recording"),
    ("target", "@ 9600\n< 31\n", "this recording has no command to the box"),
    ("target", "\x00\x01\n", ":1: this is no line of a recording"),
    ("targt", GOOD, "there is no 'targt' on this bench; there are rail, portal"),
    ("camera", GOOD, "only devices on a serial port can be recorded"),
    ("target_x", GOOD, "only devices on a serial port can be recorded"),
]


@pytest.mark.parametrize(("name", "text", "words"), WRONG, ids=[words for _, _, words in WRONG])
def test_what_cannot_be_replayed_is_one_sentence(path, tmp_path, name, text, words):
    if text is not None:
        (tmp_path / "said.txt").write_text(text)
    (tmp_path / "faults.yaml").write_text(f"recorded:\n  {name}: said.txt\n")
    for rehearsal, recorded in (
        (Rehearsal(), {name: tmp_path / "said.txt"}),
        (Rehearsal(faults=tmp_path / "faults.yaml"), None),
    ):
        with pytest.raises(ConfigError) as caught:
            rehearsal.of(load_bench(path), recorded=recorded)
        assert words in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1
    if name != "target":
        assert str(caught.value).startswith(f"{tmp_path / 'faults.yaml'}:2: recorded.{name}: ")


def test_a_file_that_says_nothing_is_refused(path, tmp_path):
    (tmp_path / "faults.yaml").write_text("faults: []\n")
    with pytest.raises(ConfigError, match="neither faults nor recorded is set"):
        Rehearsal(faults=tmp_path / "faults.yaml").of(load_bench(path))


def test_a_folder_that_cannot_be_written_is_one_sentence(path, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "file"))
    with pytest.raises(PortUnavailable, match=r"RTPIV_RECORD names .* nothing can be written"), Rehearsed(path):
        pass


def test_a_port_never_waits_for_the_disk_of_a_recording(tmp_path, monkeypatch):
    """The stop of an axis goes by this port: with a disk that hangs it leaves as if nobody recorded."""
    hangs = threading.Event()

    class Hung(io.StringIO):
        def write(self, text):
            hangs.wait(60.0)
            raise OSError(errno.EIO, "I/O error")

    monkeypatch.setattr(Path, "open", lambda place, *words, **more: Hung())
    monkeypatch.setattr(dialogue, "DISK_PATIENCE_S", 0.05)
    monkeypatch.setattr(dialogue, "MOST_WAITING", 10)
    recording = dialogue.RecordedFile(tmp_path / "hung.txt")
    began_s = time.monotonic()
    for number in range(1000):
        recording.line(f"> {number:02x}")
    recording.close()
    assert time.monotonic() - began_s < 5.0  # a disk that is asked takes 60 s
    hangs.set()


def test_recordings_of_one_port_that_begin_at_once_are_files_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    with ThreadPoolExecutor(8) as pool:
        files = list(pool.map(dialogue.recording_file, ["/dev/ttyUSB0"] * 40))
    for number, file in enumerate(files):
        file.line(f"> {number:02x}")
        file.close()
    said = {path.read_text().splitlines()[-1] for path in tmp_path.iterdir()}
    assert said == {f"> {number:02x}" for number in range(40)}


@pytest.mark.posix("a pipe")
def test_a_pipe_is_no_recording(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConfigError, match="is a pipe"):
        read_dialogue(tmp_path / "pipe")


def test_the_fixture_fails_a_test_that_says_something_else(path, said, pytester):
    """Though the test itself catches the error."""
    pytester.makepyfile(
        f"def test_it(rehearse):\n    bench = rehearse({str(path)!r}, recorded={{'target': {str(said[0])!r}}})\n"
        "    try:\n        bench.home('target_x')\n        bench.move(target_x=1.0)\n    except OSError:\n"
        "        pass\n"
    )
    ran = pytester.runpytest_inprocess("-q", "-p", "rtpiv_pytest")
    ran.stdout.fnmatch_lines([f"*not as recorded: target: {said[0]}:*"])
    ran.assert_outcomes(passed=1, errors=1)


# ---- a run of a plan ---------------------------------------------------------------------------------

PLAN = "experiment: target\nclear: {z_mm: [0.0, -10.0]}\nglass: {z_mm: [0.0]}\n"


def run_of(folder, bench, plan, **words):
    (folder / "plan.yaml").write_text(plan)
    place = folder / "runs"
    try:
        acquire(folder / "plan.yaml", bench, place, home=True, frames=LiveFrames(correct=False),
                simulate=Rehearsal(seed=3, **words))  # fmt: skip
        error = ""
    except StageError as caught:
        error = str(caught)
    return read_event_log(next(place.iterdir())), error


@pytest.mark.slow
def test_a_run_of_a_plan_says_what_was_recorded_or_is_told_what_not(tmp_path, monkeypatch):
    """Its last words too, which are those of closing; and by the file of faults, with paths from that file on."""
    bench = write_bench(tmp_path / "bench", side_px=96)
    for name in ("recorded", "again", "other"):
        (tmp_path / name).mkdir()
    with monkeypatch.context() as patch:
        patch.setenv(VARIABLE, str(tmp_path / "said"))
        run_of(tmp_path / "recorded", bench, PLAN)
    (said,) = (tmp_path / "said").glob("sim-target-*.txt")
    said.rename(tmp_path / "said" / "target.txt")
    (tmp_path / "faults.yaml").write_text("recorded: {target: said/target.txt}\n")
    happened, error = run_of(tmp_path / "again", bench, PLAN, faults=tmp_path / "faults.yaml")
    assert (happened.differs, happened.violations, error) == ([], [], "")
    happened, error = run_of(
        tmp_path / "other", bench, PLAN.replace("-10.0", "-12.0"), faults=tmp_path / "faults.yaml"
    )
    (differs,) = happened.differs
    assert differs.startswith(f"target: {tmp_path / 'said' / 'target.txt'}:")
    assert "was said, 'MOV 3 " in differs
    assert "target.txt" in error


# The expected time of a rehearsal beside the processor time that its pictures take, on several benches.


TARGET = "experiment: target\nclear: {z_mm: [-10.0]}\nglass: {z_mm: [0.0]}\n"
LENS = "\naperture: {f_mm: 60.0, f_number: 2.8, focus_mm: 500.0}"


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "simulation"), [
    ("", "samples: 4"), ("", "samples: 3" + LENS), ("three_spheres_500.yaml", "samples: 4"),
    ("furnace_window.yaml", "samples: 2"),
])  # fmt: skip
def test_pictures_take_what_was_expected(tmp_path, scene, simulation):
    """By processor time: what else the computer does is not meant."""
    side_px = 360
    path = write_bench(tmp_path, side_px, f"{simulation}\ncamera_transport: memory")
    if scene:
        text = (EXAMPLES / scene).read_text()
        text = re.sub(r"sensor_px: .*\]", f"sensor_px: [{side_px}, {side_px}]", text)
        (tmp_path / "scene.yaml").write_text(text)
    (tmp_path / "plan.yaml").write_text(TARGET)
    bench = load_bench(path)
    (step,) = [step for step in load_plan(tmp_path / "plan.yaml", bench).steps if step.view == "glass"]
    simulation_s(bench, [step])  # code is loaded once
    estimate_s = thread_count() * (sum(simulation_s(bench, [replace(step, frames=0)])) - STEP_S)
    simulation = SimulatedBench(bench)
    try:
        simulation.place(step.targets_mm)
        begun_s = sum(os.times()[:2])
        simulation.world.light()
        took_s = sum(os.times()[:2]) - begun_s
    finally:
        simulation.close()
    assert took_s / 1.5 < estimate_s < 1.5 * took_s + 0.02  # ticks of 10 ms


def test_a_flow_is_seen_in_real_time(tmp_path):
    """Its pictures are small, and its pulses come at their rate."""
    path, plan = write_flow(tmp_path, pairs=100, chunk=50)
    bench = load_bench(path)
    step = load_plan(plan, bench).steps[-1]
    assert simulation_s(bench, [step])[0] > frames_s(bench, step) > 4.0
