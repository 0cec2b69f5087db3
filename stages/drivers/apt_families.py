"""Units of speed and acceleration of Thorlabs' boxes, by their model.

The protocol sends integers whose unit depends on the electronics: servos count 1/65536 encoder counts per period
of their control loop, older steppers microsteps per second, newer ones what their motion chip counts in. Nothing
in an answer shows which. So each line says what 1 count/s and 1 count/s2 are on the wire, and who has written it
down or tried it; what nobody has is not here, and a box of it is refused.
"""

from typing import NamedTuple

SERVO_S, BRUSHLESS_S = 2048 / 6e6, 102.4e-6  # period of the control loop


class Family(NamedTuple):
    """Units of the boxes of one kind: what 1 count/s and 1 count/s2 are on the wire; whether an encoder counts."""

    models: str
    speed: float
    acceleration: float
    has_encoder: bool


FAMILIES = (
    # APT protocol, "Motor scaling"; pylablib 1.4.5 KinesisMotor; thorlabs-apt-device 0.3.8 utils: T = 2048/6e6 s
    Family(r"[TK]DC\d+", 65536 * SERVO_S, 65536 * SERVO_S**2, True),
    # the same three: T = 102.4 us
    Family(r"[TK]BD\d+|BBD[12]0\d", 65536 * BRUSHLESS_S, 65536 * BRUSHLESS_S**2, True),
    # InstrumentKit, pylablib: microsteps as they are
    Family(r"TST001|BSC00\d|BSC10\d|MST601", 1.0, 1.0, False),
    # pylablib; thorlabs-apt-device BSC: 409600 microsteps/mm, 21987328 for 1 mm/s, 4506 for 1 mm/s2; for LTS also
    # pyAPT and thorpy (github.com/freespace/pyAPT/pull/8, UniNE-CHYN/thorpy/pull/2), tried on an LTS300
    Family(r"TST101|KST[12]01|BSC20\d|MST602|LTS(150|300)\w*", 53.68, 1.0 / 90.9, False),
)
