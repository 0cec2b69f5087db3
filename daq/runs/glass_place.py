"""Position of the glass while the pairs of a run were taken, relative to the scene file.

A flow plan keeps the glass some millimetres off the light sheet (`glass_z_mm`), so what the camera looked through
is the scene with its bodies moved by so much.  The plan's place counts, not the encoders' last digit: one map
serves all frames, as for every other run.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from correction.masked import sweep
from daq.bench.elements import GLASS, Vector
from daq.errors import RunDamaged
from daq.runs.journal import Entry
from daq.runs.records import CURE
from daq.runs.run_folder import RunFolder, frame_entries
from daq.runs.run_views import bench_table
from piv.errors import PairError
from tracer.bodies import translate_by
from tracer.scene.scene import Scene

if TYPE_CHECKING:
    from daq.bench.bench_table import BenchTable

DIGITS = 6  # of a millimetre


def glass_place_mm(run: Path, frames: Iterable[Path], lines: Mapping[int, Entry] | None = None) -> Vector:
    """Displacement of the glass from its place in the scene file, as planned for some frames of a run.

    Parameters
    ----------
    run : Path
        The run.
    frames : iterable of Path
        Frames of it.
    lines : mapping, optional
        Lines of its frames by number, where they have been read.

    Raises
    ------
    PairError
        It was not the same for all of them.
    RunDamaged
        The run does not say where the glass was.
    """
    folder = RunFolder(run)
    entries = frame_entries(folder.entries()) if lines is None else lines
    by_name = {entry["file"].rpartition("/")[2]: entry for entry in entries.values()}
    table = bench_table(folder)
    found: tuple[Vector, str] | None = None
    places: dict[int, Vector] = {}  # of positions that many lines share
    for frame in frames:
        try:
            at_mm = by_name[frame.name]["planned_mm"]
            place = places.get(id(at_mm)) or glass_off_scene_mm(table, at_mm)
            places[id(at_mm)] = place
        except KeyError as error:
            raise RunDamaged(f"{run}: frame {frame.name} lacks the position of {error}; {CURE}") from None
        found = found or (place, frame.name)
        if place != found[0]:
            raise PairError(f"{run}: the glass was moved between {found[1]} and {frame.name}; evaluate two runs")
    return (0.0, 0.0, 0.0) if found is None else found[0]


def glass_off_scene_mm(table: "BenchTable", positions_mm: Mapping[str, float]) -> Vector:
    """Displacement of the glass from its place in the scene file, to a nanometre: one place is one map."""
    x, y, z = (round(part, DIGITS) + 0.0 for part in table.offset_mm(GLASS, positions_mm))
    return (x, y, z)


def with_glass_at(scene: Scene, place_mm: Vector) -> Scene:
    """The scene with its glass moved by `place_mm` from where its file has it; walls that stand, stand.

    A masked part may be on the glass or stand before it: it is masked in both places.
    """
    if not any(place_mm):
        return scene
    step, carried = translate_by(place_mm), [body for body in scene.bodies if not body.stays]
    moved = scene.with_bodies([body if body.stays else body.moved(step) for body in scene.bodies])
    if not (scene.masked and carried):
        return moved
    sight = scene.camera.rotation_matrix[2]
    ends = np.array([
        np.array(end) + side * body.capsule.radius_mm * sight
        for body in carried
        for end in (body.capsule.start_mm, body.capsule.end_mm)
        for side in (-1.0, 1.0)
    ])  # fmt: skip
    steps_px = scene.camera.project(ends + np.array(place_mm)) - scene.camera.project(ends)
    stays = scene.left_out
    return replace(moved, masked=tuple(p if p in stays else sweep(p, steps_px) for p in scene.masked))
