"""`rtpiv laser`: off from anywhere, also past a program that holds the port; alignment asks for a word."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from daq.timing.conditions import Conditions
from daq.timing.errors import NotNow
from daq.timing.opened import open_laser
from daq.timing.pulses import PairExposures, PulseTiming
from daq.timing.states import LaserState
from rtpiv.command_line.cli import DEVICE, DONE, USAGE, main
from sim.emulators.line import Line
from sim.emulators.pty import PtyPort
from sim.mechanics.clock import ScaledClock
from sim.timing_boxes.quantum_composers import QuantumComposersEmulator
from stages.clock import SYSTEM_CLOCK
from tests.daq.bench.test_timing_kind import bench_with
from tests.loops import loop_over

ROOT = Path(__file__).resolve().parents[3]
GOOD = Conditions(True, True, True, 5.0, 1000)


@pytest.fixture(autouse=True)
def alone(tmp_path_factory, monkeypatch):
    """What other programs of this computer have open is no business of these tests."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))


@pytest.fixture
def box():
    clock = ScaledClock()
    emulator = QuantumComposersEmulator(clock)
    with PtyPort(Line(emulator, clock)) as port:
        emulator.path = port.path
        yield emulator


def on_port(folder, box):
    """A bench file that names the port of a box."""
    bench = bench_with(folder)
    text = bench.path.read_text().replace("/dev/one", box.path)
    bench.path.write_text(text)
    return bench.path


def test_state_and_off_on_a_box_that_nobody_holds(tmp_path, box, capsys):
    path = on_port(tmp_path, box)
    for number in (2, 0):
        box.set_inside(number, "STAT", "1")
    assert main(["laser", "off", "--bench", str(path)]) == DONE
    said = capsys.readouterr().out
    assert said.startswith(f"laser ({path}, {box.path}): off, and reads back as off (QC,9538")
    assert not any(box.is_on_at(number) for number in range(9))
    assert main(["laser", "--bench", str(path)]) == DONE


@pytest.mark.parametrize("is_asked", [True, False])
def test_off_goes_past_a_program_that_holds_the_port(tmp_path, box, capsys, monkeypatch, is_asked):
    """Asked, it reads back; another user's program, which cannot be asked, finds that T0 does not run."""
    path = on_port(tmp_path, box)
    table = bench_with(tmp_path / "other").devices["laser"].section.model_copy(update={"port": box.path})
    with open_laser(table, SYSTEM_CLOCK) as laser:
        laser.warm(10.0)
        laser.set(PulseTiming(20.0, 10.0), PairExposures(100.0, 20_000.0, 2.0))
        laser.arm(GOOD, laser.challenge)
        laser.fire(90)
        if not is_asked:
            monkeypatch.setattr("daq.timing.switch_off.request_off", lambda port: [])
        assert main(["laser", "off", "--bench", str(path)]) == (DONE if is_asked else DEVICE)
        said = "reads back as off to process" if is_asked else "could not be read back"
        assert said in capsys.readouterr().out
        assert not any(box.is_on_at(number) for number in range(9))
        assert laser.state is (LaserState.FAULT if is_asked else LaserState.FIRING)
        laser._ends_s = 0.0  # when its time is over, the program that fires finds out
        with pytest.raises(Exception, match=r"not run to the end|laser off was called"):
            laser.wait()
        assert laser.state in (LaserState.UNKNOWN, LaserState.FAULT)


@pytest.mark.parametrize(("word", "code"), [("1234", DONE), ("4321", USAGE), ("", USAGE)])
def test_alignment_asks_for_its_word_and_says_what_is_proven(tmp_path, monkeypatch, mocker, capsys, word, code):
    mocker.patch("daq.timing.states.secrets.randbelow", return_value=234)
    monkeypatch.setattr("builtins.input", lambda: word)
    bench = bench_with(tmp_path, more=", align: {q_switch_delay_us: 300.0}")
    assert main(["laser", "align", "--for-s", "1", "--bench", str(bench.path), "--simulate"]) == code
    assert "it was never proven on this bench (rtpiv laser prove)" in " ".join(capsys.readouterr().err.split())


def test_off_without_a_port_says_that_it_was_not_reached(tmp_path, capsys):
    bench = bench_with(tmp_path)
    assert main(["laser", "off", "--bench", str(bench.path)]) == DEVICE
    said = capsys.readouterr()
    assert f"laser ({bench.path}, /dev/one): NOT reached, /dev/one does not exist" in said.out
    assert "not confirmed to be off: laser" in said.err


@pytest.mark.parametrize(
    ("words", "said"), [(["off", "--name", "other"], "no device 'other'"), (["state"], "choose a laser")]
)
def test_which_one_is_not_clear_is_said(tmp_path, capsys, words, said):
    bench = bench_with(tmp_path)
    if "state" in words:
        text = bench.path.read_text().replace("/dev/one", "/dev/other")
        section = text[text.index("  laser: ") :].replace("laser:", "second:", 1)
        bench.path.write_text(bench.path.read_text() + section)
    assert main(["laser", *words, "--bench", str(bench.path)]) == USAGE
    assert said in capsys.readouterr().err


@pytest.fixture(scope="module")
def labs(tmp_path_factory):
    """A lab of `rtpiv init`, with its laser in bench-flow.yaml beside a bench.yaml without one; and `examples`."""
    base = tmp_path_factory.mktemp("labs")
    assert main(["init", str(base / "lab")]) == DONE
    assert main(["setup", "examples", str(base / "examples")]) == DONE
    return base


@pytest.fixture(params=["lab", "examples"])
def folder(request, labs, tmp_path, box):
    """A copy of either, with its laser on a port that is there."""
    place = tmp_path / "here"
    shutil.copytree(labs / request.param, place)
    bench = place / "bench-flow.yaml"
    bench.write_text(bench.read_text().replace("/dev/ttyUSB4", box.path))
    return place


@pytest.mark.parametrize("below", ["", "runs/20260101T000000_plan-flow/frames"])
def test_off_needs_no_other_word_in_or_below_a_lab(folder, below, box, monkeypatch, capsys):
    box.set_inside(2, "STAT", "1")
    (folder / below).mkdir(parents=True, exist_ok=True)
    monkeypatch.chdir(folder / below)
    assert main(["laser", "off"]) == DONE
    assert not any(box.is_on_at(number) for number in range(9))
    assert f"laser ({folder / 'bench-flow.yaml'}, {box.path}): off" in capsys.readouterr().out


def test_off_by_a_bench_file_without_a_laser_goes_to_those_beside_it(folder, box, monkeypatch):
    box.set_inside(2, "STAT", "1")
    monkeypatch.chdir(folder)
    assert main(["laser", "off", "--bench", "bench.yaml"]) == DONE
    assert not any(box.is_on_at(number) for number in range(9))


@pytest.mark.posix("links, which Windows lets administrators make")
def test_off_says_that_the_named_file_cannot_be_read_and_still_goes_to_those_beside_it(
    folder, box, monkeypatch, capsys
):
    box.set_inside(2, "STAT", "1")
    (folder / "loop.yaml").symlink_to(folder / "loop.yaml")
    monkeypatch.chdir(folder)
    assert main(["laser", "off", "--bench", "loop.yaml"]) == DEVICE
    assert not any(box.is_on_at(number) for number in range(9))
    said = capsys.readouterr()
    assert "loop.yaml, no port): NOT reached, its bench file cannot be read" in said.out
    assert f"{box.path}): off" in said.out


@loop_over(
    "old, new",
    [
        ("scene: ", "scene: not-there-"),
        ("stages:", "stags:"),
        ("name: ", "name: again\nname: "),
        ("max_rate_hz: 15.0", "max_rate_hz: -1.0"),
        ("warmup_s", "warmup_ms"),
    ],
)
def test_a_mistake_elsewhere_in_the_bench_file_keeps_no_laser_on(labs, tmp_path, box, monkeypatch, old, new):
    text = (labs / "lab" / "bench-flow.yaml").read_text().replace("/dev/ttyUSB4", box.path)
    assert old in text
    (tmp_path / "flow.yml").write_text(text.replace(old, new))
    box.set_inside(2, "STAT", "1")
    monkeypatch.chdir(tmp_path)
    assert main(["laser", "off"]) == DONE
    assert not any(box.is_on_at(number) for number in range(9))


def test_each_of_several_is_named_with_what_became_of_it(tmp_path, box, monkeypatch, capsys):
    on_port(tmp_path, box)
    text = (tmp_path / "bench.yaml").read_text()
    (tmp_path / "second.yaml").write_text(text.replace("  laser:", "  other:").replace(box.path, "/dev/none"))
    (tmp_path / "torn.yaml").write_text("devices:\n  third: {kind: timing, box: [\n")
    (tmp_path / "copy.yaml").write_text(text)
    box.set_inside(2, "STAT", "1")
    monkeypatch.chdir(tmp_path)
    assert main(["laser", "off"]) == DEVICE
    said = capsys.readouterr()
    assert not any(box.is_on_at(number) for number in range(9))
    assert "bench.yaml" in said.out
    assert said.out.count(box.path) == 1  # its copy is the same laser
    assert f"other ({tmp_path / 'second.yaml'}, /dev/none): NOT reached" in said.out
    assert f"laser ({tmp_path / 'torn.yaml'}, no port): NOT reached" in said.out
    assert "not confirmed to be off: other, laser" in said.err


def test_off_writes_into_no_file_that_a_bench_file_calls_a_port(tmp_path, monkeypatch, capsys):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "bench.yaml").write_text(
        f"devices:\n  laser: {{kind: timing, box: qc9520, port: {tmp_path / 'notes.txt'}, channels: {{}}}}\n"
    )
    monkeypatch.chdir(tmp_path)
    assert main(["laser", "off"]) == DEVICE
    assert "is no serial port" in capsys.readouterr().out
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_off_reaches_what_a_running_process_has_open(tmp_path, box, monkeypatch, capsys):
    table = bench_with(tmp_path / "elsewhere").devices["laser"].section.model_copy(update={"port": box.path})
    monkeypatch.chdir(tmp_path)
    with open_laser(table, SYSTEM_CLOCK) as laser:
        for _ in range(2):
            laser.warm(10.0)
            assert main(["laser", "off"]) == DONE
            words = f"laser of process {os.getpid()} ({box.path}): off, and reads back as off to process"
            assert words in capsys.readouterr().out
            assert not any(box.is_on_at(number) for number in range(9))
            with pytest.raises(NotNow, match="laser off was called"):
                laser.warm(10.0)
            laser.safe()  # a person has looked at it
    assert main(["laser", "off"]) == USAGE
    assert "no laser; there is none" in capsys.readouterr().err


def test_what_a_killed_process_has_left_is_no_laser_in_use(tmp_path, monkeypatch, capsys):
    write = "import sys; from daq.timing import in_use, timing_table\n"
    write += "table = timing_table.TimingTable.model_validate_json(sys.argv[1])\n"
    write += "with in_use.register_laser(table): print('noted', flush=True); input()"
    table = bench_with(tmp_path / "elsewhere").devices["laser"].section.model_dump_json(exclude_unset=True)
    child = subprocess.Popen(
        [sys.executable, "-c", write, table], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    monkeypatch.chdir(tmp_path)
    try:
        assert child.stdout.readline() == b"noted\n"
        assert main(["laser", "off"]) == DEVICE
        assert f"laser of process {child.pid} (/dev/one): NOT reached" in capsys.readouterr().out
    finally:
        child.send_signal(signal.SIGKILL)
        child.communicate()
    assert main(["laser", "off"]) == USAGE
    assert not list(Path(os.environ["XDG_RUNTIME_DIR"]).rglob("*.json"))


def test_a_folder_that_others_may_write_to_names_no_laser(tmp_path, box, monkeypatch):
    """Who may write there could have bytes sent to any port."""
    table = bench_with(tmp_path / "elsewhere").devices["laser"].section.model_copy(update={"port": box.path})
    place = Path(os.environ["XDG_RUNTIME_DIR"]) / "rtpiv-lasers"
    place.mkdir()
    place.chmod(0o777)
    monkeypatch.chdir(tmp_path)
    with open_laser(table, SYSTEM_CLOCK) as laser:
        assert laser.state is LaserState.SAFE
        assert main(["laser", "off"]) == USAGE


@pytest.mark.parametrize("which", ["lab", "examples"])
def test_the_shipped_benches_can_align(which, labs, mocker, monkeypatch, capsys):
    """The command of docs/laser.md, as it stands there."""
    mocker.patch("daq.timing.states.secrets.randbelow", return_value=234)
    monkeypatch.setattr("builtins.input", lambda: "1234")
    monkeypatch.chdir(labs / which)
    command = "laser align --rate-hz 5 --for-s 10"
    assert f"rtpiv {command}" in (ROOT / "docs" / "laser.md").read_text()
    assert main([*command.split(), "--simulate"]) == DONE
    assert "laser: safe" in capsys.readouterr().out


@loop_over("words, said", [(["--rate-hz", "500"], "at most"), (["--for-s", "1e3"], "at most")])
def test_alignment_refuses_a_limit_before_it_asks_for_goggles(labs, monkeypatch, capsys, words, said):
    monkeypatch.setattr("builtins.input", lambda: pytest.fail("asked for the code"))
    monkeypatch.chdir(labs / "lab")
    assert main(["laser", "align", *words, "--simulate"]) == USAGE
    found = capsys.readouterr().err
    assert said in found
    assert "oggles" not in found


def test_the_doctor_looks_for_its_port(tmp_path, capsys):
    bench = bench_with(tmp_path)
    assert main(["doctor", "--bench", str(bench.path)]) == DEVICE
    assert "timing unit laser" in capsys.readouterr().out
