"""Interface of a body, of whatever kind.

Scene, files, fit, keep-out zones, renderer and benches ask a body these questions and no other: a new kind is one
file that answers them (``docs/add-a-body.md``).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ground.config import Table
from tracer.camera import Vector3
from tracer.kernels.crossed import CONTACT_TOL_MM as CONTACT_TOL_MM
from tracer.media import Medium


class Capsule(NamedTuple):
    """All points within `radius_mm` of the segment `start_mm`-`end_mm`."""

    start_mm: Vector3
    end_mm: Vector3
    radius_mm: float

    def distance_mm(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from the surface to points (..., 3), negative inside."""
        start, end = np.array(self.start_mm), np.array(self.end_mm)
        axis = end - start
        along = np.clip((points_mm - start) @ axis / max(float(axis @ axis), np.finfo(float).tiny), 0.0, 1.0)
        return np.asarray(np.linalg.norm(points_mm - start - along[..., None] * axis, axis=-1) - self.radius_mm)


class Piece(NamedTuple):
    """A convex part of a body: all points start + sum v_i edges_i, 0 <= v_i <= 1, and what is near them.

    Parameters
    ----------
    start_mm : (3,) float64
    edges_mm : (n, 3) float64
    radius_mm : float
        How near.
    """

    start_mm: NDArray[np.float64]
    edges_mm: NDArray[np.float64]
    radius_mm: float


Carrier = Literal["glass", "bench", "camera"]
Index = Callable[["Body", Medium | None], float]  # n of a medium (None: around) / n around a body


class BodySection(Table):
    """A body in a scene file; each kind adds ``kind`` and its numbers."""

    name: Annotated[str, Field(min_length=1, max_length=100)] | None = None
    kind: str

    def resolve_paths(self, folder: Path) -> Self:
        """Return the section of a scene file in a folder; files that it names are beside it."""
        return self

    def body(self, name: str, media: Mapping[str, Medium]) -> "Body":
        """Return the body described.

        Raises
        ------
        SceneError
            It cannot be; names the part at fault, such as ``core``.
        """
        raise NotImplementedError


class Room(NamedTuple):
    """Space that a body parts from the rest of the world.

    Parameters
    ----------
    medium : Medium or None
        What is in it; None: the same as around the body.
    gaps_mm : callable
        (corners (K, 3), radius) -> how far a body within `radius` of the hull of these points stays outside, and
        how far inside, of the wall; both are negative for one that the wall cuts.
    surrounds : bool
        Whether the wall goes all around what it holds; else it is a plane, to which everything has a side.
    """

    medium: Medium | None
    gaps_mm: Callable[[NDArray[np.float64], float], tuple[float, float]]
    surrounds: bool


class Number(NamedTuple):
    """One number of a body that a scene fit may find.

    Parameters
    ----------
    name : str
        What it is called after the body's name and a point.
    value : float
        [mm], [rad] or an index.
    known : str
        Key of the fit section that says how well it is known: place_mm, tilt_deg, thickness_mm, radius_mm or n.
    """

    name: str
    value: float
    known: str


class Ball(Protocol):
    """Properties that a body asks of a ball beside it (`Body.gap_to_ball_mm`)."""

    @property
    def centre_mm(self) -> Vector3:
        """Its centre."""
        ...

    @property
    def radius_mm(self) -> float:
        """Its radius."""
        ...

    @property
    def shape_um(self) -> tuple[float, ...]:
        """Deviation from a sphere; empty for a sphere."""
        ...

    @property
    def uneven_mm(self) -> float:
        """Largest deviation of its surface from the radius."""
        ...

    def radius_towards_mm(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from its centre to its surface in unit directions (..., 3)."""
        ...


class Body(ABC):
    """A body: what stands before the investigation plane.  Subclasses are frozen dataclasses."""

    name: str
    kind: ClassVar[str]
    Section: ClassVar[type[BodySection]]
    undetermined_note: ClassVar[str] = ""  # what frames do not determine of such a body

    @classmethod
    def among(cls, bodies: Iterable["Body"]) -> tuple[Self, ...]:
        """Those of some bodies that are of this kind, in order."""
        return tuple(body for body in bodies if isinstance(body, cls))

    @classmethod
    @abstractmethod
    def table_of(cls, bodies: Iterable[Any], index: Index) -> Any:  # noqa: ANN401
        """Bodies of this kind for the kernels (``tracer.kernels.world``)."""

    @abstractmethod
    def section(self) -> dict[str, Any]:
        """Return the body as a scene file has it."""

    @property
    @abstractmethod
    def capsule(self) -> Capsule:
        """Smallest capsule around the body."""

    @abstractmethod
    def moved(self, to: Callable[[Vector3], Vector3]) -> Self:
        """Return the body where a movement takes it; `to` says where it takes a point."""

    @property
    def lowest_mm(self) -> float:
        """Smallest z of the body, as far as its outline says."""
        points, radius_mm = self.outline_mm
        return float(points[:, 2].min()) - radius_mm

    @property
    def highest_mm(self) -> float:
        """Largest z of the body, as far as its outline says."""
        points, radius_mm = self.outline_mm
        return float(points[:, 2].max()) + radius_mm

    def distance_mm(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from the surface to points (..., 3), negative inside: that of the capsule, if need be."""
        return self.capsule.distance_mm(points_mm)

    def gap_to_ball_mm(self, ball: Ball) -> float:
        """Distance between the body and a ball, negative for an overlap; never too small."""
        return float(self.distance_mm(np.array(ball.centre_mm))) - ball.radius_mm + ball.uneven_mm

    @property
    def media(self) -> tuple[tuple[str, Medium], ...]:
        """Media in the body, from the outside in, with what is said of each; none in an opaque one."""
        return ()

    def with_media(self, media: Iterable[Medium]) -> Self:
        """Return the body with other media, in the order of `media`."""
        return self

    def numbers(self, wavelength_nm: float) -> tuple[Number, ...]:
        """Numbers of the body itself that a scene fit may find, where frames can show them at all."""
        return ()

    def with_numbers(self, values: Sequence[float], wavelength_nm: float) -> Self:
        """Return the body with other values of its `numbers`, in their order; places and tilts count from here.

        Raises
        ------
        SceneError
            There is no such body.
        """
        return self

    @property
    def event_names(self) -> tuple[str, ...]:
        """Names of all ways through the body, as branches have them."""
        return (self.name,)

    def is_on(self, branch: Iterable[str]) -> bool:
        """Return whether a branch goes through the body, on whatever way."""
        return not set(self.event_names).isdisjoint(branch)

    @property
    def face_names(self) -> tuple[str, ...]:
        """Names of the flat faces that a branch names after the body; empty for a round body."""
        return ()

    @property
    def may_cross_plane(self) -> bool:
        """Return whether the body may reach through the investigation plane."""
        return False

    @property
    def uneven_mm(self) -> float:
        """Largest distance of the surface inside the outline of a body out of round."""
        return 0.0

    @property
    def slope_rad(self) -> float:
        """Uncertainty of the slope of the surface, rms, as the body states it; 0: it is a formula."""
        return 0.0

    @property
    def room(self) -> Room | None:
        """The room behind or inside the body, if it parts the world (``tracer.kernels.rooms``)."""
        return None

    @property
    def carried(self) -> Carrier:
        """Support of the body: it moves with the glass, as balls do, with the camera, or with nothing."""
        return "glass"

    @property
    def stays(self) -> bool:
        """Return whether it is there still when the glass is driven out."""
        return self.carried != "glass"

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Convex parts that cover the body, for keep-out zones."""
        start, end, radius_mm = self.capsule
        return (Piece(np.array(start), np.subtract(end, start)[None], radius_mm),)

    @property
    def outline_mm(self) -> tuple[NDArray[np.float64], float]:
        """Points (K, 3) and a radius: the body lies within the radius of the hull of the points."""
        capsule = self.capsule
        return np.array([capsule.start_mm, capsule.end_mm]), capsule.radius_mm


def translate_by(step_mm: Iterable[float]) -> Callable[[Vector3], Vector3]:
    """Return the movement by a vector (3,) [mm], for `Body.moved`."""
    dx, dy, dz = (float(part) for part in step_mm)
    return lambda point: (point[0] + dx, point[1] + dy, point[2] + dz)


def vector3(values: Iterable[float]) -> Vector3:
    """Three numbers as a tuple."""
    x, y, z = (float(value) for value in values)
    return x, y, z
