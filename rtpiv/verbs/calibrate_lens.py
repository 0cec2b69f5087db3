"""Lens and focal length from a folder of hand-held boards, for `rtpiv calibrate`."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from correction.errors import TargetNotFound, ViewsMissing
from correction.lens.lens_fit import LEAST_POSES, SHARED, LensFit, SeenBoard, fit_lens
from correction.target.board_search import find_lattice
from correction.target.chessboard import Chessboard
from correction.target.two_levels import dot_spread_mm
from daq.atomic_write import write_json, write_text
from daq.runs.acquired import read_acquired
from ground.plain_words import quantity
from ground.terminal import console, error_console
from piv.files.frame_file import FRAME_ENDINGS
from rtpiv.analysis.digits import with_sigma
from rtpiv.analysis.pictures.drawing_process import drawing
from rtpiv.analysis.report.table import Table
from rtpiv.verbs.results import results_in
from tracer.errors import SceneError
from tracer.scene.fit_section import FitCameraTable, FitTable
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene, load_priors, load_scene

GLASS = (
    "{} describes glass, and names of these frames say of none: they were taken as bare. If glass stood before the"
    " board, this lens is wrong; name such frames target_glass_pose1.tif ..., bare ones target_clear_pose1.tif ..."
)
FOCUS = "Focal length and lens terms hold for this zoom and focus; leave both rings alone from now on."


def poses_in(folder: Path) -> list[Path]:
    """Frames of a folder that shows hand-held boards: three or more, and none named as one of a target run."""
    if not folder.is_dir():
        return []
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in FRAME_ENDINGS)
    files = [path for path in files if not path.name.startswith(".")]
    named = any(path.stem.startswith("target_") for path in files)
    return [] if named or len(files) < LEAST_POSES else files


def calibrate_lens(
    files: list[Path], board: Chessboard, scene: Path | None, out: Path | None, pictures: bool, overwrite: bool
) -> LensFit:
    """Fit lens and focal length to frames of a hand-held board; arguments and results as of `calibrate`.

    Raises
    ------
    ViewsMissing
        Fewer than three frames show the board, or they do not determine the focal length.
    FrameError, SceneError
        A frame cannot be read, or scene and frames are of cameras of different size.
    """
    began = time.monotonic()
    progress = error_console()
    progress.print(f"{quantity(len(files), 'frame')}, none named target_...: a board held by hand, without glass")
    nominal = None if scene is None else (load_scene(scene), load_priors(scene))
    first = read_acquired(files[0])
    if nominal is not None and nominal[0].camera.shape != first.shape:
        (rows, columns), (height, width) = nominal[0].camera.shape, first.shape
        raise SceneError(
            f"{scene}: the camera has {columns} x {rows} px, the frames {width} x {height}; give the scene of the"
            " camera that took them"
        )
    made_from = dict.fromkeys(("lens.json", *(("scene.yaml",) if nominal else ())), files[0].parent)
    with results_in(out, "lens", overwrite=overwrite, made_from=made_from) as out:
        seen: list[SeenBoard] = []
        missed: dict[str, str] = {}
        waiting = list(files)
        for number, path in enumerate(waiting):
            took = time.monotonic() - began
            left = f", {took / number * (len(waiting) - number):.0f} s left" if number else ""
            progress.print(f"{took:6.1f} s  {path.name} ({number + 1} of {len(waiting)}{left})")
            try:
                found = find_lattice(read_acquired(path, first.shape), board)
            except TargetNotFound as error:
                missed[path.name] = str(error)
                continue
            missed.pop(path.name, None)
            place_mm = found.board.place_mm(found.index)
            # A quarter of all dots, half of a level: as much as shadows make those of the worse level uncertain.
            shadow_mm = np.quantile(dot_spread_mm(found.sigma_px, found.axes_px, board.square_mm), 0.75)
            aside_mm = max(found.board.step_sigma_mm, float(shadow_mm))
            seen.append(SeenBoard(path.name, place_mm, found.position_px, found.sigma_px, aside_mm))
            if board.codes is not None and found.board != board:  # one frame shows the layout for all
                board = found.board
                waiting += [file for file in files if file.name in missed]
        if not seen:
            name, why = next(iter(missed.items()))
            raise ViewsMissing(f"no frame shows the board; {name}: {why}")
        known = FitCameraTable() if nominal is None else nominal[1].camera
        fit = fit_lens(seen, (first.shape[1], first.shape[0]), known.pixel_aspect)
        glass = [GLASS.format(scene)] if nominal is not None and nominal[0].bodies else []
        fit = replace(fit, refused={**missed, **fit.refused})
        warnings = [*glass, *fit.warnings]
        write_json(out / "lens.json", {**_facts(fit), "warnings": warnings})
        if nominal is not None and fit.has_square_pixels:
            write_text(out / "scene.yaml", _with_lens(*nominal, fit))
        _show(fit, warnings)
        if pictures:
            with drawing() as draw:
                at = np.concatenate([fit.seen[tag].position_px for tag in fit.residual_px])
                off = np.concatenate(list(fit.residual_px.values()))
                used = np.isfinite(off[:, 0])
                title = f"found minus computed, {quantity(len(fit.poses), 'board')}"
                panels = [(title, at[used], off[used])]
                draw(
                    "rtpiv.analysis.pictures.calibration:draw_residuals",
                    out / "residuals.png",
                    panels,
                    first.shape,
                )
            console().print(f"look at {out / 'residuals.png'}", style="bold")
        if nominal is None:
            console().print(f"lens.json is in {out}")
        elif fit.has_square_pixels:
            console().print(f"lens.json, and scene.yaml with this lens and its uncertainty, are in {out}")
        else:
            console().print(f"lens.json is in {out}; no scene.yaml, as cameras of scenes have square pixels")
        return fit


def _with_lens(scene: Scene, priors: FitTable, fit: LensFit) -> str:
    """Text of a scene file with the lens found, and its uncertainty as what is known of it before a fit."""
    found = fit.camera
    camera = replace(scene.camera, focal_px=found.focal_px, principal_px=found.principal_px, lens=found.lens)
    known = dict(zip(SHARED, fit.sigma.tolist(), strict=True))
    del known["pixel_aspect"]
    known["principal_px"] = max(known.pop("principal_u_px"), known.pop("principal_v_px"))
    known_camera = priors.camera.model_copy(update=known)
    return dump_scene(replace(scene, camera=camera), priors.model_copy(update={"camera": known_camera}))


def _facts(fit: LensFit) -> dict[str, object]:
    ratio, sigma = fit.seen_aspect
    return {
        "sensor_px": list(fit.camera.sensor_px),
        "numbers": dict(zip(SHARED, fit.numbers.tolist(), strict=True)),
        "sigma": dict(zip(SHARED, fit.sigma.tolist(), strict=True)),
        "covariance": fit.covariance.tolist(),
        "rms_px": fit.rms_px,
        "board_sigma_px": fit.board_sigma_px,
        "pixel_height_over_width": {"value": ratio, "sigma": sigma},
        "rms_px_of_frames": {
            tag: float(np.sqrt(np.nanmean((off**2).sum(axis=1)))) for tag, off in fit.residual_px.items()
        },
        "left_out": fit.refused,
    }


def _show(fit: LensFit, warnings: list[str]) -> None:
    screen = console()
    rows = [
        (name, with_sigma(value, sigma))
        for name, value, sigma in zip(SHARED, fit.numbers.tolist(), fit.sigma.tolist(), strict=True)
    ]
    screen.print(Table(f"lens from {quantity(len(fit.poses), 'board')}", ("number", "value"), rows))
    screen.print(
        f"marks lie {fit.rms_px:.3f} px (rms) from where this lens puts them; {fit.board_sigma_px:.3f} px of it"
        " (boards that are not flat, blur) are more than their noise"
    )
    for name, why in fit.refused.items():
        screen.print(f"{name} is left out: {why}", style="bold red")
    for warning in warnings:
        screen.print(warning, style="bold red")
    screen.print(FOCUS)
