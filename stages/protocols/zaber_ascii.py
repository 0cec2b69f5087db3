"""Zaber ASCII, firmware 6 and 7.

A chain of devices with up to 9 axes each is connected to one line, 115200 8N1.  The host says

    /<device> <axis> <id> <command>[:<checksum>] LF          missing numbers mean 0 = all / the device itself

and every addressed device answers

    @<device> <axis> [<id>] OK|RJ IDLE|BUSY <flag> <data>[:<checksum>] CR LF

The id (00-99) comes back unchanged, so a late answer is distinguished from the one expected.  ``#`` lines add
information to an answer, ``!`` lines are unsolicited alerts.  The flag is the most important warning:
``--`` none, WR no reference, WH not homed, FS stalled, FD driver off, FQ encoder, WL unexpected limit,
NI interrupted, NC manual control.  The checksum is the two's complement of the sum of the bytes between
the first character and the colon, as two hexadecimal digits.

Source: Zaber, "ASCII Protocol Manual", firmware 6 and 7.
"""

import re
from dataclasses import dataclass
from functools import partial

from stages.errors import ProtocolViolation
from stages.protocols.framing import LineStream, text_of

_REPLY = re.compile(r"@(\d{2}) (\d) (?:(\d{2}) )?(OK|RJ) (IDLE|BUSY) (--|[A-Z][A-Z0-9])(?: (.*))?")
_INFO = re.compile(r"#(\d{2}) (\d) (?:(\d{2}) )?(.*)")
_ALERT = re.compile(r"!(\d{2}) (\d) (IDLE|BUSY) (--|[A-Z][A-Z0-9])(?: (.*))?")
_CHECKSUM = re.compile(r"(.*):([0-9A-F]{2})")


def checksum(body: str) -> str:
    """Two hexadecimal digits that bring the byte sum of `body` to zero modulo 256."""
    return f"{-sum(body.encode('ascii')) & 0xFF:02X}"


@dataclass(frozen=True, slots=True)
class Command:
    """Command of a host; an empty text only asks for the state."""

    text: str
    device: int = 0
    axis: int = 0
    message_id: int | None = None
    checked: bool = True

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        words = [str(self.device), str(self.axis)]
        if self.message_id is not None:
            words.append(f"{self.message_id:02d}")
        body = " ".join([*words, self.text]) if self.text else " ".join(words)
        return f"/{_with_checksum(body, self.checked)}\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Reply:
    """The one answer of a device to a command."""

    device: int
    axis: int
    accepted: bool
    busy: bool
    flag: str
    data: str
    message_id: int | None = None
    checked: bool = True

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        number = "" if self.message_id is None else f"{self.message_id:02d} "
        verdict, state = "OK" if self.accepted else "RJ", "BUSY" if self.busy else "IDLE"
        body = f"{self.device:02d} {self.axis} {number}{verdict} {state} {self.flag} {self.data}"
        return f"@{_with_checksum(body, self.checked)}\r\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Info:
    """A line that continues an answer."""

    device: int
    axis: int
    text: str
    message_id: int | None = None
    checked: bool = True

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        number = "" if self.message_id is None else f"{self.message_id:02d} "
        body = f"{self.device:02d} {self.axis} {number}{self.text}"
        return f"#{_with_checksum(body, self.checked)}\r\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Alert:
    """Unsolicited message of a device, such as the end of a motion."""

    device: int
    axis: int
    busy: bool
    flag: str
    data: str = ""
    checked: bool = True

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        body = f"{self.device:02d} {self.axis} {'BUSY' if self.busy else 'IDLE'} {self.flag}"
        body = f"{body} {self.data}" if self.data else body
        return f"!{_with_checksum(body, self.checked)}\r\n".encode("ascii")


COMMANDS = (Command,)
ANSWERS = (Reply, Info, Alert)
Answer = Reply | Info | Alert


def _with_checksum(body: str, checked: bool) -> str:
    return f"{body}:{checksum(body)}" if checked else body


def _verify_body(line: bytes) -> tuple[str, bool]:
    """First character and body of a line, after its checksum has been verified and cut off."""
    text = text_of(line)
    match = _CHECKSUM.fullmatch(text)
    if match is None:
        return text, False
    if checksum(match[1][1:]) != match[2]:
        raise ProtocolViolation("the checksum is wrong", line)
    return match[1], True


def _number(text: str | None) -> int | None:
    return None if text is None else int(text)


def parse_command(line: bytes) -> Command:
    """Read a line of the host.

    Raises
    ------
    ProtocolViolation
        It is no command.
    """
    text, checked = _verify_body(line)
    if not text.startswith("/"):
        raise ProtocolViolation("a command starts with a slash", line)
    words = text[1:].split(" ")
    numbers: list[int] = []
    while words and len(numbers) < 3 and words[0].isdecimal() and len(words[0]) <= 2:
        numbers.append(int(words.pop(0)))
    device, axis = [*numbers, 0, 0][:2]
    return Command(" ".join(words).strip(), device, axis, numbers[2] if len(numbers) == 3 else None, checked)


def parse_answer(line: bytes) -> Answer:
    """Read a line of a device.

    Raises
    ------
    ProtocolViolation
        It is no reply, information or alert, or its checksum is wrong.
    """
    text, checked = _verify_body(line)
    if match := _REPLY.fullmatch(text):
        device, axis, number, verdict, state, flag, data = match.groups()
        return Reply(
            int(device), int(axis), verdict == "OK", state == "BUSY", flag, data or "", _number(number), checked
        )
    if match := _INFO.fullmatch(text):
        device, axis, number, rest = match.groups()
        return Info(int(device), int(axis), rest, _number(number), checked)
    if match := _ALERT.fullmatch(text):
        device, axis, state, flag, data = match.groups()
        return Alert(int(device), int(axis), state == "BUSY", flag, data or "", checked)
    raise ProtocolViolation("not a Zaber answer", line)


CommandStream = partial(LineStream, parse_command)  # of a host
AnswerStream = partial(LineStream, parse_answer)  # of a device
