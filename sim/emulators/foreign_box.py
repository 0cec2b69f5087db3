"""A stage behind a foreign library: one motor a channel, no bytes; what the library calls happens at once.

Positions are mm from the firmware's own scale, counted from where the box got its power or found its reference:
the low switch, from below. It knows no limits but its switches, at which it stops without a word, notices no
stall, forgets nothing at a stop and everything with its power. `done_early_s` makes it say "done" that long
before and after a motion begins, as some adapters do. A call may be made to hang until `hangs` is set: then it
holds no lock of the world.

The libraries themselves, as far as drivers call them, are `sim.emulators.micromanager` and
`sim.emulators.positioners`.
"""

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from sim.emulators.device import Clock, Emulator, Purpose
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.mechanics.motion import Motor

SPEED_MM_S, RAMP_MM_S2 = 20.0, 200.0
SEARCH_MM_S = 2.0


class _Channel:
    """One motor with its counter."""

    def __init__(self, motor: Motor) -> None:
        self.motor = motor
        self.steps_per_mm = motor.mechanics.steps_per_rev / motor.mechanics.lead_mm
        self.zero, self.seeks, self.begun_s = motor.steps, "", -1e9

    def go(self, target_steps: float, speed_mm_s: float) -> None:
        self.motor.go(target_steps, speed_mm_s * self.steps_per_mm, RAMP_MM_S2 * self.steps_per_mm)


class ForeignBox(Emulator):
    """The box.

    Parameters
    ----------
    motors : mapping of str to Motor
        By channel.
    clock : Clock
        Time of the world.
    done_early_s : float
        How long a motion has begun before the box says that it is busy.
    begins_late_s : float
        How long it says "done" before a motion that it was sent on begins.
    encoder : bool
        Whether it reads where the motor really is, and not the commanded position.
    """

    def __init__(
        self,
        motors: Mapping[str, Motor],
        clock: Clock,
        done_early_s: float = 0.0,
        begins_late_s: float = 0.0,
        encoder: bool = False,
    ) -> None:
        super().__init__(motors, clock)
        self._early_s, self._late_s, self._encoder = done_early_s, begins_late_s, encoder
        self._waiting: list[tuple[float, str, float]] = []  # when a motion begins, of what, to where
        self._channels = {name: _Channel(motor) for name, motor in self.motors.items()}
        for name, motor in self.motors.items():
            motor.listener = self.hear(name)
        self.hangs: dict[str, threading.Event] = {}  # call -> until when it does not return
        self.called: list[tuple[str, str, float]] = []  # motions asked for: call, channel, mm

    def position_mm(self, channel: str) -> float:
        """Position by the box's own counter."""
        one = self._channels[channel]
        return (self._read(one) - one.zero + one.motor.flicker()) / one.steps_per_mm

    def _read(self, one: _Channel) -> int:
        return one.motor.encoder_steps if self._encoder else one.motor.steps

    def busy(self, channel: str) -> bool:
        """Return whether the box reports a motion: not always the truth."""
        one = self._channels[channel]
        return (one.motor.running or bool(one.seeks)) and self.event_s - one.begun_s >= self._early_s

    def send(self, channel: str, target_mm: float) -> None:
        """Go."""
        self.called.append(("send", channel, target_mm))
        if self._late_s:
            self._waiting.append((self.event_s + self._late_s, channel, target_mm))
            self.act_at(self.event_s + self._late_s)
        else:
            self._go(channel, target_mm)

    def _tick(self, now_s: float) -> None:
        due = [waiting for waiting in self._waiting if waiting[0] <= now_s]
        self._waiting = [waiting for waiting in self._waiting if waiting[0] > now_s]
        for _, channel, target_mm in due:
            self._go(channel, target_mm)

    def _go(self, channel: str, target_mm: float) -> None:
        one = self._channels[channel]
        one.begun_s = self.event_s
        lost = one.motor.steps - one.motor.encoder_steps if self._encoder else 0  # made up by who sees them
        one.go(round(target_mm * one.steps_per_mm) + one.zero + lost, SPEED_MM_S)

    def seek(self, channel: str) -> None:
        """Look for the low switch."""
        self.called.append(("seek", channel, 0.0))
        one = self._channels[channel]
        one.begun_s = self.event_s
        if one.motor.is_closed("low"):
            self._off_the_switch(one)
        else:
            one.seeks = "down"
            one.go(float("-inf"), SPEED_MM_S)

    def stop(self, channel: str) -> None:
        """Brake, and forget what has not begun."""
        self._waiting = [waiting for waiting in self._waiting if waiting[1] != channel]
        one = self._channels[channel]
        one.seeks = ""
        one.motor.brake(RAMP_MM_S2 * one.steps_per_mm)

    def edge(self, channel: str, name: str, upwards: bool) -> None:
        """A switch closes or opens."""
        one = self._channels[channel]
        if name == "low" and one.seeks == "down":
            one.motor.halt()
            self._off_the_switch(one)
        elif name == "low" and one.seeks == "up" and upwards:
            one.motor.halt()
            one.seeks, one.zero = "", self._read(one)
        elif (name == "low" and not upwards) or (name == "high" and upwards):
            one.motor.halt()

    def _off_the_switch(self, one: _Channel) -> None:
        one.seeks = "up"
        one.go(float("inf"), SEARCH_MM_S)

    def purpose(self, channel: str) -> Purpose:
        """A reference run, or a motion."""
        return "reference" if self._channels[channel].seeks else "move"

    def person_stops(self) -> None:
        """Press stop at the box."""
        self.advance()
        for channel in self._channels:
            self.stop(channel)

    def _power_up(self) -> None:
        self._waiting.clear()
        for one in self._channels.values():
            one.zero, one.seeks = self._read(one), ""


class Wire:
    """Connection of a simulated library: a line of this process with the box at its end.

    Parameters
    ----------
    address : str
        ``sim://NAME``.
    """

    def __init__(self, address: str) -> None:
        self.line: Line = LINES[address.removeprefix("sim://")]
        if self.line.dead or self.line.is_opened:
            raise RuntimeError("the box does not answer")
        self.line.open(self)

    def close(self) -> None:
        """Let go."""
        self.line.close(self)

    @contextmanager
    def call(self, name: str) -> Iterator[ForeignBox]:
        """The box, now; what the library raises where it does not answer."""
        box = self.line.emulator
        assert isinstance(box, ForeignBox)
        if (until := box.hangs.get(name)) is not None:
            until.wait()
        with self.line.lock:
            if not self.line.is_reached or self.line.owner is not self or not box.is_on:
                box.advance()
                if not self.line.is_reached or not box.is_on:
                    raise RuntimeError("the box does not answer")
            box.advance()
            yield box
            box.advance()
        if self.line.after_traffic is not None:
            self.line.after_traffic()
