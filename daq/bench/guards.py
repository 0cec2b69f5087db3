"""Checks by the positions of axes: every path before it is driven, and the clearance of the light sheet."""

from collections.abc import Mapping, Sequence
from typing import cast

from daq.bench.bench_table import Bench
from daq.bench.elements import CAMERA, GLASS, TARGET
from daq.bench.keep_out import Carrier, Element, KeepOut
from stages.clock import SYSTEM_CLOCK
from stages.stage import Stage
from stages.way import Guard, Piece
from tracer.bodies import CONTACT_TOL_MM
from tracer.scene.scene import DEEPEST_CUT_MM, Scene


def guard_of(bench: Bench) -> Guard | None:
    """Return the guard that checks every path before it is driven; None if the bench file asks for limits only.

    Raises
    ------
    StageUsageError
        The file allows contact with a body that is not in the scene.
    """
    if bench.table.keep_out is None:
        return None
    if bench.scenes:
        return _Guards([keep_out_of(bench, scene) for scene in (bench.scene, *bench.scenes.values())])
    return keep_out_of(bench, bench.scene)


class _Guards:
    """Several cameras ride on the same axes, each with its own lens: what is too close for one is."""

    def __init__(self, guards: Sequence[Guard]) -> None:
        self._guards = guards

    def check(self, way: Sequence[Piece]) -> None:
        for guard in self._guards:
            guard.check(way)


def keep_out_of(bench: Bench, scene: Scene) -> KeepOut:
    """Return the guard for a scene; the bench file must have a section keep_out."""
    assert bench.table.keep_out is not None
    home = bench.home_mm
    carriers = {
        name: Carrier(cast("Element", axis.carries), axis.along, home[name])
        for name, axis in bench.table.stages.axes.items()
    }
    return KeepOut(scene, carriers, bench.table.keep_out)


def idle_stage(bench: Bench) -> Stage:
    """Return the stage with closed ports, to ask what it would do."""
    return Stage(bench.table.stages, SYSTEM_CLOCK, guard_of(bench))


def sheet_clearance_mm(bench: Bench, positions_mm: Mapping[str, float]) -> float:
    """Return the distance [mm] from the sheet to the nearest body or the target.

    Parameters
    ----------
    bench : Bench
        What stands there, and which axes carry it.
    positions_mm : mapping
        Measured position of every axis.

    Returns
    -------
    float
        Below 0 if the sheet is cut; infinity if there is neither glass nor target.  A tube around the sheet does
        not count: the light goes in through it.  Nor does a ball that the scene has in the sheet, as in a bed:
        more than a millimetre deep where the sheet does not lie in the target's plane.
    """
    return min((free_mm for _, free_mm in sheet_clearances_mm(bench, positions_mm)), default=float("inf"))


def sheet_clearances_mm(bench: Bench, positions_mm: Mapping[str, float]) -> list[tuple[str, float]]:
    """Distance [mm] from the sheet of all that must be clear of it: glass, target, other bodies by their names."""
    distances = list[tuple[str, float]]()
    table, sheet = bench.table, bench.scene.lit
    z_mm = {one: table.offset_mm(one, positions_mm)[2] for one in (GLASS, CAMERA)}
    deep_mm = CONTACT_TOL_MM if sheet.is_target_plane else DEEPEST_CUT_MM
    for standing in bench.scene.bodies:
        body = standing if sheet.is_target_plane else standing.moved(sheet.place)
        in_bed = body.kind == "sphere" and body.lowest_mm < -deep_mm and body.highest_mm > CONTACT_TOL_MM
        off_mm = z_mm.get(body.carried, 0.0) * float(sheet.axes()[2, 2])
        gap_mm = max(body.lowest_mm + off_mm, -body.highest_mm - off_mm)
        is_wall = body.may_cross_plane and body.kind != "sphere"
        if gap_mm > 0.0 or not (is_wall or in_bed):
            distances.append((GLASS if body.carried == GLASS else body.name, gap_mm))
    if bench.table.axes_of(TARGET):
        front_mm = bench.table.offset_mm(TARGET, positions_mm)[2] - sheet.z_mm
        keep_out = bench.table.keep_out
        thick_mm = 0.0 if keep_out is None else keep_out.target_size_mm[2]
        distances.append((TARGET, -front_mm if front_mm <= 0.0 else front_mm - thick_mm))
    return distances
