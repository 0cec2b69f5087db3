"""Rays by roots of quadratics, normals and Snell's law at each surface: no formula shared with the kernels.

Plain Python; for very many rays `numba.njit` compiles it.
"""

import math

import numpy as np
from numba.extending import register_jitable

from tracer.scene.scene import Scene
from tracer.strategies.trace import TraceResult

BASE, PRIME = 1000003, 2**31 - 1


@register_jitable(error_model="numpy")
def surface(
    ball: np.ndarray, radius: float, eta: float, side: float, p: np.ndarray, d: np.ndarray
) -> tuple[float, float]:
    """Bend d (3,) at p (3,) by Snell's law, or mirror it; cosine of incidence, and the squared one behind."""
    normal = side * (p - ball[:3]) / radius
    cosine = -(normal * d).sum()
    rest = 1.0 - eta * eta * (1.0 - cosine * cosine)
    if rest < 0.0:
        d[:] = d + 2.0 * cosine * normal
    else:
        d[:] = eta * d + (eta * cosine - math.sqrt(rest)) * normal
    d /= math.sqrt((d * d).sum())
    return cosine, rest


@register_jitable(error_model="numpy")
def met(ball: np.ndarray, radius: float, p: np.ndarray, d: np.ndarray) -> tuple[float, float, float]:
    """-p.d about the centre, the discriminant, and the smaller root of a line and a sphere (NaN if none)."""
    w = p - ball[:3]
    half = (w * d).sum()
    square = half * half - ((w * w).sum() - radius * radius)
    return -half, square, -half - math.sqrt(square) if square >= 0.0 else math.nan


@register_jitable(error_model="numpy")
def inside(ball: np.ndarray, p: np.ndarray, d: np.ndarray) -> tuple[int, float, float]:
    """Take a ray (p, d) from where it meets a sphere to where it leaves.

    Returns the way (0 beside the cores, 2 k - 1 through core k, 2 k reflected at it; -1 reflected outside), the
    distance from another way, the steepest incidence.
    """
    way, level, at, side, near, steep = 0, 0, 0, 1.0, math.inf, 1.0
    while True:
        radius = ball[3] if at == 0 else ball[4 + 2 * at]
        outer = 1.0 if at == 0 else (ball[4] if at == 1 else ball[3 + 2 * at])
        inner = ball[4] if at == 0 else ball[5 + 2 * at]
        cosine, rest = surface(ball, radius, outer / inner if side > 0.0 else inner / outer, side, p, d)
        steep = min(steep, cosine)
        if side > 0.0:
            near = min(near, abs(rest))
            if at > 0:
                steep = min(steep, math.sqrt(abs(rest)))
        if rest < 0.0:
            if at == 0:
                return -1, near, steep
            way = 2 * at
        else:
            level = at + 1 if side > 0.0 else at
            if side > 0.0 and at > 0:
                way = 2 * at - 1
        if level == 0:
            return way, near, steep
        deeper = 4 + 2 * level
        if deeper < ball.shape[0] and ball[deeper] > 0.0:
            towards, square, root = met(ball, ball[deeper], p, d)
            if towards > 0.0:
                near = min(near, abs(square) / ball[deeper] ** 2)
                if square > 0.0:
                    p += root * d
                    at, side = level, 1.0
                    continue
        radius = ball[3] if level == 1 else ball[2 + 2 * level]
        towards, square, _ = met(ball, radius, p, d)
        p += (towards + math.sqrt(max(0.0, square))) * d
        at, side = level - 1, -1.0


@register_jitable(error_model="numpy")
def second(eye: np.ndarray, ways: np.ndarray, spheres: np.ndarray, out: np.ndarray) -> None:
    """Per ray (N, 6): plane point x, y, number of all events, room to others, steepest, z.

    Events are -1 for what is turned back, -2 for what comes to the plane in a sphere that reaches through it.
    """
    for ray in range(ways.shape[0]):
        p, d = eye.copy(), ways[ray].copy()
        last, events, near, steep = -1, 0, math.inf, 1.0
        while True:
            best, first = -1, math.inf
            for k in range(spheres.shape[0]):
                if k != last:
                    towards, square, root = met(spheres[k], spheres[k, 3], p, d)
                    if towards > 0.0:
                        near = min(near, abs(square) / spheres[k, 3] ** 2)
                        if square > 0.0 and root < first:
                            best, first = k, root
            if best < 0:
                break
            low = spheres[best, 2] - spheres[best, 3] < -1e-6
            entry = p[2] + first * d[2]
            near = min(near, abs(entry) / spheres[best, 3]) if low else near
            if low and d[2] < 0.0 and entry < 0.0:
                break
            p += first * d
            way, edge, least = inside(spheres[best], p, d)
            near, steep = min(near, edge), min(steep, least)
            near = min(near, abs(p[2]) / spheres[best, 3]) if low else near
            if way >= 0 and low and p[2] < 0.0:
                events = -2
                break
            if way < 0:
                events = -1
                break
            events = (events * BASE + best + way * spheres.shape[0] + 1) % PRIME
            last = best
        t = -p[2] / d[2]
        out[ray, 0], out[ray, 1], out[ray, 2] = p[0] + t * d[0], p[1] + t * d[1], events
        out[ray, 3], out[ray, 4], out[ray, 5] = near, steep, d[2]


def numbered(where: Scene, result: TraceResult) -> np.ndarray:
    """Events of each ray, numbered as `second` does (N,)."""
    place = {name: number for number, name in enumerate(where.event_names())}
    numbers = {}
    for key, names in result.branches.items():
        events = 0
        for name in names:
            events = (events * BASE + place[name] + 1) % PRIME
        numbers[key] = events
    keys, which = np.unique(result.rays["key"], return_inverse=True)
    return np.array([numbers[int(key)] for key in keys])[which]
