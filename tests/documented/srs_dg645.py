"""Documented messages of `daq.timing.protocols.srs_dg645`."""

from daq.timing.protocols.srs_dg645 import Command, Value
from tests.documented import Example

MANUAL = "DG645 User Manual, remote programming; srsinst.dg645 2026"

EXAMPLES = (
    Example(b"*IDN?\n", Command("*IDN", asks=True), MANUAL),
    Example(b"*TRG\n", Command("*TRG"), MANUAL),
    Example(b"TSRC 5\n", Command("TSRC", "5"), MANUAL),
    Example(b"BURC?\n", Command("BURC", asks=True), MANUAL),
    Example(b"DLAY 3,2,1e-3\n", Command("DLAY", "3,2,1e-3"), MANUAL),
    Example(b"DLAY? 3\n", Command("DLAY", "3", asks=True), MANUAL),
    Example(b"2,+0.001000000000\r\n", Value("2,+0.001000000000"), MANUAL),
    Example(
        b"Stanford Research Systems,DG645,s/n001013,ver1.00.10E\r\n",
        Value("Stanford Research Systems,DG645,s/n001013,ver1.00.10E"),
        MANUAL,
    ),
)
