"""`rtpiv align`: align glass and camera with the scene file by vision."""

from pathlib import Path

from rich.console import Console

from daq.bench.bench_file import load_bench
from daq.bench.bench_table import Bench
from daq.bench.elements import CAMERA, GLASS
from daq.bench.opened import require_camera_libraries
from daq.errors import PlanError
from daq.plans.experiments.align import AlignPlan
from daq.plans.forecast import check_views
from daq.plans.plan import load_plan
from daq.runner.session import Request, Run, begin, check_disk
from ground.plain_words import counted
from ground.terminal import console, error_console
from rtpiv.verbs.acquire import ENDS, forecast_said, run_and_report
from rtpiv.verbs.operator import operator_of, require_person
from rtpiv.verbs.paths import Named
from rtpiv.verbs.results import require_folder
from stages.identities import confusable

MAY_BE_OFF_MM = 1.5  # from which an alignment is made for; less room than that at a limit is said


def align(
    plan: Named,
    /,
    bench: Named = "bench.yaml",
    out: Named = "runs",
    simulate: bool = False,
    dry_run: bool = False,
    home: bool = False,
) -> Path | None:
    """Align glass and camera.

    Parameters
    ----------
    plan : path
        plan.yaml of experiment: align.
    bench : path
        bench.yaml.
    out : path
        Folder in which the run gets a folder of its own.
    simulate : bool
        Use the bench's simulation in place of the hardware.
    dry_run : bool
        Print the way to the first look and how far every axis could put right; open nothing.  A plan of
        ``moves: 0`` takes that look, and says which moves it asks for.
    home : bool
        Home every axis first, in the configured order.

    Returns
    -------
    Path or None
        Folder of the run; None after a dry run.

    Raises
    ------
    ConfigError, PlanError
        A file is wrong, or limits or keep-out forbid the way; nothing has moved.
    AlignmentError, TargetNotFound
        A frame does not say where the glass is, or an axis did not do what it should.
    RunInterrupted
        Ended on request; resume it.
    """
    screen = console()
    request = Request(Path(bench), Path(plan), simulate, correct=False)
    loaded = load_bench(Path(bench))
    if not dry_run:
        require_camera_libraries(loaded, simulate)
    steps = load_plan(Path(plan), loaded)
    if not isinstance(steps.table, AlignPlan):
        raise PlanError(
            f"is a plan of experiment: {steps.table.experiment}", place=plan, cure="give one of experiment: align"
        )
    said = forecast_said(screen, loaded, steps, home, with_steps=dry_run, simulate=simulate)
    for sentence in short_of_room(loaded):
        error_console().print(sentence, soft_wrap=True)
    if not simulate:
        for warning in confusable(loaded.table.stages):
            error_console().print(warning, soft_wrap=True)
    if said.violations:
        first = said.violations[0]
        raise PlanError(f"{plan}: the first look is not allowed: {first.text}")
    if simulate:
        check_views(loaded, steps.steps)
    if dry_run:
        screen.print(f"then up to {counted(steps.table.moves, 'move')}, each said and judged before it is made")
        return None
    return _execute(screen, request, loaded, Path(out), home, said.raw_bytes)


def _execute(screen: Console, request: Request, bench: Bench, out: Path, home: bool, raw_bytes: int) -> Path:
    plan, person = load_plan(request.plan, bench), operator_of(None, request.simulate)
    require_person(person, plan.steps, [] if request.simulate else list(bench.table.stages.by_hand))
    require_folder(out).mkdir(parents=True, exist_ok=True)
    check_disk(out, raw_bytes)
    folder = begin(request, bench, plan, out)
    screen.print(f"run {folder.path}; the target's stage should hold: {plan.table.shows}")
    screen.print(ENDS)
    run_and_report(screen, Run(request, bench, plan, folder), home, person)
    return folder.path


def short_of_room(bench: Bench) -> list[str]:
    """Say which axes of glass and camera stand so near to a limit that an alignment may not reach its place."""
    said = []
    for name, axis in bench.table.stages.axes.items():
        low, high = axis.limits_mm
        home = bench.home_mm[name]
        room = min(home - low, high - home)
        if axis.carries in (GLASS, CAMERA) and room < MAY_BE_OFF_MM:
            said.append(
                f"{name} has {room:.2f} mm to its limit from the place of the scene file; what is off by more than"
                " that cannot be put right"
            )
    return said
