"""Zaber devices, firmware 7, as their owners know them.

A motor's channel is ``device/axis``. Positions count microsteps from the home sensor; units on the wire are the
vendor's: speed in microsteps/s x 1.6384, acceleration in microsteps/s2 x 1.6384/10000.

Home: back onto the sensor (the low switch), off it again slowly, zero there. So the last motion of homing is
forwards. An encoder watches the rotor: a held rotor stops the motion with FS. The far switch gives WL. After
power-up WR is set until homed, and positions count from where the axis stands; settings are kept. Each device has
a knob: pressed, it interrupts a motion (NI); turned, it moves the axis (NC) and the position stays known.

From firmware 7 on a motion takes a speed and an acceleration of its own (ASCII manual, move); ``move vel`` goes on
until it is stopped, ``move min`` and ``move max`` go to the limits. A command without a checksum is answered
without one (ASCII manual, checksums).
"""

from collections.abc import Callable, Mapping
from typing import ClassVar

from sim.emulators.device import Clock, Emulator, Purpose
from sim.mechanics.motion import Motor
from stages.errors import ProtocolViolation
from stages.protocols.zaber_ascii import Alert, Command, CommandStream, Reply

RANK = ("FD", "FQ", "FS", "WL", "WR", "WH", "NC", "NI")  # the reply shows the first that is set
PURPOSES: dict[str, Purpose] = {"to sensor": "reference", "off sensor": "reference", "knob": "hand"}


class _Axis:
    """One axis: settings, flags, and the state of its motion."""

    def __init__(self, motor: Motor, say: Callable[[bool, float], None]) -> None:
        self.motor = motor
        motor.listener = self
        self.zero = 0
        self.flags = {"WR"}
        self.phase = "rest"
        self._say = say
        screw = motor.mechanics
        self.settings = {
            "maxspeed": 153_600,
            "accel": 205,
            "limit.min": 0,
            "limit.max": int((screw.high_switch_mm - screw.low_switch_mm) / screw.lead_mm * screw.steps_per_rev),
            "resolution": 64,
            "limit.approach.maxspeed": 100_000,
        }

    @property
    def position(self) -> int:
        return self.motor.encoder_steps - self.zero

    @property
    def flag(self) -> str:
        return next((flag for flag in RANK if flag in self.flags), "--")

    def speed(self, setting: str = "maxspeed") -> float:
        return self.settings[setting] / 1.6384

    def ramp(self) -> float:
        return self.settings["accel"] * 10_000 / 1.6384 if self.settings["accel"] else 1e9

    def home(self) -> None:
        self.flags -= {"FS", "WL", "NI"}
        if self.motor.is_closed("low"):
            self._leave_sensor()
        else:
            self.phase = "to sensor"
            self.motor.go(float("-inf"), self.speed("limit.approach.maxspeed"), self.ramp())

    def move(self, position: float, speed: int | None = None, accel: int | None = None) -> None:
        self.phase = "move"
        self.flags -= {"NI"}
        top = self.speed() if speed is None else speed / 1.6384
        ramp = self.ramp() if accel is None else accel * 10_000 / 1.6384 or 1e9
        # the encoder's count is what positions mean; pulses lost earlier are made up for
        self.motor.go(position + self.zero + self.motor.steps - self.motor.encoder_steps, top, ramp)

    def limit(self, upper: bool) -> int:
        return self.settings["limit.max" if upper else "limit.min"]

    def stop(self) -> None:
        if self.motor.running:
            self.flags |= {"NI"} | ({"WR"} if self.phase in ("to sensor", "off sensor") else set())
            self.phase = "stop"
            self.motor.brake(self.ramp())

    def turn(self, steps: int) -> None:
        if self.motor.running and self.phase != "knob":  # manual control interrupts a command
            self.flags |= {"NI"} | ({"WR"} if self.phase in ("to sensor", "off sensor") else set())
        self.phase = "knob"
        self.flags |= {"NC"}
        self.motor.go(self.motor.steps + steps, self.speed() / 4.0, self.ramp())

    def power_up(self) -> None:
        self.zero, self.flags, self.phase = self.motor.encoder_steps, {"WR"}, "rest"

    def on_edge(self, name: str, upwards: bool) -> None:
        if name == "blocked":
            self._end({"FS", "WR"})
        elif name == "low" and self.phase == "to sensor":
            self.motor.halt()
            self._leave_sensor()
        elif name == "low" and self.phase == "off sensor":
            self.zero = self.motor.encoder_steps
            self.flags -= {"WR", "WH"}
            self._end(set())
        elif (name == "high" and upwards) or (name == "low" and not upwards):
            self._end({"WL"})

    def on_rest(self) -> None:
        self._end(set())

    def _leave_sensor(self) -> None:
        self.phase = "off sensor"
        self.motor.go(float("inf"), self.speed("limit.approach.maxspeed") / 20, self.ramp())

    def _end(self, flags: set[str]) -> None:
        self.motor.halt()
        self.flags = (self.flags - {"NC"}) | flags
        self.phase = "rest"
        self._say(False, self.motor.time_s)


class ZaberEmulator(Emulator):
    """A chain of Zaber devices.

    Parameters
    ----------
    motors : mapping of str to Motor
        ``device/axis`` (or ``device``) -> motor.
    checksums : bool
        Devices that append a checksum to answers to commands that had one.
    serial : int
        Serial number of the chain; that of a device is this and its address.
    firmware : str
        Version.
    """

    decoder = CommandStream
    has_serial = True

    READ_ONLY: ClassVar[dict[str, str]] = {
        "deviceid": "50081", "version.build": "14571", "device.hw.modified": "0",
        "comm.packet.size.max": "80", "comm.command.packets.max": "1", "comm.word.size.max": "50",
        "get.settings.max": "10", "peripheralid": "0", "system.platform": "30050301",
    }  # fmt: skip

    def __init__(
        self,
        motors: Mapping[str, Motor],
        clock: Clock,
        checksums: bool = True,
        serial: int = 70_000,
        firmware: str = "7.33",
    ) -> None:
        super().__init__(motors, clock)
        self._firmware = firmware
        self._serial = serial
        self._checked = checksums
        self._alerts = False
        self._axes: dict[tuple[int, int], _Axis] = {}
        self._by_channel: dict[str, _Axis] = {}
        for channel, motor in self.motors.items():
            device, _, axis = channel.partition("/")
            key = int(device), int(axis or 1)
            self._axes[key] = _Axis(motor, lambda busy, time_s, key=key: self._alert(key, time_s))  # type: ignore[misc]
            self._by_channel[channel] = self._axes[key]

    def axis(self, device: int, axis: int) -> _Axis:
        """One axis, for tests that look inside."""
        return self._axes[device, axis]

    def person_stops(self) -> None:
        """The knob of every device is pressed."""
        self.advance()
        for axis in self._axes.values():
            axis.stop()

    def turn_knob(self, device: int, axis: int, steps: int) -> None:
        """Turn the knob of an axis, whether it rests or not; without power nothing reads it."""
        self.advance()
        if self.is_on:
            self._axes[device, axis].turn(steps)

    def purpose(self, channel: str) -> Purpose:
        """Look for a sensor, follow a knob, or neither."""
        return PURPOSES.get(self._by_channel[channel].phase, "move")

    def _power_up(self) -> None:
        for axis in self._axes.values():
            axis.power_up()

    def _hear(self, command: Command | ProtocolViolation) -> None:
        if isinstance(command, ProtocolViolation):
            return
        for device in sorted({key[0] for key in self._axes}):
            if command.device in (0, device):
                self._answer(device, command)

    def _alert(self, key: tuple[int, int], time_s: float) -> None:
        if self._alerts:
            self.say(Alert(*key, False, self._axes[key].flag, "", self._checked).to_bytes(), time_s)

    def _answer(self, device: int, command: Command) -> None:
        axes = {axis: box for (owner, axis), box in self._axes.items() if owner == device}
        if command.axis and command.axis not in axes:
            accepted, data, addressed = False, "BADAXIS", list(axes.values())
        else:
            addressed = [axes[command.axis]] if command.axis else list(axes.values())
            accepted, data = self._obey(command.text.split(), device, addressed, command.axis)
        checked = self._checked and command.checked
        busy = any(box.motor.running for box in addressed)
        flag = min(
            (box.flag for box in addressed), key=lambda flag: RANK.index(flag) if flag in RANK else len(RANK)
        )
        reply = Reply(device, command.axis, accepted, busy, flag, data, command.message_id, checked)
        self.say(reply.to_bytes())

    def _obey(self, words: list[str], device: int, axes: list[_Axis], axis: int) -> tuple[bool, str]:
        match words:
            case []:
                return True, "0"
            case ["home"]:
                for box in axes:
                    box.home()
                return True, "0"
            case ["stop"]:
                for box in axes:
                    box.stop()
                return True, "0"
            case ["move", "abs" | "rel" | "vel" as kind, *numbers] if numbers and all(map(_whole, numbers)):
                return self._move(kind, [int(number) for number in numbers], axes)
            case ["move", "min" | "max" as kind, *numbers] if all(map(_whole, numbers)):
                own = [int(number) for number in numbers]
                for box in axes:
                    accepted, data = self._move("abs", [box.limit(kind == "max"), *own], [box])
                    if not accepted:
                        return accepted, data
                return True, "0"
            case ["warnings"] | ["warnings", "clear"]:
                flags = [flag for flag in RANK if any(flag in box.flags for box in axes)]
                if words[1:]:  # clearing tells once more what there was
                    for box in axes:
                        box.flags &= {"WR", "WH"}
                return True, " ".join([f"{len(flags):02d}", *flags])
            case ["get", name]:
                return self._get(name, device, axes, axis)
            case ["set", "comm.alert", "0" | "1" as value]:
                self._alerts = value == "1"
                return True, "0"
            case ["set", name, number] if _whole(number) and name in axes[0].settings:
                for box in axes:
                    box.settings[name] = int(number)
                return True, "0"
        return False, "BADCOMMAND"

    def _move(self, kind: str, numbers: list[int], axes: list[_Axis]) -> tuple[bool, str]:
        goal, *own = numbers
        most = 1 if kind == "vel" else 2  # a velocity is a speed already
        if len(own) > (most if int(self._firmware.partition(".")[0]) >= 7 else 0) or any(n <= 0 for n in own):
            return False, "BADDATA"
        targets = []
        for box in axes:
            if kind == "vel":
                targets.append(box.limit(goal > 0))
            else:
                targets.append(goal + (box.position if kind == "rel" else 0))
            if not box.limit(False) <= targets[-1] <= box.limit(True):
                return False, "BADDATA"
        for box, target in zip(axes, targets, strict=True):
            if kind == "vel" and not goal:
                box.motor.brake(box.ramp())
            elif kind == "vel":
                box.move(target, abs(goal), *own)
            else:
                box.move(target, *own)
        return True, "0"

    def _get(self, name: str, device: int, axes: list[_Axis], axis: int) -> tuple[bool, str]:
        if name == "pos":
            return True, " ".join(str(box.position + box.motor.flicker()) for box in axes)
        if name == "system.serial":
            return True, str(self._serial + device)
        if name == "system.axiscount":
            return True, str(len(axes) if not axis else 1)
        if name == "version":
            return True, self._firmware
        if name == "comm.alert":
            return True, str(int(self._alerts))
        if name in self.READ_ONLY:
            return True, self.READ_ONLY[name]
        if name in axes[0].settings:
            return True, " ".join(str(box.settings[name]) for box in axes)
        return False, "BADCOMMAND"


def _whole(text: str) -> bool:
    return text.removeprefix("-").isdecimal() and len(text) < 12


EMULATOR = ZaberEmulator
