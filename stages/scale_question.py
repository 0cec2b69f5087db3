"""Question to a person who turns a screw: the target, and the reading of its scale.

The interface (a terminal, a window, a simulated hand) shows `ScaleQuestion.words` and hands back what was typed,
as text; what makes a number of it stands here, once.  Places are those of the scale, in mm, digits with a point: a
comma may part thousands, and a letter O is no zero.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

from stages.axis_settings import ROUNDING_UM

PLACE = re.compile(r"[-+]?[0-9]{1,5}(\.[0-9]{1,6})?")  # no 1_0, no nan, no comma that might part thousands
ROUNDING_MM = ROUNDING_UM * 1e-3


@dataclass(frozen=True, slots=True)
class ScaleQuestion:
    """One question.

    Parameters
    ----------
    axis : str
        As the bench file calls it.
    target_mm : float or None
        Where it is to be turned, on its scale; None: it is only read.
    limits_mm : (float, float)
        What its scale may read.
    tolerance_mm : float
        A reading farther from the target than this is no answer.
    wrong : str
        What was wrong with the answer before, as a sentence; "" the first time.
    """

    axis: str
    target_mm: float | None
    limits_mm: tuple[float, float]
    tolerance_mm: float
    wrong: str = ""

    @property
    def words(self) -> str:
        """Text of the question."""
        return f"{self.wrong}\n{self._request}" if self.wrong else self._request

    @property
    def _request(self) -> str:
        if self.target_mm is None:
            return f"{self.axis} is moved by hand. What does its scale read? Type that in mm, then Enter:"
        return (
            f"Turn {self.axis} to {self.target_mm:.3f} mm, and take your hand away. What does its scale read? "
            "Type that in mm, then Enter:"
        )

    def reading_error(self, text: str) -> str | None:
        """Say in a sentence why a text is no answer; None if it is one."""
        if not text.strip():
            return f"nothing was typed; type what the scale of {self.axis} reads, or end the run with Ctrl-C"
        if (mm := place_mm(text)) is None:
            return no_place(text)
        low_mm, high_mm = self.limits_mm
        if not low_mm - ROUNDING_MM <= mm <= high_mm + ROUNDING_MM:
            return f"{mm:g} mm is outside what the scale of {self.axis} may read, {low_mm:g} to {high_mm:g} mm"
        if self.target_mm is not None and abs(mm - self.target_mm) > self.tolerance_mm + ROUNDING_MM:
            return (
                f"{mm:g} mm is {abs(mm - self.target_mm):.3f} mm from {self.target_mm:.3f}, and "
                f"{self.tolerance_mm:g} mm are allowed (in_position_um); turn {self.axis} there"
            )
        return None


# Puts a question and returns what was typed, "" for an empty line; None if there can be no answer any more.  The
# second argument says, often asked, whether the question is to be given up; then None is returned as well.
Person = Callable[[ScaleQuestion, Callable[[], bool]], str | None]


def place_mm(text: str) -> float | None:
    """Number [mm] that a person has typed; None if it is none."""
    return float(text) if PLACE.fullmatch(text := text.strip()) else None


def no_place(text: str) -> str:
    """Say what is wrong with a text that is no place."""
    return f"{text.strip()!r} is no place in mm; type digits with a point, as 10.0"
