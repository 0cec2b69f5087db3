"""A pulsed laser behind a timing unit: the one object through which light is asked for.

    laser.safe()                          everything off, and read back
    laser.warm(10.0)                      lamps at their rate; ready after `warmup_s`
    laser.set(timing, exposures)          dt, with every Q-switch off; read back
    laser.arm(conditions, code)           `code` is what a person has read from `laser.challenge` and typed
    laser.renew(conditions)               the same again, now that nothing can begin to move
    laser.fire(50)                        the box counts 50 pairs and stops by itself
    laser.wait()                          until it has; READY again, to be armed for the next chunk
    laser.stop("why")                     off now, from any thread; nothing goes on before `safe()`

The states are in `states`, what must hold in `conditions`. Every verb asks the box what it has, not its own
memory: a box that was restarted, or used by its keys, is found out before it is armed.

Every verb goes in one order: require a state, refuse what breaks a limit (nothing was sent so far), take a token
of the latch, load the box, enter the next state, switch on. The state comes before the bytes that switch on, and
these pass the latch's gate with the token: a stop at any moment either makes the token void, or finds a state in
which there is light to end.

Light ends in many ways: on request, a condition is lost, the burst ends, the bench is left (`shutdown`).
After a stop the laser is UNKNOWN until it reads back as off, and a fault from then on until `safe`.

A chunk is at most `Rules.chunk_s` long. Where the box counts (`box.counts`), so many pulses leave at most after
whatever becomes of this program. Where it cannot, we end the burst by the clock, and the watchdog after our death;
that is weaker, and a bench file has to say `uncounted: true` to have it.
"""

import math
from contextlib import suppress

from daq.timing.box import UNREADABLE, TimingBox
from daq.timing.conditions import Conditions, Rules, exposure_problem
from daq.timing.errors import LaserDoubt, LaserStopped, NotArmed, NotNow, PulsesRefused, TimingUsageError
from daq.timing.in_use import OffRequest
from daq.timing.low_energy import low_energy_burst
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
from daq.timing.shutdown import LaserShutdown
from daq.timing.states import EMITS, Event, LaserState
from daq.timing.switches import OFF, Switches
from stages.clock import SYSTEM_CLOCK, Clock
from stages.errors import StageError

# by which the first tick of a box that counts may come after the answer to the word that starts it
SPARE_S = 0.05
BURST_POLL_S = 0.01  # between two looks of `wait`
ARMED_S = 10.0  # how long conditions that were stated at arming may be believed


class Laser(LaserShutdown):
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
        super().__init__(name, box, clock)
        self.head = head
        self.rules = rules
        self.schedule: Schedule | None = None  # what the box was loaded with, as it says itself
        self.pairs = 0  # of the burst that goes on, or of the last one
        self._exposures: PairExposures | None = None
        self._rate_hz: float | None = None  # of lamps that run
        self._ends_s = math.inf  # of the burst that goes on
        self.switches = Switches({})  # of door, shutter, key; set where they are opened
        self.off_request = OffRequest(None)  # by another process; set with the switches
        self._conditions = Conditions()  # as they stood at arming
        self._armed_s = -math.inf

    # ---- how it stands ---------------------------------------------------------------------------

    @property
    def dt_us(self) -> float | None:
        """Commanded dt, from the numbers that the box says it has; None if none was set."""
        return None if self.schedule is None else self.schedule.dt_us

    @property
    def warm_in_s(self) -> float:
        """Time until the lamps have run for long enough."""
        return max(0.0, self.heated_s - self._clock.now_s())

    @property
    def most_pairs(self) -> int:
        """Largest chunk at the rate that was set; 0 if none was."""
        return 0 if self.schedule is None else int(self.rules.chunk_s * self.schedule.rate_hz + 1e-9)

    # ---- light begins ----------------------------------------------------------------------------------

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
                self._read_back()
                self._enter(Event.OFF)
                self._ask_anew()

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
        with self._lock, self._off_on_error():
            self._require(LaserState.SAFE)
            if why := self.switches.objection():
                raise NotArmed(f"{self.name} does not warm up: {why}")
            rate_hz = rate_hz or self.head.lamp_rate_hz or self.head.max_rate_hz
            self.head.require_rate(rate_hz)
            self.box.token = self._token()
            if self.head.lamp_to_q_switch_us is None:
                self.heated_s, self._rate_hz = self._clock.now_s(), None
                self._enter(Event.WARM_UP)
                self.box.stand_by()
                return
            lamps = {role: Pulse(0.0, TRIGGER_US) for role in LAMPS if role in self.box.wiring}
            self.box.load(Schedule(1e6 / rate_hz, lamps))
            self.heated_s, self._rate_hz = math.inf, rate_hz
            self._enter(Event.WARM_UP)  # before the lamps run: a stop in between finds them to end
            self.box.start_lamps()
            self.heated_s = self._clock.now_s() + self.rules.warmup_s

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
        with self._lock, self._off_on_error():
            self._require(LaserState.READY)
            if self._rate_hz is not None and not math.isclose(timing.rate_hz, self._rate_hz, rel_tol=1e-6):
                raise PulsesRefused(
                    f"the lamps run at {self._rate_hz:g} Hz, and changing that bends the beam; {timing.rate_hz:g} "
                    "pairs/s need safe() and another warm-up"
                )
            self.schedule = None
            self._exposures = exposures
            self.box.token = self._token()
            self.schedule = self.box.load(schedule)
            if not math.isclose(self.schedule.dt_us, timing.dt_us, abs_tol=1.01 * self.box.least_step_us):
                raise LaserDoubt(f"{self.name} was set to dt = {timing.dt_us} us and reads {self.schedule.dt_us}")
            return self.schedule

    def arm(self, conditions: Conditions, code: str) -> None:
        """Make ready to fire, for one chunk.

        Parameters
        ----------
        conditions : Conditions
            How things stand now.
        code : str
            `challenge`, as a person has typed it for this run.

        Raises
        ------
        NotNow, NotArmed
            It is not READY, or a condition is not met; nothing was sent.
        LaserDoubt, StageError
            The box does not hold what it was loaded with.
        """
        with self._lock, self._off_on_error():
            self._require(LaserState.READY)
            schedule, exposures = self.schedule, self._exposures
            if schedule is None or exposures is None:
                raise NotNow(f"{self.name} has no dt yet; call set() first")
            self._require_code(code)
            missing = conditions.missing(1, self.rules.clear_mm) or self.switches.objection()
            missing = missing or exposure_problem(schedule, exposures, self.rules.dark_us)
            if missing is not None:
                raise NotArmed(f"{self.name} is not armed: {missing}")
            self._require_count()
            self.box.token = self._token()
            self.box.confirm(schedule, lamps=self._rate_hz is not None)
            self._conditions, self._armed_s = conditions, self._clock.now_s()
            self._enter(Event.ARM)
            if moves := self.what_moves():  # asked when nothing can begin to move any more
                self._enter(Event.DISARM)
                raise NotArmed(f"{self.name} is not armed: {moves}")

    def renew(self, conditions: Conditions) -> None:
        """State how things stand now that nothing can begin to move: between `arm` and `fire`.

        What was stated for `arm` was true before the box had been asked for all that it holds, which takes a
        second or more; until then a motion may have begun and ended.

        Raises
        ------
        NotNow, NotArmed
            It is not ARMED, or a condition is not met (any more); nothing was sent.
        """
        with self._lock:
            self._require(LaserState.ARMED)
            if missing := conditions.missing(1, self.rules.clear_mm) or self.switches.objection():
                self._enter(Event.DISARM)
                raise NotArmed(f"{self.name} is not armed: {missing}")
            self._conditions, self._armed_s = conditions, self._clock.now_s()

    def disarm(self) -> None:
        """Go back to READY."""
        with self._lock:
            self._require(LaserState.ARMED)
            self._enter(Event.DISARM)

    def fire(self, pairs: int) -> None:
        """Give that many pairs of pulses; returns when they have begun.

        The caller must call `watch` with the conditions as they stand until they have ended:
        `supervisor.LaserSupervisor` does.

        Raises
        ------
        NotNow, TimingUsageError, NotArmed
            It is not ARMED, the chunk is too long, or the disk has no room for it; nothing was sent.
        LaserStopped
            A stop came.
        LaserDoubt, StageError
            The box did not take it; it was switched off.
        """
        with self._lock, self._off_on_error():
            self._require(LaserState.ARMED)
            assert self.schedule is not None
            most = self.most_pairs
            if not 1 <= pairs <= most:
                raise TimingUsageError(
                    f"{pairs} pairs in one chunk: 1 to {most} fit into {self.rules.chunk_s:g} s"
                )
            if (old_s := self._clock.now_s() - self._armed_s) > ARMED_S:
                raise NotArmed(f"{self.name} was armed {old_s:.0f} s ago; confirm it again (disarm, arm)")
            if missing := self._conditions.missing(pairs, self.rules.clear_mm) or self.switches.objection():
                raise NotArmed(f"{self.name} does not fire: {missing}")
            self.box.token = self._token()
            self.pairs = pairs
            self._ends_s = math.inf
            self._enter(Event.FIRE)  # before the box: a stop in between finds light to end
            self._begin(self.schedule.rate_hz)

    def align(self, code: str, rate_hz: float, for_s: float) -> None:
        """Give weak pulses to see the sheet by, counted by the box; entered from SAFE, left through `safe`.

        Parameters
        ----------
        code : str
            `challenge`, as a person has typed it.
        rate_hz, for_s : float
            Within `LowEnergyRules`.

        Raises
        ------
        NotNow, NotArmed, PulsesRefused
            It is not SAFE, the bench has no such mode, or a limit is broken; nothing was sent.
        """
        with self._lock, self._off_on_error():
            self._require(LaserState.SAFE)
            schedule, pulses = self.low_energy_burst(rate_hz, for_s)
            self._require_code(code)
            if why := self.what_moves() or self.switches.objection():
                raise NotArmed(f"{self.name} gives no light: {why}")
            self.box.token = self._token()
            self.schedule = None
            self.box.load(schedule)
            self.pairs = pulses
            self._ends_s = math.inf
            self._enter(Event.ALIGN)
            if moves := self.what_moves():
                raise LaserStopped(f"{self.name} gives no light: {moves}")
            if self.head.lamp_to_q_switch_us is not None:
                self.box.start_lamps()
            else:
                self.box.stand_by()
            self._begin(rate_hz, camera=False)

    def low_energy_burst(self, rate_hz: float, for_s: float) -> tuple[Schedule, int]:
        """Return where the weak pulses of `align` lie, and how many they are; nothing is sent.

        Raises
        ------
        NotNow, NotArmed, PulsesRefused
            The bench has no such mode, or a limit is broken.
        """
        if self.rules.align is None:
            raise NotNow(f"{self.name} has no alignment mode; set `align` in the bench file")
        self._require_count()
        return low_energy_burst(self.rules.align, self.head, self.box.wiring, rate_hz, for_s)

    # ---- light ends ------------------------------------------------------------------------------------

    def safe(self) -> None:
        """Switch everything off and read it back; allowed in every state, and the way out of UNKNOWN and FAULT.

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
            self._make_safe()
            self.off_request.close()
            self.switches.look(OFF)
            self._ask_anew()

    # ---- while it fires --------------------------------------------------------------------------------

    def switch_opened(self, why: str) -> None:
        """Switch off, from warm-up on; called by the thread of the switches, while one does not allow light.

        A switch that was open for a moment between two bursts holds the laser until `safe` as well.
        """
        if self.state not in (LaserState.SAFE, LaserState.UNKNOWN, LaserState.FAULT):
            self._try_stop(why)
        if not self.off_request.is_closed() and not self.off_request.is_confirmed() and self.confirm_off():
            self.off_request.confirm()

    def watch(self, conditions: Conditions) -> None:
        """Judge how things stand while it fires; switch off at once if something was lost.

        Raises
        ------
        LaserStopped
            It was switched off.
        """
        if self.state is not LaserState.FIRING:
            return
        if missing := conditions.missing(0, self.rules.clear_mm, fires=True) or self.switches.objection():
            self._try_stop(missing)
            raise LaserStopped(f"{self.name} was switched off: {missing}")

    def look(self) -> bool:
        """See whether the time of a burst is over, and end it then; True while one goes on.

        Raises
        ------
        LaserDoubt
            It had ended before its time, or does not end; it was switched off.
        StageError
            It could not be asked; it was switched off as far as that was possible.
        """
        if (open_switch := self.switches.objection()) and self.emits:
            self._try_stop(open_switch)
        if self.state in EMITS and self._clock.now_s() < self._ends_s:
            return True  # without the lock: the supervisor must not wait for another verb
        with self._lock:
            state = self.state
            if state not in EMITS or self._clock.now_s() < self._ends_s:
                return state in EMITS
            with self._off_on_error():
                self.box.end()
                if state is LaserState.FIRING:
                    self.box.require_lamps(self._rate_hz is not None)  # a restart ends bursts too
                    self._enter(Event.DONE)
                else:
                    self._read_back()
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
            self._clock.sleep_s(BURST_POLL_S)
        if self.state in (LaserState.UNKNOWN, LaserState.FAULT):
            raise LaserStopped(f"{self.name} was switched off: {self.why}")

    # ---- inside ----------------------------------------------------------------------------------

    def _begin(self, rate_hz: float, camera: bool = True) -> None:
        """Let the box begin its burst of `pairs`, and note when its time is over."""
        begun_s = self._clock.now_s()
        self.box.begin(self.pairs, camera)
        if self.box.counts:  # it counts from when the last output was switched on
            begun_s = self._clock.now_s() + SPARE_S
        self._ends_s = begun_s + self.pairs / rate_hz

    def _ask_anew(self) -> None:
        super()._ask_anew()
        self.schedule = self._exposures = self._rate_hz = None
        self._ends_s = math.inf

    def _require_count(self) -> None:
        """Refuse a box that cannot end a burst by itself, unless the laboratory has agreed to that."""
        if not (self.box.counts or self.rules.uncounted):
            raise NotArmed(
                f"{self.name} is not armed: its box cannot count pulses, so a crash is ended by the watchdog "
                "alone; set `uncounted: true` in the bench file if that is enough (docs/laser.md)"
            )
