"""`rtpiv calibrate`: find the bench's true geometry from frames of its target."""

import re
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from correction.evaluate.target_error import TargetError
from correction.fit.errors import ViewsMissing
from correction.fit.fit_file import save_fit
from correction.fit.map_sigma import MapSigma, map_sigma
from correction.fit.measurement import TargetFrame
from correction.fit.result import SceneFit
from correction.fit.scene_fit import fit_scene
from correction.fit.table2 import Sense1, aligned, computed_against_acquired, corrected_against_grid
from correction.fit.weakness import Weakness, weaknesses
from correction.frame_file import FRAME_ENDINGS, read_frame
from correction.target import Chessboard
from daq.pictures.calibration import Panel, draw_map_sigma, draw_residuals
from daq.runs.run_views import is_run
from daq.runs.run_views import target_frames as frames_of_run
from daq.runs.whole_text import write_json, write_text
from daq.terminal import console, error_console
from tracer.scene_file import dump_scene, load_priors, load_scene

NAME = re.compile(r"target_(clear|glass)(?:_z([+-]?\d+(?:\.\d+)?)mm)?")
WANTED = "target_clear.tif, target_glass.tif, and for other heights target_clear_z+10mm.tif and so on"


def calibrate(folder: Path, scene: Path, out: Path, square_mm: float = 2.5, disc_mm: float = 1.0) -> SceneFit:
    """Fit a scene to frames of its target.

    Parameters
    ----------
    folder : Path
        A target run; or a folder that holds ``target_clear.tif`` (bare target at z = 0), ``target_glass.tif``
        (through the glass) and, for other heights, ``target_clear_z+10mm.tif`` ...
    scene : Path
        Nominal scene.yaml; its ``fit:`` section says what may change.
    out : Path
        Folder: ``scene.yaml`` fitted, ``fit.npz`` (covariance, corners), ``map_sigma.npz`` and ``.png``,
        ``residuals.png``, ``calibration.json``.
    square_mm, disc_mm : float
        The target.

    Raises
    ------
    ConfigError, SceneError
        The scene file is wrong.
    FrameError, TargetNotFound, FitError
        The frames cannot determine the scene; nothing is written then.
    """
    progress = error_console()
    began = time.monotonic()
    nominal, priors = load_scene(scene), load_priors(scene)
    board = Chessboard(square_mm, disc_mm)
    frames = target_frames(folder, nominal.camera.shape)

    def say(text: str) -> None:
        progress.print(f"{time.monotonic() - began:6.1f} s  {text}")

    say(f"{len(frames)} frames of the target in {folder}")
    fit = fit_scene(nominal, frames, board, priors, say)
    seconds = time.monotonic() - began
    say("standard deviation of the map")
    sigma = map_sigma(fit)
    say("errors before and after")
    senses, grids, panels = _compare(fit, frames, board)
    weak = weaknesses(fit)
    out.mkdir(parents=True, exist_ok=True)
    save_fit(out / "fit.npz", fit)
    sigma.save(out / "map_sigma.npz")
    draw_map_sigma(out / "map_sigma.png", sigma)
    if panels:
        draw_residuals(out / "residuals.png", panels, nominal.camera.shape)
    summary = _summary(fit, sigma, senses, grids, weak, seconds)
    write_json(out / "calibration.json", summary)
    write_text(out / "scene.yaml", dump_scene(fit.scene))
    _print(console(), fit, sigma, senses, grids, weak, out)
    return fit


def target_frames(folder: Path, shape: tuple[int, int]) -> list[TargetFrame]:
    """Read the target frames of a run or a folder; the name says what was before the camera and the height.

    Raises
    ------
    ViewsMissing
        There is no bare target at z = 0.
    FrameError
        A frame is damaged or of another size.
    """
    if not folder.is_dir():
        raise ViewsMissing(f"{folder}: is no folder; give a run, or the folder with {WANTED}")
    if is_run(folder):
        named = frames_of_run(folder)
    else:
        named = {path.stem: path for path in sorted(folder.iterdir()) if path.suffix.lower() in FRAME_ENDINGS}
    frames = []
    for name, path in named.items():
        match = NAME.fullmatch(name)
        if match:
            image = read_frame(path, shape)
            frames.append(TargetFrame(name, image, match[1] == "glass", float(match[2] or 0.0)))
    if not frames:
        raise ViewsMissing(f"{folder}: holds no frame of the target; name them {WANTED}")
    return frames


Senses = dict[str, list[Sense1]]
Grids = dict[str, TargetError]


def _compare(fit: SceneFit, frames: Sequence[TargetFrame], board: Chessboard) -> tuple[Senses, Grids, list[Panel]]:
    """Table 2 in both senses, nominal and fitted, on the frame through glass at z = 0."""
    found = [frame for frame in frames if frame.glass and frame.height_mm == 0.0]
    senses: Senses = {}
    grids: Grids = {}
    panels: list[Panel] = []
    for frame in found[:1]:
        number = fit.frames.index(frame.name)
        for name, scene in (("nominal glass", aligned(fit)), ("fitted", fit.scene)):
            senses[name], pixel, error = computed_against_acquired(scene, fit.corners, number, board)
            grids[name] = corrected_against_grid(scene, frame.image, board)
            panels.append((f"{name}, computer-generated minus acquired", pixel, error))
    return senses, grids, panels


def _summary(
    fit: SceneFit, sigma: MapSigma, senses: Senses, grids: Grids, weak: Sequence[Weakness], seconds: float
) -> dict[str, Any]:
    """Everything a later reader needs, JSON-able."""
    corners = fit.corners
    numbers = {
        name: {"value": float(value), "sigma": float(spread), "prior_sigma": float(prior)}
        for name, value, spread, prior in zip(fit.names, fit.values, fit.sigmas, fit.bench.sigma, strict=True)
    }
    return {
        "scene_hash": fit.scene.content_hash(),
        "nominal_hash": fit.bench.scene.content_hash(),
        "wavelength_nm": fit.scene.wavelength_nm,
        "frames": list(fit.frames),
        "seconds": round(seconds, 2),
        "numbers": numbers,
        "rms_px": {
            name: corners.rms_px(behind).tolist()
            for name, behind in (("seen directly", False), ("behind glass", True))
            if np.any(corners.inlier & (corners.behind == behind))
        },
        "visible_behind_glass": fit.expected_behind,
        "used_behind_glass": fit.paired_behind,
        "outliers": int(np.count_nonzero(~corners.inlier)),
        "refused": fit.refused,
        "overlap_removed_mm": fit.pushed_mm,
        "map_sigma_px": _percentiles(sigma),
        "weak": [weakness.sentence for weakness in weak],
        "table2_computed_minus_acquired_px": {
            name: [
                {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in asdict(r).items()} for r in regions
            ]
            for name, regions in senses.items()
        },
        "table2_corrected_minus_grid_px": {name: error.to_dict() for name, error in grids.items()},
        "history": list(fit.history),
    }


def _percentiles(sigma: MapSigma) -> dict[str, dict[str, float]]:
    """Median and largest standard deviation per region, worse axis."""
    worst = sigma.sigma_px.max(axis=-1)
    regions = {"seen directly": ~sigma.behind_glass, "behind glass": sigma.behind_glass}
    return {
        name: {"median": float(np.median(values)), "largest": float(values.max())}
        for name, region in regions.items()
        if len(values := worst[region & np.isfinite(worst)])
    }


def _print(
    screen: Console,
    fit: SceneFit,
    sigma: MapSigma,
    senses: Senses,
    grids: Grids,
    weak: Sequence[Weakness],
    out: Path,
) -> None:
    """Say what was found."""
    numbers = Table(title=f"fitted scene {fit.scene.content_hash()}")
    for name in ("number", "fitted", "sigma", "moved", "prior sigma"):
        numbers.add_column(name, justify="left" if name == "number" else "right")
    rows = zip(fit.names, fit.values, fit.sigmas, fit.x * fit.bench.sigma, fit.bench.sigma, strict=True)
    for name, *row in rows:
        numbers.add_row(name, *(f"{value:.6g}" for value in row))
    screen.print(numbers)
    table = Table(title="position error of target points [px] (Table 2)")
    for name in ("sense", "scene", "region", "corners", "bias u, v", "rms u, v", "largest"):
        table.add_column(name, justify="left" if name in ("sense", "scene", "region") else "right")
    for name, regions in senses.items():
        for r in regions:
            bias, rms = (f"{p[0]:+.3f}, {p[1]:+.3f}" for p in (r.bias_px, r.rms_px))
            rms = rms.replace("+", "")
            table.add_row("computed - acquired", name, r.region, str(r.corners), bias, rms, f"{r.largest_px:.2f}")
    for name, error in grids.items():
        for figures in error.rows():
            table.add_row("corrected - grid", name, *figures)
    screen.print(table)
    for region, values in _percentiles(sigma).items():
        screen.print(f"map sigma {region}: median {values['median']:.4f} px, largest {values['largest']:.3f} px")
    count = int(np.count_nonzero(~fit.corners.inlier))
    if fit.expected_behind:
        screen.print(
            f"{fit.paired_behind} of {fit.expected_behind} visible corners behind glass used; {count} outliers"
            f" of {len(fit.corners.inlier)} corners rejected"
        )
    for weakness in weak:
        screen.print(f"weak: {weakness.sentence}")
    screen.print(f"scene.yaml, covariance, map sigma and pictures are in {out}")
