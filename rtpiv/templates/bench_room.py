"""How far stages may travel around a scene: the glass out of the picture, and nothing into the lens."""

from dataclasses import dataclass

from daq.errors import RunUsageError
from rtpiv.templates.lab import Lab

CLEAR_MM = 10.0
CLEARANCE_MM = 2.0  # of keep_out
SHEET_MM = 3.5  # what the laser wants free beside its light sheet
SHEET_OFF_MM = SHEET_MM + 0.5  # where glass and target wait beside it
RETRACT_MM = 30.0
LENS_MM = 60.0  # from the pinhole to the front of the lens
CAMERA_RADIUS_MM = 40.0
BOARD_MM = 160.0


@dataclass(frozen=True)
class Room:
    """Places and limits of the axes of a starting bench [mm]."""

    lens_ahead_mm: float
    glass_out_mm: float
    retract_mm: float
    highest_board_mm: float
    rail_homed_mm: float


def room_of(lab: Lab) -> Room:
    """Return how far the stages of a lab may travel.

    Raises
    ------
    RunUsageError
        Between lens and glass is no room to move the glass out of the picture.
    """
    centres, away = lab.centres_mm, lab.pinhole_mm[2]
    radius = lab.ball_mm / 2.0
    top = max(z for _, _, z in centres) + radius
    ahead = min(LENS_MM, 0.15 * lab.distance_mm)
    front = away - ahead - CAMERA_RADIUS_MM  # of the rounded cylinder that keep-out takes for the camera
    room = front - top - CLEAR_MM
    if room < CLEAR_MM:
        raise RunUsageError(
            f"the glass reaches {top:.0f} mm off the plane, the lens begins at {front:.0f} mm: that leaves no "
            f"{2 * CLEAR_MM:g} mm to move the glass; take a larger --distance-mm, or fewer balls"
        )
    retract = min(RETRACT_MM, room)
    highest = max(y for _, y, _ in centres) + radius
    out = -(highest + max(lab.field_mm[1] / 2.0, BOARD_MM / 4.0) + CLEAR_MM)
    board = max(0.0, min(20.0, lab.gap_mm + retract - CLEAR_MM))
    return Room(
        ahead, round(out - 0.5), round(retract - 0.5), float(int(board)), -float(min(200, int(0.5 * room)))
    )
