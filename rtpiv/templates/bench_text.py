"""The text of bench.yaml, and of bench-flow.yaml with a laser: nine axes, a camera, and their simulation."""

import textwrap
from dataclasses import dataclass

from rtpiv.templates.bench_room import BOARD_MM, CAMERA_RADIUS_MM, CLEARANCE_MM, SHEET_MM, Room
from rtpiv.templates.lab import Lab
from rtpiv.templates.scene_text import ball_names

HARDWARE = """\
# To use hardware, edit from top to bottom; look with `rtpiv doctor --bench {file}` and `rtpiv check {file}`:
#   controllers  driver (zaber_ascii, isel_dnc, pi_gcs2, grbl, thorlabs_apt) and port, best /dev/serial/by-id/...
#   axes         which motor (channel) carries what along which direction; steps_per_mm; limits well inside the
#                switches. An axis that you do not have: take it out here, in home_order, glass and simulation.axes
#   glass        where it stands out of the picture
#   keep_out     sizes of lens, camera and board: nothing may touch
#   camera       the producer (.cti) that came with your camera, and its settings
# Then leave --simulate out: docs/at-the-bench.md goes through the first day. Until then --simulate runs the same
# commands on a simulated bench that is a few tenths of a millimetre off this file, as yours will be."""

FRAMES = """\
  settings: {PixelFormat: Mono12p, ExposureTime: 2000.0, TriggerSelector: FrameStart, TriggerMode: "On",
             TriggerSource: Software}
  timeout_s: 60.0                  # yours needs less: 5.0; the simulated one draws its pictures with rays"""

PAIRS = """\
  settings: {PixelFormat: Mono12p, ExposureTime: 1000.0, DoubleFrameEnable: true, DoubleFrameInterval: 1005.0,
             TriggerSelector: FrameStart, TriggerMode: "On", TriggerSource: Line1}
  buffers: 40
  # how your camera gives the two frames of a pair, and what tells A from B: docs/files.md, pairs
  pairs: {shape: two_blocks, marker: line_status, line: 2, dead_us: 5.0, second_exposure_us: 10000.0,
          most_hz: 15.0}
  timeout_s: 60.0
devices:
  laser:                           # read docs/laser.md before it is a real one
    kind: timing
    box: qc9520                    # the timing unit: qc9520, bnc575, pivlab_oltsync ...
    port: /dev/ttyUSB4
    clear_mm: SHEET_MM             # glass and target stand at least so far off the sheet
    channels: {lamp_1: A, q_switch_1: B, lamp_2: C, q_switch_2: D, camera: E, marker: F}
    head: {max_rate_hz: 15.0, lamp_to_q_switch_us: [180.0, 185.0], q_switch_to_light_us: [0.1, 0.1],
           warmup_s: 20.0}
    # rtpiv laser align: weak because the Q-switch opens so late; how weak, measure with a power meter
    align: {max_rate_hz: 10.0, max_s: 10.0, q_switch_delay_us: 300.0}"""
FLOW = """\
  flow: {field: jet}               # or uniform, shear, vortex, channel, turbulent_channel
"""


def bench_text(lab: Lab, room: Room, laser: bool = False) -> str:
    """Return the file; with a laser and a double-frame camera, or without."""
    file = "bench-flow.yaml" if laser else "bench.yaml"
    what = "for a flow, with a laser and a camera of double frames" if laser else "without a laser"
    out, rail, top = room.glass_out_mm, room.rail_homed_mm, room.retract_mm
    touching = [] if lab.gap_mm >= CLEARANCE_MM else list(ball_names(lab))
    named = textwrap.fill(", ".join(touching), 100, subsequent_indent=" " * 12)
    contact = f"\n  contact: [{named}]   # may touch the board" if touching else ""
    disc = 0.4 * lab.board_mm
    return f"""\
# yaml-language-server: $schema=schemas/bench.schema.json
# The bench of {lab.name}, {what}: what stands where, and who moves it. Lengths in mm.
{HARDWARE.format(file=file)}
name: {lab.name}{"_flow" if laser else ""}
scene: scene.yaml                  # true where every axis stands at 0 (scene_at_mm, if elsewhere)
stages:
  controllers:
    rail: {{driver: isel_dnc, port: /dev/ttyUSB0}}
    portal: {{driver: grbl, port: /dev/ttyUSB1}}
    glass: {{driver: zaber_ascii, port: /dev/ttyUSB2}}
    target: {{driver: pi_gcs2, port: /dev/ttyUSB3}}
  axes:
{_axes(out, rail, top)}
  home_order: [glass_z, target_z, glass_y, glass_x, target_x, target_y, rail_z, camera_x, camera_y]
glass:
  out_mm: {{glass_y: {out:.1f}}}        # the plane is seen without glass there
  retract_mm: {{glass_z: {top:.1f}}}      # goes there first, comes back from there last
keep_out:
  clearance_mm: {CLEARANCE_MM}
  target_size_mm: [{BOARD_MM}, {BOARD_MM}, 5.0]   # the board: x, y, and its thickness
  camera_radius_mm: {CAMERA_RADIUS_MM}           # the camera as a cylinder
  camera_ahead_mm: {room.lens_ahead_mm:g}            # from the pinhole to the front of the lens
  camera_behind_mm: 120.0{contact}
target: {{square_mm: {lab.board_mm:g}, disc_mm: {disc:g}}}   # the chessboard; its three discs: diameter
camera:
  backend: harvesters              # any GenICam camera; or aravis
  options: {{cti: /opt/vendor/producer.cti}}
{PAIRS.replace("SHEET_MM", f"{SHEET_MM:<8}") if laser else FRAMES}
simulation:                        # what --simulate puts in place of all that
  bench: "sim.bench:SimulatedBench"
  seed: 7                          # of the misalignment and the noise
{FLOW if laser else ""}\
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
    target_z: {{lead_mm: 1.0, steps_per_rev: 10000, travel_mm: 105.0}}
"""


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


def _axes(out: float, rail: float, top: float) -> str:
    """The nine axes: `out` and `top` clear the picture of glass, `rail` is where the camera's rail is homed."""
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
    return "\n".join(axis.text(name) for name, axis in axes.items())
