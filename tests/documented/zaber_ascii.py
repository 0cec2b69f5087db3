"""Documented messages of `stages.protocols.zaber_ascii`."""

from stages.protocols.zaber_ascii import Alert, Command, Info, Reply
from tests.documented import Example

MANUAL = "Zaber, ASCII Protocol Manual"
ARTICLE = "Zaber, Zaber's ASCII Protocol, 13 July 2022"

EXAMPLES = (
    Example(b"/\n", Command("", checked=False), f"{MANUAL}, Quick Start"),
    Example(b"/home\n", Command("home", checked=False), f"{MANUAL}, Quick Start"),
    Example(b"/1 system reset\n", Command("system reset", 1, checked=False), ARTICLE),
    Example(b"/1 move abs 10000\n", Command("move abs 10000", 1, checked=False), f"{MANUAL}, move"),
    Example(b"/01 1 get pos\n", Command("get pos", 1, 1, checked=False), f"{MANUAL}, get"),
    Example(b"@01 0 OK IDLE -- 0\r\n", Reply(1, 0, True, False, "--", "0", None, False), ARTICLE),
    Example(b"@01 0 OK IDLE WR 0\r\n", Reply(1, 0, True, False, "WR", "0", None, False), f"{MANUAL}, Quick Start"),
    Example(b"@01 0 OK BUSY WR 0\r\n", Reply(1, 0, True, True, "WR", "0", None, False), f"{MANUAL}, Quick Start"),
    Example(
        b"@01 0 RJ IDLE -- BADCOMMAND\r\n",
        Reply(1, 0, False, False, "--", "BADCOMMAND", None, False),
        f"{MANUAL}, Replies",
    ),
    Example(
        b"#01 0 Visit www.zaber.com for complete instruction manuals.\r\n",
        Info(1, 0, "Visit www.zaber.com for complete instruction manuals.", None, False),
        f"{MANUAL}, help",
    ),
    Example(b"!01 1 IDLE --\r\n", Alert(1, 1, False, "--", "", False), f"{MANUAL}, Alerts"),
)
