"""`rtpiv calibrate --join`: fit cameras of one bench, with the glass and the print in common."""

import time
from collections.abc import Sequence

from correction.fit.joint_cameras import JointFit, join_fits
from correction.fit.scene_fit import fit_scene
from daq.errors import RunUsageError
from daq.runs.run_views import board_of
from ground.printable import readable_name
from ground.terminal import console, error_console
from rtpiv.options.numbers import Positive
from rtpiv.verbs.calibrate import DRAWN, FITTED, nominal_scene, target_frames, with_read_heights, write_fit
from rtpiv.verbs.paths import Named, path_of, paths_of
from rtpiv.verbs.results import results_in


def calibrate_cameras(
    folders: Sequence[Named],
    /,
    scene: Sequence[Named] = (),
    out: Named | None = None,
    square_mm: Positive | None = None,
    disc_mm: Positive | None = None,
    board: Named | None = None,
    pictures: bool = True,
    overwrite: bool = False,
) -> JointFit:
    """Fit the scenes of several cameras to frames of one target, which stood still for all of them.

    Bodies and the size of the print are the same for all cameras; each has its own pose and lens. Bodies are
    matched by name.

    Parameters
    ----------
    folders : path
        Target run and folder of each further camera in it (``RUN/cameras/NAME``), or folders as for `calibrate`.
    scene : sequence of path, optional
        Nominal scene of each camera, in their order; default the scenes of the run.
    out : path, optional
        Folder, default ``fit`` (or ``fit-2`` ... where that has results): the files of `calibrate` in
        ``camera-1``, ``camera-2`` ...; ``fit.npz`` holds the errors that the cameras have in common, which
        `mean --join` uses.
    square_mm, disc_mm
        As for `calibrate`.
    board : path, optional
        As for `calibrate`.
    pictures : bool
        Draw figures.
    overwrite : bool
        Overwrite files in the given folder that were made from other input.

    Returns
    -------
    JointFit
        Fits of the cameras and how far they agree.

    Raises
    ------
    RunUsageError
        Fewer than two cameras, or not one scene for each.
    ConfigError, SceneError, BoardError, FrameError, TargetNotFound, FitError
        As `calibrate`.
    """
    paths, scenes = paths_of(folders), paths_of(scene)
    if len(paths) < 2 or len(scenes) not in (0, len(paths)):
        raise RunUsageError(
            f"give two cameras or more, and no scene or one for each, not {len(paths)} and {len(scenes)}"
        )
    progress, screen, began = error_console(), console(), time.monotonic()

    def say(text: str) -> None:
        progress.print(f"{time.monotonic() - began:6.1f} s  {text}")

    names = (*FITTED, *(DRAWN if pictures else ()))
    made_from = {f"camera-{k}/{name}": path for k, path in enumerate(paths, start=1) for name in names}
    with results_in(out, "fit", overwrite=overwrite, made_from=made_from) as out:
        target, fits, given = board_of(paths, square_mm, disc_mm, path_of(board)), [], []
        for number, path in enumerate(paths):
            say(f"camera of {path}")
            nominal, priors = nominal_scene(path, scenes[number] if scenes else None)
            frames = target_frames(path, nominal.camera.shape)
            fits.append(fit_scene(nominal, frames, target, with_read_heights(priors, path), say))
            given.append((path, frames, priors))
        joint = join_fits(fits)
        seconds = time.monotonic() - began
        for number, (fit, (path, frames, priors)) in enumerate(zip(joint.fits, given, strict=True), start=1):
            folder = out / f"camera-{number}"
            folder.mkdir(exist_ok=True)
            write_fit(folder, fit, frames, priors, readable_name(path) if pictures else "", (say, seconds))
        for line in joint.sentences:
            screen.print(line)
        if joint.warning:
            screen.print(joint.warning, style="bold red")
        return joint
