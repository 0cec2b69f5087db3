"""Who types the code that a laser asks for: a person at the terminal, or a script where there is no light.

The laser makes its code up whenever it has been switched off, so nobody can write it down before the bench is
open.  A script can therefore answer for a simulated laser only, by `--operator NAME`; a real one wants a person
who reads the code and types it, at the bench, once a run.
"""

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from daq.errors import RunUsageError
from daq.plans.steps import Step
from daq.runner.laser_session import NoOperator, Operator
from ground.terminal import error_console

_PLACE = re.compile(r"[-+]?[0-9]{1,5}(\.[0-9]{1,6})?")  # no 1_0, no nan, no comma that might part thousands


class TerminalOperator:
    """A person at the terminal."""

    def confirmation_code(self, challenge: str, watched: str) -> str:
        """Show the code and who watches the door, and return what was typed."""
        error_console().print(
            "\nThe laser is about to be armed. Software is no interlock: door switch, goggles and beam stops are "
            f"yours.\nSwitches: {watched}.\nIs everybody out of the beam? Then type this code: {challenge}",
            soft_wrap=True,
        )
        return _typed()

    def open_seeding(self) -> None:
        """Wait for Enter."""
        error_console().print("\nThe background is done. Open the seeding, then press Enter.", soft_wrap=True)
        _typed()

    def stands_mm(self, axis: str) -> float:
        """Ask for a number until one is typed; RunUsageError at an empty line, or if the terminal has gone."""
        screen = error_console()
        screen.print(
            f"\n{axis} cannot look for its reference. Read on its scale where it stands, and type that in mm:",
            soft_wrap=True,
        )
        while text := _typed():
            if _PLACE.fullmatch(text):
                return float(text)
            screen.print(
                f"{text!r} is no place in mm; type digits with a point, as 10.0 (an empty line gives up):",
                markup=False,
                soft_wrap=True,
            )
        raise RunUsageError(f"no place of {axis} was typed; nothing has moved")


@dataclass(frozen=True)
class ScriptOperator:
    """A script that answers for a simulated laser; `name` is whose it is."""

    name: str = ""

    def confirmation_code(self, challenge: str, watched: str) -> str:
        """Say what is asked for."""
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


def operator_of(name: str | None, simulate: bool) -> Operator:
    """Return who answers for the light of a run.

    Parameters
    ----------
    name : str or None
        What `--operator` says.
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


def require_person(person: Operator, steps: Sequence[Step]) -> None:
    """Refuse steps that need light where the laser cannot be armed; RunUsageError before anything moves."""
    if isinstance(person, NoOperator) and any(step.pulses is not None for step in steps):
        person.confirmation_code("", "")


def _typed() -> str:
    """A line from the terminal; nothing if it has gone."""
    return sys.stdin.readline().strip()
