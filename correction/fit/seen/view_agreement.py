"""Pixel-wise agreement of a frame of the target with the squares of a fitted scene.

A traced pixel shows a bright square or a dark one.  With I the frame divided by the transmittance of the pixel's
ray, W and B its means nearby, over pixels of the same branch that should show bright and dark squares, and
G = (W + B) / 2, the frame agrees by

    a = +-(I - G) / mean |I - G|,     + where a bright square should be shown:  1 as it should, -1 as the other.

The contrast is what the view has and not what it should have, (W - B) / 2, which vanishes where a view shows other
squares throughout.  Undivided, the dim rim of a ball that is seen through another one would be a dark square.

Asked are pixels off every edge, disc and border of a branch, where squares are wide enough to be seen and their
contrast is LOUD times the noise of the view beside the glass.  Blur changes no sign there, nor does slow shading.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.fit.seen.prediction import in_target_frame
from correction.grid import grid_of
from correction.target import Chessboard
from ground.rows import run_rows
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import RayMap, build_ray_map
from tracer.strategies.sensitivity import TargetPose
from tracer.strategies.trace import RayStatus, trace

UNIFORM_SIDE_PX = 5  # side of what must show one square: blur and the fit's own errors reach less far
MIN_SQUARE_PX = 8.0  # views of a square that show bright and dark apart
NEARBY = 4.0  # squares: side of what W and B are taken from
# Standard deviations of the noise that bright and dark must differ from grey by, or nothing is asked
LOUD = 5.0
BLACKEST = 0.001  # share of the pixels below what a camera shows of no light
DIMMEST = 0.05  # transmittance from which light is compared
ROWS_AT_ONCE = 16  # of a frame: what is computed of them stays in a core's cache
DIRECT_VIEW = 0  # number of the view beside the glass
Bounds = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class Shown:
    """Predicted view of a board at each pixel.

    Parameters
    ----------
    rays : RayMap
        To the board.
    passed : (H, W) float32
        Transmittance of the rays.
    bright : (H, W) bool
        Whether a bright square is shown.
    clear : (H, W) bool
        Where that is sure: off edges, discs and borders, on the board, squares wide enough.
    width_px : (H, W) float64
        Narrow side of a square as seen there; 0 where it is not known.
    nearby_px : int
        Side of the square of pixels that W and B are taken from.
    """

    rays: RayMap
    passed: NDArray[np.float32]
    bright: NDArray[np.bool_]
    clear: NDArray[np.bool_]
    width_px: NDArray[np.float64]
    nearby_px: int

    @classmethod
    def of(cls, scene: Scene, pose: TargetPose, board: Chessboard, bounds_mm: Bounds) -> "Shown":
        """Trace a scene to a board at a pose, whose corners reach from least to largest x, y."""
        seen = in_target_frame(scene, pose)
        rays = first = build_ray_map(seen)
        for depth_mm in board.depths_mm[1:]:
            rays = _on_plate(rays, build_ray_map(in_target_frame(scene, pose.behind(depth_mm))), board)
        passed = np.ones(rays.branch.shape, np.float32)
        rows, columns = np.nonzero(rays.recovered & (rays.branch != DIRECT_VIEW))
        behind = np.stack((columns, rows), axis=1).astype(np.float64)
        passed[rows, columns] = trace(seen, behind).rays["transmittance"]
        width = np.empty(rays.branch.shape)
        there, bright = (np.empty(width.shape, np.bool_) for _ in range(2))

        def fill(low: int, high: int) -> None:
            rows = slice(low, high)
            width[rows] = _square_px(first.plane_mm, board, low, high)
            point = np.nan_to_num(rays.plane_mm[rows])
            on_board = (point >= bounds_mm[0]) & (point <= bounds_mm[1])
            there[rows] = on_board[..., 0] & on_board[..., 1] & (width[rows] >= MIN_SQUARE_PX)
            bright[rows] = board.shade(point) > 0.5

        run_rows(fill, len(width), ROWS_AT_ONCE)
        there &= rays.recovered & (passed > DIMMEST)
        pitch_mm = grid_of(seen.camera).pitch_mm
        side = 2 * int(NEARBY * board.square_mm / pitch_mm / 2) + 1
        return cls(rays, passed, bright, _clear(rays, there, bright), width, side)

    def agreement(self, image: NDArray[Any]) -> NDArray[np.float32]:
        """Agreement of each pixel (H, W) of a frame with the square predicted there; NaN where none is."""
        import cv2

        light = cv2.blur(image.astype(np.float32), (3, 3))
        light = (light - np.quantile(light, BLACKEST)) / np.maximum(self.passed, DIMMEST)
        out, swing = np.full(light.shape, np.nan, np.float32), np.zeros(light.shape, np.float32)
        number = np.where(self.clear, self.rays.branch.astype(np.int64) + 1, 0)
        for at, box in enumerate(scipy.ndimage.find_objects(number), start=1):
            if box is None:
                continue
            here = number[box] == at
            off = light[box] - _grey(light[box], here, self.bright[box], self.nearby_px)
            here &= np.isfinite(off)
            own = mean_nearby(np.abs(off), here, self.nearby_px)
            with np.errstate(invalid="ignore", divide="ignore"):
                out[box][here] = (np.where(self.bright[box], off, -off) / own)[here]
            swing[box][here] = own[here]
        asked = np.isfinite(out)
        beside = asked & (self.rays.branch == DIRECT_VIEW)
        if not beside.any():
            return out
        noise = 1.48 * float(np.median(np.abs(out[beside] - np.median(out[beside])) * swing[beside]))
        with np.errstate(invalid="ignore"):
            out[~(swing * self.passed > LOUD * noise)] = np.nan
        return out

    def grey(self, light: NDArray[np.float32], here: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Half way (H, W) between bright and dark squares nearby, of pixels that are `here`; NaN without both."""
        return _grey(light, here, self.bright, self.nearby_px)


def _grey(
    light: NDArray[np.float32], here: NDArray[np.bool_], bright: NDArray[np.bool_], side: int
) -> NDArray[np.float32]:
    high, low = (mean_nearby(light, here & shade, side) for shade in (bright, ~bright))
    return np.asarray(0.5 * (high + low))


def mean_nearby(light: NDArray[Any], where: NDArray[np.bool_], side: int) -> NDArray[np.float32]:
    """Mean (H, W) of the light over a square of pixels, of those `where`; NaN where there are too few."""
    import cv2

    share, window = where.astype(np.float32), (side, side)
    light = np.where(where, light, 0.0).astype(np.float32)
    total = cv2.blur(light, window, borderType=cv2.BORDER_CONSTANT)
    count = cv2.blur(share, window, borderType=cv2.BORDER_CONSTANT)
    enough = count * side**2 > UNIFORM_SIDE_PX**2
    return np.asarray(np.where(enough, total / np.maximum(count, 1e-9), np.nan), dtype=np.float32)


def _clear(rays: RayMap, there: NDArray[np.bool_], bright: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels around which one square is shown on one branch, as a mask."""
    import cv2

    kind = np.where(there, 2.0 * rays.branch + bright + 1.0, 0.0).astype(np.float32)
    around = np.ones((UNIFORM_SIDE_PX, UNIFORM_SIDE_PX), np.uint8)
    return np.asarray(there & (cv2.erode(kind, around) == cv2.dilate(kind, around)))


def _on_plate(rays: RayMap, other: RayMap, board: Chessboard) -> RayMap:
    """Ray map to a plate, from those to the planes of its two levels: pixels land where its level is met first.

    Around each mark its level is taken to reach half way to the next; what meets neither level meets the wall
    between, and shows nothing.
    """
    before = board.depths_mm[1] < 0.0  # the second is then before the first
    near, far = (other, rays) if before else (rays, other)
    on_near, on_far = (
        one.recovered & ((board.depth_mm(board.nearest_index(np.nan_to_num(one.plane_mm))) != 0.0) == odd)
        for one, odd in ((near, before), (far, not before))
    )
    plane = np.where(on_near[..., None], near.plane_mm, far.plane_mm)
    shown = (on_near | on_far) & rays.recovered & other.recovered
    status = np.where(shown, rays.status, np.uint8(RayStatus.MISSED_PLANE))
    return replace(rays, plane_mm=plane, status=status)


def _square_px(plane_mm: NDArray[np.floating[Any]], board: Chessboard, low: int, high: int) -> NDArray[np.float64]:
    """Narrow side (N, W) of a square as seen at each pixel of some rows of a map; 0 where it is not known."""
    above = max(low - 1, 0)  # derivatives along v need a row more on either side
    own = slice(low - above, high - above)
    (x_v, y_v), (x_u, y_u) = (
        np.moveaxis(np.asarray(np.gradient(plane_mm[above : high + 1], axis=axis), np.float64)[own], -1, 0)
        for axis in (0, 1)
    )
    square = (x_u**2 + x_v**2) + (y_u**2 + y_v**2)
    turned = x_u * y_v - y_u * x_v
    with np.errstate(invalid="ignore", divide="ignore"):
        widest = np.sqrt(0.5 * (square + np.sqrt(np.maximum(square**2 - 4.0 * turned**2, 0.0))))
        return np.asarray(np.nan_to_num(board.square_mm / widest, nan=0.0, posinf=0.0))
