"""Grbl 1.1: G-code on small boards, 115200 8N1.

Two kinds of input. LINES end with CR or LF and are answered ``ok`` or ``error:n`` each; a motion is answered
when it is QUEUED, not when it has ended. REAL-TIME bytes have no line end, are picked out of the stream at once
and have no answer of their own: ``?`` asks for a status report, ``!`` holds, ``~`` resumes, 0x18 resets, 0x85
cancels a jog.

Output is lines ended CR LF: ``ok``, ``error:n``, ``ALARM:n``, ``<State|MPos:x,y,z|...>``, ``$n=value``,
``[KIND:text]`` and the banner after every reset. Reports, alarms and messages come at any time, so an answer is
recognised by its shape, never by its place. Several ``?`` may get one report; during homing none is answered.

Jogs (``$J=``) are the safe motions: out of travel they are refused with ``error:15`` instead of an alarm, and
0x85 or ``!`` ends them without losing the position.

Two descendants speak the same with more words: grblHAL (banner ``GrblHAL 1.1f [...]``, sub-states of up to three
digits as in ``<Alarm:11|...>``, settings that hold texts or nothing) and FluidNC (banner ``Grbl 3.7 [FluidNC
v3.7.8 (wifi) '$' for help]``).

Source: gnea/grbl, doc/markdown/{interface,commands,jogging,settings}.md, v1.1; grblHAL, core wiki, "Report
extensions"; FluidNC wiki, "Startup messages".
"""

import re
from dataclasses import dataclass
from functools import partial

from stages.errors import ProtocolViolation
from stages.protocols.framing import LineStream, text_of

STATUS, HOLD, RESUME, RESET, JOG_CANCEL = 0x3F, 0x21, 0x7E, 0x18, 0x85
REALTIME = (STATUS, HOLD, RESUME, RESET, JOG_CANCEL)
STATES = ("Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep", "Tool")

ALARMS = {
    1: "hard limit triggered, position lost",
    2: "target outside the travel",
    3: "reset while moving, position lost",
    6: "reset during homing",
    7: "door opened during homing",
    8: "homing could not clear the switch",
    9: "homing found no switch",
}

LOCKED = 9  # refused: an alarm or a restart stands
UNNAMED = 0  # a refusal or an alarm in words that are not known
VERBOSE_ALARMS = {  # FluidNC with verbose errors tells them by name
    "hard limit": 1, "soft limit": 2, "abort cycle": 3, "probe fail initial": 4, "probe fail contact": 5,
    "homing fail reset": 6, "homing fail door": 7, "homing fail pulloff": 8, "homing fail approach": 9,
}  # fmt: skip

_NUMBER = r"-?\d{1,9}\.\d{1,6}"
_STATUS = re.compile(rf"<([A-Z][a-z]+)(?::(\d{{1,3}}))?\|(MPos|WPos):({_NUMBER}(?:,{_NUMBER})*)((?:\|[^|<>]*)*)>")


@dataclass(frozen=True, slots=True)
class Line:
    """A line for the controller."""

    text: str

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return (self.text + "\n").encode("ascii")


@dataclass(frozen=True, slots=True)
class RealTime:
    """A byte that is obeyed at once."""

    code: int

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return bytes([self.code])


@dataclass(frozen=True, slots=True)
class Ok:
    """The last line was taken."""

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return b"ok\r\n"


@dataclass(frozen=True, slots=True)
class Refusal:
    """The last line was refused."""

    code: int

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"error:{self.code}\r\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Alarm:
    """Everything has stopped; the code says why."""

    code: int

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"ALARM:{self.code}\r\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Status:
    """A report: state, position [mm], and whether it is the machine's or the work coordinate system's."""

    state: str
    position_mm: tuple[float, ...]
    machine: bool = True
    substate: int | None = None
    extras: tuple[tuple[str, str], ...] = ()

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        state = self.state if self.substate is None else f"{self.state}:{self.substate}"
        place = ",".join(f"{value:.3f}" for value in self.position_mm)
        fields = "".join(f"|{name}:{value}" for name, value in self.extras)
        return f"<{state}|{'MPos' if self.machine else 'WPos'}:{place}{fields}>\r\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Setting:
    """One line of $$."""

    number: int
    value: str

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"${self.number}={self.value}\r\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Feedback:
    """A line in brackets: MSG, VER, OPT, GC ..."""

    kind: str
    text: str

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"[{self.kind}:{self.text}]\r\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Banner:
    """The first line after power-up and after every reset."""

    version: str
    firmware: str = "Grbl"
    words: str = "'$' for help"

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"{self.firmware} {self.version} [{self.words}]\r\n".encode("ascii")


COMMANDS = (Line, RealTime)
ANSWERS = (Ok, Refusal, Alarm, Status, Setting, Feedback, Banner)
Answer = Ok | Refusal | Alarm | Status | Setting | Feedback | Banner


def parse_answer(line: bytes) -> Answer:
    """Read a line of the controller.

    Raises
    ------
    ProtocolViolation
        It is none of the lines in the module's text.
    """
    text = text_of(line)
    if text == "ok":
        return Ok()
    if match := re.fullmatch(r"error: ?(\d{1,3}|[A-Z].{0,80})", text):
        in_words = LOCKED if "lock" in match[1].lower() else UNNAMED
        return Refusal(int(match[1]) if match[1].isdecimal() else in_words)
    if match := re.fullmatch(r"ALARM: ?(\d{1,3}|[A-Z].{0,80})", text, re.IGNORECASE):
        return Alarm(int(match[1]) if match[1].isdecimal() else VERBOSE_ALARMS.get(match[1].lower(), UNNAMED))
    if match := re.fullmatch(r"\$(\d{1,4})=(.{0,200})", text):
        return Setting(int(match[1]), match[2])
    if match := re.fullmatch(r"\[([A-Za-z0-9][A-Za-z0-9 +_]{0,30}):(.*)\]", text):
        return Feedback(match[1], match[2])
    if match := re.fullmatch(r"(Grbl|GrblHAL) (\S+) \[(.{0,80} for help)\]", text):
        return Banner(match[2], match[1], match[3])
    if (match := _STATUS.fullmatch(text)) and match[1] in STATES:
        extras = tuple((name, value) for name, _, value in (f.partition(":") for f in match[5].split("|")[1:]))
        place = tuple(float(word) for word in match[4].split(","))
        return Status(match[1], place, match[3] == "MPos", None if match[2] is None else int(match[2]), extras)
    raise ProtocolViolation("not a Grbl line", line)


_SINGLES = {code: RealTime(code) for code in REALTIME}
CommandStream = partial(
    LineStream[Line | RealTime], lambda line: Line(text_of(line)), longest=80, singles=_SINGLES
)  # of a host: lines and real-time bytes, in order of arrival
AnswerStream = partial(LineStream, parse_answer)  # of a board
