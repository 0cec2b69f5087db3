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

from stages.errors import ProtocolViolation
from stages.protocols.framing import Example, LineStream, text_of

DOC = "gnea/grbl v1.1 doc/markdown"

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

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented lines."""
        return (
            Example(b"$J=X10.0 Y-1.5\n", cls("$J=X10.0 Y-1.5"), f"{DOC}/jogging.md"),
            Example(b"$J=G53 Y5.0\n", cls("$J=G53 Y5.0"), f"{DOC}/jogging.md"),
            Example(b"$H\n", cls("$H"), f"{DOC}/commands.md"),
        )


@dataclass(frozen=True, slots=True)
class RealTime:
    """A byte that is obeyed at once."""

    code: int

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return bytes([self.code])

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented bytes."""
        return (
            Example(b"?", cls(STATUS), f"{DOC}/commands.md"),
            Example(b"!", cls(HOLD), f"{DOC}/commands.md"),
            Example(b"\x18", cls(RESET), f"{DOC}/commands.md"),
            Example(b"\x85", cls(JOG_CANCEL), f"{DOC}/commands.md"),
        )


@dataclass(frozen=True, slots=True)
class Ok:
    """The last line was taken."""

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return b"ok\r\n"

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented lines."""
        return (Example(b"ok\r\n", cls(), f"{DOC}/interface.md, Response Messages"),)


@dataclass(frozen=True, slots=True)
class Refusal:
    """The last line was refused."""

    code: int

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"error:{self.code}\r\n".encode("ascii")

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented lines."""
        return (Example(b"error:15\r\n", cls(15), f"{DOC}/interface.md, jog target exceeds travel"),)


@dataclass(frozen=True, slots=True)
class Alarm:
    """Everything has stopped; the code says why."""

    code: int

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"ALARM:{self.code}\r\n".encode("ascii")

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented lines."""
        return (Example(b"ALARM:1\r\n", cls(1), f"{DOC}/interface.md, Alarm Message"),)


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

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented and recorded lines."""
        return (
            Example(
                b"<Idle|MPos:0.000,-10.000,5.000|FS:0,0>\r\n",
                cls("Idle", (0.0, -10.0, 5.0), extras=(("FS", "0,0"),)),
                f"{DOC}/interface.md, Current Position and FS",
            ),
            Example(
                b"<Hold:0|WPos:-2.500,0.000,11.000|Bf:15,128>\r\n",
                cls("Hold", (-2.5, 0.0, 11.0), False, 0, (("Bf", "15,128"),)),
                f"{DOC}/interface.md, sub-states, work position, buffer state",
            ),
            Example(
                b"<Alarm:11|MPos:0.000,0.000,0.000|FS:0,0>\r\n",
                cls("Alarm", (0.0, 0.0, 0.0), substate=11, extras=(("FS", "0,0"),)),
                "grblHAL, report extensions: the alarm's number",
            ),
        )


@dataclass(frozen=True, slots=True)
class Setting:
    """One line of $$."""

    number: int
    value: str

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"${self.number}={self.value}\r\n".encode("ascii")

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented lines."""
        return (
            Example(b"$100=250.000\r\n", cls(100, "250.000"), f"{DOC}/interface.md, $$"),
            Example(b"$13=0\r\n", cls(13, "0"), f"{DOC}/interface.md, $$"),
            Example(b"$74=\r\n", cls(74, ""), "grblHAL, settings with network support: no name is set"),
            Example(b"$396=http\r\n", cls(396, "http"), "grblHAL, settings of its web server"),
        )


@dataclass(frozen=True, slots=True)
class Feedback:
    """A line in brackets: MSG, VER, OPT, GC ..."""

    kind: str
    text: str

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"[{self.kind}:{self.text}]\r\n".encode("ascii")

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented lines."""
        return (
            Example(b"[MSG:Reset to continue]\r\n", cls("MSG", "Reset to continue"), f"{DOC}/interface.md"),
            Example(
                b"[VER:v1.1d.20161014:Some string]\r\n",
                cls("VER", "v1.1d.20161014:Some string"),
                f"{DOC}/interface.md",
            ),
            Example(b"[OPT:VL]\r\n", cls("OPT", "VL"), f"{DOC}/interface.md"),
        )


@dataclass(frozen=True, slots=True)
class Banner:
    """The first line after power-up and after every reset."""

    version: str
    firmware: str = "Grbl"
    words: str = "'$' for help"

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"{self.firmware} {self.version} [{self.words}]\r\n".encode("ascii")

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented lines."""
        return (
            Example(b"Grbl 1.1h ['$' for help]\r\n", cls("1.1h"), f"{DOC}/interface.md, Start Up Message"),
            Example(
                b"GrblHAL 1.1f ['$' or '$HELP' for help]\r\n",
                cls("1.1f", "GrblHAL", "'$' or '$HELP' for help"),
                "grblHAL, start-up message",
            ),
            Example(
                b"Grbl 3.7 [FluidNC v3.7.8 (wifi) '$' for help]\r\n",
                cls("3.7", "Grbl", "FluidNC v3.7.8 (wifi) '$' for help"),
                "FluidNC wiki, start-up message",
            ),
        )


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


class CommandStream(LineStream[Line | RealTime]):
    """Bytes of a host to lines and real-time bytes, in order of arrival."""

    def __init__(self) -> None:
        singles = {code: RealTime(code) for code in REALTIME}
        super().__init__(lambda line: Line(text_of(line)), longest=80, singles=singles)


class AnswerStream(LineStream[Answer]):
    """Bytes of a controller to answers."""

    def __init__(self) -> None:
        super().__init__(parse_answer)
