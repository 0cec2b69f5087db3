"""Space in which the stages of a new bench may move: the glass out of the picture, and nothing into the lens.

Motors are nine axes that carry camera, glass and target.  Without motors micrometers move the target, and the
glass slides along a rule: it leaves the picture along y, where the board is never in front of the plane, so it
needs no travel along z; but where it stands too close to the light sheet of a flow, a screw lifts it off.
"""

from dataclasses import dataclass

from daq.errors import RunUsageError
from rtpiv.templates.lab import Lab

CLEAR_MM = 10.0  # between glass, picture and lens
CLEARANCE_MM = 2.0  # keep_out.clearance_mm of bench.yaml, where also CAMERA_RADIUS_MM and BOARD_MM stand
SHEET_OFF_MM = 4.0  # from the light sheet to waiting glass and target: clear_mm of bench.yaml and 0.5
RETRACT_MM = 30.0
LENS_MM = 60.0  # from the pinhole to the front of the lens
CAMERA_RADIUS_MM = 40.0
BOARD_MM = 160.0
GLASS_HEIGHTS_MM = (0.0, -10.0, -20.0)  # of the board behind the glass; above 0 the glass would be in the way


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
    radius = lab.ball_mm / 2.0 + lab.wall_mm
    top = max(z for _, _, z in centres) + radius
    ahead = min(LENS_MM, 0.15 * lab.distance_mm)
    front = away - ahead - CAMERA_RADIUS_MM  # of keep-out's rounded cylinder for the camera
    room = front - top - CLEAR_MM
    if room < CLEAR_MM:
        raise RunUsageError(
            f"the glass reaches {top:.0f} mm off the plane, the lens begins at {front:.0f} mm: that leaves no "
            f"{2 * CLEAR_MM:g} mm to move the glass; take a larger --distance-mm, or fewer balls"
        )
    retract = min(RETRACT_MM, room)
    highest = max(y for _, y, _ in centres) + radius + lab.beyond_mm
    out = -(highest + max(lab.field_mm[1] / 2.0, BOARD_MM / 4.0) + CLEAR_MM)
    board = max(0.0, min(20.0, lab.gap_mm + retract - CLEAR_MM))
    return Room(
        ahead, round(out - 0.5), round(retract - 0.5), float(int(board)), -float(min(200, int(0.5 * room)))
    )


def bare_heights_mm(room: Room) -> tuple[float, ...]:
    """Heights of the board without the glass."""
    up = (room.highest_board_mm / 2.0, room.highest_board_mm)
    return (*GLASS_HEIGHTS_MM, *(height for height in up if height >= 1.0))
