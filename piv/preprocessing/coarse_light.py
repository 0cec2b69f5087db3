"""Light of coarse structure: particles out of focus, edges of bodies, a wavy surface, scratches before the flow.

It often outshines the particles of a window, moves otherwise than they do, and its vector then has a small
uncertainty. A median over `MEDIAN_PX` follows edges but not particle images, so a frame less its median shows
particles alone, with their places and the light of each, up to the very edge of a body. It is taken off only where
that matters: elsewhere large or overlapping images would lose some of their light.

Where it matters frames at half the resolution show, in which the same median costs a tenth. In areas of a window
with P_m, the variance of the median, and P_f, the mean square of the rest,

    Q = P_m/(P_f + `FLAT` P_0),      P_0 the usual P_f,

is about the same wherever nothing but particles is seen, whatever the light. Coarse light is what exceeds `LEAST`
and `EXCESS` times the lower quartile: of frames of particles of 1.5 to 8 px at most 2 % of the area, 6 % where
those of 7 px are sparse. Where the quartile is more than `LARGE`, particle images are as coarse as that median.

Hidden is what shows no particle then: the inside of a body, where next to nothing is left, and the brightest
light, such as writing, of which a median leaves the corners. No window sees it, and no vector stands there.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.rows import map_parts

MEDIAN_PX = 5  # of the frame, 3 at half the resolution
CELL = 4  # side of cells that are compared, at half the resolution
FLAT, LEAST, LARGE = 0.1, 0.7, 3.0
EXCESS = 3.0, 4.5  # over the lower quartile of Q: from where on some, and all is taken off
BESIDE = 5  # cells around: what moves there between both frames, and windows that reach into it
# No particle shows on the brightest light, such as writing or a saturated body
TOP, BRIGHT = 0.6, 5.0  # of the brightest median, and usual deviations of a frame
BARE, BARE_SIDE = 0.02, 0.3  # of the usual mean square; side of areas, in windows
Floats = NDArray[np.float32]


def coarse_light(a: Floats, b: Floats, window_px: int) -> Floats | None:
    """Find where coarse structure outshines the particles of a pair.

    Parameters
    ----------
    a, b : ndarray of float32, shape (H, W)
        Frames without the mean of their surroundings, of unit deviation, 0 where masked.
    window_px : int
        Side of the windows that will see them.

    Returns
    -------
    ndarray of float32, shape (H, W), or None
        Share of the coarse light that should go off, from 0 to 1; None if that is nowhere.
    """
    import cv2

    def means(values: Any, size: tuple[int, int]) -> Floats:  # noqa: ANN401 - cv2 has its own array type
        return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)

    height, width = a.shape
    cells = width // (2 * CELL), height // (2 * CELL)
    around = max(window_px // (2 * CELL), 1)
    if min(cells) < 2 * around:
        return None
    variance = fine = np.zeros(cells[::-1], np.float32)

    def variances(frame: Floats) -> tuple[Floats, Floats]:
        half = means(frame, (cells[0] * CELL, cells[1] * CELL))
        median = np.asarray(cv2.medianBlur(half, 3))
        coarse, square, rest = (
            cv2.blur(means(part, cells), (around, around)) for part in (median, median**2, (half - median) ** 2)
        )
        return np.maximum(square - coarse**2, np.float32(0.0)), np.asarray(rest, np.float32)

    for of_median, of_rest in map_parts(variances, (a, b)):
        variance, fine = variance + of_median, fine + of_rest
    seen = fine > 0.0
    if not seen.any():
        return None
    share = variance / (fine + np.float32(FLAT * float(np.median(fine[seen]))))
    usual = float(np.quantile(share[seen], 0.25))
    if usual > LARGE:
        return None
    over = np.clip((share / max(usual, 1e-6) - EXCESS[0]) / (EXCESS[1] - EXCESS[0]), 0.0, 1.0)
    over = np.where(share > LEAST, over, 0.0).astype(np.float32)
    if not over.any():
        return None
    weight = cv2.GaussianBlur(cv2.dilate(over, np.ones((BESIDE, BESIDE), np.uint8)), (0, 0), 1.0)
    return np.asarray(cv2.resize(weight, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


def without_coarse_light(frame: Floats, weight: Floats, window_px: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Frame (H, W) less its median where `weight` says so, and less the mean of what that leaves.

    Also the pixels (H, W) on which particles could be seen, as they are not at the frame's brightest.
    """
    import cv2

    median = np.asarray(cv2.medianBlur(frame, MEDIAN_PX))
    fine = frame - median
    fine -= cv2.blur(fine, (window_px | 1, window_px | 1), borderType=cv2.BORDER_REFLECT)
    return np.asarray(frame + weight * (fine - frame), np.float32), median < max(TOP * float(median.max()), BRIGHT)


def shows_particles(a: Floats, b: Floats, weight: Floats, window_px: int) -> NDArray[np.bool_]:
    """Pixels (H, W) but those inside a body: its light went off as coarse, and no particle is left there."""
    import cv2

    side = max(round(BARE_SIDE * window_px), 3)
    square = cv2.blur(cv2.max(a * a, b * b), (side, side))
    fluid = square[weight < 0.5]
    return np.asarray((weight < 0.5) | (square > BARE * float(np.median(fluid) if fluid.size else 0.0)))
