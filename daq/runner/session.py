"""A run from its files: what `acquire` begins and `resume` goes on with.

run.json holds the files' texts for the record and their paths to read them again; hashes of what they mean decide
whether a run may be continued.  The scene used for correction may be another file than the bench's (a fitted one);
what moves depends on the bench's scene only through keep-out and scale, so both are hashed.

**Controllers.**  A run goes on with the controllers that it began with: positions mean something else on any other
box.  Each session writes into the journal who its controllers say they are.  Two boxes whose cables were swapped,
or a spare one in the place of another, answer every command; only their identity tells.

**Steps that are taken again**, because a frame of theirs is gone or damaged.  A displacement lives between two
steps, and the reference was taken right before so that drift does not count; so a step is taken again together
with its reference, and with what is displaced from it.  A step that keeps what it has counts from its first frame
on, finished or not.
"""

import os
import shlex
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from correction.target.board_file import board_text
from daq.atomic_write import write_text
from daq.bench.bench_file import load_bench
from daq.bench.bench_table import Bench, digest
from daq.bench.elements import CAMERA
from daq.bench.opened import OpenBench, Simulation, open_bench
from daq.bench.rehearsal import with_rehearsal
from daq.errors import DiskError, ResumeRefused, RunDamaged
from daq.pipeline.corrections import Corrections
from daq.pipeline.job import Show
from daq.pipeline.pipeline import LIVE_QUEUE
from daq.plans.experiments.align import AlignPlan
from daq.plans.plan import Plan, load_plan
from daq.plans.steps import BEHIND_GLASS, Step, frame_count
from daq.runner.laser_session import NoOperator, Operator
from daq.runner.progress import Progress, Watcher
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runs.displacement import FILE as MOVED
from daq.runs.done_file import FILE as DONE
from daq.runs.frame_accounting import ambiguities
from daq.runs.frame_check import Track, frame_faults, name_faults, no_tracking, orphan_files
from daq.runs.gaps import next_place
from daq.runs.glass_place import glass_off_scene_mm, with_glass_at
from daq.runs.journal import Entry
from daq.runs.names import MAPS
from daq.runs.run_folder import RunFolder, frame_entries, remaining, steps_on_disk, versions
from daq.runs.run_views import dewarp_of
from piv.resampling.sample import Method
from stages.errors import WrongDevice
from tracer.scene.scene_file import dump_scene, load_priors, load_scene


def require_same_boxes(entries: Sequence[Entry], now: Mapping[str, str]) -> None:
    """Compare the controllers that are open with those of the sessions before.

    Parameters
    ----------
    entries : sequence of dict
        The journal.
    now : mapping of str to str
        Name in the bench file -> identity of the box that answers; "" where it does not tell.

    Raises
    ------
    WrongDevice
        Another box than before answers under a name.
    """
    for entry in entries:
        if entry["kind"] != "session":
            continue
        then = entry.get("controllers", {})
        for name, identity in now.items():
            before = then.get(name, "")
            if not before or not identity or before == identity:
                continue
            others = [other for other, box in then.items() if other != name and box == identity]
            if others:
                cure = f"that is the box that was {others[0]}; swap their cables back"
            else:
                cure = "put the box back that the run began with, or begin a new run"
            raise WrongDevice(f"{name}: {identity!r} answers, and the run began with {before!r}; {cure}")


def steps_to_retake(
    folder: RunFolder, steps: Sequence[Step], entries: Sequence[Entry], retake: bool, track: Track = no_tracking
) -> frozenset[int]:
    """Check every frame that is about to count as done; return the steps that must be taken again.

    Parameters
    ----------
    folder : RunFolder
        The run.
    steps : sequence of Step
        Its plan.
    entries : sequence of dict
        Its journal.
    retake : bool
        Whether anything may be taken again.
    track : Track, optional
        Shows how many frames have been read.

    Raises
    ------
    RunDamaged
        A frame is missing or damaged, and nothing may be taken again.
    """
    kept = steps_on_disk(entries) | {step.index for step in steps if step.may_have_gaps}
    counting = {number: entry for number, entry in frame_entries(entries).items() if entry["step"] in kept}
    faults = frame_faults(folder, counting, track)
    if faults and not retake:
        raise RunDamaged(
            f"{folder.path}: {len(faults)} of {len(counting)} frames are not what was written"
            f" ({name_faults(faults)}); restore them from a copy,"
            f" or repeat their steps with rtpiv acquire --resume {shlex.quote(str(folder.path))} --retake"
        )
    return _with_partners({fault.step for fault in faults}, steps) & kept


def _with_partners(indices: set[int], steps: Sequence[Step]) -> frozenset[int]:
    roots = {index if (reference := steps[index].reference) is None else reference for index in indices}
    return frozenset(roots | {step.index for step in steps if step.reference in roots})


DISK_MARGIN = 1.05
HAPPENED = "world.jsonl"  # what was true of a rehearsal; read by `sim.event_log`


@dataclass(frozen=True)
class Request:
    """Parameters of a run; all that run.json needs to repeat it.

    Parameters
    ----------
    bench, plan : Path
        The files.
    simulate : bool
        Whether the bench's simulation stands in for the hardware.
    correct : bool
        Whether frames are corrected as they arrive.
    scene : Path, optional
        Scene for the correction, if another than the bench's.
    target_clear : Path, optional
        Frame of the bare target for the dewarp.
    dewarp_order : int
        Its order.
    method : str
        Interpolation.
    live_queue : int
        Frames that may wait to be corrected.
    rehearsed : bool
        Whether it is a rehearsal, all in memory and with its happenings kept.
    seed : int, optional
        Of the rehearsal, if another than the bench file's.
    """

    bench: Path
    plan: Path
    simulate: bool = False
    correct: bool = True
    scene: Path | None = None
    target_clear: Path | None = None
    dewarp_order: int = 2
    method: Method = "quintic"
    live_queue: int = LIVE_QUEUE
    rehearsed: bool = False
    seed: int | None = None

    def to_dict(self) -> dict[str, Any]:
        """As plain data, paths made absolute; a run that is no rehearsal says nothing of one."""
        said = {name: v for name, v in vars(self).items() if self.rehearsed or name not in ("rehearsed", "seed")}
        return {name: os.path.realpath(v) if isinstance(v, Path) else v for name, v in said.items()}

    @classmethod
    def from_dict(cls, tree: Mapping[str, Any]) -> "Request":
        """Inverse of `to_dict`."""
        paths = ("bench", "plan", "scene", "target_clear")
        known: dict[str, Any] = {n: Path(v) if n in paths and v is not None else v for n, v in tree.items()}
        return cls(**known)


def hashes(request: Request, bench: Bench, plan: Plan) -> dict[str, str | None]:
    """Hashes of what must not change between the sessions of a run."""
    corrected = load_scene(request.scene) if request.scene is not None else bench.scene
    sheet = corrected.sheet
    beside = [(name, bench.as_seen_by(name).scene.content_hash()) for name in plan.table.further_cameras]
    return {
        "plan": plan.content_hash(),
        "bench": bench.content_hash(),
        "scene": bench.scene.content_hash(),
        "scene for the correction": corrected.content_hash() if request.correct else None,
        "light sheet": digest(asdict(sheet)) if request.correct and sheet is not None else None,
        **({"further cameras": digest(beside)} if beside else {}),
    }


def make_corrections(request: Request, bench: Bench, maps: Path, steps: Iterable[Step] = ()) -> Corrections | None:
    """Return what corrects the frames of a run, the dewarp fitted; None if nothing is to be corrected.

    The glass is taken where the steps have it: a flow plan keeps it off the light sheet, which its frames show.
    """
    if not request.correct:
        return None
    scene = load_scene(request.scene) if request.scene is not None else bench.scene
    dewarp = dewarp_of(request.target_clear, scene.camera, bench.board, request.dewarp_order)
    seen = [step for step in steps if step.on_plane]
    places = {glass_off_scene_mm(bench.table, step.targets_mm) for step in seen if step.view == BEHIND_GLASS}
    if len(places) == 1:
        scene = with_glass_at(scene, places.pop())
    if any(step.shows_light_sheet for step in seen):
        scene = scene.in_light_sheet()
    return Corrections(scene, dewarp, request.method, maps)


def begin(request: Request, bench: Bench, plan: Plan, parent: Path) -> RunFolder:
    """Make the folder of a new run, and in it those of its further cameras."""
    beside = {
        name: _about(_request_for(name, request), bench.as_seen_by(name), plan)
        for name in plan.table.further_cameras
    }
    return RunFolder.create(parent, plan.name, _about(request, bench, plan), beside)


def _about(request: Request, bench: Bench, plan: Plan) -> dict[str, Any]:
    """Contents of run.json for a camera's run."""
    board = bench.board
    scene_file = getattr(bench.table.camera, "scene", None) or bench.table.scene
    return {
        "name": plan.name,
        "request": request.to_dict(),
        "hashes": hashes(request, bench, plan),
        "versions": versions(),
        "plan": plan.path.read_text(encoding="utf-8"),
        "bench": bench.path.read_text(encoding="utf-8"),
        "scene": dump_scene(bench.scene, load_priors(bench.path.parent / scene_file)),
        "square_mm": board.square_mm,
        "disc_mm": board.disc_mm,
        **({} if bench.printed is None else {"board": board_text(bench.printed)}),
        "steps": [{"index": s.index, "tag": s.tag, "first_frame": s.first_frame, "frames": s.frames,
                   "view": s.view, "shows": s.shows, "on_plane": s.on_plane, "reference": s.reference,
                   "group": s.group, **_pulses_of(s)}
                  for s in plan.steps],
    }  # fmt: skip


def _request_for(name: str, request: Request) -> Request:
    """Request for one camera: a further one has the scene of the bench file alone, and no dewarp."""
    return request if name == CAMERA else replace(request, scene=None, target_clear=None)


def _pulses_of(step: Step) -> dict[str, Any]:
    """Facts of a step's pulses that are needed to work on finished runs."""
    if step.pulses is None:
        return {}
    return {"dt_us": step.pulses.dt_us, **({"background": True} if step.pulses.is_background else {})}


@dataclass(frozen=True)
class Run:
    """A run that may begin or go on.

    Parameters
    ----------
    request : Request
        What was asked for.
    bench, plan
        Its files, read.
    folder : RunFolder
        Where it lies.
    again : frozenset of int
        Finished steps that are to be taken again.
    """

    request: Request
    bench: Bench
    plan: Plan
    folder: RunFolder
    again: frozenset[int] = frozenset()


def reopen(path: Path, retake: bool = False, track: Track = no_tracking) -> Run:
    """Read a run's files again, and make sure that they still mean the same and that its frames are whole.

    Parameters
    ----------
    path : Path
        Folder of the run.
    retake : bool
        Whether steps with a frame that is missing or damaged are to be taken again, also those of a finished run.
    track : Track, optional
        Shows how many frames have been read.

    Raises
    ------
    ResumeRefused
        The run is finished or ambiguous, or a file means something else than when the run began.
    RunDamaged
        A record is not what was written; or, without `retake`, a frame that would count as done.
    """
    folder = RunFolder.open(path)
    about = folder.about
    if folder.is_done and not retake:
        raise ResumeRefused(f"{path} is finished; there is nothing to resume")
    entries = folder.entries()
    if said := ambiguities(entries):
        raise ResumeRefused(f"{path}: {said[0]}, so frames may have the wrong position; begin a new run")
    request = Request.from_dict(about["request"])
    bench = load_bench(request.bench)
    plan = load_plan(request.plan, bench)
    for name, now in hashes(request, bench, plan).items():
        then = about["hashes"].get(name)
        if now != then:
            raise ResumeRefused(
                f"{path}: the {name} is another than when the run began ({now}, was {then}); "
                "put the old file back, or begin a new run"
            )
    if strange := orphan_files(folder, about["steps"], entries).sentence:
        raise RunDamaged(f"{path}: {strange}")
    again = steps_to_retake(folder, plan.steps, entries, retake, track)
    if folder.is_done and not again:
        raise ResumeRefused(f"{path} is finished and all of its frames are right; no step needs to be repeated")
    if request.rehearsed:
        bench = with_rehearsal(bench, request.seed)
    return Run(request, bench, plan, folder, again)


def check_disk(folder: Path, needed_bytes: int) -> None:
    """Refuse to begin what the disk cannot hold.

    Raises
    ------
    DiskError
        There is too little room.
    """
    free_bytes = shutil.disk_usage(folder).free
    if needed_bytes * DISK_MARGIN > free_bytes:
        raise DiskError(
            f"{folder}: the run needs about {needed_bytes / 1e9:.2f} GB and {free_bytes / 1e9:.2f} GB are free; "
            "make room, or choose another folder with -o"
        )


def run_session(
    run: Run,
    home: bool,
    watcher: Watcher | None = None,
    before: Callable[[OpenBench], None] | None = None,
    operator: Operator | None = None,
    show: Mapping[str, Show] | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Open the bench and do what is left of a run.

    Parameters
    ----------
    run : Run
        New (`begin`), or opened again (`reopen`).
    home : bool
        Home every axis first, in the configured order.
    watcher : callable, optional
        Gets the progress.
    before : callable, optional
        Called with the open bench before anything moves.
    operator : Operator, optional
        The person at the bench, whom a laser asks for its confirmation code.
    show : mapping of str to callable, optional
        For a camera's name, what gets each of its frames as it arrives, for a page.
    say : callable, optional
        Gets what an alignment sees and moves, a sentence each.

    Returns
    -------
    dict
        Contents of done.json.

    Raises
    ------
    WrongDevice
        Other controllers answer than those that the run began with; nothing has moved.
    """
    request, bench, plan, folder, again = run.request, run.bench, run.plan, run.folder, run.again
    left = remaining(plan.steps, folder.entries(), again)
    folders = {CAMERA: folder, **folder.cameras()}
    shapes = [bench.as_seen_by(name).scene.camera.shape for name in folders]
    pixels = sum(height * width for height, width in shapes)
    check_disk(folder.path, 2 * pixels * frame_count(left) * (2 if request.correct else 1))
    progress = Progress(steps=len(plan.steps))

    def tell(doing: str) -> None:
        progress.doing = doing
        if watcher is not None:
            watcher(progress)

    corrections = {
        name: make_corrections(
            _request_for(name, request), bench.as_seen_by(name), folder.path.parent / MAPS, left
        )
        for name in folders
    }
    for each in filter(None, corrections.values()):
        tell("making the correction; the first one on a computer compiles for about a minute")
        each.prepare(step.view for step in left if step.on_plane)
    tell("opening the devices")
    with ExitStack() as stack:
        behind = stack.enter_context(ExitStack())  # left when the devices have got their last commands
        hardware = stack.enter_context(
            open_bench(bench, request.simulate, plan.table.shows, _exposures_before(run, left))
        )
        boxes = {name: box.identity for name, box in hardware.stage.controllers.items()}
        require_same_boxes(folder.entries(), boxes)
        if hardware.simulation is not None:
            for name, text in hardware.simulation.secrets().items():
                write_text(folder.path / name, text)
            behind.callback(_keep_what_happened, hardware.simulation, folder)
        if before is not None:
            before(hardware)
        if hardware.simulation is None:
            hardware.stage.set_operator((operator or NoOperator()).reads)
        if home:
            _home(hardware, operator or NoOperator(), tell)
        cameras = [
            RunCamera(hardware, its, corrections[name], name, request.live_queue, (show or {}).get(name))
            for name, its in folders.items()
        ]
        if again:  # a run that is short of frames is not finished; in this order a kill leaves one to be resumed
            for name in (DONE, MOVED):
                (folder.path / name).unlink(missing_ok=True)
        if not isinstance(plan.table, AlignPlan):
            runner = Runner(hardware, cameras, plan.steps, watcher, again, operator, needed=plan.table.needed)
            return runner.run()
        from daq.runner.alignment_loop import AlignmentLoop, end_in_words  # what finds glass loads slowly

        alignment = AlignmentLoop(hardware, folder, plan.table, say or (lambda sentence: None))
        done = Runner(hardware, cameras, plan.steps, watcher, again, operator, alignment, plan.table.needed).run()
        if say is not None and alignment.looks:
            for sentence in end_in_words(alignment.next_positions(), alignment.looks[-1].seen.spheres):
                say(sentence)
        return done


def _exposures_before(run: Run, left: Sequence[Step]) -> int:
    """Number of the first frame that will be exposed, for a simulation that goes on where it was."""
    if not left:
        return frame_count(run.plan.steps)
    first = left[0]
    goes_on = first.may_have_gaps and first.index not in run.again
    kept = next_place(first, frame_entries(run.folder.entries())) if goes_on else 0
    return first.first_frame + kept


def _keep_what_happened(simulation: Simulation, folder: RunFolder) -> None:
    """Write what has happened in a rehearsal behind what is there of its earlier sessions, all or nothing."""
    if text := simulation.event_log().text():
        path = folder.path / HAPPENED
        try:
            before = path.read_text(encoding="utf-8") if path.exists() else ""
        except (OSError, ValueError) as error:
            raise DiskError(f"{path} cannot be read, so it is left as it is: {error}") from error
        write_text(path, before + text)


def _home(hardware: OpenBench, operator: Operator, tell: Callable[[str], None]) -> None:
    """Home every axis, in the configured order."""

    def ask(axis: str) -> float:
        if hardware.simulation is not None:  # a simulated person reads a simulated scale
            return hardware.simulation.true_mm()[axis]
        return operator.stands_mm(axis)

    hardware.stage.home(tell=lambda axis: tell(f"homing {axis}"), ask=ask)
