"""Documented messages of `stages.protocols.pi_gcs2`."""

from stages.protocols.pi_gcs2 import MOVING, READY, STOP_ALL, Answer, Command, SingleByte
from tests.documented import Example

MANUAL = "PI, MS249E C-863.12 User Manual 1.2.1"

EXAMPLES = (
    Example(b"MOV 1 10.0\n", Command("MOV", ("1", "10.0")), f"{MANUAL}, p. 116, example 1"),
    Example(b"MOV 1 17.3 2 2.05\n", Command("MOV", ("1", "17.3", "2", "2.05")), f"{MANUAL}, p. 116, example 2"),
    Example(b"POS?\n", Command("POS?"), f"{MANUAL}, p. 116, example 4"),
    Example(b"TSP? 2 1\n", Command("TSP?", ("2", "1")), f"{MANUAL}, p. 117, example 5"),
    Example(b"FNL 1\n", Command("FNL", ("1",)), "pipython 2.11, FNL"),
    Example(b"2 POS? 1\n", Command("POS?", ("1",), 2), f"{MANUAL}, target and sender address"),
    Example(b"\x05", SingleByte(MOVING), f"{MANUAL}, p. 127, #5"),
    Example(b"\x07", SingleByte(READY), f"{MANUAL}, p. 127, #7"),
    Example(b"\x18", SingleByte(STOP_ALL), f"{MANUAL}, #24"),
    Example(
        b"2=-1158.4405 \n1=+0000.0000\n", Answer(("2=-1158.4405", "1=+0000.0000")), f"{MANUAL}, p. 117, example 5"
    ),
    Example(b"0\n", Answer(("0",)), f"{MANUAL}, p. 127, #5: motion of all axes complete"),
    Example(b"3\n", Answer(("3",)), f"{MANUAL}, p. 127, #5: first and second axis in motion"),
    Example(b"\xb1\n", Answer(("±",)), f"{MANUAL}, p. 127, #7: ready, with termination character p. 116"),
    Example(b"0x9005\n", Answer(("0x9005",)), f"{MANUAL}, p. 126, #4"),
    Example(b"0 2 1=10.0000\n", Answer(("1=10.0000",), 2), f"{MANUAL}, target and sender address"),
)
