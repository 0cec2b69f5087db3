"""The words of Thorlabs APT: addresses, message ids, bits of the state, form and length of each message.

Sources: Thorlabs, "APT Controllers Host-Controller Communications Protocol", issue 23 (2018), where three open
readers agree (thorlabs-apt-protocol 29, pylablib 1.4.5, InstrumentKit); issue 26, p. 30, for the start of a
conversation and for "server alive".
"""

from enum import IntEnum

HOST, RACK, FIRST_BAY, UNIT = 0x01, 0x11, 0x21, 0x50
BAYS = 10
SPEAKERS = (RACK, *range(FIRST_BAY, FIRST_BAY + BAYS), UNIT)
WITH_DATA = 0x80
HEADER = 6
STOP_AT_ONCE, STOP_SLOWING = 1, 2
ON, OFF = 1, 2

MOVES = 0x0010 | 0x0020 | 0x0040 | 0x0080  # forwards, backwards, and both as a jog
UPPER_SWITCH, LOWER_SWITCH = 0x0001, 0x0002
HOMING, HOMED = 0x0200, 0x0400
FAULTS = {
    0x0000_4000: "its position error was too large",
    0x0002_0000: "it is too hot",
    0x0004_0000: "its supply voltage is too low",
    0x0008_0000: "its commutation has failed",
    0x0100_0000: "its motor current was at the limit for too long",
    0x0200_0000: "its encoder has failed",
    0x0400_0000: "its motor took too much current",
    0x0800_0000: "it took too much current",
    0x4000_0000: "it reports an error",
}
ENABLED = 0x8000_0000


class Kind(IntEnum):
    """Message types; the vendor's names without MGMSG."""

    HW_DISCONNECT = 0x0002
    HW_REQ_INFO = 0x0005
    HW_GET_INFO = 0x0006
    HW_START_UPDATEMSGS = 0x0011
    HW_STOP_UPDATEMSGS = 0x0012
    HW_NO_FLASH_PROGRAMMING = 0x0018  # at the start: no new firmware is about to be written
    RACK_REQ_BAYUSED = 0x0060
    RACK_GET_BAYUSED = 0x0061
    HW_RESPONSE = 0x0080
    HW_RICHRESPONSE = 0x0081
    MOD_SET_CHANENABLESTATE = 0x0210
    MOD_REQ_CHANENABLESTATE = 0x0211
    MOD_GET_CHANENABLESTATE = 0x0212
    MOD_IDENTIFY = 0x0223
    MOT_REQ_POSCOUNTER = 0x0411
    MOT_GET_POSCOUNTER = 0x0412
    MOT_SET_VELPARAMS = 0x0413
    MOT_REQ_VELPARAMS = 0x0414
    MOT_GET_VELPARAMS = 0x0415
    MOT_REQ_STATUSBITS = 0x0429
    MOT_GET_STATUSBITS = 0x042A
    MOT_SET_GENMOVEPARAMS = 0x043A  # distance of the box's own backlash correction
    MOT_REQ_GENMOVEPARAMS = 0x043B
    MOT_GET_GENMOVEPARAMS = 0x043C
    MOT_REQ_HOMEPARAMS = 0x0441
    MOT_GET_HOMEPARAMS = 0x0442
    MOT_MOVE_HOME = 0x0443
    MOT_MOVE_HOMED = 0x0444
    MOT_SET_MOVERELPARAMS = 0x0445  # distance of a relative move that is begun without one
    MOT_REQ_MOVERELPARAMS = 0x0446
    MOT_GET_MOVERELPARAMS = 0x0447
    MOT_MOVE_RELATIVE = 0x0448
    MOT_MOVE_ABSOLUTE = 0x0453
    MOT_MOVE_COMPLETED = 0x0464
    MOT_MOVE_STOP = 0x0465
    MOT_MOVE_STOPPED = 0x0466
    MOT_REQ_STATUSUPDATE = 0x0480
    MOT_GET_STATUSUPDATE = 0x0481
    MOT_REQ_DCSTATUSUPDATE = 0x0490
    MOT_GET_DCSTATUSUPDATE = 0x0491
    MOT_ACK_DCSTATUSUPDATE = 0x0492  # "server alive"; answered by nothing


SHORT = None  # the length of what has no data
LENGTHS_OF_ANSWERS: dict[int, tuple[int | None, ...]] = {
    Kind.HW_GET_INFO: (84,),
    Kind.RACK_GET_BAYUSED: (SHORT,),
    Kind.HW_RESPONSE: (SHORT,),
    Kind.HW_RICHRESPONSE: (68,),
    Kind.MOD_GET_CHANENABLESTATE: (SHORT,),
    Kind.MOT_GET_POSCOUNTER: (6,),
    Kind.MOT_GET_VELPARAMS: (14,),
    Kind.MOT_GET_STATUSBITS: (6,),
    Kind.MOT_GET_GENMOVEPARAMS: (6,),
    Kind.MOT_GET_HOMEPARAMS: (14,),
    Kind.MOT_GET_MOVERELPARAMS: (6,),
    Kind.MOT_MOVE_HOMED: (SHORT,),
    Kind.MOT_MOVE_COMPLETED: (SHORT, 14),
    Kind.MOT_MOVE_STOPPED: (SHORT, 14),
    Kind.MOT_GET_STATUSUPDATE: (14, 28),  # 28 from BSC201, KST201 and K10CR2, as their open clients have met it
    Kind.MOT_GET_DCSTATUSUPDATE: (14,),
}
UNASKED = (
    Kind.HW_RESPONSE, Kind.HW_RICHRESPONSE, Kind.MOT_MOVE_HOMED, Kind.MOT_MOVE_COMPLETED, Kind.MOT_MOVE_STOPPED,
    Kind.MOT_GET_STATUSUPDATE, Kind.MOT_GET_DCSTATUSUPDATE,
)  # fmt: skip
VALUES = (Kind.MOT_GET_POSCOUNTER, Kind.MOT_GET_GENMOVEPARAMS, Kind.MOT_GET_MOVERELPARAMS)
SETTINGS = (
    Kind.MOT_SET_GENMOVEPARAMS, Kind.MOT_SET_MOVERELPARAMS, Kind.MOT_MOVE_RELATIVE, Kind.MOT_MOVE_ABSOLUTE,
)  # fmt: skip
LENGTHS_OF_COMMANDS: dict[int, tuple[int | None, ...]] = {
    **{kind: (SHORT,) for kind in Kind if kind not in LENGTHS_OF_ANSWERS},
    **dict.fromkeys(SETTINGS, (6,)),
    Kind.MOT_SET_VELPARAMS: (14,),
}
