"""A mesh: convex glass of any shape, such as a stone, from a file of points, normals and triangles.

Kernels take it as patches, and a tree of boxes around them (``tracer.kernels.mesh``).
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ground.config import Triple
from ground.jit import Array
from ground.plain_words import exactly
from tracer.bodies.body import Body, BodySection, Capsule, Index, vector3
from tracer.bodies.mesh_file import MeshFile, load_mesh
from tracer.camera import LONGEST_MM, Vector3, within_reach
from tracer.errors import SceneError
from tracer.kernels.mesh import BOX_NUMBERS, PATCH_NUMBERS, cross_mesh, meets_mesh, mesh_rates, normal_at
from tracer.kernels.world import KINDS, Kind
from tracer.media import Medium
from tracer.medium_table import MediumTable, Positive, medium_entry, medium_of

LEAF = 2  # patches of a box that is divided no more
MARGIN = 1e-12  # of the size, added to boxes: rounding
MIDDLES = ((0.5, 0.5), (0.0, 0.5), (0.5, 0.0))  # a, b of the middles of edges 1-2, 2-3, 3-1
ORIGIN = (0.0, 0.0, 0.0)
UNTURNED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
RIGHT = 1e-6  # of what should be 0 or 1 in a rotation


def control_points(
    points_mm: NDArray[np.float64], normals: NDArray[np.float64], triangles: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Control points (T, 10, 3) of the patches, from points (V, 3), unit normals (V, 3) and corners (T, 3)."""
    p, n = points_mm[triangles], normals[triangles]

    def on_edge(one: int, other: int) -> NDArray[np.float64]:
        rise = ((p[:, other] - p[:, one]) * n[:, one]).sum(axis=1, keepdims=True)
        return np.asarray((2.0 * p[:, one] + p[:, other] - rise * n[:, one]) / 3.0)

    edges = [on_edge(*pair) for pair in ((0, 1), (1, 0), (1, 2), (2, 1), (2, 0), (0, 2))]
    mean = np.mean(edges, axis=0)
    return np.stack([*p.transpose(1, 0, 2), *edges, mean + 0.5 * (mean - p.mean(axis=1))], axis=1)


def mesh_row(n: float, controls_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Row of a mesh of relative index n, from the control points of its patches."""
    low, high = controls_mm.min(axis=1), controls_mm.max(axis=1)
    order, boxes = _boxes(low, high)
    centre = 0.5 * (low.min(axis=0) + high.max(axis=0))
    radius = float(np.linalg.norm(controls_mm - centre, axis=2).max())
    head = [n, float(len(boxes)), *centre, radius]
    return np.concatenate((head, boxes.ravel(), controls_mm[order].transpose(0, 2, 1).ravel()))


def _boxes(low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Order of the patches, and boxes (B, BOX_NUMBERS), parents before children: halves along the longest side."""
    margin = MARGIN * float((high.max(axis=0) - low.min(axis=0)).max())
    order, boxes = np.arange(len(low)), []

    def divide(first: int, last: int) -> None:
        among = order[first:last]
        box = [*(low[among].min(axis=0) - margin), *(high[among].max(axis=0) + margin), first, 0, 0]
        boxes.append(box)
        if last - first <= LEAF:
            box[-2] = last - first
        else:
            middle = 0.5 * (low[among] + high[among])
            axis = int(np.argmax(np.ptp(middle, axis=0)))
            half = (last - first) // 2
            order[first:last] = among[np.argsort(middle[:, axis], kind="stable")]
            divide(first, first + half)
            divide(first + half, last)
        box[-1] = len(boxes)

    divide(0, len(low))
    return order, np.array(boxes).reshape(-1, BOX_NUMBERS)


def kinks(triangles: NDArray[np.int64], controls_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angle [rad] between neighbouring patches in the middle of each edge (E,): what the surface does not know.

    Patches meet at right angles to the normals of their corners; between these each has its own.
    """
    rows = np.ascontiguousarray(controls_mm.transpose(0, 2, 1)).reshape(len(triangles), PATCH_NUMBERS)
    normals = np.array([[normal_at(row, 0, a, b) for a, b in MIDDLES] for row in rows]).reshape(-1, 3)
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    most = int(triangles.max()) + 1
    _, which = np.unique(edges.min(axis=1) * most + edges.max(axis=1), return_inverse=True)
    pairs = np.argsort(which.reshape(-1), kind="stable").reshape(-1, 2)
    return np.asarray(np.linalg.norm(normals[pairs[:, 0]] - normals[pairs[:, 1]], axis=1))


class Meshes(NamedTuple):
    """Meshes for the kernels: rows (N, numbers of the longest), see ``tracer.kernels.mesh``."""

    rows: Array


KINDS[Meshes] = Kind(meets_mesh, cross_mesh, mesh_rates)


class MeshSection(BodySection):
    """A mesh in a scene file."""

    kind: Literal["mesh"]
    file: Annotated[str, Field(min_length=1, max_length=1000)]
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] | None = None
    position_mm: Triple | None = None
    rotation: Annotated[list[Triple], Field(min_length=3, max_length=3), exactly(3)] | None = None
    unit_mm: Positive = 1.0
    material: str | MediumTable

    def resolve_paths(self, folder: Path) -> Self:
        """Take the file from beside the scene file."""
        return self.model_copy(update={"file": str((folder / self.file).resolve())})

    def body(self, name: str, media: Mapping[str, Medium]) -> "Mesh":
        """Return the mesh described.

        Raises
        ------
        SceneError
            It cannot be; names the part at fault.
        """
        shape = load_mesh(self.file)
        if self.sha256 not in (None, shape.sha256):
            text = f"mesh {name!r}: {self.file} is not the file it was; put that back, or drop sha256"
            raise SceneError(problems=[("sha256", text)])
        turned = UNTURNED if self.rotation is None else tuple(vector3(row) for row in self.rotation)
        place = ORIGIN if self.position_mm is None else vector3(self.position_mm)
        return Mesh(name, Path(self.file), shape, medium_of(self.material, media), place, turned, self.unit_mm)


@dataclass(frozen=True)
class Mesh(Body):
    """A convex body of glass, known by triangles with normals.

    Parameters
    ----------
    name : str
        Name in messages, branches and files; unique in its scene.
    path : Path
        File of the shape.
    shape : MeshFile
        What is in it.
    medium : Medium
        The glass.
    position_mm : (float, float, float)
        Where the origin of the file is.
    rotation : 3 x 3 nested tuple
        Axes x, y, z of the file in the world.
    unit_mm : float
        Unit of length of the file.
    """

    kind: ClassVar[str] = "mesh"
    Section: ClassVar[type[BodySection]] = MeshSection

    name: str
    path: Path
    shape: MeshFile = field(repr=False, compare=False)
    medium: Medium
    position_mm: Vector3 = ORIGIN
    rotation: tuple[Vector3, ...] = UNTURNED
    unit_mm: float = 1.0

    def __post_init__(self) -> None:
        axes = np.array(self.rotation)
        if not (np.abs(axes @ axes.T - np.eye(3)).max() < RIGHT and np.linalg.det(axes) > 0.0):
            raise SceneError(f"mesh {self.name!r}: rotation must be orthonormal and right-handed")
        if not within_reach(self.position_mm) or not np.abs(self.points_mm).max() <= LONGEST_MM:
            raise SceneError(
                f"mesh {self.name!r}: it must lie within {LONGEST_MM:g} mm of the origin; is unit_mm right?"
            )

    @cached_property
    def points_mm(self) -> NDArray[np.float64]:
        """Points in the world (V, 3)."""
        return np.asarray(self.unit_mm * self.shape.points @ np.array(self.rotation) + np.array(self.position_mm))

    @cached_property
    def controls_mm(self) -> NDArray[np.float64]:
        """Control points of the patches in the world (T, 10, 3)."""
        return control_points(self.points_mm, self.shape.normals @ np.array(self.rotation), self.shape.triangles)

    @cached_property
    def slope_rad(self) -> float:
        """Uncertainty of the slope of the surface: half of the rms kink between neighbouring patches."""
        return 0.5 * float(np.sqrt(np.mean(kinks(self.shape.triangles, self.controls_mm) ** 2)))

    @cached_property
    def _row(self) -> NDArray[np.float64]:
        return mesh_row(1.0, self.controls_mm)

    @classmethod
    def table_of(cls, bodies: Iterable[Self], index: Index) -> Meshes:
        """Meshes for the kernels."""
        meshes = list(bodies)
        rows = np.zeros((len(meshes), max((len(mesh._row) for mesh in meshes), default=0)))
        for row, mesh in zip(rows, meshes, strict=True):
            row[: len(mesh._row)] = mesh._row
            row[0] = index(mesh, mesh.medium)
        return Meshes(rows)

    def section(self) -> dict[str, Any]:
        """Return the mesh as a scene file has it."""
        turned = {} if self.rotation == UNTURNED else {"rotation": [list(axis) for axis in self.rotation]}
        unit = {} if self.unit_mm == 1.0 else {"unit_mm": self.unit_mm}
        place = {"position_mm": list(self.position_mm), **turned, **unit}
        file = {"file": str(self.path), "sha256": self.shape.sha256}
        return {"name": self.name, "kind": self.kind, **file, **place, "material": medium_entry(self.medium)}

    @property
    def capsule(self) -> Capsule:
        """A ball around the mesh."""
        centre = vector3(self._row[2:5])
        return Capsule(centre, centre, float(self._row[5]))

    @property
    def outline_mm(self) -> tuple[NDArray[np.float64], float]:
        """All control points: the body lies in their hull."""
        return self.controls_mm.reshape(-1, 3), 0.0

    def distance_mm(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance to points (..., 3), from below: how far they are beyond the farthest tangent plane.

        The planes through all points of the file hold the body, which is convex.
        """
        normals = self.shape.normals @ np.array(self.rotation)
        beyond = np.asarray(points_mm) @ normals.T - (self.points_mm * normals).sum(axis=1)
        return np.asarray(beyond.max(axis=-1))

    def moved(self, to: Callable[[Vector3], Vector3]) -> Self:
        """Return the mesh where a movement takes its origin and axes."""
        origin = np.array(to(self.position_mm))
        ahead = [np.array(to(vector3(np.array(self.position_mm) + np.array(axis)))) for axis in self.rotation]
        axes = tuple(vector3(point - origin) for point in ahead)
        return replace(self, position_mm=vector3(origin), rotation=axes)

    @property
    def media(self) -> tuple[tuple[str, Medium], ...]:
        """The glass."""
        return ((f"mesh {self.name!r}", self.medium),)

    def with_media(self, media: Iterable[Medium]) -> Self:
        """Return the mesh of another glass."""
        (own,) = media
        return replace(self, medium=own)
