"""The word is shown and read at a terminal; a script answers for a simulated laser only; nobody is refused."""

import io
import re

import pytest

from daq.errors import RunInterrupted, RunUsageError
from daq.runner.laser_session import NoOperator
from daq.runs.run_folder import RunFolder
from rtpiv.command_line.cli import DONE, INTERRUPTED, USAGE, main
from rtpiv.verbs.operator import ScriptOperator, TerminalOperator, operator_of
from tests.daq.flow_bench import write_flow
from tests.loops import loop_over


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_person_reads_the_word_and_types_it(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", Terminal("  ember \n\n"))
    person = operator_of(None, simulate=False)
    assert isinstance(person, TerminalOperator)
    assert person.confirmation_code("ember", "no switch") == "ember"
    person.open_seeding()
    said = capsys.readouterr().err
    assert "type this code: ember" in said
    assert "no interlock" in said
    assert "Open the seeding" in said


def test_a_terminal_that_has_gone_types_nothing(monkeypatch):
    monkeypatch.setattr("sys.stdin", Terminal(""))
    assert TerminalOperator().confirmation_code("ember", "no switch") == ""


def test_without_a_terminal_nobody_says_it(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("ember\n"))
    nobody = operator_of(None, simulate=True)
    assert isinstance(nobody, NoOperator)
    with pytest.raises(RunUsageError, match="the code that arms the laser cannot be typed"):
        nobody.confirmation_code("ember", "no switch")


def test_a_script_answers_for_a_simulated_laser_only():
    assert operator_of("me", simulate=True) == ScriptOperator("me")
    with pytest.raises(RunUsageError, match="simulated laser only"):
        operator_of("me", simulate=False)


def test_a_flow_run_that_nobody_can_arm_is_refused_before_anything_moves(tmp_path, monkeypatch, capsys):
    """Not after ten minutes of homing, and no folder is left."""
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    bench, plan = write_flow(tmp_path)
    words = ("acquire", str(plan), "--bench", str(bench), "--simulate", "--home", "-o", str(tmp_path / "runs"))
    assert main([*words, "--no-correct"]) == USAGE
    said = capsys.readouterr()
    assert "the code that arms the laser cannot be typed here; use a terminal, or --operator NAME" in said.err
    assert "homing" not in said.err
    assert not (tmp_path / "runs").exists()
    assert main([*words[:4], "--operator", "me", *words[5:]]) == USAGE  # a real laser
    assert "simulated laser only" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_person_reads_where_a_stage_stands(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", Terminal(" -12.5 \n"))
    person = TerminalOperator()
    assert person.stands_mm("glass_x") == -12.5
    assert "glass_x cannot look for its reference" in capsys.readouterr().err


@loop_over("nobody", [NoOperator(), ScriptOperator()])
def test_who_sees_no_scale_says_nothing_of_it(nobody):
    with pytest.raises(RunUsageError, match="glass_x is homed by hand"):
        nobody.stands_mm("glass_x")


def test_the_hint_to_resume_repeats_who_answers_and_the_steps_are_those_of_the_panel(
    tmp_path, monkeypatch, capsys
):
    """And what Ctrl-C does to a run with light is said as it is."""
    bench, plan = write_flow(tmp_path)

    def ended(*_: object, **__: object) -> None:
        raise RunInterrupted("ended")

    monkeypatch.setattr("rtpiv.verbs.acquire.run_session", ended)
    monkeypatch.setattr(RunFolder, "remove_if_empty", lambda self: False)
    words = ("acquire", str(plan), "--bench", str(bench), "--simulate", "--home", "-o", str(tmp_path / "runs"))
    assert main([*words, "--no-correct", "--operator", "me"]) == INTERRUPTED
    said = capsys.readouterr()
    assert "Ctrl-C switches the laser off and ends within the step" in said.out
    assert said.err.splitlines()[0].endswith(" --home --operator me")
    assert main([*words[:5], "--dry-run"]) == DONE
    assert re.search(r"\W1\W+0\.\.", capsys.readouterr().out)  # the first step, and its frames


@loop_over("wrong", ["1O.0", "10,0", "1_0", "nan", "inf", "1e3", "[red]", "ten"])
def test_a_place_that_is_none_is_said_and_asked_for_again(monkeypatch, capsys, wrong):
    monkeypatch.setattr("sys.stdin", Terminal(f"{wrong}\n10.25\n"))
    assert TerminalOperator().stands_mm("target_z") == 10.25
    assert f"'{wrong}' is no place in mm; type digits with a point, as 10.0" in capsys.readouterr().err


@loop_over("lines", ["", "\n", "1O.0\n\n"])
def test_who_types_no_place_at_all_gives_up(monkeypatch, lines):
    monkeypatch.setattr("sys.stdin", Terminal(lines))
    with pytest.raises(RunUsageError, match="no place of target_z was typed; nothing has moved"):
        TerminalOperator().stands_mm("target_z")


@loop_over("text, mm", [("10", 10.0), ("-0.5", -0.5), ("+3.25", 3.25)])
def test_places(monkeypatch, text, mm):
    monkeypatch.setattr("sys.stdin", Terminal(text))
    assert TerminalOperator().stands_mm("a") == mm
