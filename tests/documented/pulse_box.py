"""Documented messages of `daq.timing.protocols.pulse_box`."""

from daq.timing.protocols.pulse_box import INTERVAL_US, START, STOP, VERSION, Command, Question, Reply
from tests.documented import Example

FIRMWARE = "Micro-Manager, TeensyPulseGenerator, firmware version 1"

EXAMPLES = (
    Example(b"\x01\x00\x00\x00\x00", Command(START), FIRMWARE),
    Example(b"\x03\x88\x13\x00\x00", Command(INTERVAL_US, 5000), f"{FIRMWARE}; a client's struct.pack('<I')"),
    Example(b"\xff\x00", Question(VERSION), FIRMWARE),
    Example(b"\x00\x01\x00\x00\x00", Reply(VERSION, 1), FIRMWARE),
    Example(b"\x02\x14\x00\x00\x00", Reply(STOP, 20), FIRMWARE),
)
