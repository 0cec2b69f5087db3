"""Settings of the correction: dewarp of the lens, limit of the map's uncertainty, interpolation of pixels.

A camera's lens is taken from its scene, or from a dewarp that is fitted to one frame of the bare target.  What is
unsure of the scene lies in the fit beside its file; the map's sigma follows from that, and nodes of which it is
larger than a limit may be left out.  A fit knows the scene's lens terms and nothing of a dewarp in their place.

Frames that were taken without glass need no scene file where the scale of a pixel is given.  Their scene is a
camera alone, FAR_MM away and straight on: pixel (i, j) is node (i, j), s = mm_per_px apart, so the principal
distance is FAR_MM / s pixels.  How far away the true camera stands is not known, so nothing of its perspective is.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from correction.errors import MapUsageError
from correction.fitted.map_sigma import SigmaLimit
from correction.fitted.scene_sigma import SceneSigma
from correction.maps.dewarp import Dewarp
from correction.target import Chessboard
from daq.atomic_write import write_text
from daq.frames.numbered_files import WITH, NumberedFiles
from daq.runs.acquired import read_acquired
from daq.runs.names import is_run
from daq.runs.run_views import FAR_MM, UNSCALED_DISTANCE_PX, board_of, dewarp_of
from piv.resampling.sample import Method
from rtpiv.analysis.fit_beside import FIT_FILE, SCENE_FILE
from rtpiv.options.numbers import Count, DewarpOrder, Positive
from tracer.camera import Camera
from tracer.masked import left_out
from tracer.scene.scene import Scene

PLAIN_SCENE = """\
# Frames without glass, {mm_per_px} mm a pixel: a camera far away, straight before the plane.
wavelength_nm: 532.0
camera: {{focal_px: {focal_px!r}, position_mm: [0.0, 0.0, {far_mm}], sensor_px: [{width}, {height}]}}
sheet: {{z_mm: 0.0, sigma_mm: 0.01}}
bodies: []
"""


@dataclass(frozen=True)
class CorrectionRecipe:
    """Settings of the correction of frames.

    Parameters
    ----------
    target_clear : path, optional
        Frame of the bare target without glass, to fit the dewarp.  Default: the lens terms of the scene's camera.
    dewarp_order : {2, 3, 4, 5}
        Order of the dewarp polynomial: 2 as in the paper, 3 to 5 where the lens distorts radially.
    square_mm : float, optional
        Side of the squares of the board, for frames outside a run (default 2.5); a run stores its own.
    disc_mm : float, optional
        Diameter of the discs of the board, for frames outside a run (default 0.4 squares); a run stores its own.
    sigma_limit_px : float, optional
        Mask nodes where the map uncertainty is larger than this; needs ``fit.npz`` beside the scene file.
    mm_per_px : float, optional
        Scale of external frames taken without glass, instead of a scene: length in the plane per pixel.
    mask : path, optional
        Image of the size of a raw frame; regions that are white in it are excluded everywhere.
    second : path, optional
        Pattern of the second frames of pairs, in quotes, such as "A%03d_2.tif" if the first ones are
        "A%03d_1.tif": frames with the same text or number in place of ``*`` or ``%03d`` form a pair.
    both : {"top-bottom", "left-right", "interlaced"}, optional
        Arrangement of the two frames of a pair in one file, if every file holds both.
    """

    target_clear: Path | str | None = None
    dewarp_order: DewarpOrder = 2
    square_mm: Positive | None = None
    disc_mm: Positive | None = None
    sigma_limit_px: Positive | None = None
    mm_per_px: Positive | None = None
    mask: Path | str | None = None
    second: Path | str | None = None
    both: Literal["top-bottom", "left-right", "interlaced"] | None = None

    def frames_of(self, paths: Sequence[Path]) -> list[Path]:
        """Return names of frames (`daq.frames.source`) with what is given of their pairs; two patterns are one.

        Raises
        ------
        MapUsageError
            The frames are in pairs already: by a run, as two frames, or by the other option.
        """
        if self.second is None and self.both is None:
            two = len(paths) == 2 and all(map(NumberedFiles.takes, paths))
            return [Path(WITH.join(map(str, paths)))] if two else list(paths)
        if len(paths) != 1 or is_run(paths[0]) or (self.second is not None and self.both is not None):
            raise MapUsageError("--second and --both are for one folder or pattern of frames, and not together")
        return [Path(f"{paths[0]}{WITH}{self.second}" if self.second is not None else f"{paths[0]}@{self.both}")]

    def scene_of(self, scene: Path | None, frame: Path, out: Path) -> Path:
        """Return the scene file of external frames: the one given, or one of a camera alone, written into `out`.

        Without a scene and a scale, lengths are in pixels.

        Raises
        ------
        MapUsageError
            Both a scene and a scale are given.
        FrameError
            The frame, of which the size is taken, cannot be read.
        DiskError
            The folder cannot be written to.
        """
        if self.mm_per_px is None and scene is not None:
            return scene
        if scene is not None:
            raise MapUsageError("--mm-per-px is for frames without a scene; leave it or --scene out")
        height, width = read_acquired(frame).shape
        out.mkdir(parents=True, exist_ok=True)
        pitch, far = (1.0, UNSCALED_DISTANCE_PX) if self.mm_per_px is None else (self.mm_per_px, FAR_MM)
        numbers = {"mm_per_px": pitch, "focal_px": far / pitch, "far_mm": far}
        (out / FIT_FILE).unlink(missing_ok=True)  # of another scene
        write_text(out / SCENE_FILE, PLAIN_SCENE.format(**numbers, width=width, height=height))
        return out / SCENE_FILE

    def apply_mask(self, scene: Scene) -> Scene:
        """Return the scene without what the mask leaves out; SceneError if it is none of this camera's frame."""
        if self.mask is None:
            return scene
        return replace(scene, masked=scene.masked + left_out(Path(self.mask), scene.camera.sensor_px))

    def board(self, paths: Iterable[Path]) -> Chessboard:
        """Return the board of the bare target and of what is named, runs or frames.

        Raises
        ------
        BoardError
            A run's board is another one.
        RunUnsuitable, RunDamaged
            A run cannot be read.
        """
        target = [] if self.target_clear is None else [Path(self.target_clear)]
        return board_of([*paths, *target], self.square_mm, self.disc_mm)

    def dewarp(self, camera: Camera, board: Chessboard) -> Dewarp | None:
        """Fit the dewarp to the bare target; None without one.

        Raises
        ------
        FrameError, FrameDamaged, RunDamaged, TargetNotFound, DewarpError
            As `daq.runs.run_views.dewarp_of`.
        """
        target = None if self.target_clear is None else Path(self.target_clear)
        return dewarp_of(target, camera, board, self.dewarp_order)

    def limit(self, sigma: SceneSigma | str) -> SigmaLimit | None:
        """Return the limit of the map uncertainty with the uncertainty of its scene; None without a limit.

        Raises
        ------
        MapUsageError
            The uncertainty of the scene is not known, or the limit is not positive.
        """
        if self.sigma_limit_px is None:
            return None
        if isinstance(sigma, str):
            raise MapUsageError(f"--sigma-limit needs the uncertainty of the scene: {sigma}")
        return SigmaLimit(sigma, self.sigma_limit_px)


@dataclass(frozen=True)
class Resampling:
    """Resampling and storage of corrected frames.

    Parameters
    ----------
    method : {"quintic", "bilinear"}
        Interpolation.
    blend : int
        Number of views to average where several paths through the glass show a node; 1 uses the best view.
    as_float : bool
        Write float32 (NaN in masked regions) instead of uint16 with an offset (0 in masked regions).
    """

    method: Method = "quintic"
    blend: Count = 1
    as_float: bool = False
