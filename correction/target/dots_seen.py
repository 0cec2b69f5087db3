"""From a frame to the dots in it, each with the directions in which its neighbours lie.

A dot is what is darker than halfway between the darkest point near it and the paper around it (of a grid of bright
dots, all the other way round): the paper is the frame closed over everything narrower than a window, so light may
be as uneven as it likes.  A dot's own picture then says how it is seen.  With m and C the mean and covariance of
its pixels, points x of the frame lie at C^(-1/2) (x - m): there the dot is a circle again, and the grid around it
square, whatever a ball has stretched, squeezed or turned; only its turn is left open, and the nearest dot tells
it. What has not the area of an ellipse with its covariance is no dot.
"""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.target.lattice_growth import Saddles
from correction.target.two_levels import RIGHT_ANGLE, level_steps
from tracer.board import Dots

MAX_DOT_RATIO = 4.0  # dots of the board as seen without glass, that the widest in the frame is at most
NEARBY_PX = 9  # side of the window in which the darkest point counts
FAINTEST = 0.12  # of the paper: what is less dark is noise
SMALLEST_PX = 5  # pixels in a dot
# Of the usual area around: half of all area is in dots of at least that
SPECK, SPECK_NEIGHBOURS = 0.2, 24
ELLIPSE = 0.8, 1.2  # area of a dot over that of an ellipse with its covariance
NEAREST_DOTS = 9  # nearest dots that are asked for the grid's directions
AROUND, NEARER_THAN_DOTS = 4, 0.82  # dots around a mark, 0.71 pitches away; of what dots are from four others
ALIKE = 0.6  # shorter over longer step, there
USUAL_PX = 24.0  # a dot, if no width is known
WALL_PX, WALL_DIRECTIONS = 41, 24  # pixels, longer than a dot; lines 7.5 degrees apart stay within walls of 3 px


def find_dots(
    frame: NDArray[Any],
    dots: Dots,
    pitch_mm: float,
    dot_px: float | None = None,
    mask: NDArray[np.bool_] | None = None,
    beside_walls: bool = False,
) -> Saddles:
    """Find dots, the darkest first.

    Parameters
    ----------
    frame : (H, W) uint8, uint16 or float32
        The frame.
    dots : Dots
        Whether they are brighter than what is around them, and on which levels they are.
    pitch_mm : float
        From one to the next.
    dot_px : float, optional
        Diameter of the largest dots as seen without glass.
    mask : (H, W) bool, optional
        True where dots may lie.
    beside_walls : bool
        Take off what is as dark along a line longer than dots: walls and shadows of a plate, which join its dots.

    Returns
    -------
    Saddles
        All of one kind; the edges of each are the directions to its neighbours.
    """
    import cv2

    light = cv2.GaussianBlur(frame.astype(np.float32), (3, 3), 0.0, borderType=cv2.BORDER_REPLICATE)
    span = float(light.max()) + float(light.min())
    light = span - light if dots.bright else light
    side = 2 * int(0.5 * MAX_DOT_RATIO * (dot_px or USUAL_PX)) + 1
    paper = cv2.morphologyEx(light, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
    depth = 1.0 - light / np.maximum(paper, 1e-6)
    if beside_walls:
        depth = np.maximum(depth - _walls(depth), 0.0)
    deepest = cv2.dilate(depth, np.ones((NEARBY_PX, NEARBY_PX), np.uint8))
    dark = (depth > 0.5 * deepest) & (deepest > FAINTEST)
    count, label, boxes, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8), connectivity=4)
    area = boxes[:, cv2.CC_STAT_AREA].astype(np.float64)
    height, width = dark.shape
    left, top = boxes[:, cv2.CC_STAT_LEFT], boxes[:, cv2.CC_STAT_TOP]
    right, bottom = left + boxes[:, cv2.CC_STAT_WIDTH], top + boxes[:, cv2.CC_STAT_HEIGHT]
    whole = (left > 0) & (top > 0) & (right < width) & (bottom < height) & (np.arange(count) > 0)
    whole &= (area >= SMALLEST_PX) & (np.maximum(right - left, bottom - top) < side)
    mean, covariance, depths = _moments(label, count, depth)
    ratio = area / np.maximum(4.0 * np.pi * np.sqrt(np.maximum(np.linalg.det(covariance), 1e-12)), 1e-12)
    whole &= (ratio > ELLIPSE[0]) & (ratio < ELLIPSE[1])
    if mask is not None:
        at = np.clip(np.rint(np.nan_to_num(mean)).astype(np.int64), 0, (width - 1, height - 1))
        whole &= mask[at[:, 1], at[:, 0]]
    found = np.flatnonzero(whole)
    found = found[~_is_speck(mean[found], area[found])]
    found = found[np.argsort(-depths[found], kind="stable")]
    if dots.levels:
        steps = level_steps(mean[found], covariance[found], dots, pitch_mm)
        towards = steps / np.linalg.norm(steps, axis=2, keepdims=True)
    else:
        steps = None
        if dots.marks == "between":
            found = found[~_stand_between(mean[found], covariance[found])]
        towards = _directions(mean[found], covariance[found])
    return Saddles(mean[found], towards, depths[found], alike=True, levels=dots.levels, steps=steps)


def _walls(depth: NDArray[Any]) -> NDArray[Any]:
    """Depth (H, W) that goes on for WALL_PX in a line, in any direction."""
    import cv2

    out = np.zeros_like(depth)
    for angle in np.pi * np.arange(WALL_DIRECTIONS) / WALL_DIRECTIONS:
        line = np.zeros((WALL_PX, WALL_PX), np.uint8)
        way = np.rint(0.5 * (WALL_PX - 1) * np.array((np.cos(angle), np.sin(angle)))).astype(int)
        middle = WALL_PX // 2
        cv2.line(line, (middle - way[0], middle - way[1]), (middle + way[0], middle + way[1]), 1)
        out = np.maximum(out, cv2.morphologyEx(depth, cv2.MORPH_OPEN, line))
    return out


def _moments(
    label: NDArray[Any], count: int, depth: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Mean (count, 2) and covariance (count, 2, 2) [px] of the pixels with each label, and mean depth (count,)."""
    v, u = np.nonzero(label)
    of = label[v, u]
    number = np.maximum(np.bincount(of, minlength=count), 1)

    def mean_of(value: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray(np.bincount(of, value, count) / number, np.float64)

    mean = np.column_stack((mean_of(u), mean_of(v)))
    du, dv = u - mean[of, 0], v - mean[of, 1]
    across = mean_of(du * dv)
    pixel = 1.0 / 12.0  # a pixel is no point
    covariance = np.array([[mean_of(du * du) + pixel, across], [across, mean_of(dv * dv) + pixel]])
    return mean, covariance.transpose(2, 0, 1), mean_of(depth[v, u])


def _is_speck(mean: NDArray[np.float64], area: NDArray[np.float64]) -> NDArray[np.bool_]:
    """True (N,) for what is far smaller than most around it by area: noise on walls, glints, dust."""
    count = min(SPECK_NEIGHBOURS, len(mean))
    if count < 2:
        return np.zeros(len(mean), bool)
    near = scipy.spatial.cKDTree(mean).query(mean, k=count)[1]
    around = np.sort(area[near], axis=1)
    share = np.cumsum(around, axis=1) / around.sum(axis=1, keepdims=True)
    usual = around[np.arange(len(mean)), (share >= 0.5).argmax(axis=1)]
    return np.asarray(area < SPECK * usual)


def _stand_between(mean: NDArray[np.float64], covariance: NDArray[np.float64]) -> NDArray[np.bool_]:
    """True (N,) for what stands in the middle of four dots, of whatever size and shape.

    Distances are in the measure of the dots themselves, so that no bent view changes them.
    """
    if len(mean) <= AROUND:
        return np.zeros(len(mean), bool)
    near = scipy.spatial.cKDTree(mean).query(mean, k=AROUND + 1)[1][:, 1:]
    step = mean[near] - mean[:, None]
    far = np.sqrt(np.einsum("nmi,nij,nmj->nm", step, np.linalg.inv(covariance[near[:, -1]]), step)).mean(axis=1)
    return np.asarray(far < NEARER_THAN_DOTS * np.median(far))


def _directions(mean: NDArray[np.float64], covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors (N, 2, 2: rows) from dots to their neighbours along the grid; NaN where no grid is around."""
    out = np.full((len(mean), 2, 2), np.nan)
    if len(mean) <= NEAREST_DOTS:
        return out
    values, vectors = np.linalg.eigh(covariance)
    narrow = vectors / np.sqrt(values)[:, None, :] @ vectors.transpose(0, 2, 1)  # C^(-1/2)
    near = scipy.spatial.cKDTree(mean).query(mean, k=NEAREST_DOTS + 1)[1][:, 1:]
    step = mean[near] - mean[:, None]
    there = np.einsum("nij,nmj->nmi", narrow, step)
    far = np.linalg.norm(there, axis=2)
    rows = np.arange(len(mean))
    first = far.argmin(axis=1)
    unit = there / far[..., None]
    along = np.abs(np.einsum("nmi,ni->nm", unit, unit[rows, first]))
    second = np.where(along < RIGHT_ANGLE, far, np.inf).argmin(axis=1)
    good = (along[rows, second] < RIGHT_ANGLE) & (far[rows, first] > ALIKE * far[rows, second])
    for k, which in enumerate((first, second)):
        chosen = step[rows, which]
        out[good, k] = (chosen / np.linalg.norm(chosen, axis=1, keepdims=True))[good]
    return out
