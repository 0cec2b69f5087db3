"""A bench without a motor and without a simulation: a person at a real terminal is the stage."""

import json
import subprocess
import sys

import pytest

from rtpiv.command_line.cli import DONE, INTERRUPTED, USAGE
from tests.daq.hand_bench import write_real_hand_bench
from tests.system.test_stage_terminal import CTRL_C, Terminal

pytestmark = pytest.mark.slow
READ = "Type that in mm, then Enter:"


class Lab:
    """Where a person works."""

    def __init__(self, folder):
        self.folder = folder
        self.bench, self.plan = write_real_hand_bench(folder)

    def start(self, *words, **options):
        return subprocess.Popen([sys.executable, "-m", "rtpiv", *words], cwd=self.folder, **options)

    @property
    def run(self):
        (found,) = (self.folder / "runs").iterdir()
        return found

    def steps(self):
        lines = [json.loads(line) for line in (self.run / "steps.jsonl").read_text().splitlines()]
        return [line["measured_mm"] for line in lines if line["kind"] == "step"]


@pytest.fixture
def lab(tmp_path):
    return Lab(tmp_path / "lab")


@pytest.fixture
def at(lab):
    opened = []

    def terminal(*words):
        opened.append(Terminal(lab, *words))
        return opened[-1]

    yield terminal
    for one in opened:
        one.close()


def answer(terminal, about, *lines):
    """Read a question, and type lines, each after the question has come again."""
    for line in lines:
        terminal.expect(about, 20.0)
        terminal.expect(READ, 20.0)
        terminal.type(line)


ACQUIRE = ("acquire", "plan.yaml", "--home", "--no-correct")


def test_a_person_turns_and_reads_ends_the_run_with_ctrl_c_and_goes_on(lab, at):
    one = at(*ACQUIRE)
    one.type("7.0")  # before anything is asked: no answer
    for axis, reads in (("target_z", "0.0"), ("glass_y", "-130"), ("target_x", "0.4"), ("target_y", "0.00")):
        answer(one, f"{axis} is moved by hand", reads)
    answer(one, "Turn glass_y to 0.000 mm", "O.0", "0.0")
    answer(one, "Turn target_x to 0.000 mm", "0,0", "", "30", "0.4", "0.01")
    one.expect("Turn target_x to 1.000 mm")
    one.expect(READ)
    one.type(CTRL_C)
    one.expect("go on with: rtpiv acquire --resume")
    assert one.process.wait(20) == INTERRUPTED
    assert lab.steps() == [{"target_z": 0.0, "glass_y": 0.0, "target_x": 0.01, "target_y": 0.0}]

    two = at("acquire", "--resume", str(lab.run), "--home")
    for axis, reads in (("target_z", "0.0"), ("glass_y", "0.0"), ("target_x", "0.7"), ("target_y", "0.0")):
        answer(two, f"{axis} is moved by hand", reads)
    answer(two, "Turn target_x to 1.000 mm", "1.0 mm", "0.99")
    two.expect("real bench", 20.0)  # who stops reading stops a terminal
    assert two.process.wait(20) == DONE
    assert [step["target_x"] for step in lab.steps()] == [0.01, 0.99]
    (moved,) = json.loads((lab.run / "displacements.json").read_text())
    assert moved["measured_mm"] == pytest.approx([0.98, 0.0, 0.0], abs=1e-9)


def test_a_terminal_that_goes_ends_the_run_and_loses_nothing(lab, at):
    one = at(*ACQUIRE)
    answer(one, "target_z is moved by hand", "0.0")
    one.expect("glass_y is moved by hand")
    one.type(b"\x04")  # the end of what is typed
    one.expect("the position of glass_y was not read; home the axis to enter it")
    assert one.process.wait(20) not in (DONE, USAGE)


def test_ctrl_c_at_the_prompt_holds_the_bench(at):
    one = at("bench", "stage")
    one.expect("stage> ")
    one.type("home")
    for axis, reads in (("target_z", "0.0"), ("glass_y", "0.0"), ("target_x", "0.0"), ("target_y", "0.0")):
        answer(one, f"{axis} is moved by hand", reads)
    one.expect("stage> ")
    one.type("move target_x=5")
    one.expect("Turn target_x to 5.000 mm")
    one.expect(READ)
    one.type(CTRL_C)
    one.expect("held> ")
    one.type("clear")
    one.expect("stage> ")
    one.type("move target_x=5")
    one.expect("home it")
    one.type("quit")
    assert one.process.wait(20) == DONE


def test_without_a_terminal_nothing_begins(lab):
    piped = lab.start(*ACQUIRE, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    said = piped.communicate(timeout=60)[1]
    assert piped.returncode == USAGE
    assert "glass_y, target_x, target_y, target_z are moved by hand" in said
    assert "run this at one, with nothing piped into it" in said
    assert not (lab.folder / "runs").exists()
