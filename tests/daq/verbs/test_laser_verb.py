"""`rtpiv laser`: off from anywhere, also past a program that holds the port; alignment asks for a word."""

import pytest

from daq.cli import DEVICE, DONE, USAGE, main
from daq.timing.conditions import Conditions
from daq.timing.opened import open_laser
from daq.timing.pulses import PairExposures, PulseTiming
from daq.timing.states import LaserState
from sim.clock import ScaledClock
from sim.emulators.line import Line
from sim.emulators.pty import PtyPort
from sim.emulators.quantum_composers import QuantumComposersEmulator
from stages.clock import SYSTEM_CLOCK
from tests.daq.acquisition.bench.test_timing_kind import bench_with

GOOD = Conditions(True, True, True, 5.0, 1000, True)


@pytest.fixture
def box():
    clock = ScaledClock()
    emulator = QuantumComposersEmulator({}, clock)
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
    assert "laser: safe (QC,9528" in capsys.readouterr().out
    assert not any(box.is_on_at(number) for number in range(9))
    assert main(["laser", "--bench", str(path)]) == DONE


def test_off_goes_past_a_program_that_holds_the_port(tmp_path, box, capsys):
    path = on_port(tmp_path, box)
    table = bench_with(tmp_path / "other").devices["laser"].section.model_copy(update={"port": box.path})
    with open_laser(table, SYSTEM_CLOCK) as laser:
        laser.warm(10.0)
        laser.set(PulseTiming(20.0, 10.0), PairExposures(100.0, 20_000.0, 2.0))
        laser.arm(GOOD, laser.challenge)
        laser.fire(90)
        assert main(["laser", "off", "--bench", str(path)]) == DEVICE
        assert "could not be read back" in capsys.readouterr().err
        assert not any(box.is_on_at(number) for number in range(9))
        laser._ends_s = 0.0  # when its time is over, the program that fires finds out
        with pytest.raises(Exception, match=r"no longer holds|switched off"):
            laser.wait()
        assert laser.state is LaserState.UNKNOWN


@pytest.mark.parametrize(("word", "code"), [("1234", DONE), ("4321", USAGE), ("", USAGE)])
def test_alignment_asks_for_its_word(tmp_path, monkeypatch, mocker, word, code):
    mocker.patch("daq.timing.standing.secrets.randbelow", return_value=234)
    monkeypatch.setattr("builtins.input", lambda: word)
    bench = bench_with(tmp_path, more=", align: {q_switch_delay_us: 300.0}")
    assert main(["laser", "align", "--for-s", "1", "--bench", str(bench.path), "--simulate"]) == code


def test_off_without_a_port_says_that_nobody_was_told(tmp_path, capsys):
    bench = bench_with(tmp_path)
    assert main(["laser", "off", "--bench", str(bench.path)]) == DEVICE
    assert "off could not be said" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [(["--name", "other"], "no device 'other'"), ([], "say which device")],
)
def test_a_bench_without_one_is_said(tmp_path, capsys, words, said):
    bench = bench_with(tmp_path)
    if not words:
        text = bench.path.read_text()
        section = text[text.index("  laser: ") :].replace("laser:", "second:", 1)
        bench.path.write_text(text + section)
    assert main(["laser", "off", "--bench", str(bench.path), *words]) == USAGE
    assert said in capsys.readouterr().err


def test_the_doctor_looks_for_its_port(tmp_path, capsys):
    bench = bench_with(tmp_path)
    assert main(["doctor", "--bench", str(bench.path)]) == DONE
    assert "timing unit laser" in capsys.readouterr().out
