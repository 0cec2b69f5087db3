"""The text of bench.yaml, and of bench-flow.yaml with a laser: stages, a camera, and their simulation."""

import textwrap

from rtpiv.templates.lab import Lab
from rtpiv.templates.scene_text import ball_names
from rtpiv.templates.stage_text import (
    BOARD_MM,
    CAMERA_RADIUS_MM,
    CLEARANCE_MM,
    SHEET_MM,
    Room,
    hand_stages,
    motor_stages,
)

HARDWARE = """\
# To use hardware, edit from top to bottom; look with `rtpiv doctor --bench {file}` and `rtpiv check {file}`:
{edit}
#   glass        where it stands out of the picture
#   keep_out     sizes of lens, camera and board: nothing may touch
#   camera       the producer (.cti) that came with your camera, and its settings
# Then leave --simulate out: docs/at-the-bench.md goes through the first day. Until then --simulate runs the same
# commands on a simulated bench that is a few tenths of a millimetre off this file, as yours will be."""

FRAMES = """\
  settings: {PixelFormat: Mono12p, ExposureTime: 2000.0, TriggerSelector: FrameStart, TriggerMode: "On",
             TriggerSource: Software}
  timeout_s: 60.0                  # yours needs less: 5.0"""

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
    stages = hand_stages(lab, room, laser) if lab.by_hand else motor_stages(room)
    touching = [] if lab.gap_mm >= CLEARANCE_MM else list(ball_names(lab))
    named = textwrap.fill(", ".join(touching), 100, subsequent_indent=" " * 12)
    contact = f"\n  contact: [{named}]   # may touch the board" if touching else ""
    disc = 0.4 * lab.board_mm
    return f"""\
# yaml-language-server: $schema=schemas/bench.schema.json
# The bench of {lab.name}, {what}: what stands where, and who moves it. Lengths in mm.
{HARDWARE.format(file=file, edit=stages.edit)}
name: {lab.name}{"_flow" if laser else ""}
scene: scene.yaml                  # true where every axis stands at 0 (scene_at_mm, if elsewhere)
stages:
  controllers:
{stages.controllers}
  axes:
{stages.axes}
  home_order: [{stages.home_order}]
glass:
  out_mm: {{glass_y: {room.glass_out_mm:.1f}}}        # the plane is seen without glass there
{stages.retract}\
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
{stages.simulation}
"""
