"""Two threads that watch a laser while it fires, so that nobody else's waiting can postpone its end.

One **asks** how things stand, every `LOOK_S`, and switches off as soon as an answer is not good; what it calls
may talk to a camera or to stages and take its time. The other one **judges** that: an answer that has not come
for `SILENCE_S` is a lost condition as well. It also ends bursts, and after a stop says off until it reads back
as off.

The second one waits on the laser's clock, so on a `VirtualClock` it is also what lets time pass while a burst
goes on.
"""

import threading
from collections.abc import Callable
from contextlib import suppress

from daq.errors import DaqError
from daq.timing.conditions import Conditions
from daq.timing.errors import LaserStopped
from daq.timing.laser import Laser
from daq.timing.states import EMITS, LaserState
from stages.clock import Clock
from stages.errors import StageError

LOOK_S = 0.01  # between two questions, and between two judgements
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
        self._heard_s = wall.now_s()
        self._ended = threading.Event()
        self._asks = threading.Thread(target=self._go_on_asking, name="conditions", daemon=True)
        self._judges = threading.Thread(target=self._go_on_judging, name="vigil", daemon=True)
        self.error: Exception | None = None  # what ended the burst before its count

    def __enter__(self) -> "Vigil":
        self._heard_s = self._wall.now_s()
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
                found = self._ask()
            except BaseException as error:  # whatever it is, nobody knows how things stand
                self._stop(f"nobody knows how things stand: {error}")
            else:
                if self._ended.is_set():
                    return  # an answer to this burst says nothing of the next one
                self._heard_s = self._wall.now_s()
                try:
                    self._laser.watch(found)
                except LaserStopped as lost:
                    self.error = lost
            self._ended.wait(LOOK_S)

    def _go_on_judging(self) -> None:
        while not self._ended.is_set() and self._laser.state is LaserState.FIRING:
            if self._wall.now_s() - self._heard_s > SILENCE_S:
                self._stop("nobody has said for a while how things stand")
            try:
                self._laser.look()
            except (DaqError, StageError) as error:
                self.error = self.error or error
            self._clock.sleep_s(LOOK_S)
        while not self._laser.confirm_off() and not self._ended.wait(CONFIRM_S):
            pass

    def _stop(self, why: str) -> None:
        with suppress(StageError):
            if self._laser.emits and not self._ended.is_set():
                self._laser.stop(why)
