"""Forecast of a plan before anything moves: moves, travel, time, disk space, and what is not allowed.

Limits and keep-out are judged by the same code that will judge the real moves (`Stage.check`), on the same
route, so a plan that passes here is refused later only if the start is another one.

**The way out of the homed place.**  Homing itself cannot be judged, because no position is known yet.
Where it ends is known only if the bench file says so (`homed_at_mm` of each axis); then the moves of `after_home`
are judged here as they will be when they are driven, and the plan is forecast from where they end. An axis that
`after_home` moves is known from then on.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from daq.bench.bench_table import Bench, trigger_is_software
from daq.bench.elements import CAMERA, GLASS, TARGET
from daq.bench.guards import sheet_clearances_mm
from daq.bench.opened import simulation_class
from daq.cameras.camera import Setting
from daq.plans.link_budget import link_excess, link_said
from daq.plans.steps import Step, frame_count, route
from daq.timing.timing_table import TimingTable
from ground.plain_words import in_words
from stages.errors import StageUsageError
from stages.stage import Stage

FRAME_OVERHEAD_S = 0.05  # trigger, readout, hand-over
STEP_OVERHEAD_S = 0.1  # reading the positions back, fsync of the journal
CHUNK_OVERHEAD_S = 1.5  # arming of camera and laser, dark frames at either end, accounting
SIMULATED_START_S, MAP_S = 0.5, 0.7  # opening and homing a simulated bench; a map of a million pixels
FILE_OVERHEAD_BYTES = 4096
DEFAULT_RATE_HZ = 10.0


@dataclass(frozen=True, slots=True)
class Violation:
    """A step that must not be made."""

    step: int
    tag: str
    text: str


@dataclass(frozen=True)
class Forecast:
    """The sum of a plan.

    Parameters
    ----------
    frames : int
        Frames to be written, of each camera.
    travel_mm : mapping
        Way of each axis, approach included.
    duration_s : float
        Estimate from speeds, accelerations, settling, exposures.
    raw_bytes, corrected_bytes : int
        Estimate of the files of all cameras.
    violations : tuple of Violation
        What is not allowed; empty if the plan may be carried out.
    link : str
        What the plan needs of the link of each camera, a line each; "" if it has no rate.
    steps_s : tuple of float
        Estimate of each step.
    is_from_scene : bool
        Whether it begins at the scene's place because it is not stated where homing leaves the axes.
    """

    frames: int
    travel_mm: Mapping[str, float]
    duration_s: float
    raw_bytes: int
    corrected_bytes: int
    violations: tuple[Violation, ...]
    link: str = ""
    steps_s: tuple[float, ...] = ()
    is_from_scene: bool = False


def forecast(
    bench: Bench,
    stage: Stage,
    steps: Sequence[Step],
    start_mm: Mapping[str, float] | None = None,
    cameras: Sequence[str] = (),
) -> Forecast:
    """Go through a list of steps without sending anything.

    Parameters
    ----------
    bench : Bench
        The bench.
    stage : Stage
        Its stage, open or not.
    steps : sequence of Step
        What is to be done.
    start_mm : mapping, optional
        Where the axes are; default is the place at which the scene file holds.
    cameras : sequence of str
        Further cameras of the bench that take the same frames.

    Raises
    ------
    PlanError
        The bench has no such camera.
    """
    seen = {CAMERA: bench} | {name: bench.as_seen_by(name) for name in cameras}
    here = dict(bench.home_mm if start_mm is None else start_mm)
    travel = dict.fromkeys(here, 0.0)
    steps_s: list[float] = []
    violations = []
    for step in steps:
        step_s = 0.0
        for move in route(bench, here, step.targets_mm):
            try:
                stage.check(here, move)
            except StageUsageError as error:
                violations.append(Violation(step.index, step.tag, str(error)))
            for piece in stage.way(here, move):
                travel[piece.axis] += abs(piece.end_mm - piece.start_mm)
            step_s += stage.duration_s(here, move)
            here |= move
        too_fast = {name: link_excess(each, step) for name, each in seen.items()}
        for said in (*_with_names(too_fast), _sheet_blocked(bench, step)):
            if said:
                violations.append(Violation(step.index, step.tag, said))
        steps_s.append(step_s + step.settle_s + STEP_OVERHEAD_S + frames_s(bench, step))
    duration_s = sum(steps_s) + max(
        (step.pulses.warm_up_s for step in steps if step.pulses is not None), default=0.0
    )
    frames, frame_bytes = frame_count(steps), sum(map(_frame_bytes, seen.values()))
    on_plane = sum(step.frames for step in steps if step.on_plane)
    disk = frames * frame_bytes, on_plane * frame_bytes
    link = "\n".join(_with_names({name: link_said(each, steps) for name, each in seen.items()}))
    return Forecast(frames, travel, duration_s, *disk, tuple(violations), link, tuple(steps_s))


def _with_names(said: Mapping[str, str]) -> list[str]:
    """Sentences about cameras, each with the name of its camera where there are several."""
    return [f"{name}: {one}" if len(said) > 1 else one for name, one in said.items() if one]


def _sheet_blocked(bench: Bench, step: Step) -> str:
    """Return why the laser would refuse to fire at the positions of a step; "" if it would not."""
    if step.pulses is None:
        return ""
    laser = bench.more.get(step.pulses.laser or "")
    if laser is None or not isinstance(laser.section, TimingTable):
        return ""
    wanted_mm, near = laser.section.clear_mm, dict[str, float]()
    for name, free_mm in sheet_clearances_mm(bench, step.targets_mm):
        if free_mm < wanted_mm:
            near[name] = min(free_mm, near.get(name, free_mm))
    if not near:
        return ""
    there = " and ".join(f"{name} {free_mm:z.3g} mm" for name, free_mm in near.items())
    moved = [name for name in near if name in (GLASS, TARGET)]
    keys = " and ".join(f"{name}_z_mm" for name in moved)
    cure = f"; {keys} in the plan {'moves it' if len(moved) == 1 else 'move them'} away" if moved else ""
    free = f"{wanted_mm:g} mm must be free (clear_mm of {step.pulses.laser})"
    return f"{there} from the light sheet, and {free}{cure}"


def frames_s(bench: Bench, step: Step) -> float:
    """Return the seconds that the frames of a step take at hardware."""
    order = step.pulses
    if order is None:
        return step.frames * _frame_s(bench.table.camera.settings)
    pairs = step.frames // 2
    return pairs / order.rate_hz + math.ceil(pairs / order.chunk) * CHUNK_OVERHEAD_S


def _frame_s(settings: Mapping[str, Setting]) -> float:
    if trigger_is_software(settings):
        return FRAME_OVERHEAD_S + float(settings.get("ExposureTime", 1000.0)) * 1e-6
    return 1.0 / float(settings.get("AcquisitionFrameRate", DEFAULT_RATE_HZ))


def _frame_bytes(bench: Bench) -> int:
    width, height = bench.scene.camera.sensor_px
    return 2 * width * height + FILE_OVERHEAD_BYTES  # frames are stored unpacked, 16 bit a pixel


def check_views(bench: Bench, steps: Iterable[Step]) -> None:
    """Refuse a plan that the simulated hardware of a bench file cannot show, if that is able to tell.

    Raises
    ------
    ConfigError
        There is no such section, or it is wrong.
    PlanError
        A step cannot be shown.
    """
    judge = getattr(simulation_class(bench), "check_views", None)
    if judge is not None:
        judge(bench, steps)


def simulation_s(bench: Bench, steps: Sequence[Step]) -> list[float]:
    """Return what the simulation of a bench file expects each step to take [s]; [] if it does not tell.

    Raises
    ------
    ConfigError
        There is no such section, or it is wrong.
    """
    tells = getattr(simulation_class(bench), "estimate_s", None)
    return [] if tells is None else [float(each_s) for each_s in tells(bench, steps)]


def time_said(bench: Bench, steps: Sequence[Step], said: Forecast, simulate: bool = True) -> str:
    """Return the duration of a plan in words: at hardware, and where its pictures have to be drawn."""
    hardware = in_words(said.duration_s)
    if not simulate or bench.table.simulation is None or not (rendering_s := simulation_s(bench, steps)):
        return hardware
    width, height = bench.scene.camera.sensor_px
    begins_s = SIMULATED_START_S + MAP_S * 1e-6 * width * height
    return f"{hardware} on hardware, {in_words(begins_s + sum(rendering_s))} simulated on an idle computer"


@dataclass(frozen=True)
class RetractPath:
    """The path out of the homed positions.

    Parameters
    ----------
    start_mm : dict or None
        Where every axis stands after it; None if that is not known.
    problems : tuple of (int, str)
        Moves of `after_home` (counted from 1) that must not be made, and why.
    sentence : str
        What a person should know about it.
    """

    start_mm: dict[str, float] | None
    problems: tuple[tuple[int, str], ...]
    sentence: str


def retract_path(bench: Bench, stage: Stage) -> RetractPath:
    """Go through `after_home` without sending anything.

    Parameters
    ----------
    bench : Bench
        Says where homing ends and what follows it.
    stage : Stage
        Its stage, open or not.
    """
    stages = bench.table.stages
    here = {name: axis.homed_at_mm for name, axis in stages.axes.items() if axis.homed_at_mm is not None}
    unknown = [name for name in stages.axes if name not in here]
    problems = []
    for number, move in enumerate(stages.after_home, start=1):
        if len(here) == len(stages.axes):
            try:
                stage.check(here, move)
            except StageUsageError as error:
                problems.append((number, str(error)))
        here |= move
    known = len(here) == len(stages.axes)
    if unknown:
        text = (
            f"note: where homing leaves {', '.join(unknown)} is not stated (homed_at_mm), so the way out of the "
            "homed place is judged only when it is driven"
        )
    elif problems:
        text = f"after_home does not lead out of the homed place: move {problems[0][0]}: {problems[0][1]}"
    else:
        text = "the plan is judged from the homed place" + (", left by after_home" if stages.after_home else "")
    return RetractPath(here if known else None, tuple(problems), text)


def forecast_from_home(
    bench: Bench, stage: Stage, steps: Sequence[Step], cameras: Sequence[str] = ()
) -> tuple[Forecast, str]:
    """Forecast a plan that begins with homing every axis; with a sentence about the way out of the homed place.

    Where that way is not known, the plan is forecast from the place at which the scene file holds.
    """
    out = retract_path(bench, stage)
    said = forecast(bench, stage, steps, out.start_mm, cameras)
    first = steps[0].index if steps else 0
    more = [Violation(first, f"move {number} of after_home", text) for number, text in out.problems]
    here = replace(said, violations=(*more, *said.violations), is_from_scene=out.start_mm is None)
    return here, out.sentence
