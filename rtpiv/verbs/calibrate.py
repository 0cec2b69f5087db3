"""`rtpiv calibrate`: fit the geometry of the bench to frames of its target."""

import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from correction.errors import ViewsMissing
from correction.fit.judge.result import SceneFit
from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.fitted.map_sigma import map_sigma
from correction.fitted.scene_sigma import save_fit
from correction.lens.lens_fit import LensFit
from daq.atomic_write import write_json, write_text
from daq.runs.acquired import read_acquired
from daq.runs.names import is_run
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import TargetView, board_of, height_sigma_mm, load_kept, target_views
from ground.plain_words import quantity
from ground.printable import readable_name
from ground.terminal import console, error_console
from piv.files.frame_file import FRAME_ENDINGS
from rtpiv.analysis.calibration import Calibration, calibration_of
from rtpiv.analysis.pictures.before_after import layers_of
from rtpiv.analysis.pictures.drawing_process import drawing
from rtpiv.options.numbers import Positive
from rtpiv.verbs.calibrate_lens import calibrate_lens, poses_in
from rtpiv.verbs.paths import Named, one_of, path_of
from rtpiv.verbs.results import results_in
from rtpiv.verbs.show import show_calibration
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene, load_priors, load_scene

PICTURES = "rtpiv.analysis.pictures"
FITTED = ("scene.yaml", "fit.npz", "map_sigma.npz", "calibration.json")
DRAWN = ("map_sigma.png", "convergence.png", "smooth_residuals.png", "residuals.png", "calibration.html")
NAME = re.compile(r"target_(clear|glass)(?:_z([+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?)mm|_(pose\w+))?")
OR_BY_HAND = "; or give three or more of a board held by hand, without glass, for the lens alone"
Work = tuple[Callable[[str], None], float]  # tells each step, and seconds that the fit took
WANTED = (
    "target_clear.tif, target_glass.tif, for other heights target_clear_z+10mm.tif and so on, and for poses by"
    " hand target_clear_pose1.tif and so on"
)


def calibrate(
    folder: Sequence[Named] | Named,
    /,
    scene: Named | None = None,
    out: Named | None = None,
    square_mm: Positive | None = None,
    disc_mm: Positive | None = None,
    board: Named | None = None,
    pictures: bool = True,
    overwrite: bool = False,
) -> SceneFit | LensFit:
    """Fit a scene to frames of its target, or a lens to frames of a board held by hand.

    Parameters
    ----------
    folder : path
        A target run (of several, the newest finished one is used); or a folder that holds ``target_clear.tif``
        (bare target at z = 0), ``target_glass.tif`` (through the glass) and, for other heights,
        ``target_clear_z+10mm.tif`` ..., and for the board held by hand, tilted or elsewhere,
        ``target_clear_pose1.tif``, ``target_glass_pose1.tif`` ...; or a folder with three or more frames of other
        names, without glass, of a board held by hand and tilted to all sides: from these only lens and focal
        length are fitted.
    scene : path, optional
        Nominal scene.yaml, with the priors in its section ``fit``.  Default for a run: the scene of its bench at
        the start of the run.
    out : path, optional
        Folder, default ``fit`` (or ``fit-2`` ... where that has results): ``scene.yaml`` fitted, ``fit.npz``
        (covariance, corners), ``map_sigma.npz`` and ``.png``, ``residuals.png``, ``smooth_residuals.png`` (for the
        test of the model), ``convergence.png``, ``calibration.html`` (verdict and numbers),
        ``calibration.json``.  For a board held by hand, default ``lens``: ``lens.json``, ``residuals.png`` and, if
        a scene is given, ``scene.yaml`` with this lens and its uncertainty as prior.
    square_mm : float, optional
        Side of the squares of the board (default 2.5); runs store their own.
    disc_mm : float, optional
        Diameter of the discs of the board (default 0.4 squares); runs store their own.
    board : path, optional
        Instead of both: board.yaml of ``rtpiv setup target``, with the scale of the print.
    pictures : bool
        Draw figures.
    overwrite : bool
        Overwrite files in the given folder that were made from other input.

    Returns
    -------
    SceneFit
        The fitted scene (`scene`), its parameters with sigma, and those that the frames do not determine.
    LensFit
        For a board held by hand: lens, focal length, covariance.

    Raises
    ------
    ConfigError, SceneError
        The scene file is wrong.
    BoardError
        The given board differs from that of the run.
    FrameError, TargetNotFound, FitError
        The frames cannot determine the scene; nothing is written then.
    """
    progress = error_console()
    began = time.monotonic()
    folder = one_of(folder)
    if not is_run(folder) and (poses := poses_in(folder)):
        held = board_of([folder], square_mm, disc_mm, path_of(board))
        try:
            return calibrate_lens(poses, held, path_of(scene), path_of(out), pictures, overwrite)
        except ViewsMissing as error:
            kind = "" if board else "describe a board of another kind, such as ChArUco or dots, by --board; "
            raise ViewsMissing(error, cure=f"{kind}or, of a board on a stage, name the frames {WANTED}") from None
    nominal, priors = nominal_scene(folder, path_of(scene))
    nominal.in_light_sheet()  # a sheet that runs through a rod or window is refused before the fit
    target = board_of([folder], square_mm, disc_mm, path_of(board))
    frames = target_frames(folder, nominal.camera.shape)
    made_from = dict.fromkeys((*FITTED, *(DRAWN if pictures else ())), folder)
    with results_in(out, "fit", overwrite=overwrite, made_from=made_from) as out:

        def say(text: str) -> None:
            progress.print(f"{time.monotonic() - began:6.1f} s  {text}")

        say(f"{quantity(len(frames), 'frame')} of the target in {folder}")
        fit = fit_scene(nominal, frames, target, with_read_heights(priors, folder), say)
        seconds = time.monotonic() - began
        write_fit(out, fit, frames, priors, readable_name(folder) if pictures else "", (say, seconds))
        return fit


def write_fit(
    out: Path, fit: SceneFit, frames: Sequence[TargetFrame], priors: FitTable, name: str, work: Work
) -> None:
    """Write all results of a fit, and pictures of a calibration with that name; none if it is ""."""
    say, seconds = work
    say("standard deviation of the map")
    sigma = map_sigma(fit)
    say("errors before and after")
    found = calibration_of(fit, sigma, frames, seconds, layers_of if name else None)
    save_fit(out / "fit.npz", fit)
    sigma.save(out / "map_sigma.npz")
    write_json(out / "calibration.json", found.to_dict())
    write_text(out / "scene.yaml", dump_scene(fit.measured_scene, priors))
    show_calibration(console(), found, bool(name))
    if name:
        _draw(out, found, fit.scene.camera.shape, name)
    results = f"covariance{', map sigma and pictures' if name else ' and map sigma'}"
    console().print(f"scene.yaml, {results} are in {out}")


def _draw(out: Path, found: Calibration, shape: tuple[int, int], name: str) -> None:
    with drawing() as draw:
        draw(
            f"{PICTURES}.calibration:draw_map_sigma", out / "map_sigma.png", found.sigma, found.fit.measured_scene
        )
        draw(f"{PICTURES}.calibration:draw_convergence", out / "convergence.png", found.fit.history)
        draw(f"{PICTURES}.calibration:draw_smooth", out / "smooth_residuals.png", found.fit)
        if found.panels:
            draw(f"{PICTURES}.calibration:draw_residuals", out / "residuals.png", found.panels, shape)
        draw("rtpiv.analysis.report.calibration:write_calibration_page", out / "calibration.html", found, name)
    console().print(f"look at {out / 'calibration.html'}", style="bold")


def nominal_scene(folder: Path, scene: Path | None) -> tuple[Scene, FitTable]:
    """Read the nominal scene and its fit section, from a file or from the run itself.

    Raises
    ------
    ViewsMissing
        No scene is given, and the folder is no run.
    RunDamaged
        The scene that the run keeps cannot be read any more.
    """
    if scene is not None:
        return load_scene(scene), load_priors(scene)
    if not folder.exists():
        raise ViewsMissing("is not there", place=folder, cure="give the folder of a target run")
    if not is_run(folder):
        raise ViewsMissing(
            "is no run, which would know its scene", place=folder, cure="give the nominal one with --scene"
        )
    return load_kept(RunFolder.open(folder), "scene", lambda file: (load_scene(file), load_priors(file)))


def with_read_heights(priors: FitTable, folder: Path) -> FitTable:
    """Return the priors, with the uncertainty of heights that a person has read."""
    read_mm = height_sigma_mm(folder) if is_run(folder) else 0.0
    if read_mm <= priors.target.z_mm:
        return priors
    return priors.model_copy(update={"target": priors.target.model_copy(update={"z_mm": read_mm})})


def target_frames(folder: Path, shape: tuple[int, int]) -> list[TargetFrame]:
    """Read the target frames of a run, at measured heights, or of a folder, at those that the names say.

    Raises
    ------
    ViewsMissing
        There is no frame of the target, or one that is named like one and is not understood.
    FrameError
        A frame is damaged or of another size.
    RunDamaged
        A frame of a run, or a record of it, is not what was written.
    """
    if not folder.is_dir():
        raise ViewsMissing("is no folder", place=folder, cure=f"give a run, or the folder with {WANTED}")
    views = target_views(folder) if is_run(folder) else _views_by_name(folder)
    if not views:
        raise ViewsMissing("holds no frame of the target", place=folder, cure=f"name them {WANTED}{OR_BY_HAND}")
    return [
        TargetFrame(view.tag, read_acquired(view.path, shape), view.glass, view.height_mm, view.pose)
        for view in views
    ]


def _views_by_name(folder: Path) -> list[TargetView]:
    """Return the frames of a folder that is no run, with the heights in their names."""
    views = []
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in FRAME_ENDINGS or not path.stem.startswith("target_"):
            continue
        match = NAME.fullmatch(path.stem)
        if match is None:
            raise ViewsMissing(
                f"is named like a frame of the target, but not {WANTED}", place=path, cure="rename it"
            )
        views.append(TargetView(path.stem, path, match[1] == "glass", float(match[2] or 0.0), match[3] or ""))
    return views
