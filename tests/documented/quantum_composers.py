"""Documented messages of `daq.timing.protocols.quantum_composers`."""

from daq.timing.protocols.quantum_composers import Command, Done, Echo, Refused, Value
from tests.documented import Example

MANUAL = "9500 Plus Series, Operating Manual, remote programming"
MANUAL_575 = "575 Series, Operating Manual, remote programming"
MANUAL_577 = "577, Operating Manual, 8.5.8"
CLOCK_575 = "575 Series, Operating Manual v5.6, p. 8-38; Blackchirp on a 9528"
QMI = "QMI, test of the Quantum Composers 9530"

EXAMPLES = (
    Example(b"*IDN?\r\n", Command("*IDN", asks=True), QMI),
    Example(b"*RST\r\n", Command("*RST"), QMI),
    Example(b":INST:CAT?\r\n", Command(":INST:CAT", asks=True), QMI),
    Example(b":PULSE0:STAT 1\r\n", Command(":PULSE0:STAT", "1"), QMI),
    Example(b":PULSE0:STAT?\r\n", Command(":PULSE0:STAT", asks=True), QMI),
    Example(b":PULSE0:PER 3.141592654\r\n", Command(":PULSE0:PER", "3.141592654"), QMI),
    Example(b":PULSE0:BCO 21\r\n", Command(":PULSE0:BCO", "21"), QMI),
    Example(b":PULSE0:ICL:MOD XPL\r\n", Command(":PULSE0:ICL:MOD", "XPL"), QMI),
    Example(b":PULSE0:ICL?\r\n", Command(":PULSE0:ICL", asks=True), CLOCK_575),
    Example(b":PULSE1:WIDTH 0.000025\r\n", Command(":PULSE1:WIDTH", "0.000025"), MANUAL_575),
    Example(b"ok\r\n", Done(), MANUAL),
    Example(b"?3\r\n", Refused(3), QMI),
    Example(b"?8\r\n", Refused(8), MANUAL),
    Example(b"?9\r\n", Refused(9), MANUAL_577),
    Example(b"QC,9534,02311,1.2.2-1.2.0\r\n", Value("QC,9534,02311,1.2.2-1.2.0"), "a 9534"),
    Example(b"T0, CHA, CHB, CHC, CHD\r\n", Value("T0, CHA, CHB, CHC, CHD"), QMI),
    Example(b"XPL?\r\n", Value("XPL?"), QMI),
    Example(b"EXT10\r\n", Value("EXT10"), CLOCK_575),
    Example(b"1\r\n", Value("1"), QMI),
    Example(b"0.000120000\r\n", Value("0.000120000"), MANUAL_575),
    Example(b":PULSE0:STAT 1\r\n", Echo(":PULSE0:STAT 1"), MANUAL),
)
