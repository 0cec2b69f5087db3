"""What the text of a bench file says of its stages: how far they may travel, and who moves them, motors or hands.

How far: the glass out of the picture, and nothing into the lens (`room_of`).

Motors are nine axes that carry camera, glass and target.  Without motors micrometers move the target, and the
glass slides along a rule: it leaves the picture along y, where the board is never before the plane, so it needs no
way along z; but where it stands too near to the light sheet of a flow, a screw lifts it off.
"""

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


@dataclass(frozen=True)
class StageText:
    """Parts of the text; each without the end of its last line, but `retract`.

    Parameters
    ----------
    edit : str
        Comment that says what to edit for hardware.
    controllers, axes : str
        Lines of these sections.
    home_order : str
        Names of the axes.
    retract : str
        The line of `glass` that says where it goes first; "" if it leaves at one go.
    simulation : str
        What the workshop built, and how it answers.
    """

    edit: str
    controllers: str
    axes: str
    home_order: str
    retract: str
    simulation: str


MOTOR_EDIT = """\
#   controllers  driver (zaber_ascii, isel_dnc, pi_gcs2, grbl, thorlabs_apt) and port, best /dev/serial/by-id/...
#   axes         which motor (channel) carries what along which direction; steps_per_mm; limits well inside the
#                switches. An axis that you do not have: take it out here, in home_order, glass, simulation.axes"""
CONTROLLERS = """\
    rail: {driver: isel_dnc, port: /dev/ttyUSB0}
    portal: {driver: grbl, port: /dev/ttyUSB1}
    glass: {driver: zaber_ascii, port: /dev/ttyUSB2}
    target: {driver: pi_gcs2, port: /dev/ttyUSB3}"""
HOME_ORDER = "glass_z, target_z, glass_y, glass_x, target_x, target_y, rail_z, camera_x, camera_y"


@dataclass(frozen=True)
class AxisText:
    """One axis of the file; lengths in mm.

    Parameters
    ----------
    controller, channel : str
        Which motor.
    carries, along : str
        What it moves, and in which direction.
    offset_mm : float
        Where it stands when homed.
    limits_mm : (float, float)
        Well inside the switches.
    speed_mm_s : float
        Its usual speed.
    steps_per_mm : float, optional
        Of a motor that counts steps.
    settle_s : float
        After a motion.
    side : str
        From which it approaches a place.
    in_position : bool
        Whether its controller has to confirm that it is there.
    """

    controller: str
    channel: str
    carries: str
    along: str
    offset_mm: float
    limits_mm: tuple[float, float]
    speed_mm_s: float
    steps_per_mm: float | None = None
    settle_s: float = 0.2
    side: str = "from_below"
    in_position: bool = False

    def text(self, name: str) -> str:
        """Return it, on three lines."""
        counts = "" if self.steps_per_mm is None else f"steps_per_mm: {self.steps_per_mm:.1f}, "
        motor = f"controller: {self.controller}, channel: {self.channel}"
        limits = f"limits_mm: [{self.limits_mm[0]:.1f}, {self.limits_mm[1]:.1f}]"
        near = ", in_position_um: 5.0" if self.in_position else ""
        acceleration = 200.0 if self.controller == "glass" else 100.0
        pace = f"speed_mm_s: {self.speed_mm_s:.1f}, acceleration_mm_s2: {acceleration:.1f}"
        return f"""\
    {name}:
      {{{motor}, carries: {self.carries}, along: {self.along}, {counts}offset_mm: {self.offset_mm:.1f},
       {limits}, {pace}, settle_s: {self.settle_s}{near},
       approach: {{side: {self.side}, distance_mm: 0.5, speed_mm_s: 2.0}}}}"""


def motor_stages(room: Room) -> StageText:
    """Return what a bench file says of stages with motors: glass is moved up, then out of the picture."""
    out, rail, top = room.glass_out_mm, room.rail_homed_mm, room.retract_mm
    many = 3200.0  # steps of the glass's motors
    axes = {
        "rail_z": AxisText("rail", "X", "camera", "z", rail, (rail + 5.0, 1500.0), 30.0, 320.0, settle_s=0.5),
        "camera_x": AxisText("portal", "X", "camera", "x", 100.0, (-95.0, 95.0), 20.0),
        "camera_y": AxisText("portal", '"Y"', "camera", "y", 100.0, (-95.0, 95.0), 20.0),
        "glass_x": AxisText("glass", "1/1", "glass", "x", -75.0, (-70.0, 70.0), 20.0, many),
        "glass_y": AxisText("glass", "2/1", "glass", "y", out - 10.0, (out - 5.0, 10.0), 20.0, many),
        "glass_z": AxisText("glass", "3/1", "glass", "z", -2.0, (-1.0, top + 10.0), 10.0, many, side="from_above"),
        "target_x": AxisText("target", '"1"', "target", "x", -50.0, (-45.0, 45.0), 10.0, in_position=True),
        "target_y": AxisText("target", '"2"', "target", "y", -50.0, (-45.0, 45.0), 10.0, in_position=True),
        "target_z": AxisText("target", '"3"', "target", "z", -75.0, (-70.0, 25.0), 10.0, in_position=True),
    }
    simulation = f"""\
  firmware: {{portal: {{"23": 0}}}}    # Grbl: home towards the high switches
  axes:                            # what the workshop built
    rail_z: {{lead_mm: 5.0, steps_per_rev: 1600, travel_mm: 2000.0, backlash_um: 50.0, lead_error_um: 1.5}}
    camera_x: {{lead_mm: 4.0, steps_per_rev: 3200, travel_mm: 200.0, origin: high switch}}
    camera_y: {{lead_mm: 4.0, steps_per_rev: 3200, travel_mm: 200.0, origin: high switch}}
    glass_x: {{lead_mm: 4.0, steps_per_rev: 12800, travel_mm: 150.0}}
    glass_y: {{lead_mm: 4.0, steps_per_rev: 12800, travel_mm: {25.0 - out:.1f}}}
    glass_z: {{lead_mm: 4.0, steps_per_rev: 12800, travel_mm: {top + 20.0:.1f}}}
    target_x: {{lead_mm: 1.0, steps_per_rev: 10000, travel_mm: 100.0}}
    target_y: {{lead_mm: 1.0, steps_per_rev: 10000, travel_mm: 100.0}}
    target_z: {{lead_mm: 1.0, steps_per_rev: 10000, travel_mm: 105.0}}"""
    return StageText(
        edit=MOTOR_EDIT,
        controllers=CONTROLLERS,
        axes="\n".join(axis.text(name) for name, axis in axes.items()),
        home_order=HOME_ORDER,
        retract=f"  retract_mm: {{glass_z: {top:.1f}}}      # goes there first, comes back from there last\n",
        simulation=simulation,
    )


HAND_EDIT = """\
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
    """Return what a bench file says of stages without motors; of a flow with a screw that lifts the glass."""
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
        edit=HAND_EDIT,
        controllers="    hands: {driver: by_hand}   # rtpiv acquire asks for each place, and what a scale reads",
        axes="\n".join(screw.text for screw in screws),
        home_order=", ".join(screw.name for screw in screws),
        retract="",
        simulation="  hand: {reads_um: 3.0, division_um: 10.0}   # how well it reads; nobody else is told\n"
        "  axes:                            # what the workshop built\n"
        + "\n".join(screw.simulated for screw in screws),
    )
