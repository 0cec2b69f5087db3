"""Documented commands among `stages.protocols.apt_messages`."""

from stages.protocols.apt_messages import Order, SetSpeeds, Setting
from stages.protocols.apt_words import FIRST_BAY, ON, RACK, Kind
from tests.documented import Example

PROTOCOL = "thorlabs-apt-protocol 29"  # MIT; the functions and parsers of this name
PUBLISHED = "InstrumentKit tests/test_thorlabs"  # dialogues of its tests
MANUAL = "Thorlabs, APT Communications Protocol, the sample of this message, as the tests of pnpq quote it"
CLIENTS = "a test of an open KDC101 client"

SETSPEEDS_RAW = b"\x13\x04\x0e\x00\xa1\x01\x01\x00\x07\x00\x00\x00\x9a\x11\x00\x00\x00\x80\x4f\x01"
SETSPEEDS_SAMPLE = bytes.fromhex("1304 0E00 A201 0100 00000000 B0350000 CDCCCC00")
EXAMPLES = (
    Example(b"\x43\x04\x01\x00\x50\x01", Order(Kind.MOT_MOVE_HOME, 1), CLIENTS),
    Example(b"\x65\x04\x01\x02\x22\x01", Order(Kind.MOT_MOVE_STOP, 1, 2, 0x22), f"{PROTOCOL}, mot_move_stop"),
    Example(b"\x10\x02\x01\x01\x50\x01", Order(Kind.MOD_SET_CHANENABLESTATE, 1, ON), CLIENTS),
    Example(b"\x05\x00\x00\x00\x11\x01", Order(Kind.HW_REQ_INFO, to=RACK), f"{PROTOCOL}, hw_req_info"),
    Example(
        b"\x18\x00\x00\x00\x50\x01", Order(Kind.HW_NO_FLASH_PROGRAMMING), f"{PROTOCOL}, hw_no_flash_programming"
    ),
    Example(
        b"\x92\x04\x00\x00\x50\x01", Order(Kind.MOT_ACK_DCSTATUSUPDATE), f"{PROTOCOL}, mot_ack_dcstatusupdate"
    ),
    Example(
        b"\x53\x04\x06\x00\xa2\x01\x01\x00\x40\x0d\x03\x00",
        Setting(Kind.MOT_MOVE_ABSOLUTE, 1, 200_000, 0x22),
        MANUAL,
    ),
    Example(
        b"\x53\x04\x06\x00\xd0\x01\x01\x00\xfb\x86\x00\x00",
        Setting(Kind.MOT_MOVE_ABSOLUTE, 1, 34555),
        "two open clients: 1 mm of a Z8 stage",
    ),
    Example(
        b"\x48\x04\x06\x00\xd0\x01\x01\x00\x18\xfc\xff\xff",
        Setting(Kind.MOT_MOVE_RELATIVE, 1, -1000),
        f"{PUBLISHED}, test_apt_mc_move",
    ),
    Example(
        b"\x3a\x04\x06\x00\xa3\x01\x01\x00\x00\x00\x00\x00",
        Setting(Kind.MOT_SET_GENMOVEPARAMS, 1, 0, 0x23),
        f"{PROTOCOL}, mot_set_genmoveparams",
    ),
    Example(SETSPEEDS_SAMPLE, SetSpeeds(1, 0, 0x35B0, 0xCCCCCD, 0x22), MANUAL),
    Example(
        SETSPEEDS_RAW,
        SetSpeeds(1, 7, 4506, 21987328, FIRST_BAY),
        f"{PROTOCOL}, mot_set_velparams: 1 mm/s of a DRV250",
    ),
)
