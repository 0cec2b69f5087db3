"""A Thorlabs box: a cube of its own (channel 1) or a rack with a card in each bay (bay1, bay2, ..).

Registers hold what the vendor's units say: counts, and speeds in units of the family. A servo cube or brushless
rack counts with its encoder and gives up with a position error when its motor is held; a stepper counts the pulses
that it makes. Speeds of the servos are 16.16 fixed-point counts per period of their control loop, those of newer
steppers are 53.68 to the microstep per second.

Home: down onto the lower switch (or up onto the upper one, as set), slowly off it, by the offset further, zero
there. After power-up a channel is not homed, counts from where it stands, corrects backlash by itself, and has
lost every setting that was not written into its memory; a cube is switched on (thorlabs-apt-device homes a KDC101
without switching it on), a rack is not. The wheel at the box stops what runs and drives what rests.

Nothing that moves is answered. The end of a motion is reported unasked, and the state ten times a second to hosts
that have asked for that; without an acknowledgement the reports end after fifty.

**Server alive.** With `falls_silent` the box keeps to the letter of the protocol, issue 26, p. 30: a host that has
not said MOT_ACK_DCSTATUSUPDATE for a second is answered about fifty commands more, and then nothing until it does.
"""

import re
from collections.abc import Mapping

from sim.emulators.device import Clock, Emulator, Purpose
from sim.mechanics.motion import Motor
from stages.errors import ProtocolViolation
from stages.protocols import apt_words as words
from stages.protocols import thorlabs_apt as apt
from stages.protocols.apt_words import Kind

UPDATES_S = 0.1
UNTHANKED, THANKS_S = 50, 1.0
CONNECTED = 0x0100
POSITION_ERROR = 0x4000
UPWARDS, DOWNWARDS = 0x0010, 0x0020
FORWARD = 1  # direction of a reference run
NOTES = "simulated"
HOMES: dict[str, Purpose] = dict.fromkeys(("to switch", "off switch", "offset"), "reference")  # by phase
PURPOSES: dict[str, Purpose] = {**HOMES, "hand": "hand"}


def _per_second(model: str) -> tuple[float, float, bool]:
    """Counts/s and counts/s2 of one unit of a model, and whether it counts with an encoder."""
    if re.match("[TK]DC|[TK]BD|BBD", model):
        loops = 6e6 / 2048 if model[1:3] == "DC" else 1e6 / 102.4
        return loops / 65536, loops * loops / 65536, True
    if re.match("TST001|(BSC|SCC)[01]0|MST601", model):
        return 1.0, 1.0, False
    return 1 / 53.68, 90.9, False


class _Channel:
    """One motor: registers, and the state of its motion."""

    def __init__(self, box: "AptEmulator", motor: Motor, place: int, ident: int) -> None:
        self.box, self.motor, self.place, self.ident = box, motor, place, ident
        motor.listener = self
        self.speed_unit, self.acceleration_unit, self.has_encoder = _per_second(box.model)
        self.power_up()

    def power_up(self) -> None:
        self.zero = self._raw_count
        self.is_homed = self.has_fault = False
        self.is_on = not self.box.is_rack
        self.phase = "rest"
        self.relative = self.target = 0
        per_rev = self.motor.mechanics.steps_per_rev
        self.backlash = per_rev // 10
        self.speeds = (0, self._units(20.0, self.acceleration_unit), self._units(1.0, self.speed_unit))
        self.homing = (2, 1, self._units(4.0, self.speed_unit), self.box.home_offset)

    def _units(self, revolutions: float, unit: float) -> int:
        return max(1, round(revolutions * self.motor.mechanics.steps_per_rev / unit))

    @property
    def _raw_count(self) -> int:
        return self.motor.encoder_steps if self.has_encoder else self.motor.steps

    @property
    def position(self) -> int:
        return self._raw_count - self.zero

    @property
    def bits(self) -> int:
        upwards = self.motor.target >= self.motor.steps
        moves = (UPWARDS if upwards else DOWNWARDS) if self.motor.running else 0
        return (
            moves | CONNECTED
            | words.UPPER_SWITCH * self.motor.is_closed("high") | words.LOWER_SWITCH * self.motor.is_closed("low")
            | words.HOMING * (self.phase in HOMES) | words.HOMED * self.is_homed
            | POSITION_ERROR * self.has_fault | words.ENABLED * self.is_on
        )  # fmt: skip

    def update(self) -> bytes:
        """Fourteen bytes: a servo tells its speed where a stepper tells the count of an encoder it may have."""
        count = self.position.to_bytes(4, "little", signed=True)
        return self.ident.to_bytes(2, "little") + count + bytes(4) + self.bits.to_bytes(4, "little")

    def go(self, position: float, phase: str = "move", speed: float | None = None) -> None:
        self.phase = phase
        _, acceleration, fastest = self.speeds
        made_up = self.motor.steps - self._raw_count  # a servo makes lost pulses up
        self.motor.go(
            position + self.zero + made_up,
            speed or fastest * self.speed_unit,
            acceleration * self.acceleration_unit,
        )

    def move(self, target: int) -> None:
        if not self.is_on:
            return
        self.target, self.has_fault = target, False
        if target == self.position:
            self._ends(Kind.MOT_MOVE_COMPLETED)
        elif target < self.position and self.backlash:
            self.go(target - self.backlash, "beyond")
        else:
            self.go(target)

    def home(self) -> None:
        if not self.is_on:
            return
        self.is_homed = self.has_fault = False
        if self.motor.is_closed("high" if self.homing[0] == FORWARD else "low"):
            self._leave_switch()
        else:
            self.go(float("inf") if self.homing[0] == FORWARD else float("-inf"), "to switch", self._homing_speed)

    @property
    def _homing_speed(self) -> float:
        return self.homing[2] * self.speed_unit

    def _leave_switch(self) -> None:
        self.go(
            float("-inf") if self.homing[0] == FORWARD else float("inf"), "off switch", self._homing_speed / 20
        )

    def stop(self, how: int) -> None:
        if not self.motor.running:
            self._ends(Kind.MOT_MOVE_STOPPED)
        elif how == words.STOP_AT_ONCE:
            self.motor.halt()
            self._ends(Kind.MOT_MOVE_STOPPED)
        else:
            self.phase = "slowing"
            self.motor.brake(self.speeds[1] * self.acceleration_unit)

    def turn(self, steps: int) -> None:
        self.go(self.position + steps, "hand")

    def on_edge(self, name: str, upwards: bool) -> None:
        home = "high" if self.homing[0] == FORWARD else "low"
        if name == "blocked":
            if self.has_encoder:
                self.has_fault = True
                self.motor.halt()
                self._ends(Kind.MOT_MOVE_STOPPED)
        elif name == home and self.phase == "to switch":
            self.motor.halt()
            self._leave_switch()
        elif name == home and self.phase == "off switch":
            self.motor.halt()
            self.zero = self._raw_count
            if self.homing[3]:
                self.go(self.homing[3], "offset", self._homing_speed)
            else:
                self._has_homed()
        elif (name == "high" and upwards) or (name == "low" and not upwards):
            self.motor.halt()
            self._ends(Kind.MOT_MOVE_STOPPED)

    def on_rest(self) -> None:
        if self.phase == "beyond":
            self.go(self.target)
        elif self.phase == "offset":
            self._has_homed()
        else:
            self._ends(Kind.MOT_MOVE_STOPPED if self.phase == "slowing" else Kind.MOT_MOVE_COMPLETED)

    def _has_homed(self) -> None:
        self.zero, self.is_homed, self.phase = self._raw_count, True, "rest"
        report = apt.Unasked(Kind.MOT_MOVE_HOMED, bytes((self.ident, 0)), True, self.place)
        self.box.say(report.to_bytes(), self.motor.time_s)

    def _ends(self, kind: Kind) -> None:
        self.phase = "rest"
        self.box.say(apt.Unasked(kind, self.update(), False, self.place).to_bytes(), self.motor.time_s)


class AptEmulator(Emulator):
    """One box.

    Parameters
    ----------
    motors : mapping of str to Motor
        Motors by channel: ``1``, .. or ``bay1``, ...
    model : str, optional
        By default a KDC101, or the stepper rack BSC203.
    serial : int
        Serial number.
    home_offset : int
        Counts from the switch to the zero of a reference run.
    falls_silent : bool
        Whether it needs a sign of life of the host.
    """

    decoder = apt.CommandStream
    has_serial = True

    def __init__(
        self,
        motors: Mapping[str, Motor],
        clock: Clock,
        model: str | None = None,
        serial: int = 27_000_001,
        home_offset: int = 0,
        falls_silent: bool = False,
    ) -> None:
        super().__init__(motors, clock)
        self._falls_silent, self._thanked_s, self._unthanked = falls_silent, clock.now_s(), 0
        self.started_by: list[int] = []  # addresses that got the word that no firmware is written
        self.is_rack = any(name.startswith("bay") for name in motors)
        self.model = model or ("BSC203" if self.is_rack else "KDC101")
        self._serial, self.home_offset = serial, home_offset
        self._channels: dict[str, _Channel] = {}
        for name, motor in self.motors.items():
            place = words.FIRST_BAY - 1 + int(name[3:]) if self.is_rack else words.UNIT
            self._channels[name] = _Channel(self, motor, place, 1 if self.is_rack else int(name))
        self._updates_left = 0
        self._next_update_s = 0.0

    def channel(self, name: str) -> _Channel:
        """One motor, for tests that look inside."""
        return self._channels[name]

    def person_stops(self) -> None:
        """Touch the wheel of every channel."""
        self.advance()
        for channel in self._channels.values():
            if channel.motor.running:
                channel.stop(words.STOP_SLOWING)

    def person_homes(self) -> None:
        """Home every channel from the menu of the box; without power there is none."""
        self.advance()
        for channel in self._channels.values() if self.is_on else ():
            channel.is_on = True
            channel.home()

    def turn_wheel(self, name: str, steps: int) -> None:
        """Turn the wheel of a channel, whether it rests or not; without power nothing reads it."""
        self.advance()
        if self.is_on:
            self._channels[name].turn(steps)

    def purpose(self, channel: str) -> Purpose:
        """A reference run, a wheel, or a motion."""
        return PURPOSES.get(self._channels[channel].phase, "move")

    def _power_up(self) -> None:
        self._updates_left = 0
        for channel in self._channels.values():
            channel.power_up()

    def _count(self, command: object) -> None:
        """Count a command of a host that has not said for a while that it is there."""
        thanks = isinstance(command, apt.Order) and command.kind == Kind.MOT_ACK_DCSTATUSUPDATE
        if self._falls_silent and not thanks and self.event_s - self._thanked_s > THANKS_S:
            self._unthanked += 1

    def say(self, data: bytes, time_s: float | None = None) -> None:
        """Answer, unless it has fallen silent."""
        if self._unthanked <= UNTHANKED:
            super().say(data, time_s)

    def _hear(self, command: apt.Command | ProtocolViolation) -> None:
        self._count(command)
        match command:
            case ProtocolViolation():
                return
            case apt.SetSpeeds():
                for channel in self._meant(command.to, command.channel):
                    channel.speeds = (command.minimum, command.acceleration, command.maximum)
            case apt.Setting():
                for channel in self._meant(command.to, command.channel):
                    _set(channel, command.kind, command.value)
            case apt.Order():
                self._obey(command)

    def _meant(self, place: int, ident: int) -> list[_Channel]:
        return [one for one in self._channels.values() if (one.place, one.ident) == (place, ident)]

    def _obey(self, order: apt.Order) -> None:
        match order.kind:
            case Kind.HW_REQ_INFO:
                if order.to == (words.RACK if self.is_rack else words.UNIT):
                    self._introduce(order.to)
            case Kind.RACK_REQ_BAYUSED if self.is_rack and order.to == words.RACK:
                used = any(one.place == words.FIRST_BAY + order.first for one in self._channels.values())
                reply = apt.Reply(Kind.RACK_GET_BAYUSED, order.first, words.ON if used else words.OFF, words.RACK)
                self.say(reply.to_bytes())
            case Kind.HW_START_UPDATEMSGS:
                self._updates_left, self._next_update_s = UNTHANKED, self.event_s + UPDATES_S
                self.act_at(self._next_update_s)
            case Kind.HW_STOP_UPDATEMSGS:
                self._updates_left = 0
            case Kind.HW_NO_FLASH_PROGRAMMING:
                self.started_by.append(order.to)
            case Kind.MOT_ACK_DCSTATUSUPDATE:
                self._thanked_s, self._unthanked = self.event_s, 0
                self._updates_left = UNTHANKED if self._updates_left else 0
            case _:
                for channel in self._meant(order.to, order.first):
                    self._ask(channel, order)

    def _ask(self, channel: _Channel, order: apt.Order) -> None:
        place, ident = channel.place, channel.ident
        values = {
            Kind.MOT_REQ_POSCOUNTER: channel.position + channel.motor.flicker(),
            Kind.MOT_REQ_GENMOVEPARAMS: channel.backlash,
            Kind.MOT_REQ_MOVERELPARAMS: channel.relative,
        }
        match order.kind:
            case Kind.MOT_REQ_POSCOUNTER | Kind.MOT_REQ_GENMOVEPARAMS | Kind.MOT_REQ_MOVERELPARAMS as kind:
                self.say(apt.Value(kind + 1, ident, values[Kind(kind)], place).to_bytes())
            case Kind.MOT_REQ_STATUSBITS:
                self.say(apt.Status(ident, channel.bits, place).to_bytes())
            case Kind.MOT_REQ_STATUSUPDATE | Kind.MOT_REQ_DCSTATUSUPDATE as kind:
                self.say(apt.Unasked(kind + 1, channel.update(), False, place).to_bytes())
            case Kind.MOT_REQ_VELPARAMS:
                self.say(apt.Speeds(ident, *channel.speeds, place).to_bytes())
            case Kind.MOT_REQ_HOMEPARAMS:
                self.say(apt.Homing(ident, *channel.homing, place).to_bytes())
            case Kind.MOD_REQ_CHANENABLESTATE:
                state = words.ON if channel.is_on else words.OFF
                self.say(apt.Reply(Kind.MOD_GET_CHANENABLESTATE, ident, state, place).to_bytes())
            case Kind.MOD_SET_CHANENABLESTATE:
                channel.is_on = order.second == words.ON
            case Kind.MOT_MOVE_HOME:
                channel.home()
            case Kind.MOT_MOVE_STOP:
                channel.stop(order.second)

    def _introduce(self, place: int) -> None:
        kind, channels = (45, len(self._channels)) if self.is_rack else (16, len(self._channels))
        info = apt.Info(self._serial, self.model, kind, (2, 0, 3), NOTES, 3, 0, channels, place)
        self.say(info.to_bytes())

    def _tick(self, now_s: float) -> None:
        while self._updates_left and self._next_update_s <= now_s:
            self._updates_left -= 1
            for channel in self._channels.values():
                kind = Kind.MOT_GET_DCSTATUSUPDATE if channel.has_encoder else Kind.MOT_GET_STATUSUPDATE
                update = apt.Unasked(kind, channel.update(), False, channel.place)
                self.say(update.to_bytes(), self._next_update_s)
            self._next_update_s += UPDATES_S
            if self._updates_left:
                self.act_at(self._next_update_s)


def _set(channel: _Channel, kind: int, value: int) -> None:
    match kind:
        case Kind.MOT_SET_GENMOVEPARAMS:
            channel.backlash = value
        case Kind.MOT_SET_MOVERELPARAMS:
            channel.relative = value
        case Kind.MOT_MOVE_ABSOLUTE:
            channel.move(value)
        case Kind.MOT_MOVE_RELATIVE:
            channel.move(channel.position + value)


EMULATOR = AptEmulator
