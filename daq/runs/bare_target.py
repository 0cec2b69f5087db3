"""The dewarp of a camera from a frame of the bare target."""

from pathlib import Path

from correction.errors import CorrectionError
from correction.maps.dewarp import Dewarp, fit_dewarp
from correction.target import Chessboard
from daq.runs.acquired import read_acquired
from piv.errors import PivError
from tracer.camera import Camera


def dewarp_of(target_clear: Path | None, camera: Camera, board: Chessboard, order: int) -> Dewarp | None:
    """Fit the dewarp to a frame of the bare target; None without a frame.

    Parameters
    ----------
    target_clear : Path, optional
        Bare target at z = 0, as acquired.
    camera : Camera
        The nominal camera.
    board : Chessboard
        The target.
    order : int
        Order of the polynomial, 2 to 5.

    Raises
    ------
    FrameError, FrameDamaged, RunDamaged
        The file is no frame of this camera, or not what was written.
    TargetNotFound, DewarpError
        The frame does not show the target, or too little of it; the message names the file.
    """
    if target_clear is None:
        return None
    frame = read_acquired(target_clear, camera.shape)
    try:
        return fit_dewarp(frame, camera, board, order)
    except (CorrectionError, PivError) as error:
        raise type(error)(f"{target_clear}: {error}") from None
