"""The texts of the plans that a lab begins with."""

from rtpiv.templates.lab import Lab
from rtpiv.templates.stage_text import SHEET_OFF_MM, Room

GLASS_HEIGHTS_MM = (0.0, -10.0, -20.0)  # of the board behind the glass; above 0 the glass would be in the way

TARGET_BY_HAND = """\
# yaml-language-server: $schema=schemas/plan.schema.json
# The chessboard, bare and behind the glass, at few heights, since hands turn: what `rtpiv calibrate` needs.
# It ends bare and begins behind glass at the plane, so that only the glass is touched between the two, and never
# stands before the plane, so that the glass slides in at one go. Touch the glass no more after it.
experiment: target
clear: {z_mm: [-20.0, -10.0, 0.0]}   # without glass; 0 is the plane
glass: {z_mm: [0.0, -5.0, -15.0]}    # through it; no height of above again, which would be read a second time
frames: 1                  # at each stop; more lower the noise
settle_s: 2.0              # a hand shakes the bench
"""
SHIFT_BY_HAND = """\
# yaml-language-server: $schema=schemas/plan.schema.json
# Printed particles, moved by a known way behind the glass that stays: `rtpiv report` says what a flow may claim.
experiment: shift
views: [glass]             # [clear, glass] has the glass taken out and put back
displacements:
  - {along: [1.0, 1.0, 0.0], px: 10.0}   # any direction; px of the bare view, or mm
repeats: 1
frames: 1
settle_s: 2.0              # a hand shakes the bench
"""


def bare_heights_mm(room: Room) -> tuple[float, ...]:
    """Heights of the board without the glass."""
    up = (room.highest_board_mm / 2.0, room.highest_board_mm)
    return (*GLASS_HEIGHTS_MM, *(height for height in up if height >= 1.0))


def target_plan(lab: Lab, room: Room) -> str:
    """The target, bare and behind the glass: what a calibration needs."""
    if lab.by_hand:
        return TARGET_BY_HAND
    heights, behind = (
        ", ".join(f"{height:.1f}" for height in each) for each in (bare_heights_mm(room), GLASS_HEIGHTS_MM)
    )
    return f"""\
# yaml-language-server: $schema=schemas/plan.schema.json
# The chessboard, bare and behind the glass, each at several heights: what `rtpiv calibrate` needs.
experiment: target
clear: {{z_mm: [{heights}]}}   # without glass; 0 is the plane
glass: {{z_mm: [{behind}]}}           # through it; above 0 the glass would be in the way
frames: 1                  # at each stop; more lower the noise
settle_s: 0.2              # after arriving
"""


def shift_plan(lab: Lab) -> str:
    """Printed particles moved by a known way: what proves the measurement."""
    if lab.by_hand:
        return SHIFT_BY_HAND
    return """\
# yaml-language-server: $schema=schemas/plan.schema.json
# Printed particles, moved by a known way, bare and through the glass: `rtpiv report` says what a flow may claim.
experiment: shift
views: [clear, glass]
displacements:
  - {along: [1.0, 1.0, 0.0], px: 10.0}   # any direction; px of the bare view, or mm
repeats: 1
frames: 1
settle_s: 0.2
"""


def flow_plan(lab: Lab, dt_us: float) -> str:
    """A flow in the light of a double-pulse laser; glass that stands too near is moved off the sheet."""
    off_mm = SHEET_OFF_MM - lab.gap_mm
    glass = f"glass_z_mm: {off_mm:.1f}           # the glass stands so far off its place, out of the sheet\n"
    return f"""\
# yaml-language-server: $schema=schemas/plan.schema.json
# A flow behind the glass, lit by a double-pulse laser: a background before the seeding is opened, then pairs.
experiment: flow
view: glass
laser: laser               # name of the device in bench-flow.yaml
pairs: 20                  # enough to look at; a mean flow wants 100 or more, Reynolds stresses 1000
dt_us: {dt_us:g}              # between the pulses: about 8 px of the fastest flow
rate_hz: 10.0
chunk: 100                 # fired in one go: no more follow a computer that dies
background: {{pairs: 10}}
target_z_mm: -30.0         # the board waits here, out of the sheet
{glass if off_mm > 0.0 else ""}"""
