"""How wide the images of particles are, in each part of a view.

The autocorrelation of many small spots is that of one spot, however they overlap: for Gaussians of standard
deviation s it falls with the lag l like  exp(-l^2 / (4 s^2)),  so

    s^2 = -l^2 / (4 ln rho(l)),     diameter = 4 s   (e^-2)

from the ratio rho of the covariance at lag l to that at no lag.  Covariances are taken between two frames of one
place, whose noise differs: only what both show counts.  Shapes that are not Gaussian change the scale of s and not
where it is smallest.

Parts are told apart by what the line of sight meets: beside all glass, and rings behind each stack of balls.  A
pixel belongs behind those balls that its straight line of sight crosses; its radius is that of the ball nearest
the camera, r = distance of the line from the centre / R.  Parts that are cut by a silhouette are left out, and a
band around every ball as well: a wide pupil sees both sides of an edge.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from tracer.scene.scene import Scene

Float64 = NDArray[np.float64]

LAG_PX = 2
LEVEL_PX = 65  # light that varies slower than this is not detail
FEWEST_PX = 400  # below, a part says nothing


class Spots(NamedTuple):
    """Spots of a part: mean of s^2 over rows and columns, and their contrast, the variance of the light."""

    variance_px2: float
    contrast: float


NO_SPOTS = Spots(float("nan"), 0.0)


def spots_in(first: NDArray[np.generic], second: NDArray[np.generic], part: NDArray[np.bool_]) -> Spots:
    """Spots in a part (H, W) of two frames of one place; NaN and 0 if it shows none."""
    a, b = (_detail(frame, part) for frame in (first, second))
    whole = _covariance(a, b, part, 0, 0)
    if not whole > 0.0:
        return NO_SPOTS
    ratios = [
        0.5 * (_covariance(a, b, part, rows, columns) + _covariance(b, a, part, rows, columns)) / whole
        for rows, columns in ((LAG_PX, 0), (0, LAG_PX))
    ]
    if not all(0.0 < ratio < 1.0 for ratio in ratios):
        return NO_SPOTS
    return Spots(float(np.mean([-(LAG_PX**2) / (4.0 * np.log(ratio)) for ratio in ratios])), whole)


def _detail(frame: NDArray[np.generic], part: NDArray[np.bool_]) -> Float64:
    """What differs from the mean light around, which is taken within the part alone."""
    inside = part.astype(np.float64)
    values = np.where(part, frame.astype(np.float64), 0.0)
    share = scipy.ndimage.uniform_filter(inside, LEVEL_PX, mode="constant")
    level = scipy.ndimage.uniform_filter(values, LEVEL_PX, mode="constant") / np.maximum(share, 1e-9)
    return np.asarray(np.where(part, values - level, 0.0))


def _covariance(a: Float64, b: Float64, part: NDArray[np.bool_], rows: int, columns: int) -> float:
    """Mean product of a and b shifted by a lag, where both lie in the part."""
    height, width = part.shape
    here, there = np.s_[: height - rows, : width - columns], np.s_[rows:, columns:]
    both = part[here] & part[there]
    count = int(np.count_nonzero(both))
    if count < FEWEST_PX:
        return float("nan")
    return float(np.sum(a[here] * b[there] * both) / count)


RINGS = {"centre": (0.0, 0.2), "halfway": (0.35, 0.55), "rim": (0.6, 0.75)}
BESIDE_FROM = 1.45  # radii


def parts_of(scene: Scene) -> dict[str, NDArray[np.bool_]]:
    """Masks (H, W) by name: ``beside``, and ``BALLS: centre``, ``halfway`` and ``rim`` for each stack of balls."""
    camera = scene.camera
    rows, columns = np.indices(camera.shape)
    rays = camera.directions(np.stack((columns, rows), axis=-1))
    balls = sorted(scene.spheres, key=lambda s: -s.centre_mm[2])
    beside = np.ones(camera.shape, np.bool_)
    radii = []
    for ball in balls:
        to = np.subtract(ball.centre_mm, camera.position_mm)
        off = np.linalg.norm(np.cross(rays, to), axis=-1) / ball.radius_mm
        radii.append(off)
        beside &= off > BESIDE_FROM
    parts = {"beside": beside}
    crossed = np.zeros(camera.shape, np.int64)
    for bit, off in enumerate(radii):
        crossed |= (off < 1.0).astype(np.int64) << bit
    for stack in np.unique(crossed):
        members = [k for k in range(len(balls)) if stack >> k & 1]
        if not members:
            continue
        name = "+".join(balls[k].name for k in members)
        for ring, (low, high) in RINGS.items():
            off = radii[members[0]]
            parts[f"{name}: {ring}"] = (crossed == stack) & (off >= low) & (off < high)
    return {name: part for name, part in parts.items() if np.count_nonzero(part) >= FEWEST_PX}
