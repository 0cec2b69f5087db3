"""Documented messages of `stages.protocols.apt_messages`."""

from stages.protocols.apt_messages import Homing, Info, Reply, Speeds, Status, Unasked, Value
from stages.protocols.apt_words import ENABLED, HOMED, LOWER_SWITCH, OFF, ON, RACK, Kind
from tests.documented import Example
from tests.documented.apt_commands import EXAMPLES as COMMANDS
from tests.documented.apt_commands import MANUAL, PROTOCOL, PUBLISHED

RECORDED = "a K10CR1, as the tests of pnpq quote it"

SPEEDS_RAW = b"\x15\x04\x0e\x00\x81\x50\x01\x00\x07\x00\x00\x00\x06\x01\x00\x00\x87\xb5\x0b\x00"
HOMING_RAW = b"\x42\x04\x0e\x00\x81\x50\x01\x00\x02\x00\x01\x00\x87\xb5\x0b\x00\x38\xff\xff\xff"
STATUS_RAW = b"\x2a\x04\x06\x00\x81\x50\x01\x00\x02\x05\x00\x80"
INFO_RAW = (
    b"\x06\x00\x54\x00\x81\x50"
    + b"\x01\x02\x03\x04"
    + b"KDC101\x00\x00"
    + b"\x10\x00\xa1\xa2\xa3\x00"
    + b"abcdefg".ljust(60, b"\x00")
    + b"\x2a\x00\x2b\x00\x01\x00"
)
INFO_MESSAGE = Info(0x04030201, "KDC101", 16, (0xA1, 0xA2, 0xA3), "abcdefg", 42, 43, 1)
INFO_SAMPLE = bytes.fromhex("0600 5400 8122 89539A05 494F4E3030312000 2C00 02013900") + bytes(60)
INFO_SAMPLE += bytes.fromhex("0100 0300 0100")
UNASKED_MOVED = b"\x01\x00\xe8\x03\x00\x00\xcd\x00\x00\x00\x00\x00\x00\x00"
EXAMPLES = (
    *COMMANDS,
    Example(
        b"\x12\x02\x01\x02\x01\x50",
        Reply(Kind.MOD_GET_CHANENABLESTATE, 1, OFF),
        f"{PUBLISHED}, test_apt_mc_enabled, with the addresses of a real box",
    ),
    Example(
        b"\x61\x00\x02\x01\x01\x11", Reply(Kind.RACK_GET_BAYUSED, 2, ON, RACK), f"{PROTOCOL}, rack_get_bayused"
    ),
    Example(
        b"\x12\x04\x06\x00\x81\x50\x01\x00\xe0\xb1\xff\xff",
        Value(Kind.MOT_GET_POSCOUNTER, 1, -20000),
        f"{PUBLISHED}, test_apt_mc_position, with the addresses of a real box",
    ),
    Example(
        b"\x47\x04\x06\x00\x81\x22\x01\x00\x00\x01\x00\x00",
        Value(Kind.MOT_GET_MOVERELPARAMS, 1, 256, 0x22),
        f"{PROTOCOL}, mot_get_moverelparams",
    ),
    Example(SPEEDS_RAW, Speeds(1, 7, 262, 767367), f"{PROTOCOL}, mot_get_velparams: 1 mm/s of an MTS50"),
    Example(HOMING_RAW, Homing(1, 2, 1, 767367, -200), f"{PROTOCOL}, mot_get_homeparams"),
    Example(STATUS_RAW, Status(1, ENABLED | HOMED | 0x0100 | LOWER_SWITCH), f"{PROTOCOL}, mot_get_statusbits"),
    Example(INFO_RAW, INFO_MESSAGE, f"{PUBLISHED}, init_kdc101"),
    Example(INFO_SAMPLE, Info(94_000_009, "ION001 ", 44, (2, 1, 57), "", 1, 3, 1, 0x22), MANUAL),
    Example(
        b"\x44\x04\x01\x00\x01\x50",
        Unasked(Kind.MOT_MOVE_HOMED, b"\x01\x00", True),
        f"{PUBLISHED}, test_apt_mc_go_home, with the addresses of a real box",
    ),
    Example(
        b"\x64\x04\x0e\x00\x81\x22" + UNASKED_MOVED,
        Unasked(Kind.MOT_MOVE_COMPLETED, UNASKED_MOVED, False, 0x22),
        f"{PUBLISHED}, test_apt_mc_move, from the second bay",
    ),
    Example(
        bytes.fromhex("6404 0e00 8150 0100 68aaa001 0000 0000 30000080"),
        Unasked(Kind.MOT_MOVE_COMPLETED, bytes.fromhex("0100 68aaa001 0000 0000 30000080")),
        RECORDED,
    ),
    Example(b"\x64\x04\x01\x00\x01\x22", Unasked(Kind.MOT_MOVE_COMPLETED, b"\x01\x00", True, 0x22), MANUAL),
)
