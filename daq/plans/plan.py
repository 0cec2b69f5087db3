"""plan.yaml -> a frozen plan -> a flat list of steps; nothing moves and nothing is open.

A plan file names its experiment; see `daq.plans.experiments` for the keys of each.  Experiments are one file each
and one line in `EXPERIMENTS`.  An experiment is a `PlanTable`: its keys in the plan file, and `poses`, a pure
function of bench and file that says what is to be photographed.  What a plan may ask and hardly ever does is asked
back, each question with its line (`plan_questions`; see `daq.bench.scene_plausibility`).
"""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from daq.bench.bench_table import Bench
from daq.bench.elements import CAMERA, DIRECTIONS, GLASS, TARGET
from daq.errors import PlanError
from daq.plans.plan_table import PlanTable, Pose
from daq.plans.steps import CLEAR, Step, steps_hash
from ground.config import Document, open_document, require_kind, validate
from ground.errors import ConfigError, Problem
from ground.plain_words import near
from ground.usual import plausibility_questions

EXPERIMENTS = {
    "target": "daq.plans.experiments.target:TargetPlan",
    "shift": "daq.plans.experiments.shift:ShiftPlan",
    "stream": "daq.plans.experiments.stream:StreamPlan",
    "focus": "daq.plans.experiments.focus:FocusPlan",
    "align": "daq.plans.experiments.align:AlignPlan",
    "flow": "daq.plans.experiments.flow:FlowPlan",
}
ON_PLANE_MM = 1e-9


@dataclass(frozen=True)
class Plan:
    """A plan and what it expands to on one bench.

    Parameters
    ----------
    name : str
        Of the file, without its ending.
    path : Path
        The file.
    document : Document
        Its contents with line numbers.
    table : PlanTable
        Its contents, checked.
    steps : tuple of Step
        The expansion.
    """

    name: str
    path: Path
    document: Document
    table: PlanTable
    steps: tuple[Step, ...]

    def content_hash(self) -> str:
        """Hex digest (16 characters) of all steps."""
        return steps_hash(self.steps)


def load_plan(path: Path | str, bench: Bench) -> Plan:
    """Read a plan file and expand it for a bench.

    Raises
    ------
    ConfigError
        The file is wrong, with line.
    PlanError
        The bench cannot carry it out.
    """
    document, table = read_plan(path)
    return Plan(document.path.stem, document.path.resolve(), document, table, expand(table, bench))


def read_plan(path: Path | str) -> tuple[Document, PlanTable]:
    """Read a plan file without asking whether any bench can do it.

    Raises
    ------
    ConfigError
        The file is wrong, with line.
    """
    document = open_document(path)
    require_kind(document, ["experiment"])
    name = document.tree.get("experiment") if isinstance(document.tree, dict) else None
    if not isinstance(name, str) or name not in EXPERIMENTS:
        hint = near(str(name), list(EXPERIMENTS))
        text = f"experiment should be one of {', '.join(EXPERIMENTS)}, not {name!r}{hint}"
        raise ConfigError(document.path, [Problem(document.line(("experiment",)), text)])
    return document, validate(document, plan_table(name))


def expand(table: PlanTable, bench: Bench) -> tuple[Step, ...]:
    """Return the steps of a plan on a bench; pure.

    Raises
    ------
    PlanError
        The bench has no axis for a displacement, the glass cannot be moved out of the way, or laser and camera
        cannot do what is asked of them.
    """
    for name in table.needed:
        if name not in bench.more or bench.more[name].kind != "reading":
            raise PlanError(
                f"needed: the bench has no reading {name!r}; give it one under devices, or leave that out"
            )
    steps: list[Step] = []
    first_frame = 0
    for index, pose in enumerate(table.poses(bench)):
        frames = table.frames if pose.frames is None else pose.frames
        steps.append(
            Step(
                index=index,
                tag=pose.tag,
                positions_mm=tuple(_positions(bench, pose).items()),
                settle_s=table.settle_s,
                first_frame=first_frame,
                frames=frames,
                view=pose.view,
                shows=table.shows,
                on_plane=_is_on_plane(pose),
                reference=pose.reference,
                group=table.frames_together,
                gaps_at_most=table.share_of_gaps,
                pulses=pose.pulses,
            )
        )
        first_frame += frames
    return tuple(steps)


def _is_on_plane(pose: Pose) -> bool:
    """True if what is seen lies in the plane that the scene's camera looks at: a light sheet always does."""
    return (pose.pulses is not None or abs(pose.target_mm[2]) < ON_PLANE_MM) and not any(pose.camera_mm)


def _positions(bench: Bench, pose: Pose) -> dict[str, float]:
    """Position of every axis for a pose."""
    positions = bench.home_mm
    if pose.view == CLEAR and bench.has_glass:
        glass = bench.table.glass
        if glass is None:
            raise PlanError(f"{pose.tag}: the bench file gives no position of the glass outside the view (glass)")
        # out of the picture it stays retracted: one travel less for everything that could touch it
        positions |= glass.retract_mm | glass.out_mm
    if pose.view != CLEAR and not bench.has_glass:
        raise PlanError(f"{pose.tag}: the scene has no glass; plan the clear view, or name a scene with bodies")
    ways = {TARGET: pose.target_mm, CAMERA: pose.camera_mm}
    if pose.view != CLEAR:
        ways[GLASS] = pose.glass_mm
    for element, ways_mm in ways.items():
        for direction, way_mm in zip(DIRECTIONS, ways_mm, strict=True):
            if way_mm:
                positions[_axis(bench, element, direction, pose.tag)] += way_mm
    return positions


def _axis(bench: Bench, element: str, direction: str, tag: str) -> str:
    found = [name for name, axis in bench.table.axes_of(element).items() if axis.along == direction]
    if not found:
        raise PlanError(f"{tag}: no axis moves the {element} along {direction}")
    return found[0]


def plan_questions(plan: Plan, bench: Bench) -> list[str]:
    """Ask about what is unusual in a plan file on its bench: questions with file and line."""
    asked = plausibility_questions(plan.document, plan.table)
    asked += [Problem(plan.document.line(place), text) for place, text in plan.table.questions(bench, plan.steps)]
    return [f"{plan.path}:{one.line}: {one.text}" for one in sorted(asked, key=lambda one: one.line)]


def plan_table(experiment: str) -> type[PlanTable]:
    """Class of an experiment; KeyError if there is no line for it."""
    module, _, name = EXPERIMENTS[experiment].partition(":")
    found: type[PlanTable] = getattr(import_module(module), name)
    return found
