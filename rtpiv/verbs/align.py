"""`rtpiv align`: align glass and camera with the scene file by vision."""

from pathlib import Path

from daq.bench.bench_file import load_bench
from daq.bench.bench_table import Bench
from daq.bench.elements import CAMERA, GLASS
from daq.bench.opened import require_camera_libraries
from daq.errors import PlanError
from daq.plans.experiments.align import AlignPlan
from daq.plans.plan import load_plan
from daq.runner.session import Request, Run
from ground.plain_words import quantity
from ground.terminal import console, error_console
from rtpiv.verbs.acquire import check_plan, run_and_report, start_run
from rtpiv.verbs.operator import operator_of
from rtpiv.verbs.paths import Named

MAY_BE_OFF_MM = 1.5  # deviation that an alignment corrects; less room than that at a limit is reported


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
        Parent folder of the run.
    simulate : bool
        Use the simulation of the bench instead of the hardware.
    dry_run : bool
        Print the path to the first frame and the range of every axis; open nothing.  A plan with ``moves: 0``
        takes that frame and prints the moves that it asks for.
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
    for sentence in short_of_room(loaded):
        error_console().print(sentence, soft_wrap=True)
    forecast = check_plan(screen, request, loaded, steps, home, with_steps=dry_run)
    if dry_run:
        screen.print(f"then up to {quantity(steps.table.moves, 'move')}, each printed and checked first")
        return None
    person = operator_of(None, simulate)
    folder = start_run(screen, request, loaded, steps, Path(out), person, forecast.raw_bytes)
    run_and_report(screen, Run(request, loaded, steps, folder), home, person)
    return folder.path


def short_of_room(bench: Bench) -> list[str]:
    """Return warnings on axes of glass and camera too close to a limit for an alignment."""
    warnings = []
    for name, axis in bench.table.stages.axes.items():
        low, high = axis.limits_mm
        home = bench.home_mm[name]
        room = min(home - low, high - home)
        if axis.carries in (GLASS, CAMERA) and room < MAY_BE_OFF_MM:
            warnings.append(
                f"{name} has {room:.2f} mm to its limit from its position in the scene file; larger deviations"
                " cannot be corrected"
            )
    return warnings
