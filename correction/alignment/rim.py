"""The rim of a sphere in a frame: a curve of pixels, and how it moves with the sphere.

From a pinhole at distance D a sphere of radius R fills the cone of half angle a = asin(R / D) about the
direction d of its centre. Each line of sight on the cone touches the sphere in one point,

    T(p) = P + sqrt(D^2 - R^2) (cos a d + sin a (cos p e1 + sin p e2)),        0 <= p < 2 pi,

so the rim is the picture of these points, lens terms and all. Only its moves across itself can be seen: the
rates are those along the outward normal, taken before lens terms, which change them by less than a part in a
hundred. A point is hidden where its line of sight meets a nearer sphere, and not used beyond the frame.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.camera import Camera

STEP_MM = 1e-3
BESIDE = 1.05  # of the radius of a body behind a rim, from which on the view beside the rim is undisturbed
EDGE_PX = 3.0  # of the frame, where nothing is measured


@dataclass(frozen=True)
class Rim:
    """Points of a rim, N of them.

    Parameters
    ----------
    pixel : (N, 2) float64
        u, v.
    outward : (N, 2) float64
        Unit normal in the frame, away from the sphere.
    rate : (N, 4) float64
        How far the rim moves along it [px] per mm of the centre's x, y, z and of the radius.
    seen : (N,) bool
        Within the frame and not behind another body.
    before_glass : (N,) bool
        Another body is seen right beside the rim.
    """

    pixel: NDArray[np.float64]
    outward: NDArray[np.float64]
    rate: NDArray[np.float64]
    seen: NDArray[np.bool_]
    before_glass: NDArray[np.bool_]

    @property
    def share_seen(self) -> float:
        """Share of the rim that the frame can show."""
        return float(self.seen.mean())


def rim_of(camera: Camera, spheres: NDArray[np.float64], number: int, points: int) -> Rim:
    """Return the rim of one of some spheres.

    Parameters
    ----------
    camera : Camera
        Who looks.
    spheres : (B, 4) float64
        Centre and radius of every body that can hide a rim [mm].
    number : int
        Which of them.
    points : int
        Places around it.
    """
    centre, radius = spheres[number, :3], float(spheres[number, 3])
    angle = 2.0 * np.pi * np.arange(points) / points
    touch = touched(camera, centre, radius, angle)
    ideal = camera.project_ideal(touch)
    pixel = camera.acquired(ideal)
    across = camera.project_ideal(touched(camera, centre, radius + STEP_MM, angle)) - ideal
    outward = across / np.linalg.norm(across, axis=1)[:, None]
    rate = np.empty((points, 4))
    for axis in range(3):
        step = STEP_MM * np.eye(3)[axis]
        ahead, behind = (
            camera.project_ideal(touched(camera, centre + s * step, radius, angle)) for s in (1.0, -1.0)
        )
        rate[:, axis] = ((ahead - behind) * outward).sum(axis=1) / (2.0 * STEP_MM)
    rate[:, 3] = (across * outward).sum(axis=1) / STEP_MM
    width, height = camera.sensor_px
    inside = (pixel >= EDGE_PX).all(axis=1) & (pixel <= np.array((width, height)) - 1.0 - EDGE_PX).all(axis=1)
    hidden, before = _others(camera, spheres, number, touch)
    return Rim(pixel, outward, rate, inside & ~hidden, before)


def touched(
    camera: Camera, centre: NDArray[np.float64], radius: float, angle: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Points (N, 3) in which lines of sight touch a sphere, at angles (N,) around it; NaN from inside it."""
    eye = np.array(camera.position_mm)
    away = centre - eye
    distance = float(np.linalg.norm(away))
    towards = away / distance
    aside = camera.rotation_matrix[0] - (camera.rotation_matrix[0] @ towards) * towards
    aside /= np.linalg.norm(aside)
    upright = np.cross(towards, aside)
    sine = radius / distance
    cosine = float(np.sqrt(1.0 - sine**2)) if sine < 1.0 else float("nan")
    around = np.cos(angle)[:, None] * aside + np.sin(angle)[:, None] * upright
    return np.asarray(eye + distance * cosine * (cosine * towards + sine * around))


def _others(
    camera: Camera, spheres: NDArray[np.float64], number: int, touch: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Points (N,) before which another sphere stands, and those behind which one does."""
    eye = np.array(camera.position_mm)
    way = touch - eye
    length = np.linalg.norm(way, axis=1)
    ray = way / length[:, None]
    hidden, before = np.zeros((2, len(touch)), dtype=np.bool_)
    for other, (x, y, z, radius) in enumerate(spheres[:, :4].tolist()):
        if other == number:
            continue
        away = np.array((x, y, z)) - eye
        along = ray @ away
        beside = np.sqrt(np.maximum(away @ away - along**2, 0.0))
        hidden |= (beside < radius) & (along < length)
        before |= (beside < BESIDE * radius) & (along >= length)
    return hidden, before
