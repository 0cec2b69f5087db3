"""Plausibility questions about a bench: unusual values, each with its line; see `daq.bench.scene_plausibility`.

Speeds are compared with accelerations and ways, places with what the camera sees, the simulated stages with the
axes that they stand for.
"""

from collections.abc import Iterator, Mapping

from daq.bench.bench_table import Bench
from daq.bench.elements import GLASS
from daq.bench.guards import keep_out_of
from daq.bench.scene_plausibility import bodies_in_picture
from ground.config import Place
from ground.errors import Problem
from ground.plain_words import slip
from ground.usual import Usual, plausibility_questions, question
from tracer.bodies import translate_by

Asked = Iterator[tuple[Place, str]]

SHORTEST_START_S = 0.005  # in which an axis reaches its speed
LONGEST_WAY_S = 900.0  # from limit to limit
FARTHEST_ZERO = 0.5  # of the way, from the controller's zero to the nearer limit
SQUARE_PX, DISC_PX = Usual(8.0, 150.0), Usual(4.0, 100.0)  # of the board
EXPOSURE_US = Usual(1.0, 1e6)
TARGET_SIZE, CAMERA_MM = Usual(0.3, 5.0), Usual(15.0, 400.0)  # the target over what the camera sees
SAME_SCALE, LEAD_MM, MOST_TRAVEL = 0.01, Usual(0.2, 25.0), 4.0  # of simulated screws


def bench_questions(bench: Bench) -> list[str]:
    """Ask about what is unusual in a bench file: questions with file and line, in the order of the lines."""
    asked = [*plausibility_questions(bench.document, bench.table)]
    for name, device in bench.more.items():
        asked += [
            Problem(problem.line, f"devices.{name}.{problem.text}")
            for problem in plausibility_questions(bench.document.inside("devices", name), device.section)
        ]
    related = [*_axes_asked(bench), *_glass_asked(bench), *_sizes_asked(bench), *_simulation_asked(bench)]
    asked += [Problem(bench.document.line(at), text) for at, text in related]
    return [f"{bench.path}:{one.line}: {one.text}" for one in sorted(asked, key=lambda one: one.line)]


def _axes_asked(bench: Bench) -> Asked:
    for name, axis in bench.table.stages.axes.items():
        at, way_mm = ("stages", "axes", name), axis.limits_mm[1] - axis.limits_mm[0]
        start_s = axis.speed_mm_s / axis.acceleration_mm_s2
        if start_s * axis.speed_mm_s > way_mm or start_s < SHORTEST_START_S:
            text = f"speed_mm_s {axis.speed_mm_s:g} with acceleration_mm_s2 {axis.acceleration_mm_s2:g}"
            text += (
                f", which takes {start_s:.2g} s and {start_s * axis.speed_mm_s:.3g} mm of a way of {way_mm:g} mm"
            )
            yield (*at, "speed_mm_s"), f"{name}: is one of both a slip: {text}?"
        if way_mm / axis.speed_mm_s > LONGEST_WAY_S:
            text = f"{way_mm / axis.speed_mm_s:.0f} s from limit to limit: is speed_mm_s or limits_mm a slip?"
            yield (*at, "limits_mm"), f"{name}: {text}"
        zero_mm = max(axis.limits_mm[0] - axis.offset_mm, axis.offset_mm - axis.limits_mm[1])
        if zero_mm > FARTHEST_ZERO * way_mm:
            text = f"the controller's zero lies {zero_mm:g} mm outside of limits_mm: is offset_mm right?"
            yield (*at, "offset_mm"), f"{name}: {text}"
        at_mm = bench.home_mm[name]
        if not axis.limits_mm[0] <= at_mm <= axis.limits_mm[1]:
            hint = slip("_mm", at_mm, *axis.limits_mm)
            yield (
                ("scene_at_mm",),
                f"{name}: does the scene hold at {at_mm:g} mm, outside of limits_mm{hint or '?'}",
            )
        homed_mm = axis.homed_at_mm
        if homed_mm is not None and max(axis.limits_mm[0] - homed_mm, homed_mm - axis.limits_mm[1]) > 0.5 * way_mm:
            yield (*at, "homed_at_mm"), f"{name}: is homed_at_mm {homed_mm:g} right, so far outside of limits_mm?"


def _glass_asked(bench: Bench) -> Asked:
    glass = bench.table.glass
    if glass is None:
        return
    positions = bench.home_mm | glass.retract_mm | glass.out_mm
    moved = bench.scene.with_bodies([
        body.moved(translate_by(bench.table.offset_mm(GLASS, positions)))
        for body in bench.scene.bodies
        if body.carried == GLASS
    ])  # fmt: skip
    if seen := bodies_in_picture(moved):
        yield ("glass", "out_mm"), f"glass.out_mm: are {', '.join(seen[:3])} still in the picture there?"


def _sizes_asked(bench: Bench) -> Asked:
    camera, target, keep_out = bench.scene.camera, bench.table.target, bench.table.keep_out
    px_per_mm = camera.focal_px * abs(float(camera.rotation_matrix[2][2])) / camera.position_mm[2]
    seen_mm = max(camera.sensor_px) / px_per_mm
    for key, mm, usual in (("square_mm", target.square_mm, SQUARE_PX), ("disc_mm", target.disc_mm, DISC_PX)):
        if key in target.model_fields_set and (asked := question(key, mm * px_per_mm, usual)):
            yield ("target", key), f"target.{key} {mm:g}: in px of the picture: {asked}"
    exposure_us = bench.table.camera.settings.get("ExposureTime")
    if isinstance(exposure_us, float | int) and (asked := question("exposure_us", exposure_us, EXPOSURE_US)):
        yield ("camera", "settings", "ExposureTime"), f"camera.settings.ExposureTime [us]: {asked}"
    if keep_out is None:
        return
    usual = Usual(TARGET_SIZE.low * seen_mm, TARGET_SIZE.high * seen_mm)
    for mm in keep_out.target_size_mm[:2]:
        if asked := question("target_size_mm", mm, usual):
            yield ("keep_out", "target_size_mm"), f"keep_out.target_size_mm: {asked}"
    if keep_out.target_size_mm[2] > 0.5 * max(keep_out.target_size_mm[:2]):
        yield ("keep_out", "target_size_mm"), "keep_out.target_size_mm: is the target thicker than half its width?"
    for key in ("camera_radius_mm", "camera_behind_mm", "camera_ahead_mm"):
        if asked := question(key, getattr(keep_out, key), CAMERA_MM):
            yield ("keep_out", key), f"keep_out.{key}: {asked}"
    for one, other, deep_mm in keep_out_of(bench, bench.scene).overlaps():
        text = f"does {one} stand {deep_mm:.3g} mm deep in {other} where the scene file holds?"
        yield ("keep_out",), f"keep_out: {text} Is one of its sizes a slip?"


def _simulation_asked(bench: Bench) -> Asked:
    made = (bench.table.simulation or {}).get("axes", {})
    for name, axis in bench.table.stages.axes.items():
        screw = made.get(name) if isinstance(made, Mapping) else None
        if not isinstance(screw, Mapping):
            continue
        at = ("simulation", "axes", name)
        lead_mm, steps, travel_mm = (screw.get(key) for key in ("lead_mm", "steps_per_rev", "travel_mm"))
        are_numbers = isinstance(lead_mm, float | int) and isinstance(steps, int) and lead_mm
        scale = float(steps) / float(lead_mm) if are_numbers else 0.0  # type: ignore[arg-type]
        if scale and axis.steps_per_mm and abs(scale / axis.steps_per_mm - 1.0) > SAME_SCALE:
            text = f"its screw makes {scale:g} steps/mm, and steps_per_mm is {axis.steps_per_mm:g}"
            yield at, f"simulation.axes.{name}: {text}: is one of them a slip?"
        if isinstance(lead_mm, float | int) and (asked := question("lead_mm", lead_mm, LEAD_MM)):
            yield at, f"simulation.axes.{name}.lead_mm: {asked}"
        if isinstance(travel_mm, float | int):
            counted_mm = -travel_mm if screw.get("origin") == "high switch" else travel_mm
            ends_mm = sorted((axis.offset_mm, axis.offset_mm + axis.sign * counted_mm))
            if axis.limits_mm[0] < ends_mm[0] or axis.limits_mm[1] > ends_mm[1]:
                text = f"its switches stand at {ends_mm[0]:g} and {ends_mm[1]:g} mm, inside of limits_mm"
                yield at, f"simulation.axes.{name}: {text}: is travel_mm, offset_mm or limits_mm a slip?"
            elif travel_mm > MOST_TRAVEL * (axis.limits_mm[1] - axis.limits_mm[0]):
                text = f"travel_mm {travel_mm:g} is {MOST_TRAVEL:g} times the way between the limits and more"
                yield at, f"simulation.axes.{name}: {text}: is it a slip?"
