"""Driver for Grbl 1.1 boards.

Channels are X, Y, Z. All motions are jogs in machine coordinates: they need no modal state, a target out of
travel is refused instead of raising an alarm, and a cancelled jog keeps its position. ``ok`` means queued, so
arrival is read from the state. Scale, speed and acceleration live in the board's settings; they are compared
with the bench file, never written (every write wears the EEPROM and blocks the board).

During ``$H`` no status is answered; its end is the ``ok``. After a hard limit (ALARM:1) the board takes nothing
but a reset, and throws that away if it comes before ``[MSG:Reset to continue]``. DTR is held low because it
resets most boards; the system raises it on opening all the same, so a board may be deaf for the two seconds of its
boot loader. There is no encoder: a stalled motor is not noticed.

**Restarts.** A board that has restarted greets with a banner and (homing enabled) stands in Alarm until a person
unlocks it. Either may be missed: the banner may be cut or damaged, the alarm unlocked at a pendant. So homing
leaves a mark on the board that every restart and reset wipes out and that means nothing to a machine without a
tool changer: the number of the tool (``T137``), drawn anew each time and read back with ``$G`` after every
position. Boards that do not keep it are judged by banner and state alone.

**Stops at the board.** A feed hold (button, pendant) ends a jog like a cancel: the board is Idle again, short of
the target. So an axis that rests elsewhere than where it was sent has been stopped by a person. A feed hold at
rest (the same button, or noise on its wire) leaves the board in Hold: it reads no line any more, but reports when
it is asked by ``?`` (state "Hold:0" of the interface description of Grbl 1.1). So whatever stays unanswered is
followed by that question. Nothing here resumes what a person may have held.

All input goes through one decoder, so a line that comes in two pieces is one line, whatever reads the second
piece.
"""

import re
from collections.abc import Sequence
from contextlib import suppress

from stages.controller import Channel, Controller
from stages.errors import (
    CommandRejected,
    DeviceError,
    LimitHit,
    MotionStopped,
    NoReply,
    NotReferenced,
    ProtocolViolation,
    StageUsageError,
    WrongDevice,
)
from stages.link import QUIET_S, Stream
from stages.motion_controller import NOISE_COUNTS
from stages.protocols import grbl
from stages.protocols.framing import LineStream

AXES = ("X", "Y", "Z")
HOMING_ENABLED, REPORT_INCHES, REPORTS = 22, 13, 10
MACHINE_POSITIONS = 1  # bit of REPORTS
STEPS, RATE, ACCELERATION = 100, 110, 120  # + 0, 1, 2 for X, Y, Z
BANNER_S = 1.5
HELD_AFTER_S = 0.5  # between questions while it homes: is it held?
REPORT_S = 0.2  # a report is given at once, or not at all
MARKS = range(2, 251)  # tool numbers that are not in common use
REPORTED_MM = 0.001  # positions have three decimals
RESET_BY_A_PERSON = (3, 6)  # in motion, while homing: this driver resets only to stop a reference run
REFUSALS = {
    5: "homing is switched off ($22=0)",
    8: "only possible at rest",
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
    _input: LineStream[grbl.Answer]
    _sent_to_mm: dict[str, float]
    _mark: int | None = None
    _asked_s: float = 0.0  # when it was last asked while it homes
    _unread: bool = False  # a jog may wait in the board's buffer

    def start_move(self, channel: str, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Begin an absolute move."""
        self._raise_alarm()
        self._stopped = False
        self._sent_to_mm = {channel: target_mm}
        try:
            self._line(f"$J=G53G90G21{channel}{target_mm:.4f}F{speed_mm_s * 60:.3f}", moves=True)
        except (NoReply, ProtocolViolation):
            self._empty_unless_read()
            raise

    def start_home(self, channel: str) -> None:
        """Begin to home every axis; the answer comes at the end. StageUsageError if homing is switched off."""
        with self._lock:
            if self._settings[HOMING_ENABLED] == 0:
                raise StageUsageError(f"{self.name}: homing is switched off; set $22=1 on the board")
            self._forget_references()
            if self._alarm is not None:
                self._reset()
            self._clear_line()
            self._look_for_hold()
            self._stopped = False
            self._sent_to_mm = {}
            with self._gate(moves=True):
                self._homing = True  # before the bytes, so that a stop from another thread sends the right one
                self._input, self._asked_s = grbl.AnswerStream(), self.clock.now_s()
                self.port.write(grbl.Line("$H").to_bytes())

    def moving(self, channel: str) -> bool:
        """Ask for a report, or look for the end of homing.

        MotionStopped also if a person has stopped it at the board; DeviceError if the board is neither idle nor
        moving nor held.
        """
        with self._lock:
            if self._homing:
                return self._homing_goes_on()
            self._raise_alarm()
            status = self._ask_again(self._status)
            if _drives(status):
                return True
            if status.state == "Alarm":
                self._alarm = self._alarm or 0
                self._raise_alarm()
            if self._stopped:
                raise MotionStopped(f"{self.name} was stopped")
            if status.state in ("Hold", "Door"):
                raise MotionStopped(f"{self.name} is held at the board ({status.state}); release it there")
            if status.state != "Idle":
                raise DeviceError(f"{self.name} is in state {status.state}; bring it to Idle")
            if self._is_short(channel, status):
                status = self._ask_again(self._status)  # had it only not begun when it was asked?
                if status.state != "Idle":
                    return True
                if self._is_short(channel, status):
                    raise MotionStopped(f"{self.name} was stopped at the board short of {channel}'s target")
            self._sent_to_mm = {}
            return False

    def position_mm(self, channel: str) -> float:
        """Machine position, that two answers agree on; StageUsageError if the board moves."""
        index = AXES.index(channel)

        def ask() -> tuple[float, bool]:
            status = self._status()
            if _drives(status):  # by a pendant or another program: two readings may agree by chance
                raise StageUsageError(f"{self.name} is moving; wait until it stops")
            self._raise_if_held(status)  # it would not confirm a position
            return status.position_mm[index], status.state == "Alarm"

        near = self._near(channel)
        place_mm, locked = self._settle_reading(channel, ask, lambda a, b: near(a[0], b[0]) and a[1] == b[1])
        if locked:
            self._forget_references()
        return place_mm

    def _is_short(self, channel: str, status: grbl.Status) -> bool:
        """Return whether a channel that was sent somewhere is not there."""
        if channel not in self._sent_to_mm:
            return False
        here_mm = status.position_mm[AXES.index(channel)]
        return not self._near(channel)(here_mm, self._sent_to_mm[channel])

    def noise_mm(self, channel: str) -> float:
        """By the counts of the board, as fine as it reports them."""
        step_mm = 1.0 / self._settings[STEPS + AXES.index(channel)] + REPORTED_MM
        return min(super().noise_mm(channel), NOISE_COUNTS * step_mm)

    def _still_referenced(self, channel: str) -> bool:
        if self._mark is not None:
            return self._ask_again(self._tool) == self._mark or self._ask_until_equal(self._tool) == self._mark
        return self._ask_again(self._status).state != "Alarm"

    def _forget_references(self) -> None:
        super()._forget_references()
        self._mark = None

    def _leave_mark(self) -> None:
        """Give the board something to forget."""
        number = MARKS[int(1e6 * self.clock.now_s()) % len(MARKS)]  # other programs have come at other times
        try:
            self._line(f"T{number}")
            self._mark = number if self._ask_until_equal(self._tool) == number else None
        except (CommandRejected, NoReply, ProtocolViolation):
            self._mark = None  # not every descendant keeps a tool

    def _tool(self) -> int | None:
        """Modal number of the tool; None if the board does not tell."""
        seen: set[int] = set()

        def accept(answer: object) -> set[int] | None:
            self._overhear(answer)
            if isinstance(answer, grbl.Feedback) and answer.kind == "GC":
                seen.update(int(number) for number in re.findall(r"\bT(\d{1,9})\b", answer.text))
            return seen if isinstance(answer, grbl.Ok | grbl.Refusal) else None

        found = self._transact(grbl.Line("$G").to_bytes(), accept)
        return found.pop() if len(found) == 1 else None

    def check_motion(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """StageUsageError if the board is set slower than the bench file says, or to another acceleration."""
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
        self._input = grbl.AnswerStream()
        self._sent_to_mm = {}

    def _identify(self) -> str:
        """Answer to $I; a stale ok can only stand before its [VER:...]."""
        seen: list[str] = []

        def accept(answer: object) -> str | None:
            self._overhear(answer)
            if isinstance(answer, grbl.Feedback) and answer.kind == "VER":
                seen[:] = [f"Grbl {answer.text}"]
            return seen[0] if seen and isinstance(answer, grbl.Ok) else None

        try:
            identity = self._converse(grbl.Line("$I").to_bytes(), accept)
        except NoReply:
            self._look_for_hold()
            raise
        self._unread = False  # lines are read in order
        return identity

    def _set_up(self) -> None:
        self._settings = self._ask_until_equal(self._read_settings)
        if self._settings[REPORT_INCHES]:
            raise WrongDevice(f"{self.name} reports inches; set $13=0 on the board")
        if not int(self._settings.get(REPORTS, MACHINE_POSITIONS)) & MACHINE_POSITIONS:
            raise WrongDevice(f"{self.name} reports work positions; set ${REPORTS}=1 on the board")
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
            self._overhear(answer)
            if isinstance(answer, grbl.Setting) and re.fullmatch(r"-?\d{1,9}(\.\d{1,6})?", answer.value):
                found[answer.number] = float(answer.value)  # descendants have settings that are texts
            return True if isinstance(answer, grbl.Ok) else None

        self._transact(grbl.Line("$$").to_bytes(), accept, timeout_s=2.0)
        needed = (group + AXES.index(name) for group in (STEPS, RATE, ACCELERATION) for name in self._channels)
        if not {HOMING_ENABLED, REPORT_INCHES, *needed} <= found.keys():
            self._suspect = True
            raise ProtocolViolation(f"{self.name}: the list of settings is not complete")
        return found

    def _stop_bytes(self) -> Sequence[bytes]:
        waits = self._homing or self._unread
        return [grbl.RealTime(grbl.RESET if waits else grbl.JOG_CANCEL).to_bytes()]

    def watchdog_bytes(self) -> Sequence[bytes]:
        """Cancel of a jog, then a reset: it is not known any more whether it was homing."""
        return [grbl.RealTime(grbl.JOG_CANCEL).to_bytes(), grbl.RealTime(grbl.RESET).to_bytes()]

    def _stream(self) -> Stream:
        return self._input

    def _take_unsolicited(self, data: bytes) -> None:
        """Reports, messages and alarms may come at any time; a late ok or half a line may not."""
        answers = self._input.feed(data)
        self._surplus(answers, self._input.rest)

    def _surplus(self, answers: Sequence[object], rest: bytes) -> None:
        for answer in answers:
            self._overhear(answer)
            if not isinstance(answer, grbl.Status | grbl.Feedback | grbl.Alarm | grbl.Banner):
                self._suspect = True
        self._suspect = self._suspect or bool(rest)

    def _overhear(self, answer: object) -> None:
        """Note messages that may come at any time and take the reference away."""
        if isinstance(answer, grbl.Alarm):
            self._note_alarm(answer.code)
        elif isinstance(answer, grbl.Banner):
            self._forget_references()

    def _take_drained(self, data: bytes) -> None:
        suspect = self._suspect
        self._surplus(self._input.feed(data), b"")
        self._input = grbl.AnswerStream()  # what has no end after such a silence will have none
        self._suspect = suspect
        self._raise_alarm()

    def _note_alarm(self, code: int) -> None:
        self._alarm = code
        if code != 2:  # a refused target keeps the position
            self._forget_references()

    def _raise_alarm(self) -> None:
        if early := self.port.pending():
            self._take_unsolicited(early)
        if self._alarm is None:
            return
        reason = grbl.ALARMS.get(self._alarm, "locked")
        message = f"{self.name}: alarm {self._alarm}, {reason}; home it"
        if self._alarm in RESET_BY_A_PERSON:
            raise MotionStopped(message)
        raise LimitHit(message) if self._alarm == 1 else DeviceError(message)

    def _status(self) -> grbl.Status:
        def accept(answer: object) -> grbl.Status | None:
            self._overhear(answer)
            self._raise_if_alarm_or_restart(answer)
            return answer if isinstance(answer, grbl.Status) else None

        status = self._transact(grbl.RealTime(grbl.STATUS).to_bytes(), accept)
        if not status.machine:
            raise WrongDevice(f"{self.name} reports work positions; set ${REPORTS}=1 on the board")
        return status

    def _raise_if_alarm_or_restart(self, answer: object) -> None:
        if isinstance(answer, grbl.Alarm):
            self._raise_alarm()
        if isinstance(answer, grbl.Banner):
            raise NotReferenced(f"{self.name} has restarted or was reset; home it")

    def _line(self, text: str, moves: bool = False) -> None:
        def accept(answer: object) -> grbl.Ok | grbl.Refusal | None:
            self._overhear(answer)
            self._raise_if_alarm_or_restart(answer)
            if isinstance(answer, grbl.Feedback) and answer.kind == "VER":
                self._suspect = True  # a fence answered twice: the ok behind it is not ours
                raise ProtocolViolation(f"{self.name}: an older answer came late", answer.to_bytes())
            return answer if isinstance(answer, grbl.Ok | grbl.Refusal) else None

        answer = self._transact(grbl.Line(text).to_bytes(), accept, moves=moves)
        if isinstance(answer, grbl.Refusal):
            if answer.code == grbl.LOCKED:
                self._forget_references()  # an alarm or a restart that was not heard of
                raise NotReferenced(f"{self.name}: locked by an alarm or a restart; home it")
            reason = REFUSALS.get(answer.code, "refused")
            raise CommandRejected(f"{self.name}: {text!r}: {reason} (error {answer.code})", answer.code)

    def _look_for_hold(self) -> None:
        """DeviceError if the board is held; a report is the one thing that it gives then."""

        def accept(answer: object) -> grbl.Status | None:
            self._overhear(answer)
            return answer if isinstance(answer, grbl.Status) else None

        with suppress(NoReply, ProtocolViolation):
            self._raise_if_held(self._converse(grbl.RealTime(grbl.STATUS).to_bytes(), accept, REPORT_S))

    def _raise_if_held(self, status: grbl.Status) -> None:
        if status.state in ("Hold", "Door") and not _drives(status):
            state = status.state if status.substate is None else f"{status.state}:{status.substate}"
            raise DeviceError(
                f"{self.name} is held at the board ({state}) and ignores all commands; release it there (cycle "
                "start), or switch it off and on and home it"
            )

    def _empty_unless_read(self) -> None:
        """See that a jog without an answer does not wait in the board.

        A board that is held reads no line: it would obey whenever it is released, long after a stop. A
        report needs no fence, its shape tells it. Where none comes either, stops reset the board until it has
        read a line.
        """

        def accept(answer: object) -> grbl.Status | None:
            self._overhear(answer)
            return answer if isinstance(answer, grbl.Status) else None

        with self._lock:
            ask = grbl.RealTime(grbl.STATUS).to_bytes()
            self._unread = True
            with suppress(NoReply, ProtocolViolation):
                if self._ask_again(lambda: self._converse(ask, accept)).state in ("Hold", "Door"):
                    self._reset()
                    self._forget_references()
                    raise MotionStopped(f"{self.name} is held at the board; release it there, then home it")
                self._unread = False

    def _homing_goes_on(self) -> bool:
        """Look for the end of homing, and whether the board was held before it has read the command.

        A board that homes gives no report, or says Home; one that is held gives one, and would obey later.
        """
        if self.clock.now_s() - self._asked_s >= HELD_AFTER_S:
            self._asked_s = self.clock.now_s()
            self.port.write(grbl.RealTime(grbl.STATUS).to_bytes())
        for answer in self._input.feed(self.port.pending()):
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
            if isinstance(answer, grbl.Status) and answer.state in ("Hold", "Door") and not _drives(answer):
                self._homing = False
                self._reset()
                raise MotionStopped(f"{self.name} was held at the board before it homed; release it, then home it")
            if isinstance(answer, grbl.Banner):
                if self._stopped:
                    self._homing = False
                    raise MotionStopped(f"{self.name} was stopped while homing; home it again")
                self._reset()  # the banner may be of a restart before $H: then the board is homing still
                self._homing = False
                raise NotReferenced(f"{self.name} has restarted or was reset while homing; home it again")
            if isinstance(answer, grbl.Ok):
                self._homing = False
                self._leave_mark()
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
            self._unread = False
            return
        raise DeviceError(f"{self.name} does not respond after a reset; switch it off and on")


def _banner(answer: object) -> bool | None:
    return True if isinstance(answer, grbl.Banner) else None


def _drives(status: grbl.Status) -> bool:
    """Return whether the board moves now; held, it brakes still under substate 1."""
    return status.state in ("Run", "Jog", "Home") or (status.state == "Hold" and status.substate == 1)
