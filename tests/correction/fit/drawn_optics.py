"""Where a lab that is not quite the scene of its file shows its corners: optics for tests, written on its own.

Nothing here knows the tracer. A ball is the surface |d| = R + e.S e, with d from its centre, e = d/|d| and S a
symmetric matrix [mm]: S = 0 is a sphere, a traceless S an ellipsoid to first order (radii R + eigenvalues of S). A
ray meets it where Newton's method along the ray ends; the normal is the gradient of |d| - e.S e. A hollow ball has
a sphere of gas about its centre; what is totally reflected there is lost. A board may be bent:
z = h + (a x^2 + 2 b x y + c y^2)/2. Corners are sought by Newton's method with differences from a start.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tracer.camera import Camera

Points = NDArray[np.float64]
STEP_PX = 1e-3
ROUNDS = 6


@dataclass(frozen=True)
class Ball:
    """A ball of the lab, with what its file does not say."""

    centre_mm: tuple[float, float, float]
    radius_mm: float
    n: float  # against the room
    shape_mm: Points = field(default_factory=lambda: np.zeros((3, 3)))
    core: tuple[float, float] | None = None  # radius [mm] of what it is filled with, and its n


@dataclass(frozen=True)
class Lab:
    """Camera, balls and board as they truly are."""

    camera: Camera
    balls: tuple[Ball, ...]
    bend_per_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    height_mm: float = 0.0


def camera_rays(camera: Camera, pixels: Points) -> tuple[Points, Points]:
    """Origins and unit directions (N, 3) of the rays through pixels (N, 2)."""
    x, y = ((pixels - np.array(camera.principal_px)) / camera.focal_px).T
    lens, r2 = camera.lens, x**2 + y**2
    gain = 1.0 + lens.k1 * r2 + lens.k2 * r2**2 + lens.k3 * r2**3
    right = gain * x + 2.0 * lens.p1 * x * y + lens.p2 * (r2 + 2.0 * x**2)
    down = gain * y + lens.p1 * (r2 + 2.0 * y**2) + 2.0 * lens.p2 * x * y
    way = np.stack((right, down, np.ones_like(x)), axis=1) @ np.array(camera.rotation)
    return np.tile(np.array(camera.position_mm), (len(pixels), 1)), way / np.linalg.norm(way, axis=1)[:, None]


def shown_mm(lab: Lab, pixels: Points) -> tuple[Points, NDArray[np.int64]]:
    """Board points (N, 2) that pixels (N, 2) show, NaN where light is lost, and through which balls (N,).

    Through ball k of B: digit 2 k + 1 to the base 2 B + 1, one more through its core, the first ball foremost.
    """
    at, way = camera_rays(lab.camera, pixels)
    through, last = np.zeros(len(at), np.int64), np.full(len(at), -1)
    for _ in range(len(lab.balls)):
        reach = np.full((len(lab.balls), len(at)), np.inf)
        for number, ball in enumerate(lab.balls):
            reach[number] = np.where(last == number, np.inf, _entry(ball, at, way))
        first = np.argmin(reach, axis=0) if lab.balls else last
        for number, ball in enumerate(lab.balls):
            here = (first == number) & np.isfinite(reach[number])
            if here.any():
                entry = at[here] + reach[number, here, None] * way[here]
                at[here], way[here], filled = _crossed(ball, entry, way[here])
                through[here] = through[here] * (2 * len(lab.balls) + 1) + 2 * number + 1 + filled
                last[here] = number
    a, b, c = lab.bend_per_mm
    point = at
    for _ in range(5):
        x, y = point[:, 0], point[:, 1]
        height = lab.height_mm + 0.5 * (a * x**2 + 2.0 * b * x * y + c * y**2)
        point = at + ((height - at[:, 2]) / way[:, 2])[:, None] * way
    return point[:, :2], through


def corners_px(lab: Lab, start_px: Points, node_mm: Points) -> Points:
    """Pixels (N, 2) that show board points (N, 2), sought from starts (N, 2); NaN where none is found."""
    pixel = np.array(start_px)
    with np.errstate(all="ignore"):
        for _ in range(ROUNDS):
            here, through = shown_mm(lab, pixel)
            rate = np.stack(
                [(shown_mm(lab, pixel + step)[0] - shown_mm(lab, pixel - step)[0]) / (2.0 * STEP_PX)
                 for step in STEP_PX * np.eye(2)], axis=2,
            )  # fmt: skip
            det = rate[:, 0, 0] * rate[:, 1, 1] - rate[:, 0, 1] * rate[:, 1, 0]
            inverse = np.stack((rate[:, 1, 1], -rate[:, 0, 1], -rate[:, 1, 0], rate[:, 0, 0]), axis=1)
            step = (inverse.reshape(-1, 2, 2) / det[:, None, None] @ (node_mm - here)[:, :, None])[:, :, 0]
            pixel = pixel + step
        begun = shown_mm(lab, start_px)[1]
        lost = ~(np.linalg.norm(step, axis=1) < 1e-6) | (through != begun)
    pixel[lost | (np.linalg.norm(pixel - start_px, axis=1) > 6.0)] = np.nan
    return pixel


def _excess(ball: Ball, point: Points) -> tuple[Points, Points]:
    """How far points (N, 3) are outside a ball [mm] (N,), and the gradient (N, 3)."""
    away = point - np.array(ball.centre_mm)
    distance = np.linalg.norm(away, axis=1)
    e = away / distance[:, None]
    turned = e @ ball.shape_mm
    height = np.sum(e * turned, axis=1)
    return distance - ball.radius_mm - height, e - 2.0 * (turned - height[:, None] * e) / distance[:, None]


def _root(ball: Ball, at: Points, way: Points, reach: Points) -> Points:
    for _ in range(5):
        excess, slope = _excess(ball, at + reach[:, None] * way)
        reach = reach - excess / np.sum(slope * way, axis=1)
    return reach


def _entry(ball: Ball, at: Points, way: Points) -> Points:
    """Path length to the entry (N,), infinite where the ball is missed or behind."""
    along = np.sum((np.array(ball.centre_mm) - at) * way, axis=1)
    nearest = np.linalg.norm(np.array(ball.centre_mm) - at - along[:, None] * way, axis=1)
    with np.errstate(all="ignore"):
        reach = _root(ball, at, way, along - np.sqrt(ball.radius_mm**2 - nearest**2))
    return np.where(np.isfinite(reach) & (along > 0.0), reach, np.inf)


def _crossed(ball: Ball, entry: Points, way: Points) -> tuple[Points, Points, NDArray[np.bool_]]:
    """Where rays that enter a ball leave it, and whereto, NaN where they do not; which (N,) cross its core."""
    at, inside = entry, _refracted(way, _excess(ball, entry)[1], 1.0 / ball.n)
    filled = np.zeros(len(at), np.bool_)
    if ball.core is not None:
        radius, n = ball.core
        core = Ball(ball.centre_mm, radius, n / ball.n)
        reach = _entry(core, at, inside)
        filled = np.isfinite(reach)
        through = at[filled] + reach[filled, None] * inside[filled]
        at, inside = at.copy(), inside.copy()
        at[filled], inside[filled], _ = _crossed(core, through, inside[filled])
    chord = 2.0 * np.sum((np.array(ball.centre_mm) - at) * inside, axis=1)
    if ball.core is not None:  # from within: the far root of the sphere
        away = at - np.array(ball.centre_mm)
        chord = 0.5 * chord + np.sqrt(0.25 * chord**2 - np.sum(away**2, axis=1) + ball.radius_mm**2)
    leave = at + _root(ball, at, inside, chord)[:, None] * inside
    return leave, _refracted(inside, -_excess(ball, leave)[1], ball.n), filled


def _refracted(way: Points, normal: Points, ratio: float) -> Points:
    """Snell's law for unit ways and normals against them (N, 3), ratio of indices before and after."""
    normal = normal / np.linalg.norm(normal, axis=1)[:, None]
    cosine = -np.sum(normal * way, axis=1)
    with np.errstate(invalid="ignore"):
        after = np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))
    return ratio * way + (ratio * cosine - after)[:, None] * normal
