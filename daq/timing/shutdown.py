"""Shutdown of a laser: off is sent first and believed last.

`stop` writes off past every lock and answer, from any thread.  From then on the laser is UNKNOWN until every
output reads back as off (`confirm_off`), and a fault from then on until a person has looked at it (`_make_safe`).
`_off_on_error` sends it whenever a verb that has begun to talk with the box does not come to its end.

Leaving the bench sends it too (`close`), and ends only when it reads back, or when nothing can be done.
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


class LaserShutdown(LaserStateMachine):
    """The states of one laser and every end of its light; safe for several threads.

    Parameters
    ----------
    name : str
        The laser's, for messages.
    box : TimingBox
        What gives the pulses; its latch is the laser's.
    clock : Clock
        Clock of its warm-up and of its patience.
    """

    def __init__(self, name: str, box: TimingBox, clock: Clock) -> None:
        super().__init__(name, box.latch, clock)
        self.box = box
        self._lock = threading.RLock()  # held while a verb talks with the box; one at a time

    def stop(self, why: str = "stopped on request") -> None:
        """Switch off now, from any thread; waits for no lock and no answer, and holds until `safe`.

        Raises
        ------
        DeviceLost
            The box could not be reached.
        """
        # The latch before the bytes: what another thread is about to switch on finds the gate shut.
        self._latch.stop(why)
        try:
            self.box.drop()
        finally:
            self._mark_unknown(why)

    def _try_stop(self, why: str) -> None:
        """Switch off; a box that cannot be reached is no error."""
        with suppress(StageError):
            self.stop(why)

    def _read_back(self) -> None:
        """Write everything off and read it back.

        Raises
        ------
        LaserDoubt, StageError
            Something is on, or could not be read.
        """
        self.box.silence()
        self.box.may_be_on = False
        if self.box.watchdog is not None:
            self.box.watchdog.rests(self.box.name)

    def confirm_off(self) -> bool:
        """After a stop: try to read back that everything is off; True if the laser is not UNKNOWN (any more).

        The supervisor calls it until it returns True. A port that was lost is opened again for it.
        """
        if self.state is not LaserState.UNKNOWN:
            return True
        with self._lock:
            try:
                self._reach()
                self._read_back()
            except (StageError, LaserDoubt):
                with suppress(StageError):
                    self.box.drop()
                return False
            with suppress(LaserStopped, NotNow):
                self._enter(Event.STILL)
            return True

    def _make_safe(self) -> None:
        """Off, read back, and nothing holds any more: a person has looked at it.

        Raises
        ------
        LaserDoubt, StageError
            It could not be confirmed; the state is UNKNOWN, and off has been said all the same.
        LaserStopped
            A stop came meanwhile.
        """
        with self._lock:
            self._latch.clear()
            count = self._latch.count  # a stop that comes while outputs are read back changes it
            try:
                self._reach()
                self._read_back()
            except BaseException as error:
                self._mark_unknown(str(error))
                raise
            if self._latch.count != count:
                raise LaserStopped(f"{self.name}: {self.why}")
            self._enter(Event.OFF)

    def close(self) -> None:
        """Switch off, read back, and give the port back.

        What was switched on and cannot be reached is tried for `LEAVING_S` more, on a port that is opened again:
        a box that does not count goes on for as long as it is not reached, and the watchdog gives a device up
        whose cable has been out.  The watchdog says off again as well if that is not confirmed.

        Raises
        ------
        LaserDoubt
            Something was switched on, and does not read back as off.
        """
        box = self.box
        try:
            if not box.is_lost or box.may_be_on:
                self._try_stop("the program has left the bench")
                end_s, tries = self._clock.now_s() + LEAVING_S, 1
                while not self.confirm_off():
                    if tries >= 3 and not (box.may_be_on and self._clock.now_s() < end_s):
                        break
                    tries += 1
                    self._clock.sleep_s(CONFIRM_INTERVAL_S)
            if box.may_be_on:
                raise LaserDoubt(
                    f"{self.name} may still give light: it does not read back as off "
                    f"({self.why}); turn its key off, then check the cable"
                )
        finally:
            box.may_be_on = False  # was reported; it is not waited for twice
            box.close()

    @contextmanager
    def _off_on_error(self) -> Iterator[None]:
        """Say off if something comes between; what was refused before anything was sent is nothing."""
        try:
            yield
        except TimingUsageError:
            raise
        except BaseException as error:
            was_stopped = self._latch.is_held
            self._try_stop(str(error) or type(error).__name__)
            if isinstance(error, CommandRejected):  # it may refuse off as well: said until it reads back, at once
                self.confirm_off()
            if was_stopped and isinstance(error, LaserDoubt):  # the box has only shown what the stop did
                raise LaserStopped(f"{self.name} was switched off: {self.why}") from error
            raise

    def _reach(self) -> None:
        """Open a port again that was lost."""
        if self.box.is_lost:
            self.box.reconnect()
