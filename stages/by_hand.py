"""Axes without a motor: a person turns the screw, and says what its scale reads.

Such an axis is asked for as every other one: `start_move` notes where to, `moving` puts the question and returns
when it is answered, and the position is what was read last.  Homing is the first reading.  The way is judged
before the question, by limits and keep-out, as if a motor were to drive it.

What is typed is asked for again until it is a reading near enough to the target (`stages.scale_question`).
Ctrl-C, a stop of the bench and a terminal that has gone end the question: then the position of the screw
is unknown, so its axis has none until it is read anew.

What cannot be detected: a screw that is turned between two questions, and a reading that is wrong and near.  How
well a scale is read is `reading_um` of its axis in the bench file; it is in the error of whatever is measured with
it.
"""

import math
from dataclasses import replace

from stages.controller_tables import AnyControllerTable
from stages.errors import MotionStopped, NotReferenced, OutOfRange, StageUsageError
from stages.motion_controller import MotionController
from stages.scale_question import Person, ScaleQuestion, place_mm


class ByHand(MotionController):
    """Every axis that one person turns."""

    _is_open = False
    _ask: Person | None = None

    def set_operator(self, person: Person) -> None:
        """Say who is asked."""
        self._ask = person

    def open(self, table: AnyControllerTable) -> str:
        """Nothing is to be opened; the positions of the screws are unknown."""
        self._reading_mm: dict[str, float] = {}
        self._wanted: tuple[str, float | None] | None = None
        self._forget_references()
        self._is_open, self.under_way = True, False
        return self.identity

    def close(self) -> None:
        """Ask no more."""
        self._is_open = False
        self._forget_references()

    @property
    def is_lost(self) -> bool:
        """True if it was not opened."""
        return not self._is_open

    def _still_referenced(self, channel: str) -> bool:
        """Not known: a screw stands where it was read."""
        return True

    def start_move(self, channel: str, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Note where a screw is to be turned; `moving` asks for it."""
        if not math.isfinite(target_mm):
            raise OutOfRange(f"{self.name}: {target_mm} is not a position")
        if channel not in self._referenced:
            raise NotReferenced(f"{self._channels[channel].axis} was not read yet; home it")
        self._begin(channel, target_mm)

    def start_home(self, channel: str) -> None:
        """Note that a scale is to be read."""
        self._referenced.discard(channel)
        self._begin(channel, None)

    def _begin(self, channel: str, target_mm: float | None) -> None:
        self.latch.check(self.token)
        self._wanted, self.under_way = (channel, target_mm), True

    def moving(self, channel: str) -> bool:
        """Ask, until there is an answer; what was asked for rests then."""
        wanted, self._wanted = self._wanted, None
        if wanted is None or wanted[0] != channel:
            return False
        try:
            reading_mm = self._read(channel, wanted[1])
        except BaseException:
            self._referenced.discard(channel)
            raise
        finally:
            self.under_way = False
        with self._lock:
            self._reading_mm[channel] = reading_mm
            self._referenced.add(channel)
        return False

    def _read(self, channel: str, target_mm: float | None) -> float:
        """Put the question until what is typed is an answer to it."""
        about = self._channels[channel]
        question = ScaleQuestion(about.axis, target_mm, about.limits_mm, about.tolerance_mm)
        if self._ask is None:
            raise StageUsageError(
                f"{about.axis} is moved by hand, and no operator is set; use a terminal, "
                "or set one (Stage.set_operator)"
            )
        while True:
            text = None if self._is_given_up() else self._ask(question, self._is_given_up)
            if text is None:
                raise MotionStopped(f"the position of {about.axis} was not read; home the axis to enter it")
            wrong = question.reading_error(text)
            if wrong is None and (reading_mm := place_mm(text)) is not None:
                return reading_mm
            question = replace(question, wrong=wrong or "")

    def _is_given_up(self) -> bool:
        return self.latch.is_held or self.latch.count != self.token

    def position_mm(self, channel: str) -> float:
        """Last reading."""
        with self._lock:
            if channel not in self._referenced:
                raise NotReferenced(f"{self._channels[channel].axis} was not read yet; home it")
            return self._reading_mm[channel]

    def check_motion(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """A hand has no speed; that of the bench file only says how long a plan will take."""

    def stop(self) -> None:
        """A hand is not stopped from here; the question ends with the stop of the bench."""

    def abandon(self) -> None:
        """Forget a question that was not put yet."""
        self._wanted = None
