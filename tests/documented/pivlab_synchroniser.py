"""Documented messages of `daq.timing.protocols.pivlab_synchroniser`."""

from daq.timing.protocols.pivlab_synchroniser import (
    QUESTIONS,
    Identity,
    LaserIs,
    Question,
    Report,
    Sequence,
    Settings,
    Switch,
    Verdict,
)
from tests.documented import Example

PIVLAB = "PIVlab, acquisition, control of the synchroniser"
FOUND = "a user's script for an xmSync"

REPORT_TEXT = "168 0 0 100 0 250 0 1"
EXAMPLES = (
    *(Example(f"{text}\r\n".encode("ascii"), Question(text), PIVLAB) for text in QUESTIONS),
    Example(
        b"TALKINGTO:oltSync:0012:sequence:50000:0,0:100,1100\r\n",
        Sequence("oltSync:0012", 50000, ((100, 1100),)),
        PIVLAB,
    ),
    Example(
        b"TALKINGTO:oltSync:0012:sequence:40000:1,0:0,19956,20000,39956:19811,19967,20211,20367\r\n",
        Sequence("oltSync:0012", 40000, ((0, 19956, 20000, 39956), (19811, 19967, 20211, 20367)), 1),
        f"{PIVLAB}; timings for an OPTOcam",
    ),
    Example(b"TALKINGTO:oltSync:0012:start\r\n", Switch("oltSync:0012", True), PIVLAB),
    Example(b"TALKINGTO:oltSync:0012:stop\r\n", Switch("oltSync:0012", False), PIVLAB),
    Example(
        b"TALKINGTO:SYNC_UOA1;FREQ:168;CAM:0;ENER:0;ener%:100;F1EXP:0;INTERF:250;EXTDLY:0;EXTSKP:0;LASER:enable\r\n",
        Settings("SYNC_UOA1", 168, 0, 0, 100, 0, 250, 0, 0, True),
        FOUND,
    ),
    Example(
        b"TALKINGTO:SYNC_UOA1;FREQ:1;CAM:1;ENER:600;ener%:0;F1EXP:100;INTERF:1234;EXTDLY:-1;EXTSKP:0;LASER:disable\r\n",
        Settings("SYNC_UOA1", 1, 1, 600, 0, 100, 1234, -1, 0, False),
        PIVLAB,
    ),
    Example(b"Sequence:OK\r\n", Verdict(True), PIVLAB),
    Example(b"Sequence:Error\r\n", Verdict(False), PIVLAB),
    Example(b"Laser:enable\r\n", LaserIs(True), PIVLAB),
    Example(b"Laser:disable\r\n", LaserIs(False), PIVLAB),
    Example(
        REPORT_TEXT.replace(" ", "\t").encode() + b"\r\n",
        Report(tuple(REPORT_TEXT.split())),
        f"{PIVLAB}; 8 fields",
    ),
    Example(
        (REPORT_TEXT + " 75 0 0 0").replace(" ", "\t").encode() + b"\r\n",
        Report((*REPORT_TEXT.split(), "75", "0", "0", "0")),
        f"{PIVLAB}; 12 fields",
    ),
    Example(b"oltSync:0012\r\n", Identity("oltSync:0012"), PIVLAB),
    Example(b"SYNC_UOA1\r\n", Identity("SYNC_UOA1"), FOUND),
)
