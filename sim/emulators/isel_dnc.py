"""isel iMC-S8 (or the older C142) in DNC mode.

The controller obeys one command after the other and answers each with one character when it has been carried
out, a motion when it has ended; what is sent meanwhile waits, only the byte 253 does not. Reference runs go
axis by axis, Z first: onto the low switch, slowly off it, zero there. A switch that closes during a motion
halts everything, is answered with 2, and undoes initialisation and reference. Nothing watches the rotor. The stop
key on the box does what byte 253 does. After power-up it is not initialised, and a motion that was under way is
never answered. Nothing in its protocol tells two boxes apart but the text of the version.

Ports: ``@0b0`` reads the eight inputs (0 and two hexadecimal digits), ``@0B0,n`` sets the eight outputs, as open
clients have it (MSmarra/ISEL, MPIMeasurements.jl); nothing hangs on them here, and no driver of ours uses them.
"""

import re
from collections import deque
from collections.abc import Mapping

from sim.emulators.device import Clock, Emulator, Purpose
from sim.mechanics.motion import Motor
from stages.errors import ProtocolViolation
from stages.protocols import isel_dnc as dnc

NAMES = ("X", "Y", "Z")
CREEP = 200.0  # steps/s off the switch
_INPUTS = re.compile(rb"@\db\d{1,5}")
_OUTPUTS = re.compile(rb"@\dB\d{1,5},(\d{1,5})")


class IselEmulator(Emulator):
    """One controller with up to three motors.

    Parameters
    ----------
    motors : mapping of str to Motor
        X, Y, Z.
    model : str
        Text of the version; None for a C142, which has no such command.
    fastest : int
        Largest speed that it takes [steps/s]: 10 000 by the guide of the iMC-S8.
    slowest : int
        Smallest.
    """

    decoder = dnc.CommandStream

    def __init__(
        self,
        motors: Mapping[str, Motor],
        clock: Clock,
        model: str | None = "iMC-S8 V2.1",
        fastest: int = 10_000,
        slowest: int = 30,
    ) -> None:
        super().__init__(motors, clock)
        self._model, self._fastest, self._slowest = model, fastest, slowest
        self._waiting: deque[dnc.Command | ProtocolViolation] = deque()
        self._to_reference: deque[str] = deque()
        self._legs: deque[tuple[str, int, float]] = deque()
        self._power_up()
        for name, motor in self.motors.items():
            motor.listener = self.hear(name)

    def _power_up(self) -> None:
        self._zero = {name: motor.steps for name, motor in self.motors.items()}
        self._referenced: set[str] = set()
        self._axes: tuple[str, ...] = ()
        self._busy = ""  # "", move, reference, stop
        self._reference_speeds = [2000, 2000, 2000, 2000]
        self._ramp = 50_000.0  # steps/s2
        for what_waits in (self._waiting, self._to_reference, self._legs):
            what_waits.clear()

    def person_stops(self) -> None:
        """Press the stop key."""
        self.advance()
        self._stop()

    def purpose(self, channel: str) -> Purpose:
        """A reference run, its end after a stop included, or a motion."""
        return "reference" if channel in self._to_reference else "move"

    def _take(self, data: bytes) -> None:
        super()._take(data)
        self._next()

    def _hear(self, command: dnc.Command | ProtocolViolation) -> None:
        if isinstance(command, dnc.Stop):
            self._stop()
        else:
            self._waiting.append(command)

    def _tick(self, now_s: float) -> None:
        self._next()

    def _next(self) -> None:
        while self._waiting and not self._busy:
            self._obey(self._waiting.popleft())

    def _finish(self, code: str) -> None:
        self._busy = ""
        self._legs.clear()
        self._to_reference.clear()
        self.say(dnc.Ack(code).to_bytes())

    def _obey(self, command: dnc.Command | ProtocolViolation) -> None:
        match command:
            case dnc.Identify() if self._model is not None:
                self.say(dnc.Identity(self._model).to_bytes())
            case dnc.Initialise(mask):
                names = tuple(name for bit, name in enumerate(NAMES) if mask >> bit & 1)
                known = bool(names) and all(name in self.motors for name in names)
                self._axes = names if known else self._axes
                self.say(dnc.Ack("0" if known else "3").to_bytes())
            case dnc.AskPosition() if self._axes:
                steps = tuple(self._position(name) + self.motors[name].flicker() for name in self._axes)
                self.say(dnc.Position(steps).to_bytes())
            case dnc.ReferenceSpeeds(speeds) if self._axes:
                self._reference_speeds = [*speeds, *self._reference_speeds[len(speeds) :]]
                self.say(dnc.Ack("0").to_bytes())
            case dnc.Numbered(verb, number) if self._axes:
                self._obey_numbered(verb, number)
            case dnc.Move(pairs, absolute) if self._axes:
                self._move(pairs, absolute)
            case ProtocolViolation(raw=line) if _INPUTS.fullmatch(line):
                self.say(b"000")
            case ProtocolViolation(raw=line) if match := _OUTPUTS.fullmatch(line):
                self.say(dnc.Ack("0" if int(match[1]) <= 0xFF else "1").to_bytes())
            case dnc.Identify() | ProtocolViolation():
                self.say(dnc.Ack("5").to_bytes())
            case _:
                self.say(dnc.Ack("4").to_bytes())

    def _obey_numbered(self, verb: str, number: int) -> None:
        names = [name for bit, name in enumerate(NAMES) if number >> bit & 1 and name in self._axes]
        if verb == "J" and self._model is not None:
            self._ramp = number * 1000.0
            self.say(dnc.Ack("0" if 1 <= number <= 4000 else "1").to_bytes())
        elif verb == "R" and names:
            self._busy = "reference"
            self._to_reference = deque(reversed(names))
            self._reference_next()
        elif verb in ("n", "N") and names:
            for name in names:
                self._zero[name] = self.motors[name].steps
            self._referenced |= set(names)
            self.say(dnc.Ack("0").to_bytes())
        else:
            self.say(dnc.Ack("5" if verb == "J" else "3").to_bytes())

    def _move(self, pairs: tuple[tuple[int, int], ...], absolute: bool) -> None:
        if len(pairs) != (4 if len(self._axes) == 3 else len(self._axes)):
            self.say(dnc.Ack("7").to_bytes())
        elif any(not self._slowest <= speed <= self._fastest for _, speed in pairs):
            self.say(dnc.Ack("D").to_bytes())
        elif set(self._axes) - self._referenced:
            self.say(dnc.Ack("R").to_bytes())
        else:
            self._busy = "move"
            ends: dict[str, int] = {}
            for name, (steps, speed) in zip([*self._axes, self._axes[-1]], pairs, strict=False):
                here = ends.get(name, self._position(name))
                ends[name] = steps if absolute and name not in ends else here + steps  # Z's second leg adds
                if ends[name] != here:
                    self._legs.append((name, ends[name], speed))
            self._leg_next()

    def _position(self, name: str) -> int:
        return self.motors[name].steps - self._zero[name]

    def _leg_next(self) -> None:
        """Start the next leg; the last one ends the command."""
        if not self._legs:
            self._finish("0")
            return
        name, target, speed = self._legs.popleft()
        self.motors[name].go(target + self._zero[name], speed, self._ramp, self.event_s)

    def _reference_next(self) -> None:
        if not self._to_reference:
            self._finish("0")
            return
        motor = self.motors[self._to_reference[0]]
        self._referenced.discard(self._to_reference[0])
        if motor.is_closed("low"):
            motor.go(float("inf"), CREEP, self._ramp, self.event_s)
        else:
            speed = self._reference_speeds[NAMES.index(self._to_reference[0])]
            motor.go(float("-inf"), speed, self._ramp, self.event_s)

    def _stop(self) -> None:
        if self._busy in ("move", "reference"):
            self._busy = "stop"
            self._legs.clear()
            for motor in self.motors.values():
                motor.brake(self._ramp)

    def edge(self, axis: str, name: str, upwards: bool) -> None:
        """A motor's carriage crosses an edge."""
        motor = self.motors[axis]
        if self._busy == "reference" and name == "low":
            motor.halt()
            if upwards:
                self._zero[axis] = motor.steps
                self._referenced.add(axis)
                self._to_reference.popleft()
            self._reference_next()
        elif (name == "low" and not upwards) or (name == "high" and upwards):
            for other in self.motors.values():
                other.halt()
            self._axes, self._referenced = (), set()
            self._finish("2")

    def rest(self, axis: str) -> None:
        """A motor has come to rest by itself."""
        if self._busy == "stop":
            if not any(motor.running for motor in self.motors.values()):
                self._finish("F")
        elif self._busy == "move":
            self._leg_next()


EMULATOR = IselEmulator
