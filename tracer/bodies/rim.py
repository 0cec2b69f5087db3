"""Discs and directions: what plates and tubes are described by."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tracer.bodies.body import vector3
from tracer.camera import Vector3
from tracer.errors import SceneError

POINTS = 64  # of a rim; its polygon is 0.1 % of a radius inside the circle
SHORTEST = 1e-9
# Directions of sides of a polygon around a disc: it has twice as many, and corners 2 % outside
SIDES = 8


def unit_vector(vector: Sequence[float], what: str) -> Vector3:
    """Return the vector (3,) with length 1.

    Raises
    ------
    SceneError
        It is none: all zeros.
    """
    length = float(np.linalg.norm(vector))
    if not length > SHORTEST:
        raise SceneError(f"{what} must have a direction, not {list(vector)}")
    return vector3(np.array(vector) / length)


def sideways(direction: Vector3) -> tuple[tuple[str, str], NDArray[np.float64]]:
    """Two unit vectors (2, 3) square to a direction and to each other, and the world's axes that they follow."""
    along = np.array(direction)
    first, second = sorted(range(3), key=lambda axis: abs(along[axis]))[:2]
    first, second = min(first, second), max(first, second)
    one = np.eye(3)[first] - along[first] * along
    one /= np.linalg.norm(one)
    other = np.cross(along, one)
    other *= np.copysign(1.0, other[second])
    return ("xyz"[first], "xyz"[second]), np.array([one, other])


def leaning(direction: Vector3, by_rad: Sequence[float]) -> Vector3:
    """Return a unit vector that leans towards its two `sideways` by two angles."""
    _, aside = sideways(direction)
    return unit_vector(vector3(np.array(direction) + np.tan(np.array(by_rad)) @ aside), "direction")


def disc(normal: Vector3, radius_mm: float) -> NDArray[np.float64]:
    """Edges (SIDES, 3) whose sums, each counted once or not or in part, make a polygon just around a disc."""
    _, aside = sideways(normal)
    angle = np.pi * np.arange(SIDES) / SIDES
    side_mm = 2.0 * radius_mm * np.tan(0.5 * np.pi / SIDES)
    return np.asarray(side_mm * (np.cos(angle)[:, None] * aside[0] + np.sin(angle)[:, None] * aside[1]))


def of_ring(over_mm: NDArray[np.float64], aside_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance from a body of revolution: how far beyond its ends, and how far beside its round sides."""
    outside = np.hypot(np.maximum(over_mm, 0.0), np.maximum(aside_mm, 0.0))
    return np.asarray(outside + np.minimum(np.maximum(over_mm, aside_mm), 0.0))


def rims(start_mm: Vector3, end_mm: Vector3, radius_mm: float) -> NDArray[np.float64]:
    """Points (2 POINTS, 3) of the two rims of a cylinder, from the ends of its axis."""
    start, end = np.array(start_mm), np.array(end_mm)
    axis = (end - start) / np.linalg.norm(end - start)
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    angle = 2.0 * np.pi / POINTS * np.arange(POINTS)
    circle = radius_mm * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * np.cross(axis, first))
    return np.concatenate((start + circle, end + circle))
