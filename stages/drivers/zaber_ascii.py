"""Driver for Zaber devices on one line (chain), ASCII protocol, firmware 6 and 7.

A channel is ``device/axis`` or just ``device``. Positions are microsteps. Speeds and accelerations go in the
controller's units: microsteps/s x 1.6384, microsteps/s2 x 1.6384/10000 (Zaber, ASCII Protocol Manual,
Appendix).

Every command carries a number that comes back with its answer, so a late answer is recognised and skipped. With
the flag WR (no reference position) or WH (not homed) the position is meaningless. Flags that begin with F are
faults that have ended the motion, and so is WL (unexpected limit); they remain until ``warnings clear``, which is
sent before homing. NI and NC report a motion that was interrupted, by another command or at the knob. An answer
carries only the flag of the highest priority; ``warnings`` returns all of them. WR is set from power-up until
homing, so it also shows a restart: it is checked in every answer, and queried wherever a position is used.

**Speed of a motion.** Settings survive power-off ("non-volatile", ASCII manual, settings), so writing them for
every move wears the memory and changes the settings of other programs. From firmware 7 on a move has its own:
``move abs P maxspeed accel``. Firmware 6 has only the settings; they are written when they change.
"""

import re
from collections.abc import Sequence
from functools import partial

from stages.controller import Channel, Controller
from stages.errors import (
    AxisStalled,
    CommandRejected,
    LimitHit,
    MotionStopped,
    NotReferenced,
    ProtocolViolation,
    StageUsageError,
    WrongDevice,
)
from stages.protocols.zaber_ascii import AnswerStream, Command, Reply

PER_SECOND = 1.6384
# Firmware from which on a move takes its own speed and acceleration
MOTION_HAS_PROFILE = 7
LARGEST_SETTING = 2**31 - 1
# Command number of every stop: its answer is not awaited, and skipped when it comes
STOP_ID = 99

FAULTS = {
    "FS": "stalled", "FQ": "has an encoder error", "FD": "has its driver switched off",
    "FE": "found no limit sensor", "FR": "went beyond its overdrive limit",
    "FO": "has its driver switched off by command",
    "FV": "had too much or too little voltage", "FC": "had too much current", "FM": "is too hot",
    "FH": "was stopped by the emergency switch",
}  # fmt: skip
LIMITS = {"WL": "ran into a limit"}
UNREFERENCED = {"WR", "WH"}  # no reference position; not homed
INTERRUPTED = {"NI", "NC"}  # by a command; by manual control
# No flag is set: an answer shows the one of highest priority
NO_FLAG = "--"


class ZaberController(Controller):
    """One line of Zaber devices."""

    default_baud = 115_200
    example_channels = ("1/1", "1/2")
    decoder = AnswerStream
    counts_steps = True
    senses_stall = True
    first_day = (
        "Devices ship in Binary at 9600 baud (A-series) until Zaber's own program has set them to ASCII at 115200."
    )

    _firmware = 0  # major number, the oldest of the line
    _next_id = 0
    _flag = NO_FLAG  # of the last answer
    _profile: dict[str, tuple[int, int]]
    _homing: set[str]
    _pressed: str | None = None  # channel whose knob has ended the last motion

    def start_move(self, channel: str, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Begin an absolute move; NotReferenced if the device has restarted, which is then stopped at once."""
        steps = round(target_mm * self._scale(channel))
        speed, acceleration = self._native(channel, speed_mm_s, acceleration_mm_s2)
        profile = f" {speed} {acceleration}" if self._firmware >= MOTION_HAS_PROFILE else ""
        if not profile and self._profile.get(channel) != (speed, acceleration):
            self._profile.pop(channel, None)
            self._ask_again(lambda: self._tell(channel, f"set maxspeed {speed}"))
            self._ask_again(lambda: self._tell(channel, f"set accel {acceleration}"))
            self._profile[channel] = (speed, acceleration)
        self._stopped = False
        self._pressed = None
        if self._tell(channel, f"move abs {steps}{profile}", moves=True).flag in UNREFERENCED:
            self.stop()  # restarted since its reference was checked: its coordinate is meaningless
            self._forget_references()
            raise NotReferenced(f"{self.name} channel {channel} has restarted; stopped at once, home it")

    def start_home(self, channel: str) -> None:
        """Begin to home, after clearing the flags of earlier faults."""
        self._referenced.discard(channel)
        self._ask_again(lambda: self._tell(channel, "warnings clear"))
        self._stopped = False
        self._pressed = None
        self._tell(channel, "home", moves=True)
        self._homing.add(channel)

    def moving(self, channel: str) -> bool:
        """Query the state once, with an empty command; return whether the channel moves.

        The flag tells what ended the motion: AxisStalled for a flag that begins with F, LimitHit for WL,
        MotionStopped for NI and NC.  A stop by a person takes precedence over the fault that it caused.
        """
        reply = self._ask_again(lambda: self._tell(channel, ""))
        ended_badly = reply.flag.startswith("F") or reply.flag in LIMITS
        if reply.busy and not ended_badly:
            # It brakes already: a stop of ours, sent now, would hide that the knob has ended the motion.
            if reply.flag in INTERRUPTED and not self._stopped:
                self._pressed = channel
            return True
        homing = channel in self._homing
        self._homing.discard(channel)
        if ended_badly or reply.flag in UNREFERENCED:
            self._referenced.discard(channel)
        flags = {reply.flag}
        if ended_badly or (homing and reply.flag in UNREFERENCED):
            flags |= self._flags(channel)  # the knob's flag ranks below that of the fault it caused
        where = f"{self.name} channel {channel}"
        if self._pressed == channel or (flags & INTERRUPTED and not self._stopped):
            raise MotionStopped(f"{where} was stopped at its knob")
        if reply.flag in LIMITS:
            raise LimitHit(f"{where} {LIMITS[reply.flag]} ({reply.flag}); home it")
        if ended_badly:
            what = FAULTS.get(reply.flag, "reports a fault")
            raise AxisStalled(f"{where} {what} ({reply.flag}); clear the way and home it")
        if self._stopped:
            raise MotionStopped(f"{where} was stopped")
        if homing and reply.flag not in UNREFERENCED:
            self._referenced.add(channel)
        return False

    def resolve_missing_reply(self, channel: str) -> None:
        """MotionStopped if the knob was pressed before our own stop."""
        if self._pressed == channel:
            raise MotionStopped(f"{self.name} channel {channel} was stopped at its knob")

    def position_mm(self, channel: str) -> float:
        """Microsteps / scale, from two answers that agree within the noise of a servo."""
        scale = self._scale(channel)
        return (
            self._settle_reading(channel, lambda: self._integer(channel, "get pos"), self._near(channel, scale))
            / scale
        )

    def rest_position_mm(self, channel: str) -> float:
        """Position [mm]; an answer without a flag confirms the reference, else all flags are queried."""
        with self._lock:
            position_mm = self.position_mm(channel)
            if self._flag != NO_FLAG or not self.has_reference(channel):
                self.confirm_reference(channel)
            return position_mm

    def check_motion(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """StageUsageError if speed or acceleration exceeds the range of its setting."""
        speed, acceleration = self._native(channel, speed_mm_s, acceleration_mm_s2)
        if not (1 <= speed <= LARGEST_SETTING and 1 <= acceleration <= 32767):
            raise StageUsageError(
                f"{self.name} channel {channel}: speed or acceleration is outside the range of the controller"
            )

    def _native(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> tuple[int, int]:
        scale = self._scale(channel)
        # at least 1: the device takes an acceleration of 0 as infinite
        return round(speed_mm_s * scale * PER_SECOND), max(
            1, round(acceleration_mm_s2 * scale * PER_SECOND / 10_000)
        )

    def _check_channel(self, channel: Channel) -> None:
        super()._check_channel(channel)
        if not re.fullmatch(r"[1-9]\d?(/[1-9])?", channel.name):
            raise StageUsageError(
                f"{self.name}: channel {channel.name!r} should be device or device/axis, such as 1/2"
            )

    def _reset_state(self) -> None:
        self._profile = {}
        self._homing = set()

    def _identify(self) -> str:
        words = []
        for device in sorted({_address(name)[0] for name in self._channels}):
            answers = [
                self._reply(device, 0, f"get {what}").data for what in ("deviceid", "system.serial", "version")
            ]
            words.append(f"Zaber {answers[0]} serial {answers[1]} firmware {answers[2]}")
        return ", ".join(words)

    def _set_up(self) -> None:
        versions = re.findall(r"firmware (\d{1,4})\b", self.identity)
        self._firmware = min((int(major) for major in versions), default=0)
        for name in self._channels:
            device, axis = _address(name)
            count = self._ask_again(partial(self._reply, device, 0, "get system.axiscount")).data
            if not (count.isdecimal() and axis <= int(count)):
                raise WrongDevice(
                    f"{self.name}: channel {name} is not there: the axis count of {device} is {count}"
                )

    def _still_referenced(self, channel: str) -> bool:
        return self._remembers_reference(channel)

    def _remembers_reference(self, channel: str) -> bool:
        return not UNREFERENCED & self._flags(channel)

    def _flags(self, channel: str) -> set[str]:
        """Return all flags that are set."""
        reply = self._ask_again(lambda: self._tell(channel, "warnings"))
        return {reply.flag, *reply.data.split()}

    def _stop_bytes(self) -> Sequence[bytes]:
        devices = sorted({_address(name)[0] for name in self._channels})
        return [Command("stop", device, 0, STOP_ID).to_bytes() for device in devices]

    def _take_unsolicited(self, data: bytes) -> None:
        """Ignore late answers and alerts: their number and address distinguish them from the answer awaited."""

    def _surplus(self, answers: Sequence[object], rest: bytes) -> None:
        """Ignore bytes behind the answer, for the same reason."""

    def _integer(self, channel: str, question: str) -> int:
        reply = self._tell(channel, question)
        # Moved by a knob or by a program that was killed: two equal readings may be chance.
        if reply.busy:
            raise StageUsageError(f"{self.name} channel {channel} is moving; wait until it stops")
        data = reply.data
        if not re.fullmatch(r"-?\d{1,15}", data):
            self._suspect = True
            raise ProtocolViolation(f"{self.name}: no whole number", data.encode())
        return int(data)

    def _tell(self, channel: str, text: str, moves: bool = False) -> Reply:
        return self._reply(*_address(channel), text, moves)

    def _reply(self, device: int, axis: int, text: str, moves: bool = False) -> Reply:
        """Send a command and return the answer with its number, from the device and axis addressed."""
        with self._lock:
            number = self._next_id
            self._next_id = (number + 1) % STOP_ID
            command = Command(text, device, axis, number)

            def accept(answer: object) -> Reply | None:
                if isinstance(answer, Reply) and (answer.message_id, answer.device) == (number, device):
                    return answer if answer.axis == axis else None
                return None

            reply = self._transact(command.to_bytes(), accept, moves=moves)
            self._flag = reply.flag
            if not reply.accepted:
                raise CommandRejected(
                    f"{self.name} refused {text!r} for {device}/{axis}: {reply.data}", reply.data
                )
            return reply


def _address(channel: str) -> tuple[int, int]:
    device, _, axis = channel.partition("/")
    return int(device), int(axis or 1)
