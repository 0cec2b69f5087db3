"""Operators of a bench: a person at the terminal, or a script for a simulated laser.

The laser makes a new code whenever it has been switched off, so it cannot be known before the bench is open.  A
script therefore confirms a simulated laser only (`--operator NAME`); at a real one a person reads and types the
code, once a run.

Axes without a motor are moved and read by the same person.  Lines typed before a question is shown are dropped, as
they answer something else.
"""

import os
import select
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from daq.errors import RunUsageError
from daq.plans.steps import Step
from daq.runner.laser_session import NoOperator, Operator, no_hands
from ground.terminal import error_console, pause_drawing
from stages.scale_question import ScaleQuestion, no_place, place_mm

ANSWER_POLL_S = 0.1  # of a wait for an answer, for a question that is given up


class TerminalOperator:
    """A person at the terminal."""

    def confirmation_code(self, challenge: str, watched: str) -> str:
        """Show the code and who watches the door, and return what was typed."""
        with pause_drawing():
            error_console().print(
                "\nThe laser is about to be armed. Software is no interlock: door switch, goggles and beam stops "
                f"are yours.\nSwitches: {watched}.\nIs everybody out of the beam? "
                f"Then type this code: {challenge}",
                soft_wrap=True,
            )
            return _read_line()

    def open_seeding(self) -> None:
        """Wait for Enter."""
        with pause_drawing():
            error_console().print("\nThe background is done. Open the seeding, then press Enter.", soft_wrap=True)
            _read_line()

    def stands_mm(self, axis: str) -> float:
        """Ask for a number until one is typed; RunUsageError at an empty line, or if the terminal has gone."""
        with pause_drawing():
            screen = error_console()
            screen.print(
                f"\n{axis} cannot look for its reference. Read on its scale where it stands, and type that in mm:",
                soft_wrap=True,
            )
            while text := _read_line():
                if (mm := place_mm(text)) is not None:
                    return mm
                screen.print(f"{no_place(text)} (an empty line gives up):", markup=False, soft_wrap=True)
        raise RunUsageError(f"no place of {axis} was typed; nothing has moved")

    def reads(self, question: ScaleQuestion, given_up: Callable[[], bool]) -> str | None:
        """Show the question and return what is typed; None if it is given up, or the terminal has gone."""
        with pause_drawing():
            _drop_typed_lines()
            error_console().print(f"\n{question.words}", markup=False, highlight=False, soft_wrap=True)
            return _read_line_unless(given_up)


@dataclass(frozen=True)
class ScriptOperator:
    """A script that answers for a simulated laser; `name` is whose it is."""

    name: str = ""

    def confirmation_code(self, challenge: str, watched: str) -> str:
        """Return the code."""
        return challenge

    def open_seeding(self) -> None:
        """The simulated seeding is open when the flow is photographed."""

    def stands_mm(self, axis: str) -> float:
        """A script sees no scale.

        Raises
        ------
        RunUsageError
            Always.
        """
        raise RunUsageError(f"{axis} is homed by hand: a person has to read where it stands")

    def reads(self, question: ScaleQuestion, given_up: Callable[[], bool]) -> str | None:
        """A script turns no screw.

        Raises
        ------
        RunUsageError
            Always.
        """
        raise RunUsageError(no_hands([question.axis]))


def operator_of(name: str | None, simulate: bool) -> Operator:
    """Return the operator of a run.

    Parameters
    ----------
    name : str or None
        Value of `--operator`.
    simulate : bool
        Whether the bench is simulated.

    Raises
    ------
    RunUsageError
        A script asks to answer for a real laser.
    """
    if name is not None and not simulate:
        raise RunUsageError(
            "--operator answers for a simulated laser only; at a real one a person types the code that it shows"
        )
    if name is not None:
        return ScriptOperator(name)
    return TerminalOperator() if sys.stdin is not None and sys.stdin.isatty() else NoOperator()


def require_person(person: Operator, steps: Sequence[Step], by_hand: Sequence[str]) -> None:
    """Refuse what needs a person where none is at a terminal; RunUsageError before anything moves.

    Parameters
    ----------
    person : Operator
        Operator of the run.
    steps : sequence of Step
        Some may need light, and so a person who types the code.
    by_hand : sequence of str
        Axes that a person moves; none on a simulated bench, which has a hand of its own.
    """
    if by_hand and not isinstance(person, TerminalOperator):
        raise RunUsageError(no_hands(by_hand))
    if isinstance(person, NoOperator) and any(step.pulses and not step.is_lit_from_outside for step in steps):
        person.confirmation_code("", "")


def _read_line() -> str:
    """Return a line from the terminal; "" if it has gone."""
    return sys.stdin.readline().strip()


def _read_line_unless(given_up: Callable[[], bool]) -> str | None:
    """Return a line from the terminal; None if it has gone, or the question is given up before.

    A signal that asks for the end does not end a read that waits for a line, so what may be given up waits here.
    """
    while os.name == "posix" and sys.stdin.isatty() and not select.select([sys.stdin], [], [], ANSWER_POLL_S)[0]:
        if given_up():
            return None
    line = sys.stdin.readline()
    return line.rstrip("\r\n") if line and not given_up() else None


def _drop_typed_lines() -> None:
    """Drop lines that wait to be read, where the system can."""
    if os.name == "posix" and sys.stdin.isatty():
        import termios  # not every system has it

        termios.tcflush(sys.stdin, termios.TCIFLUSH)
