"""The drivers against boxes that share no code with our emulators: answers in the very shapes that manuals print.

Signs, leading zeros, more fields, no checksums, lower-case digits: all of it is documented, and not how our own
emulators speak.  Each box takes a motion at once and remembers where it was sent.
"""

import re
import struct
from contextlib import closing

import pytest

from sim.emulators.device import Emulator
from sim.emulators.line import Line
from sim.emulators.protocol_sim import put_up
from sim.mechanics.clock import VirtualClock
from stages.errors import ProtocolViolation
from stages.protocols import grbl
from stages.stage import Stage
from stages.states import AxisState
from tests.loops import loop_over
from tests.stages.benches import stages_table


class Box(Emulator):
    """Cuts bytes into units and lets `reply` answer each."""

    unit = rb"[^\n]*\n"

    def __init__(self, clock):
        super().__init__({}, clock)
        self.left, self.at, self.asked = b"", {}, []

    def _take(self, data):
        self.left += data
        while match := re.match(self.unit, self.left, re.DOTALL):
            self.left = self.left[match.end() :]
            self.asked.append(match[0])
            self.say(self.reply(match[0].decode("latin-1").strip()).encode("latin-1"))


class Zaber(Box):
    """ASCII Protocol Manual: replies without checksum, information lines, an alert, flags with the answer."""

    homed = False

    def reply(self, said):
        body = said[1:].rsplit(":", 1)[0]
        device, axis, number, *words = body.split(" ")
        head = f"@{int(device):02d} {axis} {number} OK"
        flag = "--" if self.homed else "WR"
        match words:
            case ["get", "deviceid"]:
                data = "43211"
            case ["get", "system.serial" | "version" | "system.axiscount" as what]:
                data = {"system.serial": "84251", "version": "6.28", "system.axiscount": "2"}[what]
            case ["get", "pos"]:
                data = str(self.at.get(axis, 0))
            case ["warnings"]:
                data = "00" if self.homed else "02 WR WH"
            case ["home"]:
                self.homed, data = True, "0"
                self.at[axis] = 0
                return f"!{int(device):02d} {axis} IDLE --\r\n{head} BUSY -- 0\r\n"
            case ["move", "abs", steps]:
                self.at[axis], data = int(steps), "0"
            case _:
                data = "0"
        return f"{head} IDLE {flag} {data}\r\n#{int(device):02d} {axis} {number} for your information\r\n"


class Pi(Box):
    """MS249E: values with sign and leading zeros (p. 117), the bytes 5 and 7 (p. 127), CR before LF."""

    unit = rb"[\x05\x07\x18]|[^\n\x05\x07\x18]*\n"
    referenced = ""

    def reply(self, said):
        name, *words = said.split(" ")
        axis = words[0] if words else ""
        fixed = {"*IDN?": "(c)2011 Physik Instrumente (PI) Karlsruhe, C-863.11,0,1.2.0.0", "ERR?": "0",
                 "\x05": "0", "\x07": "\xb1"}  # fmt: skip
        if said in ("\x05", "") or name in fixed:
            answer = fixed.get(name, "0")
        elif name == "SAI?":
            return "1 \n2\n"
        elif name == "TRS?":
            answer = f"{axis}=1"
        elif name == "FRF":
            self.referenced += axis
            return ""
        elif name == "FRF?":
            answer = f"{axis}={int(axis in self.referenced)}"
        elif name == "MOV":
            self.at[axis] = float(words[1])
            return ""
        elif name == "POS?":
            answer = f"{axis}={self.at.get(axis, 0.0):+010.4f}"
        else:
            return ""
        return answer + ("\n" if answer == "\xb1" else "\r\n")


class Grbl(Box):
    """interface.md: every field that a report can have, numbers with few decimals, messages before the answer."""

    unit = rb"[?!~\x18\x85]|[^\n?!~\x18\x85]*\n"

    def reply(self, said):
        place = f"{self.at.get('X', -1.0):.3f},{self.at.get('Y', -1.0):.3f},0.000"
        if said == "?":
            return f"<Idle|MPos:{place}|Bf:15,128|Ln:99999|FS:500,8000|Pn:XYZPDHRS|WCO:0.000,1.551,5.664>\r\n"
        if said == "$I":
            return "[VER:1.1h.20190830:my board]\r\n[OPT:V,15,128]\r\nok\r\n"
        if said == "$$":
            values = {10: "1", 13: "0", 22: "1", 100: "250.000", 101: "250.000", 110: "3000.000", 111: "3000.000",
                      120: "100.000", 121: "100.000", 130: "200.000"}  # fmt: skip
            return "".join(f"${number}={value}\r\n" for number, value in values.items()) + "ok\r\n"
        if match := re.match(r"\$J=.*([XY])(-?[\d.]+)F", said):
            self.at[match[1]] = float(match[2])
        return (
            "[MSG:Caution: Unlocked]\r\nok\r\n" if said == "$H" else "ok\r\n" if said not in "\x18\x85!~" else ""
        )


class GrblHal(Grbl):
    """grblHAL: its own banner, alarms with their number, settings that are texts or empty, more fields."""

    homed = False

    def reply(self, said):
        if said == "\x18":
            return "\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n[MSG:'$H'|'$X' to unlock]\r\n"
        if said == "?" and not self.homed:
            return "<Alarm:11|MPos:0.000,0.000,0.000|Bf:100,1023|FS:0,0,0|Pn:P|A:|FW:grblHAL>\r\n"
        if said == "$$":
            return super().reply(said).replace("ok", "$74=\r\n$75=255\r\n$396=http\r\n$481=0\r\nok")
        if said == "$I":
            lines = (
                "[VER:1.1f.20260801:left]",
                "[OPT:VNMGPH,100,1023,3,0]",
                "[AXS:3:XYZ]",
                "[FIRMWARE:grblHAL]",
                "ok",
            )
            return "".join(f"{line}\r\n" for line in lines)
        self.homed = self.homed or said == "$H"
        return super().reply(said)


class FluidNc(Grbl):
    """FluidNC: no carriage returns to rely on, messages with levels, its own version, a tool that stays 0."""

    def reply(self, said):
        if said == "$I":
            return "[VER:3.7 FluidNC v3.7.8 (wifi) :stage]\n[OPT:MPHS]\n[MSG: Machine: traverse]\nok\n"
        if said == "$G":
            return "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\nok\n"
        return super().reply(said).replace("\r", "").replace("[MSG:", "[MSG:INFO: ")


class Isel(Box):
    """Programming guide: one character and no line end; hexadecimal digits of either case."""

    unit = rb"\xfd|[^\r]*\r"

    def reply(self, said):
        if said == "@0V":
            return "0iMC-S8 V2.03\r\n"
        if said == "@0P":
            return "0" + "".join(f"{self.at.get(axis, 0) & 0xFFFFFF:06x}" for axis in "XY")
        if match := re.match(r"@0A (-?\d+),\d+,(-?\d+),\d+", said):
            for axis, steps in zip("XY", match.groups(), strict=True):
                self.at[axis] = self.at.get(axis, 0) + int(steps)
        return "" if said == "\xfd" else "0"


class Apt(Box):
    """A BSC202 as its open clients meet it: the end of a motion told by nobody before each answer, 20 bytes of it.

    Messages are cut by their own header, as the protocol says: six bytes, and data if the receiver has bit 7.
    """

    def _take(self, data):
        self.left += data
        while len(self.left) >= 6:
            size = 6 + (struct.unpack("<H", self.left[2:4])[0] if self.left[4] & 0x80 else 0)
            if len(self.left) < size:
                return
            raw, self.left = self.left[:size], self.left[size:]
            self.asked.append(raw)
            self.say(self.reply(raw).encode("latin-1"))

    def reply(self, said):
        (kind,), place, data = struct.unpack("<H", said[:2]), said[4] & 0x7F, said[6:]
        if kind in (0x0413, 0x043A, 0x0445, 0x0453):
            self.at[place, kind] = data
        elif kind == 0x0443:
            self.at[place, 0x0443], self.at[place, 0x0453] = True, struct.pack("<Hi", 1, 0)
            return struct.pack("<HBBBB", 0x0444, 1, 0, 0x01, 0x00).decode("latin-1")
        homed = 0x0400 * self.at.get((place, 0x0443), False)
        answers = {
            0x0005: struct.pack("<I8sH4B60sHHH", 40_123_456, b"BSC202\0X", 45, 5, 1, 1, 0, b"Bench\0\1", 1, 0, 2),
            0x0411: self.at.get((place, 0x0453), struct.pack("<Hi", 1, -77)),
            0x0414: self.at.get((place, 0x0413), struct.pack("<Hiii", 1, 0, 1, 2)),
            0x0429: struct.pack("<HI", 1, 0x9020_0100 | homed),
            0x043B: self.at.get((place, 0x043A), struct.pack("<Hi", 1, 20_480)),
            0x0441: struct.pack("<HHHii", 1, 2, 1, 21_987_328, 1000),
            0x0446: self.at.get((place, 0x0445), struct.pack("<Hi", 1, 409_600)),
        }
        unasked = struct.pack("<HHBB", 0x0464, 14, 0x81, 0x00) + bytes(14)
        if kind == 0x0060:
            return (unasked + struct.pack("<HBBBB", 0x0061, said[2], 1, 0x01, 0x11)).decode("latin-1")
        if kind not in answers:
            return ""
        head = struct.pack("<HHBB", kind + 1, len(answers[kind]), 0x81, place)
        return (unasked + head + answers[kind]).decode("latin-1")


BOXES = {
    "zaber_ascii": [Zaber],
    "pi_gcs2": [Pi],
    "grbl": [Grbl, GrblHal, FluidNc],
    "isel_dnc": [Isel],
    "thorlabs_apt": [Apt],
}


@pytest.mark.parametrize(("spoken", "made"), [(name, made) for name, boxes in BOXES.items() for made in boxes])
def test_a_driver_understands_a_box_that_is_none_of_ours(spoken, made):
    clock = VirtualClock()
    box = made(clock)
    table = stages_table(spoken).model_copy(deep=True)
    with put_up(Line(box, clock)) as url:
        table.controllers["box"].__dict__["port"] = url
        with closing(Stage.open(table, clock)) as stage:
            assert stage.axis("a").state is AxisState.UNREFERENCED
            stage.home()
            for target_mm in (30.0, 29.5, 101.25):
                stage.move({"a": target_mm, "b": 130.0 - target_mm})
                here = stage.where_mm()
                assert here == pytest.approx({"a": target_mm, "b": 130.0 - target_mm}, abs=2e-3)
            stage.stop()
            assert stage.where_mm() == here
    assert len(box.asked) > 20


@loop_over(
    "line, meant",
    [
        (b"GrblHAL 1.1f ['$' or '$HELP' for help]", grbl.Banner("1.1f", "GrblHAL", "'$' or '$HELP' for help")),
        (
            b"Grbl 3.7 [FluidNC v3.7.8 (wifi) '$' for help]",
            grbl.Banner("3.7", words="FluidNC v3.7.8 (wifi) '$' for help"),
        ),
        (b"Grbl 0.9j ['$' for help]", grbl.Banner("0.9j")),
        (b"$74=", grbl.Setting(74, "")),
        (b"$396=http", grbl.Setting(396, "http")),
        (b"$1023=a b", grbl.Setting(1023, "a b")),
        (b"Alarm:1", grbl.Alarm(1)),
        (b"ALARM:17", grbl.Alarm(17)),
        (b"<Alarm:11|MPos:0.000,0.000|FS:0,0>", grbl.Status("Alarm", (0.0, 0.0), True, 11, (("FS", "0,0"),))),
        (b"<Tool|MPos:0.000,0.000,1.500>", grbl.Status("Tool", (0.0, 0.0, 1.5))),
        (b"ALARM: Hard Limit", grbl.Alarm(1)),
        (b"ALARM: Homing Fail Approach", grbl.Alarm(9)),
        (b"ALARM: Unhomed", grbl.Alarm(0)),
        (b"error:15", grbl.Refusal(15)),
        (b"error: GCode cannot be executed in lock or alarm state", grbl.Refusal(9)),
        (b"error: Bad value", grbl.Refusal(0)),
        (b"[NVS STORAGE:*FLASH]", grbl.Feedback),
        (b"[FREE MEMORY:102K]", grbl.Feedback),
        (b"[NEWOPT:ENUMS,RT+,HOME]", grbl.Feedback),
        *(
            (f"<Idle|MPos:1.000|FS:0,0|{field}>".encode(), grbl.Status)
            for field in ("Sc:XY", "T:0|TLR:0", "FW:grblHAL", "A:", "D1", "In:-1", "SD:12.5,/a b.nc")
        ),
    ],
)
def test_descendants_of_grbl_are_read_as_what_they_are(line, meant):
    found = grbl.parse_answer(line)
    assert isinstance(found, meant) if isinstance(meant, type) else found == meant


@pytest.mark.parametrize(
    "line", [b"Grbl 1.1h ['$' for hel", b"bl 1.1h ['$' for help]", b"$=1", b"$x=1", b"ALARM:", b"GrblHAL"]
)
def test_pieces_are_not(line):
    with pytest.raises(ProtocolViolation):
        grbl.parse_answer(line)
