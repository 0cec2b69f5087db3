"""Meshes of known shapes, written as a program for meshes would write them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Shape = Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]


def icosphere(halvings: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Directions (V, 3) and triangles (20 4^halvings, 3) of a divided icosahedron."""
    golden = 0.5 * (1.0 + 5.0**0.5)
    points = [
        (-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0), (0, -1, golden), (0, 1, golden),
        (0, -1, -golden), (0, 1, -golden), (golden, 0, -1), (golden, 0, 1), (-golden, 0, -1), (-golden, 0, 1),
    ]  # fmt: skip
    faces = [
        (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6),
        (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10),
        (8, 6, 7), (9, 8, 1),
    ]  # fmt: skip
    at = np.array(points, float) / np.linalg.norm(points[0])
    triangles = np.array(faces)
    for _ in range(halvings):
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, which = np.unique(edges, axis=0, return_inverse=True)
        middle = at[unique].sum(axis=1)
        new = len(at) + which.reshape(-1, 3)
        at = np.concatenate((at, middle / np.linalg.norm(middle, axis=1, keepdims=True)))
        (a, b, c), (ab, bc, ca) = triangles.T, new.T
        quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    return at, triangles


def write_ply(
    path: Path, points: NDArray[np.float64], normals: NDArray[np.float64] | None, triangles: NDArray[np.int64]
) -> Path:
    """Write a PLY file in ASCII with all digits."""
    keys = ["x", "y", "z"] + (["nx", "ny", "nz"] if normals is not None else [])
    head = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    head += [f"property double {key}" for key in keys]
    head += [f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header"]
    rows = points if normals is None else np.concatenate((points, normals), axis=1)
    lines = [" ".join(map(repr, row)) for row in rows.tolist()]
    lines += [" ".join(map(str, (3, *triangle))) for triangle in triangles.tolist()]
    path.write_text("\n".join((*head, *lines)) + "\n")
    return path


def write_obj(
    path: Path, points: NDArray[np.float64], normals: NDArray[np.float64], triangles: NDArray[np.int64]
) -> Path:
    """Write an OBJ file."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    lines += [f"vn {x!r} {y!r} {z!r}" for x, y, z in normals.tolist()]
    lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in (triangles + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")
    return path


def ball_points(
    radius_mm: float, halvings: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """A sphere about the origin: points, normals, triangles."""
    directions, triangles = icosphere(halvings)
    return radius_mm * directions, directions, triangles


def stone_value(p: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """An irregular convex stone, F(p) = 0, and the gradient of F: a rounded box, skewed and lopsided [mm]."""
    skew = np.array([[1.0, 0.15, 0.0], [0.0, 1.0, -0.1], [0.1, 0.0, 1.0]])
    q = p @ skew.T
    size = np.array([22.0, 17.0, 14.0])
    u = q / size
    tilt = 0.12 * u[..., 0] + 0.08 * u[..., 1]
    value = (u**2).sum(axis=-1) + 0.25 * (u**4).sum(axis=-1) + tilt - 1.0
    gradient = (2.0 * u + u**3) / size
    gradient[..., 0] += 0.12 / size[0]
    gradient[..., 1] += 0.08 / size[1]
    return value, gradient @ skew


def stone_points(halvings: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Points of the stone along the directions of an icosphere, normals and triangles."""
    directions, triangles = icosphere(halvings)
    r = np.full(len(directions), 15.0)
    for _ in range(60):
        value, gradient = stone_value(r[:, None] * directions)
        r -= value / (gradient * directions).sum(axis=1)
    points = r[:, None] * directions
    _, gradient = stone_value(points)
    return points, gradient / np.linalg.norm(gradient, axis=1, keepdims=True), triangles
