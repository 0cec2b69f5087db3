"""Two threads that watch a laser while it fires, so that no other wait can postpone its end.

One **asks** how things stand, every `WATCH_POLL_S`, and switches off as soon as an answer is not good; what it
calls may talk to a camera or to stages and take its time. The other one **judges** that: an answer that has not
come for `SILENCE_S` is a lost condition as well. It also ends bursts, and after a stop says off until it reads
back as off.

**A silent box or a busy computer?** On a computer that has too much to do both threads are late, and a stage that
answers in milliseconds seems to say nothing for a second.  What tells the two apart is the judge's own waking: if
there is no answer while the judge wakes every `WATCH_POLL_S`, a device is silent; if the judge is late too, it
could not have asked.  So of the time between two looks no more than `ON_TIME_S` counts as silence.  That has an
end: who could not ask for `BLIND_S`, for whatever reason, does not watch, and the light goes off.  A computer that
does not even wake to see that is the one that hangs, of which the box's own count is the end (ADR 14).

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
from daq.timing.shutdown import CONFIRM_INTERVAL_S
from daq.timing.states import EMITS, LaserState
from stages.clock import Clock
from stages.errors import StageError

WATCH_POLL_S = 0.01  # between two questions, and between two judgements
SILENCE_S = 1.0  # without a new answer, of the wall's time in which the judge was on time
# between two looks of a judge who is on time; what is beyond is the computer's, not a device's
ON_TIME_S = 0.02
BLIND_S = 5.0  # of the wall's clock, without a new answer, however busy the computer was


class LaserSupervisor:
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
        self._heard_s = wall.now_s()  # written by the one who asks
        self._looked_s = self._knew_s = self._heard_s  # last look of the judge, and what he had heard by then
        self._silence_s = 0.0  # since then, as far as the judge was on time
        self._ended = threading.Event()
        self._asks = threading.Thread(target=self._go_on_asking, name="conditions", daemon=True)
        self._judges = threading.Thread(target=self._go_on_judging, name="supervisor", daemon=True)
        self.error: Exception | None = None  # what ended the burst before its count

    def __enter__(self) -> "LaserSupervisor":
        self._heard_s = self._looked_s = self._wall.now_s()
        self._asks.start()
        self._judges.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._laser.state in EMITS:  # the watch has ended
            with suppress(StageError):
                self._laser.stop("the program has left the chunk")
        self._ended.set()
        self._judges.join()

    def wait(self) -> None:
        """Return when the burst has ended; LaserStopped if it was switched off."""
        while self._laser.state is LaserState.FIRING and self._judges.is_alive():
            self._clock.sleep_s(WATCH_POLL_S)
        if self.error is not None:
            raise self.error
        self._laser.wait()

    def ask(self) -> None:
        """Ask once how things stand, and switch off if a condition is not met or not known."""
        try:
            found = self._ask()
        except BaseException as error:  # whatever it is, the conditions are not known
            self._stop(f"the state of camera and stages is unknown: {error}")
            return
        if self._ended.is_set():
            return  # an answer to this burst says nothing of the next one
        self._heard_s = self._wall.now_s()
        try:
            self._laser.watch(found)
        except LaserStopped as lost:
            self.error = lost

    def judge(self) -> None:
        """Check once that the conditions are still known, and whether the burst has ended."""
        if blind := self._blindness():
            self._stop(blind)
        try:
            self._laser.look()
        except (DaqError, StageError) as error:
            self.error = self.error or error

    def _go_on_asking(self) -> None:
        while not self._ended.is_set():
            self.ask()
            self._ended.wait(WATCH_POLL_S)

    def _go_on_judging(self) -> None:
        while not self._ended.is_set() and self._laser.state is LaserState.FIRING:
            self.judge()
            self._clock.sleep_s(WATCH_POLL_S)
        while not self._laser.confirm_off() and not self._ended.wait(CONFIRM_INTERVAL_S):
            pass

    def _blindness(self) -> str | None:
        """Return why the conditions are not known, now that the judge looks again; None if they are."""
        now_s, heard_s = self._wall.now_s(), self._heard_s
        if heard_s != self._knew_s:
            self._knew_s, self._silence_s = heard_s, 0.0
        self._silence_s += min(now_s - self._looked_s, ON_TIME_S)
        self._looked_s = now_s
        if self._silence_s > SILENCE_S:
            return f"no state was reported for {SILENCE_S:g} s; camera or stages do not answer"
        if (blind_s := now_s - heard_s) > BLIND_S:
            return (
                f"this computer was too busy for {blind_s:.1f} s to ask how things stand; end other programs, "
                "or ask for less at once (no live correction, a lower rate)"
            )
        return None

    def _stop(self, why: str) -> None:
        with suppress(StageError):
            if self._laser.emits and not self._ended.is_set():
                self._laser.stop(why)
