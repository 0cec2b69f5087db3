"""`rtpiv acquire`: execute a plan on a bench or its simulation."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from daq.bench.bench_file import load_bench
from daq.bench.bench_table import Bench
from daq.bench.elements import CAMERA, Vector
from daq.bench.guards import idle_stage
from daq.bench.opened import check_devices, require_camera_libraries
from daq.bench.rehearsal import Rehearsal
from daq.errors import BadBalance, FrameDoubt, PlanError
from daq.pipeline.pipeline import LIVE_QUEUE
from daq.plans.experiments.focus import FocusPlan
from daq.plans.forecast import Forecast, check_views, forecast_from_home, time_said
from daq.plans.forecast import forecast as forecast_plan
from daq.plans.plan import Plan, load_plan, read_plan
from daq.plans.steps import Step
from daq.runner.laser_session import Operator
from daq.runner.progress import watch
from daq.runner.session import Request, Run, begin, check_disk, run_session
from daq.runs.displacement import FILE as MOVED
from daq.runs.displacement import Moved, read_displacements
from daq.runs.frame_accounting import UNCHECKED, chunk_sentences, rejection_sentence
from daq.runs.gaps import gap_sentence
from daq.runs.run_folder import RunFolder
from ground.errors import ConfigError
from ground.plain_words import quantity
from ground.terminal import console, error_console
from piv.resampling.sample import Method
from rtpiv.analysis.report.table import ALL_COLUMNS, Table
from rtpiv.options.numbers import Count, DewarpOrder
from rtpiv.verbs.operator import ScriptOperator, operator_of, require_person
from rtpiv.verbs.paths import Named, path_of
from rtpiv.verbs.results import require_folder
from stages.errors import PortUnavailable
from stages.identities import confusable

if TYPE_CHECKING:
    from daq.live.run_shown import RunShown

FORECAST_STEPS = 40
SHOWN_DISPLACEMENTS = 12
ENDS = "Ctrl-C finishes the step, twice stops the axes now, Ctrl-Z pauses between steps"
ENDS_IN_LIGHT = (
    "Ctrl-C switches the laser off and ends within the step, whose pairs are kept; twice stops the axes now;"
    " Ctrl-Z pauses between steps"
)
ENDS_IN_FOREIGN_LIGHT = (
    "Ctrl-C ends within the step, whose pairs are kept, and leaves the laser to its own program; twice stops the"
    " axes now; Ctrl-Z pauses between steps"
)


@dataclass(frozen=True)
class LiveFrames:
    """Processing of frames as they arrive.

    Parameters
    ----------
    correct : bool
        Correct frames as they arrive.
    scene : path, optional
        Scene for the correction, such as a fitted one; default that of the bench.
    target_clear : path, optional
        Frame of the bare target, for the dewarp.
    dewarp_order : {2, 3, 4, 5}
        Order of the dewarp polynomial.
    method : {"quintic", "bilinear"}
        Interpolation of the correction.
    live_queue : int
        Maximum number of frames waiting for correction; 1 for the lowest latency.
    live : bool
        Show corrected frames in the browser during the run.
    """

    correct: bool = True
    scene: Named | None = None
    target_clear: Named | None = None
    dewarp_order: DewarpOrder = 2
    method: Method = "quintic"
    live_queue: Count = LIVE_QUEUE
    live: bool = False


def acquire(
    plan: Named,
    /,
    bench: Named = "bench.yaml",
    out: Named = "runs",
    simulate: bool | Rehearsal = False,
    dry_run: bool = False,
    home: bool = False,
    operator: str | None = None,
    frames: LiveFrames = LiveFrames(),
) -> Path | None:
    """Execute a plan on a bench.

    Parameters
    ----------
    plan : path
        plan.yaml.
    bench : path
        bench.yaml.
    out : path
        Folder in which the run gets a folder of its own.
    simulate : bool or Rehearsal
        Use the simulation of the bench instead of the hardware; a rehearsal adds faults and a seed.
    dry_run : bool
        Print steps, travel, time, disk space and violations; open nothing.  With `simulate` also refuse views
        that the simulated bench cannot show.
    home : bool
        Home every axis first, in the configured order; the plan is then checked from the homing position, if the
        bench file gives it.
    operator : str, optional
        Confirm the simulated laser of a flow run without asking at the terminal, and record this name
        (docs/laser.md).  Not for a real laser.
    frames : LiveFrames
        Processing of frames as they arrive.

    Returns
    -------
    Path or None
        Folder of the run; None after a dry run.

    Raises
    ------
    ConfigError, PlanError
        A file is wrong, or the plan violates limits or keep-out; nothing has moved.
    CameraSetupError
        Libraries of the camera are not installed.
    RunInterrupted
        Ended on request; resume it.
    """
    screen = console()
    plan, bench, out = Path(plan), Path(bench), Path(out)
    given = path_of(frames.scene), path_of(frames.target_clear)
    order, method, queue = frames.dewarp_order, frames.method, frames.live_queue
    rehearsal = simulate if isinstance(simulate, Rehearsal) else None
    simulate = bool(simulate)
    loaded = _bench_of(bench, plan)
    check_devices(loaded)
    if not dry_run and rehearsal is None:  # which has all cameras in memory
        require_camera_libraries(loaded, simulate)
    steps = load_plan(plan, loaded)
    rehearsed = loaded if rehearsal is None else rehearsal.of(loaded, len(steps.steps))
    seed = None if rehearsal is None else rehearsal.seed
    request = Request(
        bench, plan, simulate, frames.correct, *given, order, method, queue, rehearsal is not None, seed
    )
    forecast = check_plan(screen, request, loaded, steps, home, with_steps=dry_run)
    if simulate:
        require_lens(loaded, steps)
    if dry_run:
        return None
    person = operator_of(operator, simulate)
    size = forecast.raw_bytes + (forecast.corrected_bytes if frames.correct else 0)
    folder = start_run(screen, request, loaded, steps, out, person, size)
    run_and_report(screen, Run(request, rehearsed, steps, folder), home, person, live=frames.live)
    return folder.path


def check_plan(
    screen: Console, request: Request, bench: Bench, plan: Plan, home: bool, with_steps: bool
) -> Forecast:
    """Forecast a plan on an idle bench, print the forecast, and refuse a plan that violates limits or keep-out."""
    stage, simulate, cameras = idle_stage(bench), request.simulate, plan.table.further_cameras
    if home:
        found, sentence = forecast_from_home(bench, stage, plan.steps, cameras)
        if not (simulate and found.is_from_scene):  # it concerns hardware alone
            screen.print(sentence, soft_wrap=True)
    else:
        found = forecast_plan(bench, stage, plan.steps, cameras=cameras)
    print_forecast(screen, bench, plan, found, with_steps, simulate)
    if not simulate:
        for warning in confusable(bench.table.stages):
            error_console().print(warning, soft_wrap=True)
    if found.violations:
        first = found.violations[0]
        raise PlanError(
            f"{request.plan}: {len(found.violations)} of its moves or rates are not allowed; "
            f"step {first.step + 1} ({first.tag}): {first.text}"
        )
    if simulate:
        check_views(bench, plan.steps)
    return found


def start_run(
    screen: Console, request: Request, bench: Bench, plan: Plan, out: Path, person: Operator, size_bytes: int
) -> RunFolder:
    """Create the folder of a run, if operator and disk allow it, and print how to end the run."""
    require_person(person, plan.steps, [] if request.simulate else list(bench.table.stages.by_hand))
    require_folder(out).mkdir(parents=True, exist_ok=True)
    check_disk(out, size_bytes)
    folder = begin(request, bench, plan, out)
    is_lit = any(step.pulses is not None for step in plan.steps)
    is_foreign = any(step.is_lit_from_outside for step in plan.steps)
    screen.print(
        f"run {folder.path}" + ("" if is_lit else f"; the target's stage should hold: {plan.table.shows}")
    )
    screen.print(ENDS_IN_FOREIGN_LIGHT if is_foreign else ENDS_IN_LIGHT if is_lit else ENDS)
    return folder


def require_lens(bench: Bench, plan: Plan) -> None:
    """Refuse a focus scan through the pinhole that our simulated camera is by default."""
    simulation = bench.table.simulation or {}
    ours = str(simulation.get("bench", "")).startswith("sim.")
    if isinstance(plan.table, FocusPlan) and ours and simulation.get("aperture") is None:
        raise PlanError(
            f"{bench.path}: the simulated lens is a pinhole, which is sharp at every distance; give it an"
            " aperture: simulation: {aperture: {f_mm: 60.0, f_number: 2.8, focus_mm: 500.0}}"
        )


def _bench_of(bench: Path, plan: Path) -> Bench:
    """Read a bench; if it is wrong, report the errors of the plan as well."""
    try:
        return load_bench(bench)
    except ConfigError as error:
        wrong = [error]
        try:
            read_plan(plan)
        except ConfigError as more:
            wrong.append(more)
        raise ConfigError.merge(wrong) from None


def run_and_report(
    screen: Console,
    run: Run,
    home: bool,
    person: Operator,
    live: bool = False,
    is_new: bool = True,
) -> dict[str, Any]:
    """Execute the remaining steps of a run, and print its result or how to resume."""
    request, folder = run.request, run.folder
    try:
        with watch(error_console()) as watcher, run_pages(screen, run, live) as shown:
            for page in shown.values():
                watcher = page.watching(watcher)
            done = run_session(
                run,
                home,
                watcher,
                operator=person,
                show={name: page.show for name, page in shown.items()},
                say=lambda sentence: screen.print(sentence, soft_wrap=True, highlight=False),
            )
    except (BadBalance, FrameDoubt):
        said = f"the run is in {folder.path}; its contents are uncertain, so it cannot be resumed"
        error_console().print(said, soft_wrap=True, highlight=False)
        raise
    except BaseException as error:
        if is_new and folder.remove_if_empty():  # the bench could not be opened, or an axis was not homed
            said = "nothing was taken, so this run is not kept"
            if isinstance(error, PortUnavailable) and not request.simulate:
                said += "; without hardware: --simulate"
            error_console().print(said, soft_wrap=True, highlight=False)
            raise
        homing = " --home" if home or request.simulate else ""  # a simulated bench forgets its positions
        said = f"the run is in {folder.path}; go on with: rtpiv acquire --resume"
        said += f" {shlex.quote(str(folder.path))}{homing}"
        if isinstance(person, ScriptOperator):
            said += f" --operator {shlex.quote(person.name)}"
        error_console().print(said, soft_wrap=True, highlight=False)
        raise
    print_done(screen, folder, done)
    return done


@contextmanager
def run_pages(screen: Console, run: Run, live: bool) -> "Iterator[dict[str, RunShown]]":
    """Serve a page of each camera of the run, if they are wanted; by the names of the cameras."""
    if not live:
        yield {}
        return
    from daq.live.live_page import BYTES_PER_PX, LivePage
    from daq.live.run_shown import RunShown
    from rtpiv.analysis.gaps import share_of_scene
    from tracer.scene.scene_file import load_scene

    further, shown = run.folder.cameras(), dict[str, RunShown]()
    with ExitStack() as stack:
        for name in (CAMERA, *further):
            bench, given = run.bench.as_seen_by(name), run.request.scene
            scene = bench.scene if given is None or name in further else load_scene(given)
            width, height = scene.camera.sensor_px
            page = stack.enter_context(LivePage(BYTES_PER_PX * width * height, 0, scene, bench.board))
            whose = f" ({name})" if further else ""
            screen.print(f"look at {page.url}{whose}", soft_wrap=True, highlight=False)
            through = share_of_scene(scene)
            shown[name] = RunShown(page, run.folder, "" if through is None else through.sentence, name)
        yield shown


def print_forecast(
    screen: Console, bench: Bench, plan: Plan, said: Forecast, with_steps: bool, simulate: bool
) -> None:
    """Print the forecast of a plan."""
    if with_steps:
        columns = ("step", "frames", "tag", "view", "axes away from the scene's place in mm")
        rows = [_step_row(step, bench.home_mm) for step in plan.steps[:FORECAST_STEPS]]
        screen.print(Table(f"steps of {plan.name}", columns, rows, left=ALL_COLUMNS))
        if len(plan.steps) > FORECAST_STEPS:
            screen.print(f"... and {len(plan.steps) - FORECAST_STEPS} more")
    time = f"about {time_said(bench, plan.steps, said, simulate)}"
    travel = ", ".join(f"{name} {mm:.0f}" for name, mm in said.travel_mm.items() if mm)
    cameras = 1 + len(plan.table.further_cameras)
    each = f" of each of {cameras} cameras" if cameras > 1 else ""
    screen.print(
        f"{quantity(len(plan.steps), 'step')}, {quantity(said.frames, 'frame')}{each}, {time}; "
        f"travel in mm: {travel or 'none'}; "
        f"disk: {said.raw_bytes / 1e6:.0f} MB raw, {said.corrected_bytes / 1e6:.0f} MB corrected"
    )
    if any(step.is_lit_from_outside for step in plan.steps):
        screen.print(UNCHECKED, soft_wrap=True, highlight=False)
    if said.link:
        screen.print(said.link, soft_wrap=True, highlight=False)
    for violation in said.violations:
        screen.print(f"not allowed: step {violation.step + 1} ({violation.tag}): {violation.text}", style="bold")


def _step_row(step: Step, home_mm: Mapping[str, float]) -> tuple[str, ...]:
    away = ", ".join(f"{n} {mm:+.3f}" for n, mm in step.positions_mm if mm != home_mm[n])
    frames = f"{step.first_frame}..{step.numbers[-1]}" if step.frames > 1 else str(step.first_frame)
    return str(step.index + 1), frames, step.tag, step.view, away or "-"


def print_done(screen: Console, folder: RunFolder, done: dict[str, Any]) -> None:
    """Print the result of a finished run."""
    counts, entries = done["conservation"], folder.entries()
    chunks = chunk_sentences(entries)
    screen.print(
        f"{counts['triggered']} triggered = {counts['written']} written + {counts['incomplete']} incomplete "
        f"+ {counts['rejected']} {'dark or surplus' if chunks else 'rejected'} + {counts['lost']} lost"
    )
    for sentence in filter(None, (rejection_sentence(entries), *chunks)):
        screen.print(sentence, soft_wrap=True, highlight=False)
    for step in done.get("gaps", ()):
        frames = sum(planned["frames"] for planned in folder.about["steps"] if planned["index"] == step["step"])
        screen.print(f"{step['tag']}: {gap_sentence(step['gaps'], frames)}", style="bold")
    for flow in done["flow"]:
        latency = flow["latency_ms"]
        if latency is not None:
            screen.print(
                f"{flow['corrected_live']} corrected as they arrived, latency p50 {latency['p50']:.0f} ms, "
                f"p99 {latency['p99']:.0f} ms; {flow['skipped_live']} skipped and corrected after the run"
            )
    path = folder.path / MOVED
    if path.exists():
        _print_displacements(screen, path, read_displacements(folder))
    screen.print(str(folder.path), style="bold")


def _print_displacements(screen: Console, path: Path, found: Sequence[Moved]) -> None:
    def deviation(vector: Vector | None, commanded: Vector) -> str:
        if vector is None:
            return "not known on a real bench"
        return ", ".join(f"{1e3 * (v - c):+.1f}" for v, c in zip(vector, commanded, strict=True))

    rows = [
        (
            entry["tag"],
            ", ".join(f"{c:+.4f}" for c in entry["commanded_mm"]),
            deviation(entry["measured_mm"], entry["commanded_mm"]),
            deviation(entry["true_mm"], entry["commanded_mm"]),
        )
        for entry in found[:SHOWN_DISPLACEMENTS]
    ]
    columns = ("pair", "commanded x, y, z", "measured - commanded in um", "true - commanded in um")
    screen.print(Table("displacement of the target in mm", columns, rows, left=ALL_COLUMNS))
    if len(found) > SHOWN_DISPLACEMENTS:
        screen.print(f"... and {len(found) - SHOWN_DISPLACEMENTS} more in {path}")
