"""The two synchronisers that PIVlab drives: oltSync, and the older xmSync (SimpleSync).

9600 8N1, lines that end with CR LF, often behind a radio dongle; every command names the box that it is meant
for by what that box has said of itself. An oltSync says ``oltSync:`` in its name. The host says

    WhoAreYou?      WhichFirmWare?      WarningSignEnable!
    TALKINGTO:<id>:sequence:<cycle us>:<mode>,0:<on>,<off>,<on>,<off>:<on>,<off> ...   a group for each pin, in us
    TALKINGTO:<id>:start        TALKINGTO:<id>:stop

to an oltSync, and to an xmSync everything in one line, the laser's switch included:

    TALKINGTO:<id>;FREQ:..;CAM:..;ENER:..;ener%:..;F1EXP:..;INTERF:..;EXTDLY:..;EXTSKP:..;LASER:enable|disable

Modes: 0 free running, 1 once for each rising edge at the input, 2 while it is high, 3 from a rising edge on. An
oltSync answers a sequence as a whole with ``Sequence:OK`` or ``Sequence:Error``, start and stop with
``Laser:enable`` or ``Laser:disable``. An xmSync answers with 8 or 12 fields between tabs, of which the eighth is
1 when the laser is on; what the others mean is not published.

Nothing tells how many pulses have left, and neither box counts them. Source: PIVlab's own source text (2026),
which is the only documentation there is; the firmware is not public.
"""

import re
from dataclasses import dataclass
from functools import partial

from stages.errors import ProtocolViolation
from stages.protocols.framing import LineStream, TextLine, text_of

QUESTIONS = ("WhoAreYou?", "WhichFirmWare?", "WarningSignEnable!")
LASER_FIELD = 7  # counted from 0
MAX_ANSWER_BYTES = 512

_ID = r"[^:;\s][^;\t]*?"
_SEQUENCE = re.compile(rf"TALKINGTO:({_ID}):sequence:(\d{{1,9}}):(\d),0:([\d,:]+)")
_SWITCH = re.compile(rf"TALKINGTO:({_ID}):(start|stop)")
_SETTINGS = re.compile(
    rf"TALKINGTO:({_ID});FREQ:(-?\d+);CAM:(-?\d+);ENER:(-?\d+);ener%:(-?\d+);F1EXP:(-?\d+);INTERF:(-?\d+);"
    r"EXTDLY:(-?\d+);EXTSKP:(-?\d+);LASER:(enable|disable)"
)


@dataclass(frozen=True, slots=True)
class Question(TextLine):
    """One of QUESTIONS; every box in reach answers, the last one is not answered."""


@dataclass(frozen=True, slots=True)
class Sequence:
    """Pulses of an oltSync in every cycle."""

    device: str
    cycle_us: int
    pins: tuple[tuple[int, ...], ...]  # moments at which each goes on, off, on, off ...
    mode: int = 0

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        pins = ":".join(",".join(str(moment) for moment in pin) for pin in self.pins)
        return f"TALKINGTO:{self.device}:sequence:{self.cycle_us}:{self.mode},0:{pins}\r\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Switch:
    """Start or stop the sequence of an oltSync."""

    device: str
    starts: bool

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"TALKINGTO:{self.device}:{'start' if self.starts else 'stop'}\r\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Settings:
    """All settings of an xmSync, the laser's switch included, in one line."""

    device: str
    frequency_hz: int
    camera_divider: int
    energy_us: int
    energy_percent: int
    first_exposure_us: int
    interframe_us: int
    external_delay_us: int
    external_skip: int
    laser: bool

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return (
            f"TALKINGTO:{self.device};FREQ:{self.frequency_hz};CAM:{self.camera_divider};ENER:{self.energy_us};"
            f"ener%:{self.energy_percent};F1EXP:{self.first_exposure_us};INTERF:{self.interframe_us};"
            f"EXTDLY:{self.external_delay_us};EXTSKP:{self.external_skip};"
            f"LASER:{'enable' if self.laser else 'disable'}\r\n"
        ).encode("ascii")


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict of an oltSync on a sequence."""

    accepted: bool

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return b"Sequence:OK\r\n" if self.accepted else b"Sequence:Error\r\n"


@dataclass(frozen=True, slots=True)
class LaserIs:
    """Laser state of an oltSync."""

    on: bool

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return b"Laser:enable\r\n" if self.on else b"Laser:disable\r\n"


@dataclass(frozen=True, slots=True)
class Report:
    """Answer of an xmSync to every line; 8 fields, or 12."""

    fields: tuple[str, ...]

    @property
    def on(self) -> bool:
        """True if the laser is on."""
        return self.fields[LASER_FIELD] == "1"

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return ("\t".join(self.fields) + "\r\n").encode("ascii")


@dataclass(frozen=True, slots=True)
class Identity(TextLine):
    """Identity of a box, or of its firmware."""


COMMANDS = (Question, Sequence, Switch, Settings)
ANSWERS = (Verdict, LaserIs, Report, Identity)
Command = Question | Sequence | Switch | Settings
Answer = Verdict | LaserIs | Report | Identity


def parse_command(line: bytes) -> Command:
    """Read a line of the host.

    Raises
    ------
    ProtocolViolation
        It is no command of a synchroniser.
    """
    text = text_of(line)
    if text in QUESTIONS:
        return Question(text)
    if match := _SWITCH.fullmatch(text):
        return Switch(match[1], match[2] == "start")
    if match := _SEQUENCE.fullmatch(text):
        try:
            pins = tuple(tuple(int(moment) for moment in pin.split(",")) for pin in match[4].split(":"))
        except ValueError:
            raise ProtocolViolation("a pin without moments", line) from None
        return Sequence(match[1], int(match[2]), pins, int(match[3]))
    if match := _SETTINGS.fullmatch(text):
        hz, divider, energy_us, percent, first_us, dt_us, delay_us, skip = (int(match[n]) for n in range(2, 10))
        on = match[10] == "enable"
        return Settings(match[1], hz, divider, energy_us, percent, first_us, dt_us, delay_us, skip, on)
    raise ProtocolViolation("not a command of a synchroniser", line)


def parse_answer(line: bytes) -> Answer:
    """Read a line of a box.

    Raises
    ------
    ProtocolViolation
        It is no answer of a synchroniser.
    """
    fields = tuple(text_of(field) for field in line.split(b"\t"))
    text = fields[0]
    if len(fields) > 1:
        if len(fields) in (8, 12) and fields[LASER_FIELD] in ("0", "1"):
            return Report(fields)
    elif text.startswith("Sequence:"):
        if text in ("Sequence:OK", "Sequence:Error"):
            return Verdict(text == "Sequence:OK")
    elif text.startswith("Laser:"):
        if text in ("Laser:enable", "Laser:disable"):
            return LaserIs(text == "Laser:enable")
    elif text.strip():
        return Identity(text.strip())
    raise ProtocolViolation("not an answer of a synchroniser", line)


CommandStream = partial(LineStream, parse_command, longest=MAX_ANSWER_BYTES)  # of a host


class AnswerStream(LineStream[Answer]):
    """Bytes of a box to answers."""

    def __init__(self) -> None:
        super().__init__(parse_answer, longest=MAX_ANSWER_BYTES)
