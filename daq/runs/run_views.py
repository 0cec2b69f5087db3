"""Contents of a run folder for the verbs that work on finished runs: scene, target frames, a first view.

Frames show a board (`board_of`: what their run says; of lone files, what the options say), and a plane: the light
sheet, or a print on the target's stage (`shows_light_sheet`).  A camera's dewarp is fitted to a frame of the bare
target (`dewarp_of`).
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Literal, TypeVar

from correction.errors import BoardError, CorrectionError
from correction.grid import grid_of
from correction.maps.dewarp import Dewarp, fit_dewarp
from correction.target import Chessboard
from correction.target.board_file import UNMEASURED, PrintedBoard, read_board
from daq.atomic_write import write_text
from daq.errors import RunDamaged
from daq.runs.acquired import read_acquired, run_of
from daq.runs.journal_lines import ReadingRecord
from daq.runs.names import FILE, is_run
from daq.runs.records import CURE
from daq.runs.run_file import PlannedStep
from daq.runs.run_folder import RunFolder, frame_entries
from ground.config import load_yaml, read
from ground.errors import ConfigError, GroundError
from piv.errors import FrameError, PivError
from tracer.camera import Camera
from tracer.errors import TracerError
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene

if TYPE_CHECKING:  # most commands have no run, and do not wait for the models of benches
    from daq.bench.bench_table import BenchTable

UNSCALED_DISTANCE_PX = 2e4  # the same without any scale: lengths are pixels of the frame
# where a camera is taken to stand of which only a scale is given: at the edge of a view of 100 mm
FAR_MM = 1e4
# motion along the view is 0.5 % of itself across it
T = TypeVar("T")


@dataclass(frozen=True)
class TargetView:
    """A frame of the board, through the glass or bare, and how far before the plane it stood, or its pose."""

    tag: str
    path: Path
    glass: bool
    height_mm: float
    pose: str = ""


@dataclass(frozen=True)
class View:
    """A frame of a run and what it shows: `shows` names the print, `on_plane` says that it stood at z = 0."""

    path: Path
    tag: str
    shows: str
    glass: bool
    on_plane: bool


def bench_scene(path: Path) -> str:
    """Text of the bench's scene file as it was when a run began."""
    return RunFolder.open(path).about["scene"]


def load_kept(folder: RunFolder, what: Literal["bench", "scene", "plan", "board"], load: Callable[[Path], T]) -> T:
    """Load the text of a file that the run keeps in its record.

    Raises
    ------
    RunDamaged
        It was loaded when the run began, and cannot be any more.
    """
    with TemporaryDirectory() as place:
        own = Path(place) / f"{what}.yaml"
        write_text(own, folder.about[what])
        try:
            return load(own)
        except ConfigError as error:
            problem = error.problems[0].text
            raise RunDamaged(f"{folder.path / FILE}: its {what} cannot be read: {problem}; {CURE}") from None


def scene_file(path: Path, out: Path) -> Path:
    """Scene file of a run: the one its frames were corrected with as they arrived, if it still says the same.

    Otherwise the bench's scene as it was when the run began, written to ``scene.yaml`` in `out`.
    """
    about = RunFolder.open(path).about
    used = about["request"].get("scene")
    if used is not None and Path(used).is_file():
        try:
            if load_scene(used).content_hash() == about["hashes"].get("scene for the correction"):
                return Path(used)
        except (GroundError, TracerError):
            pass  # no longer a scene: not the file that was used
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "scene.yaml", bench_scene(path))
    return out / "scene.yaml"


def target_views(path: Path) -> list[TargetView]:
    """First frame of every step that photographed the board, in the order of the plan.

    The investigation plane is where the board stood when the plan had it there.  Frames that were planned at one
    height share the mean of what the stages reported, so that the last digit of an encoder is no other height.

    Raises
    ------
    RunUnsuitable
        The folder is no run.
    RunDamaged
        What it says is not what was written.
    """
    from daq.bench.elements import TARGET

    folder = RunFolder.open(path)
    about, entries = folder.about, frame_entries(folder.entries())
    steps = [s for s in about["steps"] if s["shows"] == "chessboard" and s["first_frame"] in entries]
    if not steps:
        return []
    table = bench_table(folder)
    reported_mm = defaultdict[float, list[float]](list)
    planned_mm: list[float] = []
    for step in steps:
        entry = entries[step["first_frame"]]
        try:
            planned, measured = (table.offset_mm(TARGET, entry[name])[2] for name in ("planned_mm", "measured_mm"))
        except KeyError as error:
            raise RunDamaged(f"{path}: frame {entry['frame']} lacks the position of {error}; {CURE}") from None
        planned_mm.append(0.0 if step["on_plane"] else planned)
        reported_mm[planned_mm[-1]].append(measured)
    heights_mm = {planned: fmean(reported) for planned, reported in reported_mm.items()}
    plane_mm = heights_mm.get(0.0, 0.0)
    views = []
    for step, planned in zip(steps, planned_mm, strict=True):
        file = folder.inside(entries[step["first_frame"]]["file"])
        views.append(TargetView(step["tag"], file, step["view"] == "glass", heights_mm[planned] - plane_mm))
    return views


def first_view(folder: RunFolder) -> View | None:
    """First frame through the glass with the print in the plane, else what comes nearest to that.

    Of an alignment it is the last look, which shows what it has come to.
    """
    files = _files(folder)
    views = [
        View(files[s["first_frame"]], s["tag"], s["shows"], s["view"] == "glass", s["on_plane"])
        for s in folder.about["steps"]
        if s["first_frame"] in files
    ]
    if views and views[0].tag.startswith("look_"):
        return views[-1]
    return max(views, key=lambda view: (view.glass, view.on_plane), default=None)


def _files(folder: RunFolder) -> dict[int, Path]:
    """Frames that are on the disk, by number; every name is confined to the run."""
    return {number: folder.inside(entry["file"]) for number, entry in frame_entries(folder.entries()).items()}


def bench_table(folder: RunFolder) -> "BenchTable":
    """Bench file of a run as it was when the run began."""
    from daq.bench.bench_table import BenchTable

    return load_kept(folder, "bench", lambda file: read(file, BenchTable))


def height_sigma_mm(path: Path) -> float:
    """Standard deviation of a height of the target, a difference of two places, as hands read; 0 of motors."""
    from daq.bench.elements import TARGET

    table = bench_table(RunFolder.open(path))
    axes = table.axes_of(TARGET)
    read_um = [um for name, um in table.stages.by_hand.items() if name in axes and axes[name].along == "z"]
    return math.sqrt(2.0 * sum((um * 1e-3) ** 2 for um in read_um))


def notes_of(folder: RunFolder) -> dict[str, str]:
    """Return the operator's notes in the plan of a run; raises as `load_kept`."""
    tree = load_kept(folder, "plan", load_yaml).tree
    notes = tree.get("notes") if isinstance(tree, dict) else None
    return {str(key): str(value) for key, value in notes.items()} if isinstance(notes, dict) else {}


def readings_of(folder: RunFolder) -> dict[str, list[tuple[str, ReadingRecord]]]:
    """Readings of the gauges by name: tag of each finished step, and the reading as the journal has it."""
    found: dict[str, list[tuple[str, ReadingRecord]]] = {}
    # taken again: the last
    last = {entry["step"]: entry for entry in folder.entries() if entry["kind"] == "step"}
    for _, entry in sorted(last.items()):
        for name, reading in entry.get("readings", {}).items():
            found.setdefault(name, []).append((entry["tag"], reading))
    return found


def board_of(
    paths: Iterable[Path],
    square_mm: float | None = None,
    disc_mm: float | None = None,
    board: Path | None = None,
) -> Chessboard:
    """Return the board of runs, of frames of runs, or of files that belong to none.

    Parameters
    ----------
    paths : iterable of Path
        Run folders and frames.
    square_mm, disc_mm : float, optional
        Given data of the board; otherwise squares are those of `Chessboard`, and discs as wide in them.
        Such a print, or that of a run, is as unsure as that of a board file without measured bars.
    board : Path, optional
        Or a board file that says it.

    Raises
    ------
    ConfigError
        The board file is wrong.
    BoardError
        The given data contradict a run, or two runs differ.
    RunUnsuitable, RunDamaged
        A run cannot be read.
    """
    runs = {found.path: found for path in paths if (found := RunFolder(path) if is_run(path) else run_of(path))}
    said = {"square_mm": square_mm, "disc_mm": disc_mm}
    files = {path: load_kept(run, "board", read_board) for path, run in runs.items() if "board" in run.about}
    if files or board is not None:
        sizes = [name for name, value in said.items() if value is not None]
        return _board_of_runs(files if board is None else {board: read_board(board), **files}, list(runs), sizes)
    by = dict.fromkeys(said, "the options say")
    for path, run in runs.items():
        about = run.about
        for name, value in (("square_mm", about["square_mm"]), ("disc_mm", about.get("disc_mm"))):
            if value is None:
                continue
            before = said[name]
            if before is not None and before != value:
                raise BoardError(
                    f"{path}: the board of this run has {name} {value:g}, {by[name]} {before:g}; a run stores its "
                    "board, so omit the option, and use frames of one board at a time"
                )
            said[name], by[name] = value, f"{path} says"
    usual = Chessboard()
    square = said["square_mm"] or usual.square_mm
    disc = said["disc_mm"] or usual.disc_mm / usual.square_mm * square
    return Chessboard(square, disc, scale_sigma=(UNMEASURED, UNMEASURED))


def _without_measure(board: PrintedBoard) -> PrintedBoard:
    """Return a board without what was measured of its print."""
    return board.model_copy(update={"bars_mm": None, "measured_mm": None, "read_sigma_mm": None})


def _board_of_runs(files: Mapping[Path, PrintedBoard], runs: Sequence[Path], sizes: Sequence[str]) -> Chessboard:
    """The board of files that say the same; runs without one, or sizes said beside them, contradict it.

    A print may be measured after its frames were taken: the first file with a measure says its scale.
    """
    first = next(iter(files))
    printed = next((file for file in files.values() if file.measured_mm is not None), files[first])
    for path, other in files.items():
        if _without_measure(other) != _without_measure(printed) or other.measured_mm not in (
            None,
            printed.measured_mm,
        ):
            raise BoardError(f"{path}: has another board than {first}; take frames of one board at a time")
    for path in [path for path in runs if path not in files]:
        raise BoardError(f"{path}: keeps no board file, so {first} is not its board; leave that out")
    if sizes:
        raise BoardError(f"{first}: contains the size of the board; omit {' and '.join(sizes)}")
    return printed.board()


def shows_light_sheet(frames: Iterable[Path]) -> bool:
    """Return whether frames show particles in the light sheet; a frame of no run does.

    Raises
    ------
    FrameError
        Some do, and others show a print.
    RunUnsuitable, RunDamaged
        A run cannot be read.
    """
    runs = {None if run is None else run.path: run for run in map(run_of, frames)}
    found = {run is None or any(map(in_light_sheet, run.about["steps"])) for run in runs.values()}
    if len(found) > 1:
        raise FrameError(
            "some frames show a print on the target's stage, others the light sheet; correct them apart"
        )
    return found != {False}


def in_light_sheet(step: PlannedStep) -> bool:
    """Return whether the frames of a step of a run do: those of a flow or a stream."""
    return "dt_us" in step or step.get("group", 1) > 1


def tells_a_scale_alone(scene: Scene) -> bool:
    """True if a scene is that of frames of which only the size of a pixel is known: no slope of its rays is."""
    return not scene.bodies and scene.camera.position_mm in ((0.0, 0.0, FAR_MM), (0.0, 0.0, UNSCALED_DISTANCE_PX))


def length_unit(scene: Scene) -> str:
    """Return the unit of lengths on the plane: "mm", or "px" where no scale is given."""
    return "px" if not scene.bodies and scene.camera.position_mm == (0.0, 0.0, UNSCALED_DISTANCE_PX) else "mm"


def where_lit(scene: Scene) -> str:
    """Say in which plane particles were taken to lie, how unsure that is, and what makes it surer."""
    scale = ""
    if length_unit(scene) == "px":
        scale = "No scale is given (--mm-per-px, or --scene), so lengths are pixels of the frame. "
    elif not scene.bodies:
        shown = f"{grid_of(scene.camera).pitch_mm:.4g} mm"
        scale = f"The scale is taken as exact ({shown}/px); the uncertainties do not include its error. "
    if tells_a_scale_alone(scene):
        return f"{scale}The viewing direction is not known: no uncertainty includes out-of-plane motion."
    if scene.sheet is not None:
        return f"{scale}Particles were taken to lie in {scene.sheet.summary}; its sigma is in that of the vectors."
    return (
        f"{scale}The scene file does not say where the light sheet is, so particles were taken to lie in"
        f" {scene.lit.summary}; all of that is in the sigma of map and vectors. Find it with rtpiv sheet,"
        " from 10 pairs or more, best 50; or measure it and write `sheet` into the scene file."
    )


def dewarp_of(target_clear: Path | None, camera: Camera, board: Chessboard, order: int) -> Dewarp | None:
    """Fit the dewarp to a frame of the bare target; None without a frame.

    Parameters
    ----------
    target_clear : Path, optional
        Bare target at z = 0, as acquired.
    camera : Camera
        The nominal camera.
    board : Chessboard
        The target.
    order : int
        Order of the polynomial, 2 to 5.

    Raises
    ------
    FrameError, FrameDamaged, RunDamaged
        The file is no frame of this camera, or not what was written.
    TargetNotFound, DewarpError
        The frame does not show the target, or too little of it; the message names the file.
    """
    if target_clear is None:
        return None
    frame = read_acquired(target_clear, camera.shape)
    try:
        return fit_dewarp(frame, camera, board, order)
    except (CorrectionError, PivError) as error:
        raise type(error)(f"{target_clear}: {error}") from None
