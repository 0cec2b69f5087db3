"""Driver for Grbl 1.1 boards.

Channels are X, Y, Z. All motions are jogs in machine coordinates: they need no modal state, a target out of
travel is refused instead of raising an alarm, and a cancelled jog keeps its position. ``ok`` means queued, so
arrival is read from the state. Scale, speed and acceleration live in the board's settings; they are compared
with the bench file, never written (every write wears the EEPROM and blocks the board).

During ``$H`` no status is answered; its end is the ``ok``. After a hard limit (ALARM:1) the board takes nothing
but a reset, and throws that away if it comes before ``[MSG:Reset to continue]``. DTR is held low because it
resets most boards; the system raises it on opening all the same, so a board may be deaf for the two seconds of its
boot loader. There is no encoder: a stalled motor is not noticed.
"""

from collections.abc import Sequence

from stages.controller import Channel, Controller
from stages.errors import (
    CommandRejected,
    DeviceError,
    LimitHit,
    MotionStopped,
    NoReply,
    ProtocolViolation,
    StageUsageError,
    WrongDevice,
)
from stages.link import QUIET_S, Stream
from stages.protocols import grbl

AXES = ("X", "Y", "Z")
HOMING_ENABLED, REPORT_INCHES = 22, 13
STEPS, RATE, ACCELERATION = 100, 110, 120  # + 0, 1, 2 for X, Y, Z
BANNER_S = 1.5
REFUSALS = {
    5: "homing is switched off ($22=0)",
    8: "only possible at rest",
    9: "locked by an alarm; home it",
    15: "the target is outside the travel",
}


class GrblController(Controller):
    """One Grbl board."""

    default_baud = 115_200
    example_channels = ("X", "Y")
    hold_dtr = True
    wakes_within_s = 4.0
    homes_together = True

    _settings: dict[int, float]
    _homing: bool
    _alarm: int | None
    _pushed: grbl.AnswerStream

    def start_move(self, channel: str, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Begin an absolute move."""
        self._raise_alarm()
        self._stopped = False
        self._line(f"$J=G53G90G21{channel}{target_mm:.4f}F{speed_mm_s * 60:.3f}")

    def start_home(self, channel: str) -> None:
        """Begin to home every axis; the answer comes at the end."""
        with self._lock:
            if self._settings[HOMING_ENABLED] == 0:
                raise StageUsageError(f"{self.name}: homing is switched off; set $22=1 on the board")
            self._referenced.clear()
            if self._alarm is not None:
                self._reset()
            self._clear_line()
            self._stopped = False
            self._homing = True  # before the bytes, so that a stop from another thread sends the right one
            self._pushed = grbl.AnswerStream()
            self.port.write(grbl.Line("$H").to_bytes())

    def moving(self, channel: str) -> bool:
        """Ask for a report, or look for the end of homing."""
        with self._lock:
            if self._homing:
                return self._homing_goes_on()
            self._raise_alarm()
            status = self._repeated(self._status)
            if status.state in ("Run", "Jog", "Home") or (status.state == "Hold" and status.substate == 1):
                return True
            if status.state == "Alarm":
                self._alarm = self._alarm or 0
                self._raise_alarm()
            if self._stopped:
                raise MotionStopped(f"{self.name} was stopped")
            if status.state != "Idle":
                raise DeviceError(f"{self.name} is in state {status.state}; bring it to Idle")
            return False

    def position_mm(self, channel: str) -> float:
        """Machine position, read twice."""
        place = self._agreed(lambda: self._status().position_mm)
        return place[AXES.index(channel)]

    def check_motion(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Raise if the board's own settings differ from the bench file's."""
        index = AXES.index(channel)
        fastest_mm_s = self._settings[RATE + index] / 60
        if speed_mm_s > fastest_mm_s * 1.001:
            raise StageUsageError(f"{self.name} {channel}: at most {fastest_mm_s:.3g} mm/s (${RATE + index})")
        own = self._settings[ACCELERATION + index]
        if abs(own - acceleration_mm_s2) > 0.01 * own:
            raise StageUsageError(
                f"{self.name} {channel}: ${ACCELERATION + index} is {own:g} mm/s2, the bench file says "
                f"{acceleration_mm_s2:g}; make them equal"
            )

    def _check_channel(self, channel: Channel) -> None:
        if channel.name not in AXES:
            raise StageUsageError(f"{self.name}: channel {channel.name!r} should be X, Y or Z")

    def _reset_state(self) -> None:
        self._homing = False
        self._alarm = None
        self._pushed = grbl.AnswerStream()

    def _identify(self) -> str:
        """Answer to $I; a stale ok can only stand before its [VER:...]."""
        seen: list[str] = []

        def accept(answer: object) -> str | None:
            if isinstance(answer, grbl.Feedback) and answer.kind == "VER":
                seen[:] = [f"Grbl {answer.text}"]
            return seen[0] if seen and isinstance(answer, grbl.Ok) else None

        return self._converse(grbl.Line("$I").to_bytes(), accept)

    def _set_up(self) -> None:
        self._settings = self._agreed(self._read_settings)
        if self._settings[REPORT_INCHES]:
            raise WrongDevice(f"{self.name} reports inches; set $13=0 on the board")
        for channel in self._channels.values():
            number = STEPS + AXES.index(channel.name)
            own = self._settings[number]
            if channel.steps_per_mm is not None and abs(own - channel.steps_per_mm) > 1e-3 * own:
                raise WrongDevice(
                    f"{self.name} {channel.name}: ${number} is {own:g} steps/mm, the bench file says "
                    f"{channel.steps_per_mm:g}; make them equal"
                )

    def _read_settings(self) -> dict[int, float]:
        found: dict[int, float] = {}

        def accept(answer: object) -> bool | None:
            if isinstance(answer, grbl.Setting):
                found[answer.number] = float(answer.value)
            return True if isinstance(answer, grbl.Ok) else None

        self._transact(grbl.Line("$$").to_bytes(), accept, timeout_s=2.0)
        needed = (group + AXES.index(name) for group in (STEPS, RATE, ACCELERATION) for name in self._channels)
        if not {HOMING_ENABLED, REPORT_INCHES, *needed} <= found.keys():
            self._suspect = True
            raise ProtocolViolation(f"{self.name}: the list of settings is not complete")
        return found

    def _stop_bytes(self) -> Sequence[bytes]:
        return [grbl.RealTime(grbl.RESET if self._homing else grbl.JOG_CANCEL).to_bytes()]

    def _stream(self) -> Stream:
        return grbl.AnswerStream()

    def _unsolicited(self, data: bytes) -> None:
        """Reports, messages and alarms may come at any time; a late ok may not."""
        self._surplus(self._pushed.feed(data), b"")

    def _surplus(self, answers: Sequence[object], rest: bytes) -> None:
        for answer in answers:
            if isinstance(answer, grbl.Alarm):
                self._note_alarm(answer.code)
            elif isinstance(answer, grbl.Banner):
                self._referenced.clear()  # it has reset itself, and forgotten where it was
            elif not isinstance(answer, grbl.Status | grbl.Feedback):
                self._suspect = True
        self._suspect = self._suspect or bool(rest)

    def _drained(self, data: bytes) -> None:
        suspect = self._suspect
        self._surplus(grbl.AnswerStream().feed(data), b"")
        self._suspect = suspect
        self._raise_alarm()

    def _note_alarm(self, code: int) -> None:
        self._alarm = code
        if code != 2:  # a refused target keeps the position
            self._referenced.clear()

    def _raise_alarm(self) -> None:
        if early := self.port.pending():
            self._unsolicited(early)
        if self._alarm is None:
            return
        reason = grbl.ALARMS.get(self._alarm, "locked")
        message = f"{self.name}: alarm {self._alarm}, {reason}; home it"
        raise LimitHit(message) if self._alarm == 1 else DeviceError(message)

    def _status(self) -> grbl.Status:
        def accept(answer: object) -> grbl.Status | None:
            if isinstance(answer, grbl.Alarm):
                self._note_alarm(answer.code)
                self._raise_alarm()
            if isinstance(answer, grbl.Banner):
                self._referenced.clear()
                raise DeviceError(f"{self.name} has reset itself; home it")
            return answer if isinstance(answer, grbl.Status) else None

        status = self._transact(grbl.RealTime(grbl.STATUS).to_bytes(), accept)
        if not status.machine:
            raise WrongDevice(f"{self.name} reports work positions; set $10=1 on the board")
        return status

    def _line(self, text: str) -> None:
        def accept(answer: object) -> grbl.Ok | grbl.Refusal | None:
            if isinstance(answer, grbl.Alarm):
                self._note_alarm(answer.code)
                self._raise_alarm()
            if isinstance(answer, grbl.Feedback) and answer.kind == "VER":
                self._suspect = True  # a fence answered twice: the ok behind it is not ours
                raise ProtocolViolation(f"{self.name}: an older answer came late", answer.to_bytes())
            return answer if isinstance(answer, grbl.Ok | grbl.Refusal) else None

        answer = self._transact(grbl.Line(text).to_bytes(), accept)
        if isinstance(answer, grbl.Refusal):
            reason = REFUSALS.get(answer.code, "refused")
            raise CommandRejected(f"{self.name}: {text!r}: {reason} (error {answer.code})", answer.code)

    def _homing_goes_on(self) -> bool:
        for answer in self._pushed.feed(self.port.pending()):
            if isinstance(answer, grbl.Alarm):
                self._homing = False
                self._note_alarm(answer.code)
                if self._stopped:
                    raise MotionStopped(f"{self.name} was stopped while homing; home it again")
                self._raise_alarm()
            if isinstance(answer, grbl.Refusal):
                self._homing = False
                raise CommandRejected(f"{self.name}: homing refused (error {answer.code})", answer.code)
            if isinstance(answer, ProtocolViolation):
                self._suspect = True
            if isinstance(answer, grbl.Ok):
                self._homing = False
                self._referenced |= set(self._channels)
                return False
        return True

    def _reset(self) -> None:
        """Soft reset until the banner comes; the first one after a limit may be thrown away."""
        for _ in range(3):
            self.port.drain(QUIET_S)
            try:
                self._converse(grbl.RealTime(grbl.RESET).to_bytes(), _banner, BANNER_S)
            except (NoReply, ProtocolViolation):
                continue
            self.port.drain(QUIET_S)
            self._suspect = False
            self._alarm = None
            return
        raise DeviceError(f"{self.name} does not come back from a reset; switch it off and on")


def _banner(answer: object) -> bool | None:
    return True if isinstance(answer, grbl.Banner) else None
