"""Vectors while the flow runs: enough to see whether dt, seeding and focus are right, in a quarter of the pixels.

Frames are joined 2 x 2, which keeps all their light, and evaluated with two passes of windows that are 64 px in
the frame as it came. Displacements are good to a few hundredths of a pixel.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorField
from piv.errors import PairError

LIVE = PivSettings(windows_px=(32, 32), extra_passes=0)


def live_vectors(
    frame_a: NDArray[Any],
    frame_b: NDArray[Any],
    valid: NDArray[np.bool_] | None = None,
    threads: int | None = None,
) -> VectorField:
    """Measure the displacement from frame A to frame B, roughly and fast.

    Parameters
    ----------
    frame_a, frame_b : ndarray, shape (H, W)
        uint8, uint16 or float32 intensities.
    valid : ndarray of bool, shape (H, W), optional
        True where the frames show the flow.
    threads : int, optional
        Threads to use.

    Returns
    -------
    VectorField
        On windows of 64 px, in pixels of the frames as they came.

    Raises
    ------
    PairError, FrameError
        As `evaluate_pair`.
    """
    if np.ndim(frame_a) != 2 or np.shape(frame_a) != np.shape(frame_b):
        raise PairError(f"two frames of one size are needed, not {np.shape(frame_a)} and {np.shape(frame_b)}")
    mask = None if valid is None else _join(valid.astype(np.float32)) > 0.9
    field = evaluate_pair(_join(frame_a), _join(frame_b), mask, LIVE, threads)
    doubled: dict[str, Any] = {name: 2.0 * part for name, part in field.lengths.items()}
    return replace(
        field,
        x_px=2.0 * field.x_px + 0.5,
        y_px=2.0 * field.y_px + 0.5,
        window_px=2 * field.window_px,
        step_px=2 * field.step_px,
        nan_pixels=4 * field.nan_pixels,
        side_px=None if field.side_px is None else 2 * field.side_px,
        **doubled,
    )


def _join(frame: NDArray[Any]) -> NDArray[np.float32]:
    """Means of 2 x 2 pixels."""
    import cv2

    height, width = frame.shape[0] // 2, frame.shape[1] // 2
    whole = np.asarray(frame[: 2 * height, : 2 * width], np.float32)
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.float32)
