"""States of a laser and their transitions, as a table that the code obeys.

    state     light           how it is left
    --------  --------------  -----------------------------------------------------------------------------------
    UNKNOWN   may be there    OFF -> SAFE, STILL -> FAULT, and nothing else
    SAFE      none            WARM_UP -> WARM, ALIGN -> ALIGNING
    WARM      none, lamps on  HEATED -> READY
    READY     none, lamps on  ARM -> ARMED
    ARMED     none, lamps on  FIRE -> FIRING, DISARM -> READY
    FIRING    pulses          DONE -> READY
    ALIGNING  weak pulses     OFF -> SAFE, and nothing else
    FAULT     none            OFF -> SAFE, and nothing else

OFF (a person asked for it; everything was written off and reads back as off) leads from every state to SAFE. BAD
(a stop, a lost condition, a lost link, an answer that does not fit) leads from every state to UNKNOWN: off has
been sent, and is not confirmed. STILL (it reads back as off) makes that a FAULT, which a person has to
look at. A laser without lamps is warm at once.

`LaserStateMachine` is what may be asked of a laser now, for several threads: its state, why it is unknown, the
confirmation code.  Every verb of a laser requires a state and enters another one; what a stop from another thread
has made of the state meanwhile wins over what the verb would have made of it.  What can move on the bench is kept
still from arming until the light reads back as off.

A laser is one object around one latch, written in three files: its states (here), every end of its light
(`shutdown.LaserShutdown`), and every beginning (`laser.Laser`).  Each is the base class of the next.
"""

import math
import secrets
import threading
from collections.abc import Callable
from enum import Enum
from typing import Protocol

from daq.timing.errors import LaserStopped, NotArmed, NotNow
from stages.clock import Clock
from stages.stop_latch import StopLatch


class LaserState(Enum):
    """States of a laser."""

    UNKNOWN = "unknown"
    SAFE = "safe"
    WARM = "warm"
    READY = "ready"
    ARMED = "armed"
    FIRING = "firing"
    ALIGNING = "aligning"
    FAULT = "fault"


class Event(Enum):
    """Events of a laser."""

    OFF = "everything is off and reads back as off"
    WARM_UP = "lamps begin to run"
    HEATED = "the lamps have run for long enough"
    ARM = "all conditions hold and the operator has confirmed"
    DISARM = "it shall not fire now"
    FIRE = "a counted burst begins"
    DONE = "the box has counted to the end"
    ALIGN = "weak pulses begin"
    BAD = "a stop, a lost condition, a lost link, an answer that does not fit"
    STILL = "off was sent and reads back"


_S, _E = LaserState, Event

NEXT: dict[LaserState, dict[Event, LaserState]] = {
    _S.UNKNOWN: {_E.STILL: _S.FAULT},
    _S.SAFE: {_E.WARM_UP: _S.WARM, _E.ALIGN: _S.ALIGNING},
    _S.WARM: {_E.HEATED: _S.READY},
    _S.READY: {_E.ARM: _S.ARMED},
    _S.ARMED: {_E.FIRE: _S.FIRING, _E.DISARM: _S.READY},
    _S.FIRING: {_E.DONE: _S.READY},
    _S.ALIGNING: {},
    _S.FAULT: {},
}

EMITS = frozenset({_S.FIRING, _S.ALIGNING})  # light is meant to leave; in UNKNOWN it may
BARS_MOTION = EMITS | {_S.ARMED}  # nothing may move: what was said at arming has to stay true


def after(state: LaserState, event: Event) -> LaserState:
    """Return the state that an event leads to; ValueError if the table has no such way."""
    if event is Event.OFF:
        return LaserState.SAFE
    if event is Event.BAD:
        return LaserState.UNKNOWN
    try:
        return NEXT[state][event]
    except KeyError:
        raise ValueError(f"a laser that is {state.value} cannot meet this: {event.value}") from None


_WAYS = {
    LaserState.UNKNOWN: "its state is unknown; only safe() is allowed",
    LaserState.FAULT: "look at it, then safe()",
    LaserState.SAFE: "warm() comes first",
    LaserState.WARM: "its lamps still warm up",
    LaserState.READY: "set() and arm() come first",
    LaserState.ARMED: "fire() or disarm()",
    LaserState.FIRING: "wait() or stop()",
    LaserState.ALIGNING: "end it with safe()",
}


class Movers(Protocol):
    """Something that moves on the bench; `stages.stage.Stage` is one."""

    def bar_motion(self, why: Callable[[], str | None]) -> None:
        """Ask before anything moves; a sentence as the answer refuses the motion."""

    def what_moves(self) -> str | None:
        """Say what moves or is about to, as part of a sentence."""


class LaserStateMachine:
    """State machine of a laser; safe for several threads.

    Parameters
    ----------
    name : str
        The laser's, for messages.
    latch : StopLatch
        What switches it off.
    clock : Clock
        Clock of its warm-up.
    """

    def __init__(self, name: str, latch: StopLatch, clock: Clock) -> None:
        self.name = name
        self.why = "it has not been looked at yet"  # of the last change to UNKNOWN
        self.challenge = ""  # the code to be typed
        self.heated_s = math.inf  # when the lamps have run for long enough
        self._latch = latch
        self._clock = clock
        self._state_lock = threading.Lock()  # held for an assignment, never while anything is sent
        self._state = LaserState.UNKNOWN
        self._movers: list[Movers] = []

    @property
    def state(self) -> LaserState:
        """Present state; WARM becomes READY by the clock."""
        with self._state_lock:
            if self._state is LaserState.WARM and self._clock.now_s() >= self.heated_s:
                self._state = after(self._state, Event.HEATED)
            return self._state

    @property
    def emits(self) -> bool:
        """True if light is meant to leave now; asks no lock, so a signal handler may ask it."""
        return self._state in EMITS

    # ---- verbs ---------------------------------------------------------------------------------

    def _require(self, wanted: LaserState) -> None:
        """Raise NotNow, with the way, in any other state."""
        if (state := self.state) is not wanted:
            raise NotNow(f"{self.name} is {state.value}, not {wanted.value}: {_WAYS[state]} ({self.why})")

    def _token(self) -> int:
        """Return what bytes that switch on have to show; LaserStopped while a stop holds."""
        if self._latch.is_held:
            raise LaserStopped(f"{self.name} is held: {self.why}; look at it, then safe()")
        return self._latch.count

    def _enter(self, event: Event) -> None:
        """Go on by the table; what a stop has made of the state meanwhile wins."""
        with self._state_lock:
            try:
                self._state = after(self._state, event)
            except ValueError as error:
                if self._latch.is_held:
                    raise LaserStopped(f"{self.name} was switched off: {self.why}") from None
                raise NotNow(f"{self.name}: {error}") from None

    def _mark_unknown(self, why: str) -> None:
        """Change to UNKNOWN; the first reason stays."""
        with self._state_lock:
            if self._state is not LaserState.UNKNOWN:
                self.why = why
            self._state = after(self._state, Event.BAD)
            self.challenge = ""

    # ---- the confirmation code ------------------------------------------------------------------------------

    def _ask_anew(self) -> None:
        """Make another code up, so that no plan, script or habit can hold it."""
        self.challenge = str(1000 + secrets.randbelow(9000))
        self.heated_s = math.inf

    def _require_code(self, code: str) -> None:
        """Raise NotArmed unless it is the one that is asked for."""
        if not self.challenge or not secrets.compare_digest(code.strip().encode(), self.challenge.encode()):
            raise NotArmed(f"{self.name} is not armed: type the code that it asks for ({self.challenge})")

    # ---- beside what moves -----------------------------------------------------------------------

    def add_motion_interlock(self, movers: Movers) -> None:
        """Let nothing of `movers` move while light may leave, and no light leave while something of it moves."""
        self._movers.append(movers)
        movers.bar_motion(self.objection)

    def objection(self) -> str | None:
        """Say why nothing may move now, as a sentence; asks no lock, so any thread may ask it."""
        state = self._state
        if state is LaserState.UNKNOWN:
            return f"it is unknown whether {self.name} is off; say safe(), or rtpiv laser off"
        if state in BARS_MOTION:
            return f"{self.name} is {state.value}; let it end, or switch it off first"
        return None

    def what_moves(self) -> str | None:
        """Say what moves or is about to, as part of a sentence; None if nothing does."""
        return next(filter(None, (movers.what_moves() for movers in self._movers)), None)
