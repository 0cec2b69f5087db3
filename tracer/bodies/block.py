"""Glass that stands alone: boxes, plates, prisms and cuvettes, convex with flat faces, hollow or not.

A block is a convex polygon, its profile, drawn out along its own z axis.  A box has a rectangle for a profile; a
plate is a thin box, a cuvette a box with a wall.  Light goes beside a block as well as through it.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ground.config import Pair, Triple
from ground.jit import Array
from ground.plain_words import exactly
from tracer.bodies.body import Body, BodySection, Capsule, Carrier, Index, Number, Piece, Room, vector3
from tracer.bodies.rim import of_ring
from tracer.camera import LONGEST_MM, SMALLEST_MM, Vector3, within_reach
from tracer.errors import SceneError
from tracer.kernels.block import FACES, block_rates, cross_block, leave_block, meets_block
from tracer.kernels.world import KINDS, Kind
from tracer.media import Medium, shifted
from tracer.medium_table import MediumTable, Positive, medium_entry, medium_of

EDGE_MM = 0.5  # ground or chipped along the edges of cut glass
MOST_SIDES = FACES - 2
NO_FACE = (0.0, 0.0, 0.0, 2.0 * LONGEST_MM)  # a half-space that holds everything
SHARPEST = 1e-6  # sine of the angle at a corner of a profile, from which it is one
RIGHT = 1e-6  # of what should be 0 or 1 in a rotation
ORIGIN = (0.0, 0.0, 0.0)
UNTURNED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
BOX_FACES = ("right", "top", "left", "bottom", "back", "front")
Profile = tuple[tuple[float, float], ...]


class Blocks(NamedTuple):
    """Blocks for the kernels: rows (N, 39), see ``tracer.kernels.block``."""

    rows: Array


ROW = (
    "x", "y", "z", "n", "n_filled", "wall", "edge",
    *(f"face{face}_{part}" for face in range(FACES) for part in ("x", "y", "z", "distance")),
)  # fmt: skip
KINDS[Blocks] = Kind(meets_block, cross_block, block_rates, leave_block, ROW)


def rotate_axes(axes: Sequence[Vector3], by_rad: Sequence[float]) -> tuple[Vector3, ...]:
    """Return axes turned about the world's x, then y, then z."""
    rotated = np.array(axes)
    for axis, angle in enumerate(by_rad):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[one, one] = turn[other, other] = math.cos(angle)
        turn[one, other], turn[other, one] = -math.sin(angle), math.sin(angle)
        rotated = rotated @ turn.T
    return tuple(vector3(row) for row in rotated)


class BlockSection(BodySection):
    """Keys of boxes and prisms alike in a scene file."""

    centre_mm: Triple
    rotation: Annotated[list[Triple], Field(min_length=3, max_length=3), exactly(3)] | None = None
    turned_deg: Triple | None = None
    wall_mm: Annotated[float, Field(ge=0.0)] = 0.0
    filled: str | MediumTable | None = None
    edge_mm: Annotated[float, Field(ge=0.0)] = EDGE_MM
    material: str | MediumTable
    carried_by: Carrier | None = None

    def common(self, name: str, media: Mapping[str, Medium]) -> dict[str, Any]:
        """Arguments of a block that do not depend on its profile.

        Raises
        ------
        SceneError
            The rotation is given twice, or a medium is unknown.
        """
        if self.rotation is not None and self.turned_deg is not None:
            raise SceneError(problems=[("turned_deg", f"block {name!r}: give turned_deg or rotation, not both")])
        axes = UNTURNED if self.rotation is None else tuple(vector3(row) for row in self.rotation)
        return {
            "medium": medium_of(self.material, media),
            "centre_mm": vector3(self.centre_mm),
            "rotation": axes
            if self.turned_deg is None
            else rotate_axes(UNTURNED, np.deg2rad(self.turned_deg).tolist()),
            "wall_mm": self.wall_mm,
            "filled": None if self.filled is None else medium_of(self.filled, media),
            "edge_mm": self.edge_mm,
            "carried_by": self.carried_by,
        }


class BoxSection(BlockSection):
    """A box, plate or cuvette in a scene file."""

    kind: Literal["box"]
    size_mm: Annotated[list[Positive], Field(min_length=3, max_length=3), exactly(3)]

    def body(self, name: str, media: Mapping[str, Medium]) -> "Box":
        """Return the box described.

        Raises
        ------
        SceneError
            It cannot be; names the part at fault.
        """
        width, height, depth = self.size_mm
        return Box(name, rectangle(width, height), depth, **self.common(name, media))


class PrismSection(BlockSection):
    """A prism in a scene file."""

    kind: Literal["prism"]
    profile_mm: Annotated[list[Pair], Field(min_length=3)]
    length_mm: Positive

    def body(self, name: str, media: Mapping[str, Medium]) -> "Prism":
        """Return the prism described.

        Raises
        ------
        SceneError
            It cannot be; names the part at fault.
        """
        profile = tuple((float(x), float(y)) for x, y in self.profile_mm)
        return Prism(name, profile, self.length_mm, **self.common(name, media))


@dataclass(frozen=True)
class Block(Body):
    """A convex body with flat faces: a profile drawn out along its own z axis.

    Parameters
    ----------
    name : str
        Name in messages, branches and files; unique in its scene.
    profile_mm : tuple of pairs
        Corners of the profile in its own x and y, 3 to 6 of them, convex.
    length_mm : float
        Extent along its own z, half of it to each side.
    medium : Medium
        The glass.
    centre_mm : (float, float, float)
        Where its own origin is.
    rotation : 3 x 3 nested tuple
        Its own axes x, y, z in the world.
    wall_mm : float
        Thickness of the walls of a hollow block, closed all around; 0: solid.
    filled : Medium or None
        What is in a hollow block; None: what is around it.
    edge_mm : float
        Width along all edges through which nothing is seen.
    carried_by : "bench", "glass", "camera" or None
        What it moves with on a bench; None: a hollow one with nothing, a solid one with the glass.
    """

    Section: ClassVar[Any] = BoxSection | PrismSection
    undetermined_note: ClassVar[str] = "faces that show no corner of the board displace no ray"

    name: str
    profile_mm: Profile
    length_mm: float
    medium: Medium
    centre_mm: Vector3 = ORIGIN
    rotation: tuple[Vector3, ...] = UNTURNED
    wall_mm: float = 0.0
    filled: Medium | None = None
    edge_mm: float = EDGE_MM
    carried_by: Carrier | None = None

    def __post_init__(self) -> None:
        who, axes, corners = f"{self.kind} {self.name!r}", np.array(self.rotation), np.array(self.profile_mm)
        if not 3 <= len(corners) <= MOST_SIDES:
            raise SceneError(f"{who}: profile_mm must have 3 to {MOST_SIDES} corners, not {len(corners)}")
        sides = np.roll(corners, -1, axis=0) - corners
        lengths = np.linalg.norm(sides, axis=1)
        if not min(lengths.min(), self.length_mm) >= SMALLEST_MM:
            raise SceneError(f"{who}: every side must be {SMALLEST_MM:g} mm long at least; it has no thickness")
        ways = sides / lengths[:, None]
        sines = ways[:, 0] * np.roll(ways[:, 1], -1) - ways[:, 1] * np.roll(ways[:, 0], -1)
        turns = np.arctan2(sines, (ways * np.roll(ways, -1, axis=0)).sum(axis=1)).sum()
        if not (
            np.abs(sines).min() > SHARPEST
            and abs(abs(turns) - 2.0 * math.pi) < 0.1
            and len({*np.sign(sines)}) == 1
        ):
            raise SceneError(
                f"{who}: profile_mm must be a convex polygon: corners in order around it, the first not repeated"
            )
        if turns < 0.0:
            object.__setattr__(self, "profile_mm", self.profile_mm[::-1])
        if not (np.abs(axes @ axes.T - np.eye(3)).max() < RIGHT and np.linalg.det(axes) > 0.0):
            raise SceneError(f"{who}: rotation must be orthonormal and right-handed")
        if not within_reach(self.centre_mm) or not np.abs(self.corners_mm).max() <= LONGEST_MM:
            raise SceneError(f"{who}: it must lie within {LONGEST_MM:g} mm of the origin")
        middle = corners.mean(axis=0)
        normals, distances = self.own_faces
        inner_mm = float((distances - normals[:, :2] @ middle).min())
        taken_mm = self.wall_mm + self.edge_mm + (SMALLEST_MM if self.wall_mm > 0.0 else 0.0)
        if not inner_mm > taken_mm:
            raise SceneError(
                f"{who}: wall_mm and edge_mm, {taken_mm:g} mm together, leave nothing of its half of"
                f" {inner_mm:.4g} mm; give less than that, or a larger size"
            )
        if self.filled is not None and self.wall_mm == 0.0:
            raise SceneError(f"{who}: a solid one, of wall_mm 0, has no inside; drop filled or give wall_mm")

    @cached_property
    def own_faces(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Outward unit normals (F, 3) in its own axes, sides first, then the ends; distances (F,) of the faces."""
        corners = np.array(self.profile_mm)
        sides = np.roll(corners, -1, axis=0) - corners
        across = np.stack((sides[:, 1], -sides[:, 0]), axis=1) / np.linalg.norm(sides, axis=1)[:, None]
        normals = np.zeros((len(corners) + 2, 3))
        normals[:-2, :2] = across
        normals[-2, 2], normals[-1, 2] = -1.0, 1.0
        half = 0.5 * self.length_mm
        return normals, np.array([*(across * corners).sum(axis=1), half, half])

    @property
    def face_names(self) -> tuple[str, ...]:
        """Names of the faces, in the order of `own_faces`, as branches have them."""
        return (*(f"side{number}" for number in range(1, len(self.profile_mm) + 1)), "back", "front")

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """Outward unit normals of the faces in the world (F, 3)."""
        return np.asarray(self.own_faces[0] @ np.array(self.rotation))

    @cached_property
    def corners_mm(self) -> NDArray[np.float64]:
        """Corners in the world (2 P, 3): those of the back, then of the front."""
        flat, half = np.array(self.profile_mm), 0.5 * self.length_mm
        own = np.concatenate([np.column_stack((flat, np.full(len(flat), z))) for z in (-half, half)])
        return np.asarray(own @ np.array(self.rotation) + np.array(self.centre_mm))

    @classmethod
    def table_of(cls, bodies: Iterable[Self], index: Index) -> Blocks:
        """Blocks for the kernels."""
        rows = []
        for block in bodies:
            faces = np.tile(NO_FACE, (FACES, 1))
            faces[: len(block.normals)] = np.column_stack((block.normals, block.own_faces[1]))
            n, filled = index(block, block.medium), index(block, block.filled)
            rows.append([*block.centre_mm, n, filled, block.wall_mm, block.edge_mm, *faces.ravel()])
        return Blocks(np.array(rows).reshape(-1, len(ROW)))

    def section(self) -> dict[str, Any]:
        """Return the block as a scene file has it."""
        rotation = {} if self.rotation == UNTURNED else {"rotation": [list(axis) for axis in self.rotation]}
        wall = {} if self.wall_mm == 0.0 else {"wall_mm": self.wall_mm}
        filled = {} if self.filled is None else {"filled": medium_entry(self.filled)}
        filled |= {} if self.carried_by is None else {"carried_by": self.carried_by}
        head = {"name": self.name, "kind": self.kind, "centre_mm": list(self.centre_mm), **self._size_entry()}
        tail = {"edge_mm": self.edge_mm, "material": medium_entry(self.medium), **filled}
        return {**head, **rotation, **wall, **tail}

    def _size_entry(self) -> dict[str, Any]:
        """Keys of its size in a scene file."""
        return {"profile_mm": [list(corner) for corner in self.profile_mm], "length_mm": self.length_mm}

    @cached_property
    def capsule(self) -> Capsule:
        """A capsule around it, along the longest of its own axes."""
        axes, apart = np.array(self.rotation), self.corners_mm - np.array(self.centre_mm)
        own = apart @ axes.T
        middle = 0.5 * (own.min(axis=0) + own.max(axis=0))
        along = int(np.argmax(np.ptp(own, axis=0)))
        aside = np.delete(own - middle, along, axis=1)
        reach = np.zeros(3)
        reach[along] = 0.5 * float(np.ptp(own[:, along]))
        ends = (np.array(self.centre_mm) + (middle + sign * reach) @ axes for sign in (-1.0, 1.0))
        start, end = (vector3(point) for point in ends)
        return Capsule(start, end, float(np.linalg.norm(aside, axis=1).max()))

    @property
    def outline_mm(self) -> tuple[NDArray[np.float64], float]:
        """Its corners: the body is their hull."""
        return self.corners_mm, 0.0

    @property
    def carried(self) -> Carrier:
        """Support that it moves with: `carried_by`."""
        return self.carried_by or ("glass" if self.wall_mm == 0.0 else "bench")

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """A box around it; of a hollow one a plank each side and a plate each end."""
        axes, corners = np.array(self.rotation), self.corners_mm
        flat, count = np.array(self.profile_mm), len(self.profile_mm)
        low, size = flat.min(axis=0), np.ptp(flat, axis=0)
        corner = np.array(self.centre_mm) + np.array([*low, -0.5 * self.length_mm]) @ axes
        edges = np.array([*size, self.length_mm])[:, None] * axes
        if self.wall_mm == 0.0:
            return (Piece(corner, edges, 0.0),)
        inwards = -self.wall_mm * self.normals
        planks = [
            Piece(corners[k], np.array([corners[(k + 1) % count] - corners[k], edges[2], inwards[k]]), 0.0)
            for k in range(count)
        ]
        ends = [(corner, inwards[-2]), (corner + edges[2], inwards[-1])]
        return (*planks, *(Piece(start, np.array([*edges[:2], inward]), 0.0) for start, inward in ends))

    def distance_mm(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from the surface to points (..., 3), negative in the glass."""
        own = (np.asarray(points_mm) - np.array(self.centre_mm)) @ np.array(self.rotation).T
        normals, distances = self.own_faces
        beyond = own @ normals.T - distances
        corners = np.array(self.profile_mm)
        sides = np.roll(corners, -1, axis=0) - corners
        w = own[..., None, :2] - corners
        along = np.clip((w * sides).sum(axis=-1) / (sides * sides).sum(axis=-1), 0.0, 1.0)
        outside = np.linalg.norm(w - along[..., None] * sides, axis=-1).min(axis=-1)
        deepest = beyond[..., :-2].max(axis=-1)
        outer = of_ring(beyond[..., -2:].max(axis=-1), np.where(deepest > 0.0, outside, deepest))
        return outer if self.wall_mm == 0.0 else np.maximum(outer, -self.wall_mm - beyond.max(axis=-1))

    def _edge_ways(self) -> NDArray[np.float64]:
        """Unit directions of its edges in the world (P + 1, 3)."""
        profile = np.array(self.profile_mm)
        sides = np.column_stack((np.roll(profile, -1, axis=0) - profile, np.zeros(len(profile))))
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        return np.asarray(np.concatenate((sides, [[0.0, 0.0, 1.0]])) @ np.array(self.rotation))

    def gap_to_block_mm(self, other: "Block") -> float:
        """Largest gap between two blocks along any axis that can separate them; negative where they overlap."""
        crosses = np.cross(self._edge_ways()[:, None], other._edge_ways()[None]).reshape(-1, 3)
        lengths = np.linalg.norm(crosses, axis=1, keepdims=True)
        crosses = (crosses / np.maximum(lengths, SHARPEST))[lengths[:, 0] > SHARPEST]
        axes = np.concatenate((self.normals, other.normals, crosses))
        one, two = self.corners_mm @ axes.T, other.corners_mm @ axes.T
        return float(np.maximum(one.min(axis=0) - two.max(axis=0), two.min(axis=0) - one.max(axis=0)).max())

    def stands_before(self, eye_mm: Vector3, points_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether the straight line from a point (3,) to each of others (..., 3) meets the block."""
        normals, eye = self.normals, np.array(eye_mm)
        limit = self.own_faces[1] + normals @ np.array(self.centre_mm)
        above, slope = normals @ eye - limit, (np.asarray(points_mm) - eye) @ normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -above / slope
        first = np.where(slope < 0.0, t, np.where((slope == 0.0) & (above > 0.0), np.inf, -np.inf)).max(axis=-1)
        last = np.where(slope > 0.0, t, np.inf).min(axis=-1)
        return np.asarray((first < np.minimum(last, 1.0)) & (last > 0.0))

    def moved(self, to: Callable[[Vector3], Vector3]) -> Self:
        """Return the block where a movement takes its origin and axes."""
        origin = np.array(to(self.centre_mm))
        ahead = [np.array(to(vector3(np.array(self.centre_mm) + np.array(axis)))) for axis in self.rotation]
        return replace(self, centre_mm=vector3(origin), rotation=tuple(vector3(point - origin) for point in ahead))

    @property
    def media(self) -> tuple[tuple[str, Medium], ...]:
        """The glass, and what is inside if that is said."""
        filled = () if self.filled is None else ((f"in {self.kind} {self.name!r}", self.filled),)
        return ((f"{self.kind} {self.name!r}", self.medium), *filled)

    def with_media(self, media: Iterable[Medium]) -> Self:
        """Return the block of other media."""
        own, *filled = media
        return replace(self, medium=own, filled=filled[0] if filled else None)

    def numbers(self, wavelength_nm: float) -> tuple[Number, ...]:
        """Place, turns about the world's axes, sizes and n."""
        places = [Number(axis, value, "place_mm") for axis, value in zip("xyz", self.centre_mm, strict=True)]
        turns = [Number(f"tilt_{axis}", 0.0, "tilt_deg") for axis in "xyz"]
        sizes = [Number(name, value, "thickness_mm") for name, value in self._sizes().items()]
        return (*places, *turns, *sizes, Number("n", self.medium.n(wavelength_nm), "n"))

    def with_numbers(self, values: Sequence[float], wavelength_nm: float) -> Self:
        """Return the block moved, turned about its own origin, and of other sizes."""
        x, y, z, *rest, n = values
        sizes = dict(zip(self._sizes(), rest[3:], strict=True))
        return replace(
            self._of_sizes(sizes),
            centre_mm=(x, y, z),
            rotation=rotate_axes(self.rotation, rest[:3]) if any(rest[:3]) else self.rotation,
            medium=shifted(self.medium, n - self.medium.n(wavelength_nm)),
        )

    def _sizes(self) -> dict[str, float]:
        """Sizes that a fit may find, by name."""
        return {"length": self.length_mm} | ({"wall": self.wall_mm} if self.wall_mm > 0.0 else {})

    def _of_sizes(self, sizes: Mapping[str, float]) -> Self:
        """Return the block with other `_sizes`."""
        return replace(self, length_mm=sizes["length"], wall_mm=sizes.get("wall", 0.0))

    @property
    def event_names(self) -> tuple[str, ...]:
        """Names of the ways through, off the inside, in and out; the faces are added to them."""
        own = self.name
        return (own,) if self.wall_mm == 0.0 else (own, f"{own} off inside", f"{own} in", f"{own} out")

    def is_on(self, branch: Iterable[str]) -> bool:
        """Return whether a branch goes through the block, by whatever faces."""
        return not {event.rpartition(" ")[0] for event in branch}.isdisjoint(self.event_names)

    @property
    def may_cross_plane(self) -> bool:
        """A block may: the plane runs through cuvettes, and cuts what stands in a flow."""
        return True

    @property
    def room(self) -> Room | None:
        """The inside, if there is one."""
        return None if self.wall_mm == 0.0 else Room(self.filled, self._gaps_mm, surrounds=True)

    def _gaps_mm(self, corners_mm: NDArray[np.float64], radius_mm: float) -> tuple[float, float]:
        w = corners_mm - np.array(self.centre_mm)
        beyond = w @ self.normals.T - self.own_faces[1]
        inside = -self.wall_mm - float(beyond.max())
        towards, own = w.mean(axis=0), self.corners_mm - np.array(self.centre_mm)
        towards = towards / max(float(np.linalg.norm(towards)), np.finfo(float).tiny)
        outside = max(float(beyond.min(axis=0).max()), float((w @ towards).min() - (own @ towards).max()))
        return outside - radius_mm, inside - radius_mm


def rectangle(width_mm: float, height_mm: float) -> Profile:
    """Profile of a box."""
    x, y = 0.5 * width_mm, 0.5 * height_mm
    return ((x, -y), (x, y), (-x, y), (-x, -y))


@dataclass(frozen=True)
class Box(Block):
    """A block with a rectangle for a profile: a box, a plate or a cuvette; parameters as of `Block`."""

    kind: ClassVar[str] = "box"

    @property
    def size_mm(self) -> Vector3:
        """Width, height and depth along its own axes."""
        x, y = self.profile_mm[1]
        return 2.0 * x, 2.0 * y, self.length_mm

    def _size_entry(self) -> dict[str, Any]:
        return {"size_mm": list(self.size_mm)}

    @property
    def face_names(self) -> tuple[str, ...]:
        """Names of the faces as branches have them."""
        return BOX_FACES

    def _sizes(self) -> dict[str, float]:
        own = dict(zip(("width", "height", "depth"), self.size_mm, strict=True))
        return own | ({"wall": self.wall_mm} if self.wall_mm > 0.0 else {})

    def _of_sizes(self, sizes: Mapping[str, float]) -> Self:
        profile = rectangle(sizes["width"], sizes["height"])
        return replace(self, profile_mm=profile, length_mm=sizes["depth"], wall_mm=sizes.get("wall", 0.0))


@dataclass(frozen=True)
class Prism(Block):
    """A block of any convex profile; parameters as of `Block`."""

    kind: ClassVar[str] = "prism"
