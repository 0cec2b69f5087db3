"""Documented messages of `stages.protocols.isel_dnc`."""

from stages.protocols.isel_dnc import (
    MEANING,
    STEPS_LIMIT,
    Ack,
    AskPosition,
    Identify,
    Identity,
    Initialise,
    Move,
    Numbered,
    Position,
    ReferenceSpeeds,
    Stop,
)
from tests.documented import Example

GUIDE = "isel, iMC-M/-MP/-S8 Programming Guide 06/2010, as open clients of the controller quote it"

EXAMPLES = (
    Example(b"@0V\r", Identify(), f"{GUIDE}, version"),
    Example(b"@01\r", Initialise(1), f"{GUIDE}, axis definition: X"),
    Example(b"@07\r", Initialise(7), f"{GUIDE}, axis definition: XYZ"),
    Example(b"@0R7\r", Numbered("R", 7), f"{GUIDE}, reference run"),
    Example(b"@0n7\r", Numbered("n", 7), f"{GUIDE}, zero point"),
    Example(b"@0J100\r", Numbered("J", 100), f"{GUIDE}, acceleration in Hz/ms"),
    Example(b"@0d1600,1600,1600,1600\r", ReferenceSpeeds((1600,) * 4), f"{GUIDE}, reference speed"),
    Example(
        b"@0M 1000,500,2000,500,3000,500,0,30\r",
        Move(((1000, 500), (2000, 500), (3000, 500), (0, 30))),
        f"{GUIDE}, motion to position",
    ),
    Example(b"@0A 320,3200\r", Move(((320, 3200),), absolute=False), f"{GUIDE}, relative motion"),
    Example(b"@0P\r", AskPosition(), f"{GUIDE}, position query"),
    Example(b"\xfd", Stop(), "one open client of the iMC-S8: stop is the byte 253"),
    *(Example(code.encode("ascii"), Ack(code), f"{GUIDE}, error table: {text}") for code, text in MEANING.items()),
    Example(b"00003E8000000FFFFFF", Position((1000, 0, -1)), f"{GUIDE}, position query"),
    Example(b"0800000", Position((-STEPS_LIMIT,)), f"{GUIDE}, position query"),
    Example(b"0iMC-S8 V1.0", Identity("iMC-S8 V1.0"), "shape only: the text differs between firmwares"),
)
