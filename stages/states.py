"""States of an axis and their transitions, as a table that the code obeys.

    state          position        move  home  read  how it is left
    -------------  --------------  ----  ----  ----  ---------------------------------------------------------
    UNREFERENCED   unknown         no    yes   no    HOME -> HOMING
    READY          known, at rest  yes   yes   yes   START -> MOVING, HOME -> HOMING, FORGET -> UNREFERENCED
    MOVING         not asked for   no    no    no    REST -> READY, FORGET -> UNREFERENCED
    HOMING         unknown         no    no    no    FOUND -> READY, FORGET -> UNREFERENCED
    LOST           unknown         no    no    no    CONNECT -> UNREFERENCED, or READY if the box still has it

CUT (the port is gone) leads from every state to LOST. FORGET is whatever takes the reference away: the controller
has restarted, a limit switch, a stall, an interrupted reference run. READY is never remembered, it is asked for:
each reading of a position is followed by the question whether the box still vouches for it.

Above all axes stands the bench: FREE, or HELD by a person's stop (`stages.stop_latch`). While it is HELD nothing
moves, homes or is exposed, whatever the axes could do; reading positions and stopping again stay allowed.
"""

from enum import Enum


class AxisState(Enum):
    """States of an axis."""

    UNREFERENCED = "unreferenced"  # home it
    READY = "ready"
    MOVING = "moving"
    HOMING = "homing"
    LOST = "lost"  # reconnect, then home it


class Event(Enum):
    """Events of an axis."""

    START = "a motion begins"
    REST = "a motion has ended, the reference still holds"
    HOME = "a reference run begins"
    FOUND = "the reference has been found"
    FORGET = "the reference is gone"
    CUT = "the port is gone"
    CONNECT = "the port is open again"


_S, _E = AxisState, Event

NEXT: dict[AxisState, dict[Event, AxisState]] = {
    _S.UNREFERENCED: {_E.HOME: _S.HOMING, _E.FORGET: _S.UNREFERENCED, _E.FOUND: _S.READY},
    _S.READY: {_E.START: _S.MOVING, _E.HOME: _S.HOMING, _E.FORGET: _S.UNREFERENCED, _E.FOUND: _S.READY},
    _S.MOVING: {_E.REST: _S.READY, _E.FORGET: _S.UNREFERENCED},
    _S.HOMING: {_E.FOUND: _S.READY, _E.FORGET: _S.UNREFERENCED},
    _S.LOST: {_E.CONNECT: _S.UNREFERENCED},
}

MAY_MOVE = frozenset({_S.READY})
MAY_HOME = frozenset({_S.READY, _S.UNREFERENCED})
MAY_READ = frozenset({_S.READY})


def after(state: AxisState, event: Event) -> AxisState:
    """Return the state that an event leads to; ValueError if the table has no such way."""
    if event is Event.CUT:
        return AxisState.LOST
    try:
        return NEXT[state][event]
    except KeyError:
        raise ValueError(f"an axis that is {state.value} cannot meet this: {event.value}") from None
