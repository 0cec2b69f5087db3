"""Stages of a starting bench without motors: micrometers move the target, the glass slides along a rule.

The glass leaves the picture along y, where the board is never before the plane, so it needs no way along z; but
where it stands too near to the light sheet of a flow, a screw lifts it off.
"""

from dataclasses import dataclass

from rtpiv.templates.bench_room import SHEET_OFF_MM, Room
from rtpiv.templates.lab import Lab
from rtpiv.templates.stage_text import StageText

EDIT = """\
#   axes         which scale (channel: your name of it) moves what along which direction; axis = what it reads
#                + offset_mm, and sign: -1 if it counts backwards; reading_um: standard deviation of a reading;
#                limits that the screw can reach. docs/at-the-bench.md, without motors, says more"""
DRUM_UM, RULE_UM, RULE_NEAR_UM = 4.2, 20.0, 100.0  # readings of a drum of 10 um, and of glass put against a stop
SLOW = "speed_mm_s: 0.5, acceleration_mm_s2: 5.0"
FAST = "speed_mm_s: 10.0, acceleration_mm_s2: 50.0"  # only to say how long a plan takes


@dataclass(frozen=True)
class ScrewText:
    """One axis that a hand moves; lengths in mm.

    Parameters
    ----------
    channel : str
        What people call its scale.
    name : str
        Of the axis: what it carries, and in which direction.
    offset_mm : float
        Where it stands when its scale reads 0.
    limits_mm : (float, float)
        What it can reach.
    travel_mm : float
        Of the simulated one.
    is_rule : bool
        Whether it slides along a rule, in place of a screw.
    """

    channel: str
    name: str
    offset_mm: float
    limits_mm: tuple[float, float]
    travel_mm: float
    is_rule: bool = False

    @property
    def text(self) -> str:
        """It, on three lines."""
        carried = "carries: {}, along: {}".format(*self.name.split("_"))
        reading = f"{RULE_UM}, in_position_um: {RULE_NEAR_UM}" if self.is_rule else f"{DRUM_UM}"
        pace = FAST if self.is_rule else SLOW
        low, high = self.limits_mm
        return f"""\
    {self.name}:
      {{controller: hands, channel: {self.channel}, {carried}, offset_mm: {self.offset_mm:.1f},
       limits_mm: [{low:.1f}, {high:.1f}], reading_um: {reading}, {pace}}}"""

    @property
    def simulated(self) -> str:
        """What the workshop built: springs take the play of micrometers, and a rule counts turns of 1 mm."""
        lead, true = (1.0, ", lead_error_um: 0.0") if self.is_rule else (0.5, "")
        built = f"lead_mm: {lead}, steps_per_rev: 10000, travel_mm: {self.travel_mm:.1f}, backlash_um: 0.0{true}"
        return f"    {self.name}: {{{built}}}"


def hand_stages(lab: Lab, room: Room, laser: bool) -> StageText:
    """Return what a bench file says of them; of a flow with a screw that lifts glass off the light sheet."""
    out = room.glass_out_mm
    screws = [
        ScrewText("rear drum", "target_z", -40.0, (-39.0, 9.0), 50.0),
        ScrewText("rule", "glass_y", out - 10.0, (out - 5.0, 10.0), 25.0 - out, is_rule=True),
        ScrewText("left drum", "target_x", -12.5, (-12.0, 12.0), 25.0),
        ScrewText("upper drum", "target_y", -12.5, (-12.0, 12.0), 25.0),
    ]
    if laser and lab.gap_mm < SHEET_OFF_MM:
        screws.insert(1, ScrewText("lifting drum", "glass_z", -1.5, (-1.0, 10.0), 12.5))
    return StageText(
        edit=EDIT,
        controllers="    hands: {driver: by_hand}   # rtpiv acquire asks for each place, and what a scale reads",
        axes="\n".join(screw.text for screw in screws),
        home_order=", ".join(screw.name for screw in screws),
        retract="",
        simulation="  hand: {reads_um: 3.0, division_um: 10.0}   # how well it reads; nobody else is told\n"
        "  axes:                            # what the workshop built\n"
        + "\n".join(screw.simulated for screw in screws),
    )
