"""Stages of a starting bench with motors: nine axes that carry camera, glass and target."""

from dataclasses import dataclass

from rtpiv.templates.bench_room import Room
from rtpiv.templates.stage_text import StageText

EDIT = """\
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
    """Return what a bench file says of them: glass is moved up, then out of the picture."""
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
        edit=EDIT,
        controllers=CONTROLLERS,
        axes="\n".join(axis.text(name) for name, axis in axes.items()),
        home_order=HOME_ORDER,
        retract=f"  retract_mm: {{glass_z: {top:.1f}}}      # goes there first, comes back from there last\n",
        simulation=simulation,
    )
