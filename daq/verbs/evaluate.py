"""`rtpiv evaluate`: vectors of a pair seen through glass, with errors and a page to look at."""

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.table import Table

from correction.correction_map import build_correction_map
from correction.corrector import Corrector
from correction.dewarp import Dewarp, fit_dewarp
from correction.evaluate.piv import evaluate_pair
from correction.evaluate.regions import regions_of
from correction.evaluate.shift import evaluate_shift
from correction.evaluate.vector_file import write_netcdf, write_vtk
from correction.evaluate.velocity_route import velocity_route
from correction.frame_file import read_frame
from correction.target import Chessboard
from daq.evaluation_page import SHIFT_HEAD, Evaluation, shift_rows, write_page
from daq.terminal import console
from tracer.ray_map import build_ray_map
from tracer.scene_file import load_scene


def evaluate(
    pair: list[Path],
    scene: Path,
    out: Path,
    target_clear: Path | None = None,
    dewarp_order: int = 2,
    square_mm: float = 2.5,
    shift_mm: tuple[float, float] | None = None,
    stage_um: float = 10.0,
    velocity: bool = False,
    vtk: bool = False,
) -> Evaluation:
    """Correct a pair of frames, measure its displacements, and write a report.

    Parameters
    ----------
    pair : list of two Paths
        Frame A and frame B as acquired.
    scene : Path
        scene.yaml, best a fitted one.
    out : Path
        Folder: ``vectors.nc``, ``evaluation.json``, ``report.html``, its figures as SVG, ``vectors.vtk`` on
        request.
    target_clear, dewarp_order, square_mm
        As for `correct`.
    shift_mm : (float, float), optional
        True displacement of the particles, x to the right and y UP: errors are stated against it.
    stage_um : float
        Standard error of the stage that moved the sheet, for the error budget.
    velocity : bool
        Also take the velocity route (the scene must hold the camera's true pose; no dewarp).
    vtk : bool
        Also write VTK text.

    Raises
    ------
    ConfigError, FrameError, PairError, TargetNotFound, DewarpError
        What the file, the frames or the target make impossible, in one sentence.
    """
    loaded = load_scene(scene)
    shape = loaded.camera.shape
    frame_a, frame_b = (read_frame(path, shape) for path in pair)
    dewarp: Dewarp | None = None
    if target_clear is not None:
        clear = read_frame(target_clear, shape)
        dewarp = fit_dewarp(clear, loaded.camera, Chessboard(square_mm), dewarp_order)
    ray_map = build_ray_map(loaded)
    corrector = Corrector(build_correction_map(loaded, ray_map), dewarp)
    corrected_a, corrected_b = corrector(frame_a), corrector(frame_b)
    field = evaluate_pair(corrected_a, corrected_b, corrector.recovered)
    regions = regions_of(field, corrector.map, loaded)
    result = None
    if shift_mm is not None:
        scale = corrector.map.grid.px_per_mm
        truth = (shift_mm[0] * scale, -shift_mm[1] * scale)
        result = evaluate_shift(field, regions, truth, stage_um * 1e-3 * scale)
    traced = velocity_route(frame_a, frame_b, loaded, ray_map) if velocity else None
    evaluation = Evaluation(field, regions, result, traced)
    out.mkdir(parents=True, exist_ok=True)
    about = {"scene_hash": loaded.content_hash(), "frames": ", ".join(p.name for p in pair)}
    about["rtpiv_version"] = version("rtpiv")
    write_netcdf(out / "vectors.nc", field, corrector.map.grid, about)
    if vtk:
        write_vtk(out / "vectors.vtk", field, corrector.map.grid)
    summary: dict[str, Any] = {**about, "vectors": field.counts}
    if result is not None:
        summary["shift"] = result.to_dict()
    (out / "evaluation.json").write_text(json.dumps(summary, indent=1))
    write_page(out, evaluation, corrector, loaded, (frame_a, corrected_a), about)
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
