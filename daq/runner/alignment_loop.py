"""An alignment's steps are aimed as it goes: what the last look has shown decides where the next one is.

    look -> find glass and camera in the frame -> journal -> did the last move do what it should? -> where next?

The journal has what was seen (`look`) and where the axes were sent (`step`); the frames are there, so a run that
was interrupted finds the same again. Before a move is made, all of its way is judged by limits, and by keep-out
for the glass where it was SEEN, not where the scene file has it: that is off by what is being put right.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from correction.alignment.moves import (
    DIRECTIONS,
    MOVE_SIGMAS,
    STAGE_STEP_MM,
    Look,
    Wanted,
    plan_moves,
    require_followed,
)
from correction.alignment.seen import REACH_MM, Expected, find_arrangement, usable
from correction.alignment.spheres_seen import MAX_STRAY_MM, SphereSeen
from daq.bench.bench_table import Bench
from daq.bench.elements import CAMERA, GLASS, TARGET
from daq.bench.keep_out import Carrier, Element, KeepOut
from daq.bench.opened import OpenBench
from daq.errors import PlanError
from daq.plans.experiments.align import AlignPlan
from daq.plans.steps import Step, route
from daq.runs.journal import Journal, utc_now
from daq.runs.journal_lines import Entry
from daq.runs.raw_frame import read_raw
from daq.runs.run_folder import RunFolder, frame_entries
from stages.errors import StageUsageError
from stages.way import Guard
from tracer.scene.scene_file import load_priors

SAID_MM = 1e-6
UNSURE = 0.25  # of a sigma: glass that is seen to stand so near its place is moved by noise alone


class AlignmentLoop:
    """Aims the steps of one alignment.

    Parameters
    ----------
    hardware : OpenBench
        Open.
    folder : RunFolder
        Its run.
    table : AlignPlan
        The plan.
    say : callable
        Gets a sentence a look and a move.
    """

    def __init__(
        self, hardware: OpenBench, folder: RunFolder, table: AlignPlan, say: Callable[[str], None]
    ) -> None:
        self._hardware = hardware
        self._folder = folder
        self._table = table
        self._say = say
        self._priors = load_priors(hardware.bench.path.parent / hardware.bench.table.scene)
        self.looks: list[Look] = []
        self.is_settled = False  # after the last look nothing need move that is known to be off

    def before(self, step: Step) -> Step:
        """Return a step with the places that the looks before it ask for.

        Raises
        ------
        AlignmentError, TargetNotFound
            The frames do not say where to go, or an axis did not do what it should.
        PlanError
            Limits or keep-out forbid it; nothing has moved.
        """
        self._see(step.index)
        if not self.looks:
            return step
        bench, stage = self._hardware.bench, self._hardware.stage
        require_followed(self.looks, _names(bench))
        want = self.next_positions()
        before = self._entry("step", step.index - 1)
        targets = next_targets(bench, before["planned_mm"], self.looks[-1], want)
        stage.guard = guard_where_seen(bench, want)
        here = dict(before["measured_mm"])
        for move in route(bench, here, targets):
            try:
                stage.check(here, move)
            except StageUsageError as error:
                raise PlanError(f"the glass cannot be moved there: {error}; nothing was moved") from error
            here |= move
        self._say(move_in_words(before["planned_mm"], targets))
        return replace(step, positions_mm=tuple(targets.items()))

    def after(self, step: Step, journal: Journal) -> None:
        """Look at the frames of a step, and write down what is seen."""
        self._see(step.index + 1)
        want, look = self.next_positions(), self.looks[-1]
        journal.append(
            "look",
            sync=True,
            step=step.index,
            tag=step.tag,
            utc=utc_now(),
            glass_mm=look.seen.glass_mm.tolist(),
            glass_sigma_mm=look.seen.sigma_mm.tolist(),
            spheres={one.name: one.off_mm.tolist() for one in look.seen.spheres if one.own_rim},
            remarks=list(look.seen.remarks),
            **({} if look.seen.camera_mm is None else {"camera_mm": look.seen.camera_mm.tolist()}),
        )
        back_mm = self._table.back_mm if step.index == 0 else 0.0
        wish = f"; {back_mm:g} mm of z are the back_mm of the plan, for safety" if back_mm else ""
        self._say(f"{step.tag}: {look_in_words(look, want)}{wish}")
        if step.index == 0:
            for remark in look.seen.remarks:
                self._say(remark)
        planned = self._entry("step", step.index)["planned_mm"]
        targets = next_targets(self._hardware.bench, planned, look, want)
        moved = {name for name, mm in targets.items() if mm != planned[name]}
        aside = {name for (element, along), name in _names(self._hardware.bench).items()
                 if element == GLASS and along != "z"}  # fmt: skip
        sure_mm = float(np.hypot(*want.glass_sigma_mm[:2]))
        is_little = want.sideways_mm <= min(STAGE_STEP_MM, UNSURE * sure_mm)
        self.is_settled = not moved or (moved <= aside and is_little)
        if self._table.moves == 0:
            self._say(f"with moves allowed: {move_in_words(planned, targets)}")

    def next_positions(self) -> Wanted:
        """Return the positions of the axes that the looks so far ask for."""
        bench = self._hardware.bench
        axes = {
            element: "".join(sorted({axis.along for axis in bench.table.axes_of(element).values()}))
            for element in (GLASS, CAMERA)
        }
        return plan_moves(self.looks, axes, free_before_target_mm(bench))

    # ---- looks -----------------------------------------------------------------------------------

    def _see(self, steps: int) -> None:
        """Have a look for each of the first steps."""
        while len(self.looks) < steps:
            self.looks.append(self._look(len(self.looks)))

    def _look(self, number: int) -> Look:
        bench, measured = self._hardware.bench, self._entry("step", number)["measured_mm"]
        glass, camera, board = (
            np.array(bench.table.offset_mm(element, measured)) for element in (GLASS, CAMERA, TARGET)
        )
        put_up, camera_put_up, reach = np.zeros(3), np.zeros(3), REACH_MM
        if self.looks:
            want, last = self.next_positions(), self.looks[-1]
            put_up, camera_put_up = want.put_up_mm, want.camera_put_up_mm
            # where it is if it has gone the other way must be in sight too
            reach = 0.5 + 2.0 * float(np.hypot(*(glass - last.glass_mm)[:2]))
        expected = Expected(glass + put_up, camera + camera_put_up, board)
        target = bench.board if self._table.target else None
        seen = find_arrangement(self._frame(number), bench.scene, target, expected, reach, self._priors)
        return Look(glass, camera, seen)

    def _frame(self, step: int) -> NDArray[np.float32]:
        """Mean of the frames of a step."""
        entries = [entry for entry in frame_entries(self._folder.entries()).values() if entry["step"] == step]
        frames = [read_raw(self._folder.inside(str(e["file"])), e["crc32"])[0] for e in entries]
        for frame in frames:
            usable(frame, self._hardware.bench.scene.camera)
        return np.asarray(np.mean(np.array(frames, dtype=np.float32), axis=0))

    def _entry(self, kind: str, step: int) -> Entry:
        """Last line of a kind about a step."""
        return next(e for e in reversed(self._folder.entries()) if e["kind"] == kind and e["step"] == step)


def _names(bench: Bench) -> dict[tuple[str, str], str]:
    """Element and direction -> axis."""
    return {
        (axis.carries, axis.along): name
        for name, axis in bench.table.stages.axes.items()
        if axis.carries in (GLASS, CAMERA)
    }


def next_targets(bench: Bench, planned_mm: Mapping[str, float], last: Look, want: Wanted) -> dict[str, float]:
    """Position of every axis; those that need not move keep theirs."""
    targets = dict(planned_mm)
    for (element, along), name in _names(bench).items():
        here, there = (last.glass_mm, want.glass_mm) if element == GLASS else (last.camera_mm, want.camera_mm)
        way = float((there - here)[DIRECTIONS.index(along)])
        if abs(way) > SAID_MM:
            targets[name] = round(targets[name] + way, 6)
    return targets


def free_before_target_mm(bench: Bench) -> float:
    """Distance by which keep-out lets the glass come nearer to the target than in the scene; 0 without it."""
    table = bench.table.keep_out
    if table is None:
        return 0.0
    glass = [body for body in bench.scene.bodies if body.carried == GLASS]
    gaps = [body.lowest_mm - (0.0 if body.name in table.contact else table.clearance_mm) for body in glass]
    return max(0.0, min(gaps, default=0.0))


def guard_where_seen(bench: Bench, want: Wanted) -> Guard | None:
    """Keep-out for glass and camera where they were seen to stand, as far as there are axes to say it by."""
    if bench.table.keep_out is None:
        return None
    off = {GLASS: want.put_up_mm, CAMERA: want.camera_put_up_mm, TARGET: np.zeros(3)}
    home = bench.home_mm
    carriers = {
        name: Carrier(
            cast("Element", axis.carries),
            axis.along,
            home[name] - float(off[axis.carries][DIRECTIONS.index(axis.along)]),
        )
        for name, axis in bench.table.stages.axes.items()
    }
    return KeepOut(bench.scene, carriers, bench.table.keep_out)


def look_in_words(look: Look, want: Wanted) -> str:
    """Say where the glass stands."""
    x, y, z = (1e3 * want.glass_left_mm).tolist()
    sx, sy, sz = (1e3 * want.glass_sigma_mm).tolist()
    said = (
        f"the glass stands x {x:+.0f} +- {sx:.0f}, y {y:+.0f} +- {sy:.0f}, z {z:+.0f} +- {sz:.0f} um off its place"
    )
    if look.seen.camera_mm is not None:
        said += ", the camera ({:+.2f}, {:+.2f}, {:+.2f}) mm".format(*look.seen.camera_mm)
    return said


def move_in_words(before_mm: Mapping[str, float], targets_mm: Mapping[str, float]) -> str:
    """Say which axes are moved, and by how much."""
    ways = {name: mm - before_mm[name] for name, mm in targets_mm.items() if mm != before_mm[name]}
    if not ways:
        return "no axis needs to move"
    return "moving " + ", ".join(f"{name} {way:+.4f} mm" for name, way in ways.items())


def _balls_in_words(spheres: Sequence[SphereSeen], glass_left_mm: NDArray[np.float64]) -> list[str]:
    """Say of every ball what is known of its place in the glass, sideways."""
    said = []
    for one in spheres:
        off, sure = float(np.hypot(*(one.off_mm - glass_left_mm)[:2])), float(np.hypot(*one.sigma_mm[:2]))
        if not one.own_rim:
            said.append(
                f"{one.name}: not judged, no rim of its own is seen; it may stand {1e3 * MAX_STRAY_MM:.0f} um"
                " beside its place in the glass, which `rtpiv calibrate` finds"
            )
        elif off > max(MOVE_SIGMAS * sure, 2.0 * STAGE_STEP_MM):
            said.append(
                f"{one.name} itself stands {1e3 * off:.0f} +- {1e3 * sure:.0f} um off its place in the glass,"
                " sideways: no move of the glass cures that; `rtpiv calibrate` finds it"
            )
        else:
            said.append(
                f"{one.name}: at its place in the glass, {1e3 * off:.0f} +- {1e3 * sure:.0f} um off sideways"
            )
    return said


def end_in_words(want: Wanted, spheres: Sequence[SphereSeen] = ()) -> list[str]:
    """Say what an alignment has come to, with the balls that the last look has seen."""
    said = _balls_in_words(spheres, want.glass_left_mm)
    sure = float(np.hypot(*want.glass_sigma_mm[:2]))
    rims, hidden = ([one.name for one in spheres if one.own_rim is own] for own in (True, False))
    by = f" by {', '.join(rims)}" if hidden else ""
    if want.sideways_mm <= STAGE_STEP_MM:
        last = f"aligned{by}: {1e3 * want.sideways_mm:.0f} um off sideways, +- {1e3 * sure:.0f} um"
    else:
        last = (
            f"not aligned to a step of {1e3 * STAGE_STEP_MM:.0f} um{by}: {1e3 * want.sideways_mm:.0f} um off"
            f" sideways, +- {1e3 * sure:.0f} um; look again, with more moves or more frames"
        )
    said.append(f"{last}; not judged: {', '.join(hidden)} (+- {1e3 * MAX_STRAY_MM:.0f} um)" if hidden else last)
    left, sigma = float(want.glass_left_mm[2]), float(want.glass_sigma_mm[2])
    said.append(
        f"along z the glass stands {left:+.2f} mm off its place, known from one frame to +- {sigma:.2f} mm"
        + (", so it was left that far before the target; `rtpiv calibrate` finds it" if want.stands_off_mm else "")
    )
    return said
