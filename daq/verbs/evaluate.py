"""`rtpiv evaluate`: vectors of pairs seen through glass, with their errors, uncertainty and a page to look at."""

from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from correction.dewarp import Dewarp, fit_dewarp
from correction.errors import PairError
from correction.evaluate.vector_file import write_netcdf, write_traced, write_vtk
from correction.fit.scene_sigma import SceneSigma
from correction.frame_file import read_frame
from correction.target import Chessboard
from daq.evaluation import Evaluation, Route, Task, evaluate_task
from daq.report.page import Page
from daq.report.pair import pair_chapters, pair_tiles
from daq.report.tables import ROUTE_HEAD, SHIFT_HEAD, SIGMA_HEAD, Row, route_rows, shift_rows, sigma_rows
from daq.runs.run_views import ShiftPair, is_run, scene_file, shift_pairs
from daq.runs.whole_text import write_json
from daq.terminal import console
from tracer.errors import TracerError
from tracer.scene import Scene
from tracer.scene_file import load_scene

FIT_FILE = "fit.npz"
IN_PLANE_MM = 0.01  # a sheet moved farther out of its plane shows no uniform displacement


def evaluate(
    paths: list[Path],
    out: Path,
    scene: Path | None = None,
    target_clear: Path | None = None,
    dewarp_order: int = 2,
    square_mm: float = 2.5,
    shift_mm: tuple[float, float] | None = None,
    stage_um: float = 10.0,
    route: Route = "image",
    vtk: bool = False,
) -> list[Evaluation]:
    """Correct pairs of frames, measure their displacements, and write a page for each.

    Parameters
    ----------
    paths : list of Path
        Frame A and frame B as acquired; or one run folder of a shift experiment.
    out : Path
        Folder: ``vectors.nc``, ``evaluation.json``, ``report.html`` with its figures as SVG and PNG, and on
        request ``vectors.vtk`` and ``vectors_velocity.nc``; for a run one such folder a pair.
    scene : Path, optional
        scene.yaml, best a fitted one: with the fit's ``fit.npz`` beside it vectors carry the map's uncertainty.
        A run without it is evaluated with the scene that its frames were corrected with.
    target_clear, dewarp_order, square_mm
        As for `correct`.
    shift_mm : (float, float), optional
        True displacement of the particles, x to the right and y UP: errors are stated against it.  For a run
        the displacement measured by the stages is taken.
    stage_um : float
        Standard error of the stage that moved the sheet, for the error budget.
    route : {"image", "compare", "best"}
        Correct, then correlate; also carry raw vectors through the glass and compare; or take in each region the
        better of both (the scene must hold the camera's true pose; no dewarp).
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
    screen = console()
    if target_clear is not None and route != "image":
        raise PairError(
            "the velocity route traces raw pixels; give the camera's lens terms in the scene, no dewarp"
        )
    run = paths[0] if len(paths) == 1 and is_run(paths[0]) else None
    if run is None and (len(paths) != 2 or scene is None):
        raise PairError("give two frames and --scene, or the folder of a shift run")
    pairs = shift_pairs(run) if run is not None else []
    if scene is None:
        scene = scene_file(paths[0], out)
    fitted = load_scene(scene)
    sigma = _scene_sigma(scene, fitted, target_clear is not None)
    if isinstance(sigma, str):
        screen.print(f"no uncertainty of the map: {sigma}")
    dewarp: Dewarp | None = None
    if target_clear is not None:
        clear = read_frame(target_clear, fitted.camera.shape)
        dewarp = fit_dewarp(clear, fitted.camera, Chessboard(square_mm), dewarp_order)
    found = []
    for task in [_task(pair, fitted, out) for pair in pairs] or [_two_frames(paths, fitted, out, shift_mm)]:
        evaluation = evaluate_task(task, dewarp, sigma, stage_um, route)
        _write(evaluation, vtk)
        _print(screen, evaluation)
        found.append(evaluation)
    return found


def _two_frames(paths: list[Path], scene: Scene, out: Path, shift_mm: tuple[float, float] | None) -> Task:
    """Task of two frames."""
    first, second = paths
    return Task(f"{first.stem}, {second.stem}", (first, second), scene, out, shift_mm)


def _task(pair: ShiftPair, scene: Scene, out: Path) -> Task:
    """Task of a pair of a run."""
    through = scene if pair.glass else scene.with_bodies(())
    x, y, z = pair.measured_mm
    shift: tuple[float, float] | None = (x, y)
    note = ""
    if abs(z) > IN_PLANE_MM:
        shift, note = None, f"moved by {z:+.3f} mm along z: no one displacement is true for all vectors."
    return Task(pair.tag, pair.frames, through, out / pair.tag, shift, pair.commanded_mm[:2], note)


def _scene_sigma(scene: Path, fitted: Scene, dewarped: bool) -> SceneSigma | str:
    """Uncertainty of the scene from the fit beside its file, or why there is none."""
    if not scene.with_name(FIT_FILE).is_file():
        return "there is no fit beside the scene; run rtpiv calibrate"
    if dewarped:
        return "the fit does not hold for a dewarped camera"
    try:
        sigma = SceneSigma.load(scene.with_name(FIT_FILE))
        sigma.check(fitted)
    except TracerError as error:
        return str(error)
    return sigma


def _write(evaluation: Evaluation, vtk: bool) -> None:
    """Write the folder of a pair, the page last."""
    task, field, grid = evaluation.task, evaluation.field, evaluation.corrector.map.grid
    out = task.out
    out.mkdir(parents=True, exist_ok=True)
    about = {"scene_hash": task.scene.content_hash(), "frames": ", ".join(path.name for path in task.frames)}
    about["rtpiv_version"] = version("rtpiv")
    write_netcdf(out / "vectors.nc", field, grid, about, evaluation.map_sigma, evaluation.by_velocity)
    if evaluation.traced is not None:
        write_traced(out / "vectors_velocity.nc", evaluation.traced, about)
    if vtk:
        write_vtk(out / "vectors.vtk", field, grid)
    summary: dict[str, Any] = {**about, "note": task.note, "no_map_sigma": evaluation.no_map_sigma}
    summary |= {"vectors": field.counts, "nan_pixels": field.nan_pixels, "doubt": field.doubt}
    summary["sigma_px"] = [dict(zip(SIGMA_HEAD, row, strict=True)) for row in sigma_rows(evaluation)]
    if evaluation.shift is not None:
        summary["shift"] = evaluation.shift.to_dict()
    if evaluation.routes is not None:
        summary["routes"] = [dict(zip(ROUTE_HEAD, row, strict=True)) for row in route_rows(evaluation.routes)]
    write_json(out / "evaluation.json", summary)
    page = Page("PIV through glass: " + task.name, about["frames"])
    page.tiles(pair_tiles(evaluation))
    pair_chapters(page, evaluation)
    page.heading("Provenance")
    page.facts([*about.items(), ("bodies", ", ".join(body.name for body in task.scene.bodies) or "none")])
    page.write(out / "report.html")


def _print(screen: Console, evaluation: Evaluation) -> None:
    counts = ", ".join(f"{count} {name}" for name, count in evaluation.field.counts.items())
    screen.print(f"{evaluation.task.name}: {counts}")
    if evaluation.field.doubt:
        screen.print(evaluation.field.doubt, style="bold red")
    tables: list[tuple[str, tuple[str, ...], list[Row]]] = []
    if evaluation.shift is not None:
        tables.append(("errors against the known shift [px]", SHIFT_HEAD, shift_rows(evaluation.shift)))
    if evaluation.map_sigma is not None:
        tables.append(("standard uncertainty, rms [px]", SIGMA_HEAD, sigma_rows(evaluation)))
    if evaluation.routes is not None:
        tables.append(("both routes by r / R [px]", ROUTE_HEAD, route_rows(evaluation.routes)))
    for title, head, rows in tables:
        table = Table(title=title)
        for number, column in enumerate(head):
            table.add_column(column, justify="right" if number else "left")
        for row in rows:
            table.add_row(*row)
        screen.print(table)
    screen.print(f"look at {evaluation.task.out / 'report.html'}")
