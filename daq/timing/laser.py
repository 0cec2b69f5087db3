"""A pulsed laser behind a timing unit: the one object through which light is asked for.

    laser.safe()                          everything off, and read back
    laser.warm(10.0)                      lamps at their rate; ready after `warmup_s`
    laser.set(timing, exposures)          dt, with every Q-switch off; read back
    laser.arm(conditions, word)           `word` is what a person has read from `laser.challenge` and typed
    laser.fire(50, look)                  the box counts 50 pairs and stops by itself
    laser.wait()                          until it has; READY again, to be armed for the next chunk
    laser.stop("why")                     off now, from any thread; nothing goes on before `safe()`

The states are in `states`, what must hold in `conditions`. Every verb asks the box what it has, not its own
memory: a box that was restarted, or used by its keys, is found out before it is armed.

A chunk is at most `Rules.chunk_s` long. Where the box counts (`box.counts`), so many pulses leave at most after
whatever becomes of this program. Where it cannot, we end the burst by the clock, and the watchdog after our death;
that is weaker, and a bench file has to say `uncounted: true` to have it.
"""

import math
import secrets
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Protocol

from daq.timing.box import UNREADABLE, TimingBox
from daq.timing.conditions import Conditions, exposure_problem
from daq.timing.errors import LaserDoubt, LaserStopped, NotArmed, NotNow, PulsesRefused, TimingUsageError
from daq.timing.pulses import (
    LAMPS,
    TRIGGER_US,
    LaserHead,
    PairExposures,
    Pulse,
    PulseTiming,
    Schedule,
    schedule_of,
)
from daq.timing.rules import Rules, weak_schedule
from daq.timing.states import BARS_MOTION, EMITS, Event, LaserState, after
from stages.clock import SYSTEM_CLOCK, Clock
from stages.errors import StageError

LATE_S = 1.0  # a burst that the box still calls running so long after its end is in doubt
LOOK_S = 0.01  # between two looks of `wait`
ARMED_S = 10.0  # how long conditions that were stated at arming may be believed

_WAYS = {
    LaserState.UNKNOWN: "nobody knows what it does; only safe() is allowed",
    LaserState.FAULT: "look at it, then safe()",
    LaserState.SAFE: "warm() comes first",
    LaserState.WARM: "its lamps still warm up",
    LaserState.READY: "set() and arm() come first",
    LaserState.ARMED: "fire() or disarm()",
    LaserState.FIRING: "wait() or stop()",
    LaserState.ALIGNING: "end it with safe()",
}


class Movers(Protocol):
    """What can move on the bench; `stages.stage.Stage` is one."""

    def bar_motion(self, why: Callable[[], str | None]) -> None:
        """Ask before anything moves; a sentence as the answer refuses the motion."""
        ...

    def what_moves(self) -> str | None:
        """Say what moves or is about to, as part of a sentence."""
        ...


class Laser:
    """A laser and the box that triggers it; safe for several threads.

    Parameters
    ----------
    name : str
        What the bench file calls it.
    box : TimingBox
        Connected or not; its latch is the laser's.
    head : LaserHead
        What the laser can do.
    rules : Rules
        What the laboratory asks for.
    clock : Clock
        Clock of warm-up and bursts.
    """

    def __init__(
        self, name: str, box: TimingBox, head: LaserHead, rules: Rules, clock: Clock = SYSTEM_CLOCK
    ) -> None:
        self.name = name
        self.box = box
        self.head = head
        self.rules = rules
        self.why = "it has not been looked at yet"  # of the last time that it went into doubt
        self.schedule: Schedule | None = None  # what the box was loaded with, as it says itself
        self.pairs = 0  # of the burst that goes on, or of the last one
        self._clock = clock
        self._latch = box.latch
        self._lock = threading.RLock()  # one verb at a time
        self._state_lock = threading.Lock()
        self._state = LaserState.UNKNOWN
        self._challenge = ""
        self._exposures: PairExposures | None = None
        self._conditions = Conditions()  # as they stood at arming
        self._armed_s = -math.inf
        self._rate_hz: float | None = None  # of lamps that run
        self._heated_s = math.inf
        self._ends_s = math.inf
        self._movers: list[Movers] = []

    # ---- what it is ------------------------------------------------------------------------------

    @property
    def state(self) -> LaserState:
        """What may be asked of it now; WARM becomes READY by the clock."""
        with self._state_lock:
            if self._state is LaserState.WARM and self._clock.now_s() >= self._heated_s:
                self._state = after(self._state, Event.HEATED)
            return self._state

    @property
    def emits(self) -> bool:
        """Whether light is meant to leave now; asks no lock, so a signal handler may ask it."""
        return self._state in EMITS

    @property
    def challenge(self) -> str:
        """Word that a person has to type before anything can be armed; another one after every `safe`.

        It is made up anew each time, so that no plan, script or habit can hold it.
        """
        return self._challenge

    @property
    def dt_us(self) -> float | None:
        """Commanded dt, from the numbers that the box says it has; None if none was set."""
        return None if self.schedule is None else self.schedule.dt_us

    @property
    def warm_in_s(self) -> float:
        """Time until the lamps have run for long enough."""
        return max(0.0, self._heated_s - self._clock.now_s())

    # ---- beside what moves -------------------------------------------------------------------------

    def keep_still(self, movers: Movers) -> None:
        """Let nothing of `movers` move while light may leave, and no light leave while something of it moves."""
        self._movers.append(movers)
        movers.bar_motion(self.objection)

    def objection(self) -> str | None:
        """Say why nothing may move now, as a sentence; asks no lock, so any thread may ask it."""
        state = self._state
        if state is LaserState.UNKNOWN:
            return f"nobody knows whether {self.name} is off; say safe(), or rtpiv laser off"
        if state in BARS_MOTION:
            return f"{self.name} is {state.value}; let it end, or switch it off first"
        return None

    def _what_moves(self) -> str | None:
        return next(filter(None, (movers.what_moves() for movers in self._movers)), None)

    # ---- off -------------------------------------------------------------------------------------

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
                self._enter(Event.OFF)
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
                self._doubt(str(doubt))
                raise
            if self._latch.count != count:
                raise LaserStopped(f"{self.name}: {self.why}")
            self._enter(Event.OFF)
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
            self._doubt(why)

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
                self._enter(Event.STILL)
            return True

    def close(self) -> None:
        """Switch off, read back, and give the port back; the watchdog says off again if that is not confirmed."""
        try:
            if not self.box.lost:
                self.stop("the program has left the bench")
                for _ in range(3):
                    if self.confirm_off():
                        break
        finally:
            self.box.close()

    # ---- on --------------------------------------------------------------------------------------

    def warm(self, rate_hz: float | None = None) -> None:
        """Let the lamps run, Q-switches off; READY after `warmup_s`. Without lamps it is READY at once.

        Parameters
        ----------
        rate_hz : float, optional
            Of the lamps, and so of the pairs; the laser's only one, or its largest, by default.

        Raises
        ------
        NotNow, PulsesRefused, LaserDoubt, StageError
            It is not SAFE, cannot run at this rate, or the box does not do it.
        """
        with self._lock, self._doubting():
            self._require(LaserState.SAFE)
            rate_hz = rate_hz or self.head.lamp_rate_hz or self.head.max_rate_hz
            self._require_rate(rate_hz)
            self.box.token = self._begin()
            if self.head.lamp_to_q_switch_us is None:
                self._heated_s, self._rate_hz = self._clock.now_s(), None
                self._enter(Event.WARM_UP)
                return
            lamps = {role: Pulse(0.0, TRIGGER_US) for role in LAMPS if role in self.box.wiring}
            self.box.load(Schedule(1e6 / rate_hz, lamps))
            self._heated_s, self._rate_hz = math.inf, rate_hz
            self._enter(Event.WARM_UP)
            self.box.start_lamps()
            self._heated_s = self._clock.now_s() + self.rules.warmup_s

    def set(self, timing: PulseTiming, exposures: PairExposures) -> Schedule:
        """Load dt and exposures while no Q-switch is on; return what the box says it has.

        Raises
        ------
        NotNow, PulsesRefused
            It is not READY, or the numbers do not go together; nothing was sent.
        LaserDoubt, StageError
            The box does not take them.
        """
        schedule = schedule_of(timing, self.head, exposures)
        with self._lock, self._doubting():
            self._require(LaserState.READY)
            if self._rate_hz is not None and not math.isclose(timing.rate_hz, self._rate_hz, rel_tol=1e-6):
                raise PulsesRefused(
                    f"the lamps run at {self._rate_hz:g} Hz, and changing that bends the beam; {timing.rate_hz:g} "
                    "pairs/s need safe() and another warm-up"
                )
            self.schedule = None
            self._exposures = exposures
            self.box.token = self._begin()
            self.schedule = self.box.load(schedule)
            if not math.isclose(self.schedule.dt_us, timing.dt_us, abs_tol=1.01 * self.box.least_step_us):
                raise LaserDoubt(f"{self.name} was set to dt = {timing.dt_us} us and says {self.schedule.dt_us}")
            return self.schedule

    def arm(self, conditions: Conditions, word: str) -> None:
        """Make ready to fire, for one chunk.

        Parameters
        ----------
        conditions : Conditions
            How things stand now.
        word : str
            `challenge`, as a person has typed it for this run.

        Raises
        ------
        NotNow, NotArmed
            It is not READY, or a condition is not met; nothing was sent.
        LaserDoubt, StageError
            The box does not hold what it was loaded with.
        """
        with self._lock, self._doubting():
            self._require(LaserState.READY)
            schedule, exposures = self.schedule, self._exposures
            if schedule is None or exposures is None:
                raise NotNow(f"{self.name} has no dt yet; set() comes first")
            self._require_word(word)
            missing = conditions.missing(1, self.rules.clear_mm)
            missing = missing or exposure_problem(schedule, exposures, self.rules.dark_us)
            if missing is not None:
                raise NotArmed(f"{self.name} is not armed: {missing}")
            if not (self.box.counts or self.rules.uncounted):
                raise NotArmed(
                    f"{self.name} is not armed: its box cannot count pulses, so a crash is ended by the watchdog "
                    "alone; say `uncounted: true` in the bench file if that is enough (docs/laser.md)"
                )
            self.box.token = self._begin()
            self.box.confirm(schedule, lamps=self._rate_hz is not None)
            self._conditions, self._armed_s = conditions, self._clock.now_s()
            self._enter(Event.ARM)
            if moves := self._what_moves():  # asked when nothing can begin to move any more
                self._enter(Event.DISARM)
                raise NotArmed(f"{self.name} is not armed: {moves}")

    def disarm(self) -> None:
        """Go back to READY."""
        with self._lock:
            self._require(LaserState.ARMED)
            self._enter(Event.DISARM)

    def fire(self, pairs: int) -> None:
        """Give that many pairs of pulses; returns when they have begun.

        Somebody must call `watch` with the conditions as they stand until they have ended: `vigil.Vigil` does.

        Raises
        ------
        NotNow, TimingUsageError, NotArmed
            It is not ARMED, the chunk is too long, or the disk has no room for it; nothing was sent.
        LaserStopped
            A stop came.
        LaserDoubt, StageError
            The box did not take it; it was switched off.
        """
        with self._lock, self._doubting():
            self._require(LaserState.ARMED)
            assert self.schedule is not None
            most = self.most_pairs
            if not 1 <= pairs <= most:
                raise TimingUsageError(
                    f"{pairs} pairs in one chunk: 1 to {most} fit into {self.rules.chunk_s:g} s"
                )
            if (old_s := self._clock.now_s() - self._armed_s) > ARMED_S:
                raise NotArmed(f"{self.name} was armed {old_s:.0f} s ago; state the conditions anew (disarm, arm)")
            if missing := self._conditions.missing(pairs, self.rules.clear_mm):
                raise NotArmed(f"{self.name} does not fire: {missing}")
            self.box.token = self._begin()
            self.pairs = pairs
            self._ends_s = math.inf
            self._enter(Event.FIRE)
            begun_s = self._clock.now_s()
            self.box.begin(pairs)
            if self.box.counts:  # it counts from when the last output was switched on
                begun_s = self._clock.now_s()
            self._ends_s = begun_s + self.camera_triggers / self.schedule.rate_hz

    @property
    def camera_triggers(self) -> int:
        """Pairs of frames that the camera is triggered for in a burst of `pairs`; those beyond are dark."""
        return self.box.camera_triggers(self.pairs)

    @property
    def most_pairs(self) -> int:
        """Largest chunk at the rate that was set; 0 if none was."""
        return 0 if self.schedule is None else int(self.rules.chunk_s * self.schedule.rate_hz + 1e-9)

    def align(self, word: str, rate_hz: float, for_s: float) -> None:
        """Give weak pulses to see the sheet by, counted by the box; entered from SAFE, left through `safe`.

        Parameters
        ----------
        word : str
            `challenge`, as a person has typed it.
        rate_hz, for_s : float
            Within `AlignRules`.

        Raises
        ------
        NotNow, NotArmed, PulsesRefused
            It is not SAFE, the bench has no such mode, or a limit is broken; nothing was sent.
        """
        with self._lock, self._doubting():
            self._require(LaserState.SAFE)
            rules = self.rules.align
            if rules is None:
                raise NotNow(f"{self.name} has no alignment mode; say `align` in the bench file")
            self._require_word(word)
            if not (self.box.counts or self.rules.uncounted):
                raise NotArmed(f"{self.name}: its box cannot count pulses; see `uncounted` in docs/laser.md")
            if not (0.0 < rate_hz <= rules.max_rate_hz and 0.0 < for_s <= rules.max_s):
                raise PulsesRefused(
                    f"alignment at {rate_hz:g} Hz for {for_s:g} s: at most {rules.max_rate_hz:g} Hz and "
                    f"{rules.max_s:g} s"
                )
            self._require_rate(rate_hz)
            if moves := self._what_moves():
                raise NotArmed(f"{self.name} gives no light: {moves}")
            self.box.token = self._begin()
            schedule = weak_schedule(rules, self.head, self.box.wiring, rate_hz)
            self.schedule = None
            self.box.load(schedule)
            self.pairs = max(1, int(rate_hz * for_s))
            self._ends_s = math.inf
            self._enter(Event.ALIGN)
            if moves := self._what_moves():
                raise LaserStopped(f"{self.name} gives no light: {moves}")
            if self.head.lamp_to_q_switch_us is not None:
                self.box.start_lamps()
            self.box.begin(self.pairs, camera=False)
            self._ends_s = self._clock.now_s() + self.pairs / rate_hz

    # ---- while it fires ----------------------------------------------------------------------------

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
                    self._enter(Event.DONE)
                else:
                    self._silence()
                    self._enter(Event.OFF)
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

    # ---- inside ------------------------------------------------------------------------------------

    def _begin(self) -> int:
        if self._latch.held:
            raise LaserStopped(f"{self.name} is held: {self.why}; look at it, then safe()")
        return self._latch.count

    def _require(self, wanted: LaserState) -> None:
        if (state := self.state) is not wanted:
            raise NotNow(f"{self.name} is {state.value}, not {wanted.value}: {_WAYS[state]} ({self.why})")

    def _require_word(self, word: str) -> None:
        if not self._challenge or not secrets.compare_digest(word.strip().encode(), self._challenge.encode()):
            raise NotArmed(f"{self.name} is not armed: type the word that it asks for ({self._challenge})")

    def _require_rate(self, rate_hz: float) -> None:
        if not (math.isfinite(rate_hz) and 0.0 < rate_hz <= self.head.max_rate_hz):
            raise PulsesRefused(f"{rate_hz:g} pulses/s are not within the laser's 0 to {self.head.max_rate_hz:g}")
        lamp_hz = self.head.lamp_rate_hz
        if lamp_hz is not None and not math.isclose(rate_hz, lamp_hz, rel_tol=1e-6):
            raise PulsesRefused(f"the lamps run at {lamp_hz:g} Hz and at no other rate ({rate_hz:g})")

    def _ask_anew(self) -> None:
        self._challenge = str(1000 + secrets.randbelow(9000))
        self.schedule = self._exposures = self._rate_hz = None
        self._heated_s = self._ends_s = math.inf

    def _silence(self) -> None:
        self.box.silence()
        if self.box.watchdog is not None:
            self.box.watchdog.rests(self.box.name)

    def _stop_quietly(self, why: str) -> None:
        with suppress(StageError):
            self.stop(why)

    def _doubt(self, why: str) -> None:
        with self._state_lock:
            if self._state is not LaserState.UNKNOWN:
                self.why = why
            self._state = after(self._state, Event.BAD)
            self._challenge = ""

    def _enter(self, event: Event) -> None:
        """Go on by the table; what a stop has made of the state meanwhile wins."""
        with self._state_lock:
            try:
                self._state = after(self._state, event)
            except ValueError as error:
                if self._latch.held:
                    raise LaserStopped(f"{self.name} was switched off: {self.why}") from None
                raise NotNow(f"{self.name}: {error}") from None

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
