"""What every emulator is made of: motors, a clock, and answers with the moment at which they are given."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, NamedTuple, Protocol

from sim.motion import Motor


class Clock(Protocol):
    """Time of the simulated world."""

    def now_s(self) -> float:
        """Seconds."""
        ...


class Said(NamedTuple):
    """Bytes an emulator gives, and when."""

    time_s: float
    data: bytes


class Emulator(ABC):
    """Base of all emulators.

    Parameters
    ----------
    motors : mapping of str to Motor
        The motors by the name of their channel.
    clock : Clock
        Time of the world.
    """

    zero_at_top: ClassVar[bool] = False  # the controller's coordinate is zero at the upper switch

    def __init__(self, motors: Mapping[str, Motor], clock: Clock) -> None:
        self.motors = dict(motors)
        self._clock = clock
        self._said: list[Said] = []
        self.event_s = clock.now_s()  # moment of what firmware reacts to

    def feed(self, data: bytes) -> None:
        """Take bytes from the host, now."""
        self.advance()
        self._take(data)

    def advance(self) -> None:
        """Let the motors catch up with the clock."""
        now_s = self._clock.now_s()
        while any(motor.time_s < now_s for motor in self.motors.values()):  # one may start another in the past
            for motor in self.motors.values():
                motor.advance(now_s)
        self.event_s = now_s
        self._tick(now_s)

    def said(self) -> list[Said]:
        """Return what has been answered since the last call."""
        self.advance()
        said, self._said = self._said, []
        return said

    def say(self, data: bytes, time_s: float | None = None) -> None:
        """Answer, now or at the moment of an event."""
        self._said.append(Said(self.event_s if time_s is None else time_s, data))

    def hear(self, channel: str) -> "Ear":
        """Return the listener of one motor for firmware that judges all motors in one place."""
        return Ear(self, channel)

    def edge(self, channel: str, name: str, upwards: bool) -> None:  # noqa: B027 - for firmware that hears
        """A motor's carriage crosses an edge."""

    def rest(self, channel: str) -> None:  # noqa: B027
        """A motor has come to rest by itself."""

    @abstractmethod
    def _take(self, data: bytes) -> None:
        """Act on bytes of the host."""

    def _tick(self, now_s: float) -> None:  # noqa: B027 - most firmware only reacts
        """Do what is due without having been asked."""


class Ear:
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
