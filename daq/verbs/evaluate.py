"""`rtpiv evaluate`: vectors of pairs seen through glass, with their errors, uncertainty and a page to look at."""

from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from correction.errors import PairError
from correction.evaluate.vector_file import write_netcdf, write_traced, write_vtk
from correction.fit.scene_sigma import SceneSigma
from correction.prepared import PreparedCorrections
from daq.acquisition.runs.acquired import read_acquired
from daq.acquisition.runs.bare_target import dewarp_of
from daq.acquisition.runs.board import board_of
from daq.acquisition.runs.pairs import FramePair, RunPairs, pairs_of
from daq.acquisition.runs.run_views import is_run, scene_file
from daq.acquisition.runs.whole_text import write_json
from daq.analysis.evaluation import Evaluation, Route, Task, evaluate_task
from daq.analysis.report.page import Page
from daq.analysis.report.pair import pair_chapters, pair_tiles
from daq.analysis.report.tables import ROUTE_HEAD, SHIFT_HEAD, SIGMA_HEAD, Row, route_rows, shift_rows, sigma_rows
from daq.terminal import console
from ground.errors import GroundError
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
    square_mm: float | None = None,
    disc_mm: float | None = None,
    shift_mm: tuple[float, float] | None = None,
    stage_sigma_um: float = 10.0,
    route: Route = "image",
    vtk: bool = False,
) -> list[Evaluation]:
    """Correct pairs of frames, measure their displacements, and write a page for each.

    Parameters
    ----------
    paths : list of Path
        Frame A and frame B as acquired; or the folder of a run whose frames form pairs: a shift run, or a stream.
    out : Path
        Folder: ``vectors.nc``, ``evaluation.json``, ``report.html`` with its figures as SVG and PNG, and on
        request ``vectors.vtk`` and ``vectors_velocity.nc``; for a run one such folder a pair.
    scene : Path, optional
        scene.yaml, best a fitted one: with the fit's ``fit.npz`` beside it vectors carry the map's uncertainty.
        A run without it is evaluated with the scene that its frames were corrected with.
    target_clear, dewarp_order, square_mm, disc_mm
        As for `correct`.
    shift_mm : (float, float), optional
        True displacement of the particles, x to the right and y UP: errors are stated against it.  For a run
        the displacement measured by the stages is taken.
    stage_sigma_um : float
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
    ConfigError, FrameError, PairError, BoardError, TargetNotFound, DewarpError, RunUnsuitable, RunDamaged
        What the file, the frames, the target or the run make impossible, in one sentence.
    """
    screen = console()
    if target_clear is not None and route != "image":
        raise PairError(
            "the velocity route traces raw pixels; give the camera's lens terms in the scene, no dewarp"
        )
    run = paths[0] if len(paths) == 1 and is_run(paths[0]) else None
    if run is None and (len(paths) != 2 or scene is None):
        raise PairError("give two frames and --scene, or the folder of a run whose frames form pairs")
    given = pairs_of(run) if run is not None else RunPairs((), ())
    if given.alone:
        screen.print(f"{len(given.alone)} frames lost their partner and are in no pair")
    if scene is None:
        scene = scene_file(paths[0], out)
    fitted = load_scene(scene)
    sigma = _scene_sigma(scene, fitted, target_clear is not None)
    if isinstance(sigma, str):
        screen.print(f"no uncertainty of the map: {sigma}")
    board = board_of([*paths, *([] if target_clear is None else [target_clear])], square_mm, disc_mm)
    dewarp = dewarp_of(target_clear, fitted.camera, board, dewarp_order)
    tasks = [_task(pair, fitted, out) for pair in given.pairs] or [_two_frames(paths, fitted, out, shift_mm)]
    for path in [path for task in tasks for path in task.frames]:
        read_acquired(path, fitted.camera.shape)  # a damaged one is found now, not after an hour
    corrections, found = PreparedCorrections(), []
    for task in tasks:
        evaluation = evaluate_task(task, corrections.of(task.scene, dewarp), sigma, stage_sigma_um, route)
        _write(evaluation, vtk)
        _print(screen, evaluation)
        found.append(evaluation)
    return found


def _two_frames(paths: list[Path], scene: Scene, out: Path, shift_mm: tuple[float, float] | None) -> Task:
    """Task of two frames."""
    first, second = paths
    return Task(f"{first.stem}, {second.stem}", (first, second), scene, out, shift_mm)


def _task(pair: FramePair, scene: Scene, out: Path) -> Task:
    """Task of a pair of a run."""
    task = Task(
        pair.tag, pair.frames, scene if pair.glass else scene.with_bodies(()), out / pair.tag, dt_s=pair.dt_s
    )
    if pair.measured_mm is None or pair.commanded_mm is None:
        return task
    x, y, z = pair.measured_mm
    task = replace(task, commanded_mm=pair.commanded_mm[:2])
    if abs(z) > IN_PLANE_MM:
        return replace(task, note=f"moved by {z:+.3f} mm along z: no one displacement is true for all vectors.")
    return replace(task, shift_mm=(x, y))


def _scene_sigma(scene: Path, fitted: Scene, dewarped: bool) -> SceneSigma | str:
    """Uncertainty of the scene from the fit beside its file, or why there is none."""
    if not scene.with_name(FIT_FILE).is_file():
        return "there is no fit beside the scene; run rtpiv calibrate"
    if dewarped:
        return "the fit does not hold for a dewarped camera"
    try:
        sigma = SceneSigma.load(scene.with_name(FIT_FILE))
        sigma.check(fitted)
    except (GroundError, TracerError) as error:
        return str(error)
    return sigma


def _write(evaluation: Evaluation, vtk: bool) -> None:
    """Write the folder of a pair, the page last."""
    task, field, grid = evaluation.task, evaluation.field, evaluation.grid
    out = task.out
    out.mkdir(parents=True, exist_ok=True)
    about = {"scene_hash": task.scene.content_hash(), "frames": ", ".join(path.name for path in task.frames)}
    about["rtpiv_version"] = version("rtpiv")
    write_netcdf(out / "vectors.nc", field, grid, about, evaluation.map_sigma, evaluation.by_velocity, task.dt_s)
    if evaluation.traced is not None:
        write_traced(out / "vectors_velocity.nc", evaluation.traced, about, task.dt_s)
    if vtk:
        write_vtk(out / "vectors.vtk", field, grid, task.dt_s)
    summary: dict[str, Any] = {
        **about,
        "note": task.note,
        "dt_s": task.dt_s,
        "no_map_sigma": evaluation.no_map_sigma,
    }
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
