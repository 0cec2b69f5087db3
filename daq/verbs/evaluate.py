"""`rtpiv evaluate`: vectors of a pair seen through glass, with errors and a page to look at."""

from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.table import Table

from correction.correction_map import build_correction_map
from correction.corrector import Corrector
from correction.dewarp import Dewarp, fit_dewarp
from correction.errors import PairError
from correction.evaluate.piv import evaluate_pair
from correction.evaluate.regions import regions_of
from correction.evaluate.shift import evaluate_shift
from correction.evaluate.vector_file import write_netcdf, write_vtk
from correction.evaluate.velocity_route import velocity_route
from correction.frame_file import read_frame
from correction.target import Chessboard
from daq.evaluation_page import SHIFT_HEAD, Evaluation, shift_rows, write_page
from daq.run_views import is_run, scene_text, shift_pairs
from daq.terminal import console
from daq.whole_text import write_json, write_text
from tracer.ray_map import build_ray_map
from tracer.scene import Scene
from tracer.scene_file import load_scene


@dataclass(frozen=True)
class Task:
    """One pair to evaluate: where it lies, through which scene, and what is known of its displacement."""

    frames: tuple[Path, Path]
    scene: Scene
    out: Path
    shift_mm: tuple[float, float] | None


def evaluate(
    paths: list[Path],
    out: Path,
    scene: Path | None = None,
    target_clear: Path | None = None,
    dewarp_order: int = 2,
    square_mm: float = 2.5,
    shift_mm: tuple[float, float] | None = None,
    stage_um: float = 10.0,
    velocity: bool = False,
    vtk: bool = False,
) -> list[Evaluation]:
    """Correct pairs of frames, measure their displacements, and write a report for each.

    Parameters
    ----------
    paths : list of Path
        Frame A and frame B as acquired; or one run folder of a shift experiment.
    out : Path
        Folder: ``vectors.nc``, ``evaluation.json``, ``report.html``, its figures as SVG, ``vectors.vtk`` on
        request; for a run one such folder a pair.
    scene : Path, optional
        scene.yaml, best a fitted one; a run without it is evaluated with the scene it was taken with.
    target_clear, dewarp_order, square_mm
        As for `correct`.
    shift_mm : (float, float), optional
        True displacement of the particles, x to the right and y UP: errors are stated against it.  For a run
        the displacement measured by the stages is taken.
    stage_um : float
        Standard error of the stage that moved the sheet, for the error budget.
    velocity : bool
        Also take the velocity route (the scene must hold the camera's true pose; no dewarp).
    vtk : bool
        Also write VTK text.

    Returns
    -------
    list of Evaluation
        One a pair.

    Raises
    ------
    ConfigError, FrameError, PairError, TargetNotFound, DewarpError, ResumeRefused
        What the file, the frames, the target or the run make impossible, in one sentence.
    """
    return [
        _evaluate(task, target_clear, dewarp_order, square_mm, stage_um, velocity, vtk)
        for task in _tasks(paths, out, scene, shift_mm)
    ]


def _tasks(paths: list[Path], out: Path, scene: Path | None, shift_mm: tuple[float, float] | None) -> list[Task]:
    """Pairs to evaluate: the two frames given, or every pair of a run."""
    if len(paths) == 1 and is_run(paths[0]):
        out.mkdir(parents=True, exist_ok=True)
        if scene is None:
            scene = out / "scene.yaml"
            write_text(scene, scene_text(paths[0]))
        loaded = load_scene(scene)
        return [
            Task(pair.frames, loaded if pair.glass else loaded.with_bodies(()), out / pair.tag, pair.measured_mm)
            for pair in shift_pairs(paths[0])
        ]
    if len(paths) != 2 or scene is None:
        raise PairError("give two frames and --scene, or the folder of a shift run")
    return [Task((paths[0], paths[1]), load_scene(scene), out, shift_mm)]


def _evaluate(
    task: Task,
    target_clear: Path | None,
    dewarp_order: int,
    square_mm: float,
    stage_um: float,
    velocity: bool,
    vtk: bool,
) -> Evaluation:
    """Evaluate one pair and write its folder."""
    scene, out = task.scene, task.out
    shape = scene.camera.shape
    frame_a, frame_b = (read_frame(path, shape) for path in task.frames)
    dewarp: Dewarp | None = None
    if target_clear is not None:
        clear = read_frame(target_clear, shape)
        dewarp = fit_dewarp(clear, scene.camera, Chessboard(square_mm), dewarp_order)
    ray_map = build_ray_map(scene)
    corrector = Corrector(build_correction_map(scene, ray_map), dewarp)
    corrected_a, corrected_b = corrector(frame_a), corrector(frame_b)
    field = evaluate_pair(corrected_a, corrected_b, corrector.recovered)
    regions = regions_of(field, corrector.map, scene)
    result = None
    if task.shift_mm is not None:
        scale = corrector.map.grid.px_per_mm
        truth = (task.shift_mm[0] * scale, -task.shift_mm[1] * scale)
        result = evaluate_shift(field, regions, truth, stage_um * 1e-3 * scale)
    traced = velocity_route(frame_a, frame_b, scene, ray_map) if velocity else None
    evaluation = Evaluation(field, regions, result, traced)
    out.mkdir(parents=True, exist_ok=True)
    about = {"scene_hash": scene.content_hash(), "frames": ", ".join(path.name for path in task.frames)}
    about["rtpiv_version"] = version("rtpiv")
    write_netcdf(out / "vectors.nc", field, corrector.map.grid, about)
    if vtk:
        write_vtk(out / "vectors.vtk", field, corrector.map.grid)
    summary: dict[str, Any] = {**about, "vectors": field.counts}
    if result is not None:
        summary["shift"] = result.to_dict()
    write_json(out / "evaluation.json", summary)
    write_page(out, evaluation, corrector, scene, (frame_a, corrected_a), about)
    _print(evaluation, out)
    return evaluation


def _print(evaluation: Evaluation, out: Path) -> None:
    screen = console()
    counts = ", ".join(f"{count} {name}" for name, count in evaluation.field.counts.items())
    screen.print(f"vectors: {counts}")
    if evaluation.shift is not None:
        table = Table(title="errors against the known shift [px]")
        for column in SHIFT_HEAD:
            table.add_column(column, justify="left" if column == "region" else "right")
        for row in shift_rows(evaluation.shift):
            table.add_row(*row)
        screen.print(table)
    screen.print(f"look at {out / 'report.html'}")
