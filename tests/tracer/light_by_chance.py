"""Light of a sheet through balls, by chance: random rays, roots of quadratics, Snell for vectors, random places.

Nothing is shared with the tracer: rays go from surface to surface, and what a piece leaves is drawn at random
places along it and counted in boxes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ball = tuple[float, float, float, float, float]  # x, y, z, radius, index; 0: opaque
PLACES = 8  # drawn on each piece of a ray


@dataclass
class Counted:
    """Light in boxes, its first two moments by height, and where the power went."""

    sums: Array  # (3, rows, columns)
    passed: float = 0.0
    absorbed: float = 0.0
    emitted: float = 0.0


@dataclass(frozen=True)
class Boxes:
    """Square boxes of the plane: left, top, side, rows and columns; heights up to `reach` count."""

    left: float
    top: float
    side: float
    shape: tuple[int, int]
    reach: float


def next_surface(p: Array, d: Array, centres: Array, radii: Array) -> tuple[Array, Array]:
    """Distance (N,) to the nearest ball ahead, and which; inf and -1 for none."""
    best, which = np.full(len(p), np.inf), np.full(len(p), -1)
    for k, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
        w = p - centre
        half, rest = np.sum(w * d, axis=1), np.sum(w * w, axis=1) - radius**2
        with np.errstate(invalid="ignore"):
            t = -half - np.sqrt(half**2 - rest)
        nearer = (t > 1e-7) & (t < best)
        best[nearer], which[nearer] = t[nearer], k
    return best, which


def bend(d: Array, normal: Array, ratio: float) -> tuple[Array, Array]:
    """Direction behind a surface whose normal points against the light, and the share that goes on (Fresnel)."""
    cosine = -np.sum(d * normal, axis=1)
    sine2 = ratio**2 * (1.0 - cosine**2)
    with np.errstate(invalid="ignore"):
        behind = np.sqrt(1.0 - sine2)
        s = (ratio * cosine - behind) / (ratio * cosine + behind)
        p = (ratio * behind - cosine) / (ratio * behind + cosine)
    through = np.where(sine2 < 1.0, 1.0 - 0.5 * (s**2 + p**2), 0.0)
    return ratio * d + (ratio * cosine - np.nan_to_num(behind))[:, None] * normal, through


def count_light(balls: list[Ball], p: Array, d: Array, power: Array, boxes: Boxes, seed: int) -> Counted:
    """Count the light of rays from p (N, 3) along d (N, 3); balls: x, y, z, radius, index, 0 for opaque ones."""
    rng, table = np.random.default_rng(seed), np.array(balls, float).reshape(-1, 5)
    centres, radii, indices = table[:, :3], table[:, 3], table[:, 4]
    found = Counted(np.zeros((3, *boxes.shape)), emitted=float(power.sum()))
    for _ in range(12):
        t, which = next_surface(p, d, centres, radii)
        drop(p, d, np.minimum(t, 1e3), power, boxes, rng, found.sums)
        found.passed += float(power[which < 0].sum())
        opaque = (which >= 0) & (indices[which] == 0.0)
        found.absorbed += float(power[opaque].sum())
        on = (which >= 0) & ~opaque
        if not on.any():
            break
        p, d, power, which = (p + np.minimum(t, 1e3)[:, None] * d)[on], d[on], power[on], which[on]
        centre, radius, n = centres[which], radii[which], float(indices[indices > 0.0][0])
        inner, light = bend(d, (p - centre) / radius[:, None], 1.0 / n)
        chord = -2.0 * np.sum((p - centre) * inner, axis=1)
        p = p + chord[:, None] * inner
        d, more = bend(inner, (centre - p) / radius[:, None], n)
        d /= np.linalg.norm(d, axis=1)[:, None]
        power = power * light * more
    return found


def drop(p: Array, d: Array, t: Array, power: Array, boxes: Boxes, rng: np.random.Generator, sums: Array) -> None:
    """Leave power times length at random places of pieces, within the boxes."""
    low, high = np.zeros(len(p)), t.copy()
    right, bottom = boxes.left + boxes.side * boxes.shape[1], boxes.top - boxes.side * boxes.shape[0]
    for axis, least, most in ((0, boxes.left, right), (1, bottom, boxes.top), (2, -boxes.reach, boxes.reach)):
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = (least - p[:, axis]) / d[:, axis], (most - p[:, axis]) / d[:, axis]
        low, high = np.fmax(low, np.minimum(one, two)), np.fmin(high, np.maximum(one, two))
    on = high > low
    p, d, low, high, power = p[on], d[on], low[on], high[on], power[on]
    for k in range(PLACES):
        at = low + (high - low) * (k + rng.random(len(p))) / PLACES
        place = p + at[:, None] * d
        column = np.clip(((place[:, 0] - boxes.left) / boxes.side).astype(int), 0, boxes.shape[1] - 1)
        row = np.clip(((boxes.top - place[:, 1]) / boxes.side).astype(int), 0, boxes.shape[0] - 1)
        number, share = row * boxes.shape[1] + column, power * (high - low) / PLACES
        for moment in range(3):
            weights = share * place[:, 2] ** moment
            sums[moment] += np.bincount(number, weights, minlength=sums[moment].size).reshape(boxes.shape)
