"""Documented messages of `stages.protocols.grbl`."""

from stages.protocols.grbl import (
    HOLD,
    JOG_CANCEL,
    RESET,
    STATUS,
    Alarm,
    Banner,
    Feedback,
    Line,
    Ok,
    RealTime,
    Refusal,
    Setting,
    Status,
)
from tests.documented import Example

DOC = "gnea/grbl v1.1 doc/markdown"

EXAMPLES = (
    Example(b"$J=X10.0 Y-1.5\n", Line("$J=X10.0 Y-1.5"), f"{DOC}/jogging.md"),
    Example(b"$J=G53 Y5.0\n", Line("$J=G53 Y5.0"), f"{DOC}/jogging.md"),
    Example(b"$H\n", Line("$H"), f"{DOC}/commands.md"),
    Example(b"?", RealTime(STATUS), f"{DOC}/commands.md"),
    Example(b"!", RealTime(HOLD), f"{DOC}/commands.md"),
    Example(b"\x18", RealTime(RESET), f"{DOC}/commands.md"),
    Example(b"\x85", RealTime(JOG_CANCEL), f"{DOC}/commands.md"),
    Example(b"ok\r\n", Ok(), f"{DOC}/interface.md, Response Messages"),
    Example(b"error:15\r\n", Refusal(15), f"{DOC}/interface.md, jog target exceeds travel"),
    Example(b"ALARM:1\r\n", Alarm(1), f"{DOC}/interface.md, Alarm Message"),
    Example(
        b"<Idle|MPos:0.000,-10.000,5.000|FS:0,0>\r\n",
        Status("Idle", (0.0, -10.0, 5.0), extras=(("FS", "0,0"),)),
        f"{DOC}/interface.md, Current Position and FS",
    ),
    Example(
        b"<Hold:0|WPos:-2.500,0.000,11.000|Bf:15,128>\r\n",
        Status("Hold", (-2.5, 0.0, 11.0), False, 0, (("Bf", "15,128"),)),
        f"{DOC}/interface.md, sub-states, work position, buffer state",
    ),
    Example(
        b"<Alarm:11|MPos:0.000,0.000,0.000|FS:0,0>\r\n",
        Status("Alarm", (0.0, 0.0, 0.0), substate=11, extras=(("FS", "0,0"),)),
        "grblHAL, report extensions: the alarm's number",
    ),
    Example(b"$100=250.000\r\n", Setting(100, "250.000"), f"{DOC}/interface.md, $$"),
    Example(b"$13=0\r\n", Setting(13, "0"), f"{DOC}/interface.md, $$"),
    Example(b"$74=\r\n", Setting(74, ""), "grblHAL, settings with network support: no name is set"),
    Example(b"$396=http\r\n", Setting(396, "http"), "grblHAL, settings of its web server"),
    Example(b"[MSG:Reset to continue]\r\n", Feedback("MSG", "Reset to continue"), f"{DOC}/interface.md"),
    Example(
        b"[VER:v1.1d.20161014:Some string]\r\n",
        Feedback("VER", "v1.1d.20161014:Some string"),
        f"{DOC}/interface.md",
    ),
    Example(b"[OPT:VL]\r\n", Feedback("OPT", "VL"), f"{DOC}/interface.md"),
    Example(b"Grbl 1.1h ['$' for help]\r\n", Banner("1.1h"), f"{DOC}/interface.md, Start Up Message"),
    Example(
        b"GrblHAL 1.1f ['$' or '$HELP' for help]\r\n",
        Banner("1.1f", "GrblHAL", "'$' or '$HELP' for help"),
        "grblHAL, start-up message",
    ),
    Example(
        b"Grbl 3.7 [FluidNC v3.7.8 (wifi) '$' for help]\r\n",
        Banner("3.7", "Grbl", "FluidNC v3.7.8 (wifi) '$' for help"),
        "FluidNC wiki, start-up message",
    ),
)
