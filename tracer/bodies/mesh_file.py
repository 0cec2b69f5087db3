"""Meshes from PLY and OBJ files: points, normals and triangles, checked before anything is made of them.

A mesh has to be one closed surface, oriented outwards, convex, and to bring normals at its points: without them
the shape between the points is not known (``tracer.kernels.mesh``).
"""

import hashlib
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.plain_file import read_plain
from tracer.errors import SceneError

MOST_BYTES = 200_000_000
SAME = 1e-9  # of the size: points of a seam, which files write twice
CREASE = 1e-3  # between two normals of one point
# Slope by which a neighbour may rise above the tangent plane of a point: noise, not a hollow
HOLLOW = 1e-3
ENDINGS = (".ply", ".obj")


@dataclass(frozen=True)
class MeshFile:
    """Contents of a mesh file, in its own units.

    Parameters
    ----------
    points : (V, 3) float64
        Points.
    normals : (V, 3) float64
        Outward unit normals there.
    triangles : (T, 3) int64
        Corners, counter-clockwise seen from outside.
    sha256 : str
        Digest of the file.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    triangles: NDArray[np.int64]
    sha256: str


def load_mesh(path: Path | str) -> MeshFile:
    """Read and check a mesh.

    Raises
    ------
    SceneError
        The file is none, or cannot be traced; part ``file``, with the place and the cure.
    """
    path = Path(path)
    if path.suffix.lower() not in ENDINGS:
        raise _wrong(path, "is neither PLY nor OBJ; export the mesh as one of them, with normals")
    try:
        content = read_plain(path, MOST_BYTES)
    except OSError as error:
        raise _wrong(path, f"cannot be read: {error.strerror or error}") from None
    points, normals, triangles = _parse(path, content)
    points, normals, triangles = _merge_points(path, points, normals, triangles)
    _check_shape(path, points, normals, triangles)
    return MeshFile(points, normals, triangles, hashlib.sha256(content).hexdigest())


def _wrong(path: Path, text: str) -> SceneError:
    return SceneError(problems=[("file", f"mesh file {path}: {text}")])


def _parse(path: Path, content: bytes) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    try:
        from trimesh.exchange.obj import load_obj
        from trimesh.exchange.ply import load_ply
    except ImportError:
        raise _wrong(path, "meshes need an extra: pip install 'rtpiv[mesh]'") from None
    try:
        if path.suffix.lower() == ".ply":
            found: dict[str, Any] = load_ply(io.BytesIO(content), skip_materials=True)
        else:
            text = io.StringIO(content.decode("utf-8"))
            found = load_obj(text, skip_materials=True, maintain_order=True)
            parts = found.get("geometry", {"": found})
            if len(parts) != 1:
                raise _wrong(path, f"holds {len(parts)} objects; give each its own file and body")
            (found,) = parts.values()
    except SceneError:
        raise
    except Exception as error:  # a reader of foreign files raises whatever it stumbles over
        raise _wrong(
            path, f"cannot be understood: {str(error).splitlines()[0] if str(error) else error!r}"
        ) from None
    if found.get("vertex_normals") is None:
        raise _wrong(path, "has no normals at its points, without which glass cannot be traced; export them too")
    points, normals = (np.array(found[key], np.float64) for key in ("vertices", "vertex_normals"))
    triangles = np.array(found.get("faces", np.empty((0, 3))), np.int64)
    fits = points.ndim == 2 and points.shape == normals.shape and points.shape[1:] == (3,)
    if not fits or triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles):
        raise _wrong(path, "needs a normal for each point, and triangles; export it triangulated, with normals")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise _wrong(path, f"has a triangle of a point that is not there, of {len(points)}")
    if not (np.isfinite(points).all() and np.isfinite(normals).all()):
        raise _wrong(path, "has a point or normal that is no number")
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    if not (lengths > 0.5).all():
        raise _wrong(path, f"point {int(np.argmin(lengths)) + 1} has no normal; export normals of unit length")
    return points, normals / lengths, triangles


def _merge_points(
    path: Path, points: NDArray[np.float64], normals: NDArray[np.float64], triangles: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Make one of points that a file has several times, where they have one normal."""
    size = float(np.ptp(points, axis=0).max())
    if not size > 0.0:
        raise _wrong(path, "has no extent")
    grid = np.round((points - points.min(axis=0)) / (SAME * size)).astype(np.int64)
    _, first, which = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    which = which.reshape(-1)
    apart = np.linalg.norm(normals - normals[first][which], axis=1)
    if float(apart.max()) > CREASE:
        worst = points[int(np.argmax(apart))]
        raise _wrong(path, f"has two normals at {_place(worst)}: a crease; round it, or export smooth normals")
    return points[first], normals[first], which[triangles]


def _check_shape(
    path: Path, points: NDArray[np.float64], normals: NDArray[np.float64], triangles: NDArray[np.int64]
) -> None:
    corners = points[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    flat = area <= 1e-14 * float(np.ptp(points, axis=0).max()) ** 2
    if flat.any():
        raise _wrong(path, f"has a triangle without area at {_place(corners[int(np.argmax(flat)), 0])}; remove it")
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    code = edges[:, 0] * len(points) + edges[:, 1]
    back = edges[:, 1] * len(points) + edges[:, 0]
    order = np.argsort(code)
    found = np.searchsorted(code[order], back).clip(max=len(code) - 1)
    if len(np.unique(code)) < len(code):
        twice = edges[np.setdiff1d(np.arange(len(code)), np.unique(code, return_index=True)[1])[0]]
        raise _wrong(
            path, f"has neighbours of opposite orientation at {_place(points[twice[0]])}; orient them alike"
        )
    open_edges = code[order][found] != back
    if open_edges.any():
        at = points[edges[int(np.argmax(open_edges)), 0]]
        raise _wrong(path, f"is open at {_place(at)}: an edge has one triangle only; close the surface")
    unit = across / area[:, None]
    if float((corners[:, 0] * across).sum()) <= 0.0:
        raise _wrong(path, "is inside out: its triangles run clockwise seen from outside; flip them")
    if (np.einsum("tkc,tc->tk", normals[triangles], unit) <= 0.0).any():
        bad = np.einsum("tkc,tc->tk", normals[triangles], unit).min(axis=1)
        at = corners[int(np.argmin(bad)), 0]
        raise _wrong(path, f"has a normal at {_place(at)} that points into it, or too coarse triangles there")
    step = points[edges[:, 1]] - points[edges[:, 0]]
    rise, reach = (step * normals[edges[:, 0]]).sum(axis=1), np.linalg.norm(step, axis=1)
    if float((rise - HOLLOW * reach).max()) > 0.0:
        at = points[edges[int(np.argmax(rise - HOLLOW * reach)), 0]]
        raise _wrong(path, f"is hollow at {_place(at)}: rays are followed through convex bodies; cut it into such")


def _place(point: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{x:.6g}" for x in point) + ")"
