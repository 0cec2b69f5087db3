"""Files of a new lab, from the YAML files beside this module; and the scene that scene.yaml describes.

A mark ``@{name}`` stands for a value, and a line ``@hands,lift|...`` is kept if all of these conditions hold.
"""

import math
import re
import textwrap
from pathlib import Path
from string import Template

from correction.target import board_file
from rtpiv.analysis.prints.pages import bars_on
from rtpiv.templates.arrangement import tube_radii_mm
from rtpiv.templates.lab import Lab, medium_of_glass
from rtpiv.templates.room import CLEARANCE_MM, GLASS_HEIGHTS_MM, SHEET_OFF_MM, Room, bare_heights_mm
from tracer.board import CHIRAL
from tracer.bodies import Body, Rod, Sphere, Tube
from tracer.camera import Camera, look_at, thin_lens_distance_mm
from tracer.light_sheet import LightSheet
from tracer.media import MEDIA, ConstantMedium, media_names
from tracer.scene.scene import Scene

NAMES = {
    ("behind", 1): ("ball",),
    ("triangle", 3): ("top", "left", "right"),
    ("pyramid", 4): ("top", "left", "right", "tip"),
    ("pyramid", 5): ("southwest", "southeast", "northeast", "northwest", "tip"),
}
CONDITION = re.compile(r"@([\w,]+)\|")
TUBE_GLASS = "borosilicate"
# Displacement between two pulses [px] and speed [mm/s]: of the jet at its exit; between balls, strongly sheared.
JET_FLOW, BED_FLOW = (8.0, 1300.0), (4.0, 700.0)


class Marks(Template):
    """Text with marks ``@{name}``."""

    delimiter = "@"


def fill(file: str, conditions: set[str], /, **values: str) -> str:
    """Return the text of a template.

    Parameters
    ----------
    file : str
        Its name in this folder.
    conditions : set of str
        Conditions that hold.
    **values : str
        Values of its marks.
    """
    kept = []
    for line in Path(__file__).with_name(file).read_text(encoding="utf-8").splitlines(keepends=True):
        found = CONDITION.match(line)
        if found is None or conditions.issuperset(found[1].split(",")):
            kept.append(line[found.end() :] if found else line)
    return Marks("".join(kept)).substitute(values)


def scene_text(lab: Lab) -> str:
    """Return scene.yaml."""
    wide = max(map(len, ball_names(lab)))
    bodies = [
        f"  - {{name: {name + ',':{wide + 1}} kind: sphere, centre_mm: [{_decimals(centre)}], "
        f"radius_mm: {size / 2.0:.4g}, material: {_material(glass)}}}"
        for name, centre, size, glass in zip(
            ball_names(lab), lab.centres_mm, lab.each_mm, lab.each_glass, strict=True
        )
    ]
    bodies += [
        f"  - {{name: rod{number}, kind: rod, start_mm: [{_decimals(start)}], "
        f"end_mm: [{_decimals(end)}], radius_mm: {lab.support_mm / 2.0:.4g}}}  # opaque"
        for number, (start, end) in enumerate(lab.rods_mm, start=1)
    ]
    if (tube := _tube(lab)) is not None:
        bodies.append(
            f"  - {{name: tube, kind: tube, start_mm: [{_decimals(tube.start_mm)}], "
            f"end_mm: [{_decimals(tube.end_mm)}],\n     outer_radius_mm: {tube.outer_radius_mm:g}, "
            f"inner_radius_mm: {tube.inner_radius_mm:g}, material: {TUBE_GLASS}, carried_by: glass}}"
        )
    plain = ("wavelength_nm", "lens_mm", "distance_mm", "pixel_pitch_um")
    return fill(
        "scene.yaml",
        ({"bed"} if lab.layers else {"open"}) | (set() if lab.support_mm else {"no_rods"}),
        **{name: f"{getattr(lab, name):g}" for name in plain},
        field=" x ".join(f"{side:.0f}" for side in lab.field_mm),
        px_per_mm=f"{lab.px_per_mm:.1f}",
        width=str(lab.sensor_px[0]),
        height=str(lab.sensor_px[1]),
        hide="" if lab.turn_deg else "# ",
        pinhole=", ".join(f"{c:g}" for c in lab.pinhole_mm),
        media=str(media_names()),
        sheet_mm=f"{lab.sheet_mm:g}",
        light_mm=f"{lab.light_mm:g}",
        light_deg="90.0" if lab.is_tube else "180.0",
        bodies="\n".join(bodies),
    )


def bench_text(lab: Lab, room: Room, laser: bool = False) -> str:
    """Return bench.yaml, or with a laser and a double-frame camera bench-flow.yaml."""
    touching = [] if lab.gap_mm >= CLEARANCE_MM else list(ball_names(lab))
    lifts = laser and not lab.layers and lab.gap_mm < SHEET_OFF_MM
    conditions = {"hands" if lab.by_hand else "motors", "flow" if laser else "frames"}
    conditions |= {"touching"} if touching else set()
    conditions |= {"lift"} if lifts else set()
    conditions |= {"own_board" if lab.square_mm else "printed"}
    conditions |= {"bed" if lab.layers else "open"}
    clear_mm = min(SHEET_OFF_MM - 0.5, math.floor(10.0 * lab.sheet_clear_mm) / 10.0) if lab.layers else 3.5
    out, rail, top = room.glass_out_mm, room.rail_homed_mm, room.retract_mm
    lengths = {
        "out_mm": out,
        "glass_mm": out - 10.0,
        "glass_low_mm": out - 5.0,
        "glass_travel_mm": 25.0 - out,
        "rail_mm": rail,
        "rail_low_mm": rail + 5.0,
        "retract_mm": top,
        "lift_mm": top + 10.0,
        "lift_travel_mm": top + 20.0,
    }
    return fill(
        "bench.yaml",
        conditions,
        **{name: f"{mm:.1f}" for name, mm in lengths.items()},
        name=lab.name,
        file="bench-flow.yaml" if laser else "bench.yaml",
        glass_order="glass_z, glass_y" if lifts else "glass_y",
        ahead_mm=f"{room.lens_ahead_mm:g}",
        touching=textwrap.fill(", ".join(touching), 100, subsequent_indent=" " * 12),
        square_mm=f"{lab.board_mm:g}",
        disc_mm=f"{0.4 * lab.board_mm:g}",
        clear_mm=f"{clear_mm:g}",
        sheet_mm=f"{lab.sheet_mm:g}",
        ball_mm=f"{lab.ball_mm:g}",
        wall_mm=f"{0.15 * lab.ball_mm:g}",
    )


def board_text(lab: Lab) -> str:
    """Return board.yaml: the chessboard that `rtpiv setup target board.yaml` prints."""
    discs = [list(square) for square in CHIRAL]
    return board_file.board_text(
        board_file.PrintedBoard(
            kind="chessboard",
            square_mm=lab.board_mm,
            disc_mm=round(0.4 * lab.board_mm, 9),
            discs=discs,
            bars_mm=list(bars_on("A4")),
        )
    )


def target_plan(lab: Lab, room: Room) -> str:
    """Return the plan of a calibration: the target, bare and behind the glass."""
    heights = {"bare_mm": bare_heights_mm(room), "behind_mm": GLASS_HEIGHTS_MM}
    texts = {name: ", ".join(f"{height:.1f}" for height in each) for name, each in heights.items()}
    return fill("plan-target.yaml", {"hands" if lab.by_hand else "motors"}, **texts)


def shift_plan(lab: Lab) -> str:
    """Return the plan of a known shift of printed particles, which checks the measurement."""
    return fill("plan-shift.yaml", {"hands" if lab.by_hand else "motors"})


def flow_plan(lab: Lab) -> str:
    """Return the plan of a flow lit by a double-pulse laser; glass too close to the sheet is moved away."""
    moved_px, speed_mm_s = BED_FLOW if lab.layers else JET_FLOW
    dt_us = max(20.0, round(1e6 * moved_px / lab.px_per_mm / speed_mm_s, -1))
    off_mm = SHEET_OFF_MM - lab.gap_mm
    conditions = {"near"} if off_mm > 0.0 and not lab.layers else set()
    return fill("plan-flow.yaml", conditions, dt_us=f"{dt_us:g}", px=f"{moved_px:g}", off_mm=f"{off_mm:.1f}")


def ball_names(lab: Lab) -> tuple[str, ...]:
    """Names of the balls, in the order of `centres_mm`."""
    return NAMES.get((lab.arrangement, lab.balls)) or tuple(f"ball{number + 1}" for number in range(lab.balls))


def _tube(lab: Lab) -> Tube | None:
    """Tube around the balls of a lab, if they stand in one."""
    if not lab.is_tube:
        return None
    half = round(0.5 * lab.span_mm[1] + lab.beyond_mm, 2)
    ends = (0.0, -half, lab.sheet_mm), (0.0, half, lab.sheet_mm)
    return Tube("tube", *ends, *tube_radii_mm(lab.ball_mm), MEDIA[TUBE_GLASS], carried_by="glass")


def _material(glass: str) -> str:
    return f"{{n: {glass}}}" if isinstance(medium_of_glass(glass), ConstantMedium) else repr(glass)


def _decimals(place: tuple[float, float, float]) -> str:
    return ", ".join(f"{c:.4f}" for c in place)


def scene_of(lab: Lab) -> Scene:
    """Return the scene that ``scene_text`` describes, without writing a file.

    Raises
    ------
    SceneError
        A ball reaches the lens.
    """
    width, height = lab.sensor_px
    pinhole = lab.pinhole_mm
    camera = Camera(
        focal_px=thin_lens_distance_mm(lab.lens_mm, lab.distance_mm) / (lab.pixel_pitch_um * 1e-3),
        principal_px=(0.5 * (width - 1), 0.5 * (height - 1)),
        sensor_px=(width, height),
        position_mm=pinhole,
        rotation=look_at(pinhole, (0.0, 0.0, 0.0)),
    )
    each = zip(ball_names(lab), lab.centres_mm, lab.each_mm, lab.each_glass, strict=True)
    bodies: list[Body] = [
        Sphere(name, centre, size / 2.0, medium_of_glass(glass)) for name, centre, size, glass in each
    ]
    rods = [
        Rod(f"rod{number}", start, end, lab.support_mm / 2.0)
        for number, (start, end) in enumerate(lab.rods_mm, start=1)
    ]
    sheet = LightSheet(z_mm=lab.sheet_mm) if lab.layers else None
    if (tube := _tube(lab)) is not None:
        bodies.append(tube)
    return Scene(camera, (*bodies, *rods), lab.wavelength_nm, MEDIA["air"], sheet)
