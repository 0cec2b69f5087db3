"""Shutdown of a laser: off is sent first and believed last.

`send_off` writes off past every lock and answer, from any thread.  From then on the laser is UNKNOWN until every
output reads back as off (`confirm`), and a fault from then on until a person has looked at it (`make_safe`).
`off_on_error` sends it whenever a verb that has begun to talk with the box does not come to its end.

Leaving the bench sends it too (`leave`), and ends only when it reads back, or when nothing can be done.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from daq.timing.box import TimingBox
from daq.timing.errors import LaserDoubt, LaserStopped, NotNow, TimingUsageError
from daq.timing.states import Event, LaserState, LaserStateMachine
from stages.clock import Clock
from stages.errors import CommandRejected, StageError

CONFIRM_INTERVAL_S = 0.2  # between two attempts to read back that everything is off
LEAVING_S = 10.0  # time for these attempts when the bench is left; a loose cable is mostly put back by then


class LaserShutdown:
    """The end of one laser's light; safe for several threads.

    Parameters
    ----------
    box : TimingBox
        What gives the pulses.
    states : LaserStateMachine
        How the laser stands.
    lock : RLock
        Held while a verb talks with the box; one at a time.
    clock : Clock
        Clock of its patience.
    """

    def __init__(self, box: TimingBox, states: LaserStateMachine, lock: threading.RLock, clock: Clock) -> None:
        self._box, self._states, self._lock, self._clock = box, states, lock, clock

    def send_off(self, why: str) -> None:
        """Send off now, from any thread; waits for no lock and no answer, and holds until `make_safe`.

        Raises
        ------
        DeviceLost
            The box could not be reached.
        """
        self._box.latch.stop(why)
        try:
            self._box.drop()
        finally:
            self._states.mark_unknown(why)

    def try_send_off(self, why: str) -> None:
        """Send it; a box that cannot be reached is no error."""
        with suppress(StageError):
            self.send_off(why)

    def read_back(self) -> None:
        """Write everything off and read it back.

        Raises
        ------
        LaserDoubt, StageError
            Something is on, or could not be read.
        """
        self._box.silence()
        self._box.may_be_on = False
        if self._box.watchdog is not None:
            self._box.watchdog.rests(self._box.name)

    def confirm(self) -> bool:
        """After a stop: try to read back that everything is off; True if it is not UNKNOWN (any more)."""
        if self._states.state is not LaserState.UNKNOWN:
            return True
        with self._lock:
            try:
                self._reach()
                self.read_back()
            except (StageError, LaserDoubt):
                with suppress(StageError):
                    self._box.drop()
                return False
            with suppress(LaserStopped, NotNow):
                self._states.enter(Event.STILL)
            return True

    def make_safe(self) -> None:
        """Off, read back, and nothing holds any more: a person has looked at it.

        Raises
        ------
        LaserDoubt, StageError
            It could not be confirmed; the state is UNKNOWN, and off has been said all the same.
        LaserStopped
            A stop came meanwhile.
        """
        with self._lock:
            latch = self._box.latch
            latch.clear()
            count = latch.count  # a stop that comes while outputs are read back changes it
            try:
                self._reach()
                self.read_back()
            except BaseException as error:
                self._states.mark_unknown(str(error))
                raise
            if latch.count != count:
                raise LaserStopped(f"{self._states.name}: {self._states.why}")
            self._states.enter(Event.OFF)

    def leave(self) -> None:
        """Say off, read it back, and give the port back.

        What was switched on and cannot be reached is tried for `LEAVING_S` more, on a port that is opened again:
        a box that does not count goes on for as long as it is not reached, and the watchdog gives a device up
        whose cable has been out.  The watchdog says off again as well if that is not confirmed.

        Raises
        ------
        LaserDoubt
            Something was switched on, and does not read back as off.
        """
        box = self._box
        try:
            if not box.is_lost or box.may_be_on:
                self.try_send_off("the program has left the bench")
                end_s, tries = self._clock.now_s() + LEAVING_S, 1
                while not self.confirm():
                    if tries >= 3 and not (box.may_be_on and self._clock.now_s() < end_s):
                        break
                    tries += 1
                    self._clock.sleep_s(CONFIRM_INTERVAL_S)
            if box.may_be_on:
                raise LaserDoubt(
                    f"{self._states.name} may still give light: it does not read back as off "
                    f"({self._states.why}); turn its key, then see to the cable"
                )
        finally:
            box.may_be_on = False  # was reported; it is not waited for twice
            box.close()

    @contextmanager
    def off_on_error(self) -> Iterator[None]:
        """Say off if something comes between; what was refused before anything was sent is nothing."""
        try:
            yield
        except TimingUsageError:
            raise
        except BaseException as error:
            was_stopped = self._box.latch.is_held
            self.try_send_off(str(error) or type(error).__name__)
            if isinstance(error, CommandRejected):  # it may refuse off as well: said until it reads back, at once
                self.confirm()
            if was_stopped and isinstance(error, LaserDoubt):  # the box has only shown what the stop did
                raise LaserStopped(f"{self._states.name} was switched off: {self._states.why}") from error
            raise

    def _reach(self) -> None:
        """Open a port again that was lost."""
        if self._box.is_lost:
            self._box.reconnect()
