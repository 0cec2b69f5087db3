"""What a laser may do, and what is believed of it, as a table that the code obeys.

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
been said, and nobody has confirmed it. STILL (it reads back as off) makes that a FAULT, which a person has to
look at. A laser without lamps is warm at once.
"""

from enum import Enum


class LaserState(Enum):
    """What may be asked of a laser now."""

    UNKNOWN = "unknown"
    SAFE = "safe"
    WARM = "warm"
    READY = "ready"
    ARMED = "armed"
    FIRING = "firing"
    ALIGNING = "aligning"
    FAULT = "fault"


class Event(Enum):
    """What happens to a laser."""

    OFF = "everything is off and reads back as off"
    WARM_UP = "lamps begin to run"
    HEATED = "the lamps have run for long enough"
    ARM = "all conditions hold and the operator has said the word"
    DISARM = "it shall not fire now"
    FIRE = "a counted burst begins"
    DONE = "the box has counted to the end"
    ALIGN = "weak pulses begin"
    BAD = "a stop, a lost condition, a lost link, an answer that does not fit"
    STILL = "what was in doubt reads back as off"


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

EMITS = frozenset({_S.FIRING, _S.ALIGNING})  # light is meant to leave; in UNKNOWN nobody knows
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
