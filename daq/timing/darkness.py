"""Every way in which a laser goes dark: it is told to, a condition is lost, its burst ends, the bench is left.

Off is said first and believed last: `stop` writes it past every lock and answer, and what was said is in doubt
(UNKNOWN) until it reads back (`confirm_off`), and a fault from then on until a person says `safe`.  How light
begins is in `laser`.
"""

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from daq.timing.box import UNREADABLE, TimingBox
from daq.timing.conditions import Conditions, Rules
from daq.timing.errors import LaserDoubt, LaserStopped, NotNow, TimingUsageError
from daq.timing.pulses import PairExposures, Schedule
from daq.timing.states import EMITS, Event, LaserState, Movers, Standing
from stages.clock import Clock
from stages.errors import StageError

LATE_S = 1.0  # a burst that the box still calls running so long after its end is in doubt
LOOK_S = 0.01  # between two looks of `wait`
CONFIRM_S = 0.2  # between two attempts to read back that everything is off
LEAVING_S = 10.0  # how long whoever leaves goes on with them; a cable that comes loose is mostly put back by then


class Darkness:
    """A laser as far as its light ends; base of `laser.Laser`.

    Parameters
    ----------
    name : str
        What the bench file calls it.
    box : TimingBox
        Connected or not; its latch is the laser's.
    rules : Rules
        What the laboratory asks for.
    clock : Clock
        Clock of warm-up and bursts.
    """

    def __init__(self, name: str, box: TimingBox, rules: Rules, clock: Clock) -> None:
        self.name = name
        self.box = box
        self.rules = rules
        self.schedule: Schedule | None = None  # what the box was loaded with, as it says itself
        self.pairs = 0  # of the burst that goes on, or of the last one
        self._clock = clock
        self._latch = box.latch
        self._lock = threading.RLock()  # one verb at a time
        self._standing = Standing(name, box.latch, clock)
        self._exposures: PairExposures | None = None
        self._rate_hz: float | None = None  # of lamps that run
        self._ends_s = math.inf  # of the burst that goes on

    # ---- how it stands ---------------------------------------------------------------------------

    @property
    def state(self) -> LaserState:
        """What may be asked of it now; WARM becomes READY by the clock."""
        return self._standing.state

    @property
    def emits(self) -> bool:
        """Whether light is meant to leave now; asks no lock, so a signal handler may ask it."""
        return self._standing.emits

    @property
    def why(self) -> str:
        """What happened the last time that it went into doubt."""
        return self._standing.why

    @property
    def challenge(self) -> str:
        """Word that a person has to type before anything can be armed; another one after every `safe`."""
        return self._standing.challenge

    def keep_still(self, movers: Movers) -> None:
        """Let nothing of `movers` move while light may leave, and no light leave while something of it moves."""
        self._standing.keep_still(movers)

    # ---- told to ---------------------------------------------------------------------------------

    def open(self, url: str, baud: int | None = None) -> None:
        """Connect the box and see that everything is off; UNKNOWN if that cannot be read.

        Raises
        ------
        PortError, WrongBox
            It is not there, or must not be used.
        """
        with self._lock:
            self.box.connect(url, baud)
            with suppress(*UNREADABLE):
                self._silence()
                self._standing.enter(Event.OFF)
                self._ask_anew()

    def safe(self) -> None:
        """Switch everything off and read it back; allowed in every state, and the way out of every doubt.

        Raises
        ------
        LaserDoubt, StageError
            It could not be confirmed; the state is UNKNOWN, and off has been said all the same.
        LaserStopped
            A stop came meanwhile.
        """
        with suppress(StageError):
            self.box.drop()  # first, and without the lock that another verb may hold
        with self._lock:
            self._latch.clear()
            count = self._latch.count
            try:
                if self.box.lost:
                    self.box.reconnect()
                self._silence()
            except BaseException as doubt:
                self._standing.doubt(str(doubt))
                raise
            if self._latch.count != count:
                raise LaserStopped(f"{self.name}: {self.why}")
            self._standing.enter(Event.OFF)
            self._ask_anew()

    def stop(self, why: str = "stopped on request") -> None:
        """Switch off now, from any thread; waits for no lock and no answer, and holds until `safe`.

        Raises
        ------
        DeviceLost
            The box could not be told.
        """
        self._latch.stop(why)
        try:
            self.box.drop()
        finally:
            self._standing.doubt(why)

    def confirm_off(self) -> bool:
        """After a stop: try to read back that everything is off; True if nothing is in doubt (any more).

        Whoever watches calls it until it says True. A port that was lost is opened again for it.
        """
        if self.state is not LaserState.UNKNOWN:
            return True
        with self._lock:
            try:
                if self.box.lost:
                    self.box.reconnect()
                self._silence()
            except (StageError, LaserDoubt):
                with suppress(StageError):
                    self.box.drop()
                return False
            with suppress(LaserStopped, NotNow):
                self._standing.enter(Event.STILL)
            return True

    def close(self) -> None:
        """Switch off, read back, and give the port back.

        What was switched on and cannot be reached is tried for `LEAVING_S` more, on a port that is opened again:
        a box that does not count goes on for as long as nobody reaches it, and the watchdog gives a device up
        whose cable has been out.  The watchdog says off again as well if that is not confirmed.

        Raises
        ------
        LaserDoubt
            Something was switched on, and does not read back as off.
        """
        try:
            if not self.box.lost or self.box.may_be_on:
                self._stop_quietly("the program has left the bench")
                end_s, tries = self._clock.now_s() + LEAVING_S, 1
                while not self.confirm_off():
                    if tries >= 3 and not (self.box.may_be_on and self._clock.now_s() < end_s):
                        break
                    tries += 1
                    self._clock.sleep_s(CONFIRM_S)
            if self.box.may_be_on:
                raise LaserDoubt(
                    f"{self.name} may still give light: it does not read back as off ({self.why}); turn its key, "
                    "then see to the cable"
                )
        finally:
            self.box.may_be_on = False  # has been said; nobody waits for it twice
            self.box.close()

    # ---- while it fires --------------------------------------------------------------------------

    def watch(self, conditions: Conditions) -> None:
        """Judge how things stand while it fires; switch off at once if something was lost.

        Raises
        ------
        LaserStopped
            It was switched off.
        """
        if self.state is not LaserState.FIRING:
            return
        if missing := conditions.missing(0, self.rules.clear_mm, fires=True):
            self._stop_quietly(missing)
            raise LaserStopped(f"{self.name} was switched off: {missing}")

    def look(self) -> bool:
        """See whether a burst has ended, ending it where the box does not; True while one goes on.

        Raises
        ------
        LaserDoubt
            The box goes on beyond its count; it was switched off.
        StageError
            It could not be asked; it was switched off as far as that was possible.
        """
        if self.state in EMITS and self._clock.now_s() < self._ends_s:
            return True  # without the lock: whoever watches must not wait for another verb
        with self._lock:
            state = self.state
            if state not in EMITS or self._clock.now_s() < self._ends_s:
                return state in EMITS
            with self._doubting():
                if self.box.counts and self.box.running():
                    if self._clock.now_s() > self._ends_s + LATE_S:
                        raise LaserDoubt(f"{self.name} still gives pulses after its count of {self.pairs}")
                    return True
                if state is LaserState.FIRING:
                    self.box.end()
                    self.box.require_lamps(self._rate_hz is not None)  # a restart ends bursts too
                    self._standing.enter(Event.DONE)
                else:
                    self._silence()
                    self._standing.enter(Event.OFF)
                return False

    def wait(self) -> None:
        """Return when the burst has ended and is confirmed to have.

        Raises
        ------
        LaserStopped
            It was switched off meanwhile.
        """
        while self.look():
            self._clock.sleep_s(LOOK_S)
        if self.state in (LaserState.UNKNOWN, LaserState.FAULT):
            raise LaserStopped(f"{self.name} was switched off: {self.why}")

    # ---- inside ----------------------------------------------------------------------------------

    def _ask_anew(self) -> None:
        self._standing.ask_anew()
        self.schedule = self._exposures = self._rate_hz = None
        self._ends_s = math.inf

    def _silence(self) -> None:
        self.box.silence()
        self.box.may_be_on = False
        if self.box.watchdog is not None:
            self.box.watchdog.rests(self.box.name)

    def _stop_quietly(self, why: str) -> None:
        with suppress(StageError):
            self.stop(why)

    @contextmanager
    def _doubting(self) -> Iterator[None]:
        """Switch off if something comes between; what was refused before anything was sent is nothing."""
        try:
            yield
        except TimingUsageError:
            raise
        except BaseException as error:
            self._stop_quietly(str(error) or type(error).__name__)
            raise
