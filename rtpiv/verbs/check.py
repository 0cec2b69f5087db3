"""`rtpiv check`: validate input files and verify runs."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from daq.bench.scene_plausibility import scene_questions
from daq.errors import DaqError, RunDamaged, RunUsageError
from daq.runs.names import CAMERAS, MAPS, is_run
from ground.config import open_document
from ground.errors import ConfigError, GroundError, Problem, UntrustedProgram
from ground.terminal import console, progress
from rtpiv.verbs.paths import Named, paths_of
from stages.errors import StageError
from tracer.errors import TracerError
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene

if TYPE_CHECKING:
    from daq.runs.run_check import RunCheck
    from rtpiv.verbs.check_bench import Benches

WRONG = (GroundError, TracerError, DaqError, StageError)
TELLING = {  # keys that only one kind of file has
    "scene": ("camera", "bodies", "wavelength_nm", "ambient", "glasses"),
    "bench": ("stages", "scene", "keep_out", "simulation"),
    "plan": ("experiment",),
    "board": ("kind", "square_mm", "pitch_mm", "dot_mm", "large_dot_mm", "bars_mm", "measured_mm", "particle_mm"),
    "piv": (
        "final_window_px",
        "finest_window_px",
        "first_window_px",
        "passes",
        "overlap",
        "prepare",
        "window",
        "denoise",
    ),
}


@dataclass(frozen=True)
class FileCheck:
    """A valid file: its kind, a summary, and questions about unusual numbers."""

    path: Path
    kind: str
    said: str
    questions: tuple[str, ...] = ()  # about allowed but unusual numbers, with file and line


def check(paths: Sequence[Named] | Named, /, bench: Named | None = None) -> "list[FileCheck | RunCheck]":
    """Validate files before use and verify runs after; nothing is changed, nothing is opened.

    Parameters
    ----------
    paths : path, or list of path
        Scene, bench, plan, board and PIV files; folders that hold such files (``*.yaml``); folders of runs.
    bench : path, optional
        Bench for plans, which are checked as by `acquire --home --dry-run`.  Default: a bench among `paths`, or a
        bench.yaml beside the plan; without any only the plan itself is checked.

    Returns
    -------
    list of FileCheck or RunCheck
        One a file or run; `check_run` makes the latter without printing anything.

    Raises
    ------
    RunUsageError
        Files are wrong: all problems of all of them, with file and line.
    RunDamaged
        A run is not what was acquired; all of them have been looked at and shown.
    """
    given = paths_of(paths)
    runs = [path for path in given if is_run(path)]
    folders = {path: sorted(path.glob("*.yaml")) for path in given if path.is_dir() and path not in runs}
    empty = [path for path, files in folders.items() if not files]
    if empty and not runs:
        raise RunUsageError(
            "is neither a run nor a folder with .yaml files", place=empty[0], cure="name what to check"
        )
    caches = [path for path in empty if path.name == MAPS]
    for path in caches:  # beside runs, as `runs/*` names it
        console().print(f"{path}  correction maps shared by runs; missing ones are computed again")
    runs = [path for path in given if path in runs or path in empty]  # among runs one that is none is a finding
    runs = [path for path in runs if path not in caches]
    files = [file for path in given if path not in runs for file in folders.get(path, [path])]
    checks: list[FileCheck | RunCheck] = []
    wrong: Exception | None = None
    try:
        checks += check_files(files, None if bench is None else Path(bench), _show)
    except RunUsageError as error:
        wrong = error
    if runs:
        checks += _check_runs(runs)
    if wrong is not None:
        raise wrong
    return checks


def _show(file: FileCheck) -> None:
    """Print the summary of a file at once: the next one may have to compile kernels."""
    console().print(f"{file.path}  ok  {file.kind}: {file.said}", soft_wrap=True)
    for question in file.questions:
        console().print(f"  {question}", soft_wrap=True, highlight=False)


def check_files(
    paths: Iterable[Path], bench: Path | None = None, tell: Callable[[FileCheck], None] = lambda file: None
) -> list[FileCheck]:
    """Check files without printing, and report each valid one; otherwise as `check`."""
    found: list[FileCheck] = []
    problems: list[str] = []
    kinds: dict[Path, str] = {}
    for path in paths:
        try:
            kinds[path] = _kind_of(path)
        except ConfigError as error:
            problems.append(str(error))
    named = [path for path, kind in kinds.items() if kind == "bench"] if bench is None else [bench]
    benches = _benches() if {"bench", "plan"} & set(kinds.values()) else None
    for path, kind in kinds.items():
        beside = path.parent / "bench.yaml"
        try:
            said, questions = _describe(path, kind, benches, named or [beside] * beside.is_file())
            found.append(FileCheck(path, kind, said, tuple(questions)))
            tell(found[-1])
        except UntrustedProgram:  # a person may be asked
            raise
        except WRONG as error:
            problems.append(str(error))
    if problems:
        lines = [line for problem in problems for line in problem.splitlines()]
        raise RunUsageError("\n".join(dict.fromkeys(lines)))
    return found


def _benches() -> "Benches":
    from rtpiv.verbs.check_bench import Benches  # checking a scene does not import the bench

    return Benches()


def _kind_of(path: Path) -> str:
    document = open_document(path)
    keys = set(document.tree) if isinstance(document.tree, dict) else set()
    hits = {kind: len(keys & set(telling)) for kind, telling in TELLING.items()}
    if "experiment" in keys:
        return "plan"
    if "stages" in keys or "scene" in keys:
        return "bench"
    best = max(hits, key=lambda kind: hits[kind])
    if not hits[best]:
        text = "is no file of ours: a scene has camera and bodies, a bench stages, a plan experiment, a board kind"
        raise ConfigError(path, [Problem(1, text)])
    return best


def _describe(path: Path, kind: str, benches: "Benches | None", named: Sequence[Path]) -> tuple[str, list[str]]:
    """Return the summary of a file, and questions about it."""
    if kind == "scene":
        scene = load_scene(path)
        return f"{_describe_scene(scene)}{_describe_view(scene)}", scene_questions(path)
    if kind == "piv":
        from rtpiv.analysis.pairs.piv_file import piv_choice

        return f"last windows of {piv_choice(piv=path).settings.windows_text}", []
    if kind == "board":
        return _describe_board(path), []
    assert benches is not None
    return benches.describe(path) if kind == "bench" else benches.describe_plan(path, named)


def _describe_board(path: Path) -> str:
    """Return the summary of a board file; ConfigError if there is no such board."""
    from correction.errors import BoardError
    from correction.target.board_file import read_board

    printed = read_board(path)
    if printed.kind == "particles":
        return f"{printed.particles} particles"
    try:
        board = printed.board()
    except BoardError as error:
        raise ConfigError(path, [Problem(1, str(error))]) from error
    levels = "" if printed.levels is None else f", by {printed.levels} on two levels {printed.step_mm:g} mm apart"
    wide, high = (100.0 * sigma for sigma in board.scale_sigma)
    return (
        f"{printed.kind} of {board.pitch_mm:g} mm{levels}; width and height known to {wide:.2g} and {high:.2g} %"
    )


def _describe_view(scene: Scene) -> str:
    """Return the share seen through glass, with advice where it is small; inside a bed that of the gaps."""
    if not scene.bodies:
        return ""
    from rtpiv.analysis.gaps import share_of_scene  # compiled: checking a plan does not wait for it
    from rtpiv.analysis.views.arranged import little

    if (shown := share_of_scene(scene)) is None:
        return ""
    return ". ".join(filter(None, (f"; {shown.sentence}", little(scene, shown))))


def _describe_scene(scene: Scene) -> str:
    counts: dict[str, int] = {}
    for body in scene.bodies:
        counts[body.kind] = counts.get(body.kind, 0) + 1
    bodies = (
        ", ".join(f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in counts.items()) or "no bodies"
    )
    camera = scene.camera
    width, height = camera.sensor_px
    scale = camera.focal_px / abs(camera.position_mm[2] / float(camera.rotation_matrix[2][2]))
    sheet = "" if scene.sheet is None else f"; {scene.sheet.summary}"
    return f"{bodies}; camera of {width} x {height} px, {scale:.1f} px/mm on the plane{sheet}"


def _cameras_of(run: Path) -> list[Path]:
    """Runs of the further cameras in the folder of a run; none of a damaged one, which is named for itself."""
    from daq.runs.run_folder import RunFolder

    try:
        names = RunFolder(run).about.get("cameras", [])
    except DaqError:
        return []
    return [run / CAMERAS / name for name in names]


def _check_runs(runs: Sequence[Path]) -> "list[RunCheck]":
    from daq.runs.run_check import check_run

    screen = console()
    checks = []
    for path in [inner for run in runs for inner in (run, *_cameras_of(run))]:
        found = check_run(path, progress)
        screen.print(path, soft_wrap=True)  # as all lines here: a path has to be copied in one piece
        for finding in found.findings:
            sound = "ok " if finding.sound else "BAD"
            screen.print(f"  {finding.part:<13} {sound}  {finding.said}", soft_wrap=True)
        checks.append(found)
    bad = [found for found in checks if not found.is_sound]
    if bad:
        parts = [finding.part for found in bad for finding in found.findings if not finding.sound]
        named = ", ".join(str(found.path) for found in bad)
        raise RunDamaged(
            f"not what was acquired in {', '.join(dict.fromkeys(parts))}", place=named, cure="see above"
        )
    return checks
