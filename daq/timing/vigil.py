"""Two threads that watch a laser while it fires, so that nobody else's waiting can postpone its end.

One **asks** how things stand, again and again; what it calls may talk to a camera or to stages and take its
time. The other **judges** the last answer every `LOOK_S`, and takes silence for a lost condition: an answer
older than `SILENCE_S` switches off as well. It also ends bursts, and after a stop says off until it reads back
as off.

The judge waits on the laser's clock, so on a `VirtualClock` it is also what lets time pass while a burst goes on.
"""

import threading
from collections.abc import Callable
from contextlib import suppress

from daq.errors import DaqError
from daq.timing.conditions import Conditions
from daq.timing.laser import Laser
from daq.timing.states import EMITS, LaserState
from stages.clock import Clock
from stages.errors import StageError

LOOK_S = 0.01  # between two judgements
SILENCE_S = 1.0  # of the wall's clock, without a new answer
CONFIRM_S = 0.2  # between two attempts to read back that everything is off


class Vigil:
    """The watch over one chunk: enter it after `fire`, leave it when the burst has ended.

    Parameters
    ----------
    laser : Laser
        FIRING, or about to.
    ask : callable
        Returns the conditions as they stand; called from a thread of its own.
    clock : Clock
        The laser's.
    wall : Clock
        What silence is measured by.
    """

    def __init__(self, laser: Laser, ask: Callable[[], Conditions], clock: Clock, wall: Clock) -> None:
        self._laser, self._ask, self._clock, self._wall = laser, ask, clock, wall
        self._last: tuple[float, Conditions | BaseException] | None = None
        self._ended = threading.Event()
        self._asks = threading.Thread(target=self._go_on_asking, name="conditions", daemon=True)
        self._judges = threading.Thread(target=self._go_on_judging, name="vigil", daemon=True)
        self.error: Exception | None = None  # what ended the burst before its count

    def __enter__(self) -> "Vigil":
        self._begun_s = self._wall.now_s()
        self._asks.start()
        self._judges.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._laser.state in EMITS:  # nobody watches any more
            with suppress(StageError):
                self._laser.stop("the program has left the chunk")
        self._ended.set()
        self._judges.join()

    def wait(self) -> None:
        """Return when the burst has ended; LaserStopped if it was switched off."""
        while self._laser.state is LaserState.FIRING and self._judges.is_alive():
            self._clock.sleep_s(LOOK_S)
        if self.error is not None:
            raise self.error
        self._laser.wait()

    def _go_on_asking(self) -> None:
        while not self._ended.is_set():
            try:
                found: Conditions | BaseException = self._ask()
            except BaseException as error:  # whatever it is, nobody knows how things stand
                found = error
            self._last = (self._wall.now_s(), found)
            self._ended.wait(LOOK_S)

    def _go_on_judging(self) -> None:
        while not self._ended.is_set() and self._laser.state is LaserState.FIRING:
            try:
                self._judge()
                self._laser.look()
            except (DaqError, StageError) as error:
                self.error = error
            self._clock.sleep_s(LOOK_S)
        while not self._laser.confirm_off() and not self._ended.wait(CONFIRM_S):
            pass

    def _judge(self) -> None:
        if self._last is None:
            since_s, found = self._begun_s, None
        else:
            since_s, found = self._last
        if isinstance(found, BaseException):
            self._laser.stop(f"nobody knows how things stand: {found}")
        elif self._wall.now_s() - since_s > SILENCE_S:
            self._laser.stop("nobody has said for a second how things stand")
        elif found is not None:
            self._laser.watch(found)
