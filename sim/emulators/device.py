"""Base of every emulator: motors, a clock, power, and answers with the moment at which they are given.

**Power.** `switch_off` halts the motors where they are and takes what firmware holds in volatile memory: bytes
of a command that is not complete, answers not yet given, positions, references. `switch_on` begins anew, with a
banner where the box has one. Carriages do not care: they stand where they stood.
"""

import math
from bisect import insort
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Literal, NamedTuple, Protocol
from zlib import crc32

from sim.mechanics.motion import Motor
from stages.link import Stream


def serial_number(name: str) -> int:
    """Six digits that differ from name to name and are the same in every process."""
    return 100_000 + crc32(name.encode()) % 900_000


class Clock(Protocol):
    """Time of the simulated world."""

    def now_s(self) -> float:
        """Seconds."""


# where it was sent; looking for its reference; turned by a person
Purpose = Literal["move", "reference", "hand"]


class TimedReply(NamedTuple):
    """Bytes an emulator gives, and when."""

    time_s: float
    data: bytes


class Emulator:
    """Base of all emulators.

    Parameters
    ----------
    motors : mapping of str to Motor
        The motors by the name of their channel.
    clock : Clock
        Time of the world.
    """

    # a number by which its protocol distinguishes it from another of its kind
    has_serial: ClassVar[bool] = False
    decoder: ClassVar[Callable[[], Stream] | None] = None  # of what a host says; begun anew with the power
    zero_at_top: ClassVar[bool] = False  # the controller's coordinate is zero at the upper switch

    def __init__(self, motors: Mapping[str, Motor], clock: Clock) -> None:
        self.motors = dict(motors)
        self._all_motors = tuple(self.motors.values())
        self._up_to_s = -math.inf
        self._clock = clock
        self._said: list[TimedReply] = []
        self._due_s: list[float] = []  # moments at which firmware wants to act by itself, sorted
        self._is_on = True
        self._on_again_s: float | None = None
        self.event_s = clock.now_s()  # moment of what firmware reacts to
        self._decode_anew()

    @classmethod
    def individual(cls, name: str) -> dict[str, Any]:
        """Options that make a box tell itself from another of its kind, where its protocol can show it."""
        return {"serial": serial_number(name)} if cls.has_serial else {}

    def feed(self, data: bytes) -> None:
        """Take bytes from the host, now."""
        self.advance()
        if self._is_on:
            self._take(data)

    def advance(self) -> None:
        """Let the motors catch up with the clock."""
        now_s = self._clock.now_s()
        if now_s == self._up_to_s:
            return
        while self._due_s and self._due_s[0] <= now_s:
            self._come_to(self._due_s.pop(0))
        self._come_to(now_s)

    def _come_to(self, time_s: float) -> None:
        self._up_to_s = time_s
        is_late = True
        while is_late:  # one may start another in the past
            is_late = False
            for motor in self._all_motors:
                if motor.time_s < time_s:
                    is_late = True
                    motor.advance(time_s)
        self.event_s = time_s
        if self._on_again_s is not None and time_s >= self._on_again_s:
            self.switch_on()
        if self._is_on:
            self._tick(time_s)

    @property
    def next_s(self) -> float | None:
        """Next moment at which firmware acts by itself, as far as is known."""
        return self._due_s[0] if self._due_s else None

    def restart(self, off_s: float = 0.0) -> None:
        """Power fails now and is back `off_s` later; nothing is heard meanwhile."""
        self.switch_off()
        if off_s > 0.0:
            self._on_again_s = self.event_s + off_s
            self.act_at(self._on_again_s)
        else:
            self.switch_on()

    def switch_off(self) -> None:
        """Power fails: motors halt, what is volatile is gone."""
        self.advance()
        for motor in self.motors.values():
            motor.halt()
        self._is_on, self._on_again_s = False, None
        self._said.clear()
        self._due_s.clear()

    def switch_on(self) -> None:
        """Power is back."""
        self._is_on, self._on_again_s = True, None
        self._decode_anew()
        self._power_up()

    @property
    def is_on(self) -> bool:
        """Return whether it has power."""
        return self._is_on

    def person_stops(self) -> None:
        """Stop what moves as a person does, at the box or through another of its interfaces."""

    def purpose(self, channel: str) -> Purpose:
        """Purpose of the present motion of a motor, as firmware knows it."""
        return "move"

    @property
    def has_answers(self) -> bool:
        """Return whether there is something to fetch with `take_answers`."""
        return bool(self._said)

    def take_answers(self) -> list[TimedReply]:
        """Return what has been answered since the last call."""
        self.advance()
        said, self._said = self._said, []
        return said

    def say(self, data: bytes, time_s: float | None = None) -> None:
        """Answer, now or at the moment of an event."""
        self._said.append(TimedReply(self.event_s if time_s is None else time_s, data))

    def hear(self, channel: str) -> "MotorListener":
        """Return the listener of one motor for firmware that judges all motors in one place."""
        return MotorListener(self, channel)

    def edge(self, channel: str, name: str, upwards: bool) -> None:
        """A motor's carriage crosses an edge."""

    def rest(self, channel: str) -> None:
        """A motor has come to rest by itself."""

    def act_at(self, time_s: float) -> None:
        """See that `_tick` is called at a moment to come."""
        insort(self._due_s, time_s)

    def _power_up(self) -> None:
        """Begin as after power-up: whatever is not kept in permanent memory is forgotten."""

    def _decode_anew(self) -> None:
        """Forget the beginning of a command."""
        decoder = type(self).decoder
        self._stream = None if decoder is None else decoder()

    def _take(self, data: bytes) -> None:
        """Act on bytes of the host."""
        for command in () if self._stream is None else self._stream.feed(data):
            self._hear(command)

    def _hear(self, command: Any) -> None:  # noqa: ANN401 - what its decoder makes
        """Act on a command, or on what is none."""

    def _tick(self, now_s: float) -> None:
        """Do what is due without having been asked."""


class MotorListener:
    """Tells firmware which of its motors an event belongs to, and when it was."""

    def __init__(self, emulator: Emulator, channel: str) -> None:
        self._emulator, self._channel = emulator, channel

    def on_edge(self, name: str, upwards: bool) -> None:
        """Pass an edge on."""
        self._emulator.event_s = self._emulator.motors[self._channel].time_s
        self._emulator.edge(self._channel, name, upwards)

    def on_rest(self) -> None:
        """Pass the end of a motion on."""
        self._emulator.event_s = self._emulator.motors[self._channel].time_s
        self._emulator.rest(self._channel)
