"""A tube: a cylindrical wall of glass, filled with another medium if need be, with bodies inside.

A tube without a hole is a rod of glass: nothing is in it.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ground.config import Triple
from ground.jit import Array
from tracer.bodies.body import Body, BodySection, Capsule, Carrier, Index, Number, Piece, Room, vector3
from tracer.bodies.rim import SHORTEST, leaning, of_ring, rims, sideways
from tracer.camera import LONGEST_MM, SMALLEST_MM, Vector3, within_reach
from tracer.errors import SceneError
from tracer.kernels.tube import cross_tube, leave_tube, meets_tube, tube_rates
from tracer.kernels.world import KINDS, Kind
from tracer.media import Medium, shifted
from tracer.medium_table import MediumTable, Positive, medium_entry, medium_of

STAVES = 32  # of a wall: they stand out by 0.5 % of its radius


class Tubes(NamedTuple):
    """Tubes for the kernels: rows (N, 11), see ``tracer.kernels.tube``."""

    rows: Array


ROW = ("x", "y", "z", "axis_x", "axis_y", "axis_z", "length", "outer_radius", "inner_radius", "n", "n_filled")
KINDS[Tubes] = Kind(meets_tube, cross_tube, tube_rates, leave_tube, ROW)


class TubeSection(BodySection):
    """A tube in a scene file."""

    kind: Literal["tube"]
    start_mm: Triple
    end_mm: Triple
    outer_radius_mm: Positive
    inner_radius_mm: Annotated[float, Field(ge=0.0)]
    material: str | MediumTable
    filled: str | MediumTable | None = None
    carried_by: Carrier | None = None

    def body(self, name: str, media: Mapping[str, Medium]) -> "Tube":
        """Return the tube described.

        Raises
        ------
        SceneError
            It cannot be; names the part at fault.
        """
        filled = None if self.filled is None else medium_of(self.filled, media)
        ends, radii = (vector3(self.start_mm), vector3(self.end_mm)), (self.outer_radius_mm, self.inner_radius_mm)
        return Tube(name, *ends, *radii, medium_of(self.material, media), filled, self.carried_by)


@dataclass(frozen=True)
class Tube(Body):
    """A glass tube with open ends, or a glass rod with opaque ones.

    Parameters
    ----------
    name : str
        Name in messages, branches and files; unique in its scene.
    start_mm, end_mm : (float, float, float)
        Ends of the axis.
    outer_radius_mm, inner_radius_mm : float
        Radii of the wall; an inner one of 0 makes a rod.
    medium : Medium
        The glass.
    filled : Medium or None
        What is in the tube; None: what is around it.
    carried_by : "bench", "glass", "camera" or None
        What it moves with on a bench; None: a tube with nothing, a rod with the glass.
    """

    kind: ClassVar[str] = "tube"
    Section: ClassVar[type[BodySection]] = TubeSection
    undetermined_note: ClassVar[str] = "its place along its axis moves no ray"

    name: str
    start_mm: Vector3
    end_mm: Vector3
    outer_radius_mm: float
    inner_radius_mm: float
    medium: Medium
    filled: Medium | None = None
    carried_by: Carrier | None = None

    def __post_init__(self) -> None:
        hollow = self.inner_radius_mm != 0.0
        least_mm = SMALLEST_MM if hollow else 0.0
        if not (least_mm <= self.inner_radius_mm < self.outer_radius_mm <= LONGEST_MM):
            raise SceneError(
                f"tube {self.name!r}: inner_radius_mm must be 0 (a rod) or {SMALLEST_MM:g} mm at least, and less"
                f" than outer_radius_mm, {self.outer_radius_mm:g} mm, not {self.inner_radius_mm:g} mm"
            )
        if self.filled is not None and not hollow:
            raise SceneError(f"tube {self.name!r}: a rod, of inner_radius_mm 0, has no inside; drop filled")
        if not (within_reach(self.start_mm) and within_reach(self.end_mm)):
            raise SceneError(
                f"tube {self.name!r}: start_mm and end_mm must lie within {LONGEST_MM:g} mm of the origin"
            )
        if not math.dist(self.start_mm, self.end_mm) > SHORTEST:
            raise SceneError(f"tube {self.name!r}: start_mm and end_mm must be two points, the ends of its axis")

    @property
    def axis(self) -> Vector3:
        """Unit vector from start to end."""
        step = np.array(self.end_mm) - np.array(self.start_mm)
        return vector3(step / np.linalg.norm(step))

    @property
    def length_mm(self) -> float:
        """Length of the axis."""
        return math.dist(self.start_mm, self.end_mm)

    @classmethod
    def table_of(cls, bodies: Iterable[Self], index: Index) -> Tubes:
        """Tubes for the kernels."""
        rows = [
            [
                *tube.start_mm, *tube.axis, tube.length_mm, tube.outer_radius_mm, tube.inner_radius_mm,
                index(tube, tube.medium), index(tube, tube.filled),
            ]
            for tube in bodies
        ]  # fmt: skip
        return Tubes(np.array(rows).reshape(-1, 11))

    def section(self) -> dict[str, Any]:
        """Return the tube as a scene file has it."""
        filled = {} if self.filled is None else {"filled": medium_entry(self.filled)}
        filled |= {} if self.carried_by is None else {"carried_by": self.carried_by}
        ends = {"start_mm": list(self.start_mm), "end_mm": list(self.end_mm)}
        radii = {"outer_radius_mm": self.outer_radius_mm, "inner_radius_mm": self.inner_radius_mm}
        return {
            "name": self.name, "kind": self.kind, **ends, **radii, "material": medium_entry(self.medium), **filled
        }  # fmt: skip

    @property
    def capsule(self) -> Capsule:
        """A capsule around the tube, round beyond its ends."""
        return Capsule(self.start_mm, self.end_mm, self.outer_radius_mm)

    @property
    def carried(self) -> Carrier:
        """Support that it moves with."""
        return self.carried_by or ("glass" if self.inner_radius_mm == 0.0 else "bench")

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Staves of the wall: planks as thick as it, rounded; the inside is free."""
        if self.inner_radius_mm == 0.0:
            return super().pieces
        _, aside = sideways(self.axis)
        along = self.length_mm * np.array(self.axis)
        half, start = math.pi / STAVES, np.array(self.start_mm)
        middle = 0.5 * (self.outer_radius_mm + self.inner_radius_mm)
        radius_mm = self.outer_radius_mm - middle + middle * (1.0 / math.cos(half) - 1.0)
        pieces = []
        for angle in 2.0 * half * np.arange(STAVES):
            outwards = math.cos(angle) * aside[0] + math.sin(angle) * aside[1]
            wide = 2.0 * middle * math.tan(half) * (math.cos(angle) * aside[1] - math.sin(angle) * aside[0])
            pieces.append(Piece(start + middle * outwards - 0.5 * wide, np.array([along, wide]), radius_mm))
        return tuple(pieces)

    @property
    def outline_mm(self) -> tuple[NDArray[np.float64], float]:
        """Points of both rims."""
        return rims(self.start_mm, self.end_mm, self.outer_radius_mm), 0.0

    def distance_mm(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from the wall to points (..., 3), negative in the glass."""
        w, axis = points_mm - np.array(self.start_mm), np.array(self.axis)
        along = w @ axis
        off = np.linalg.norm(w - along[..., None] * axis, axis=-1)
        aside = np.maximum(off - self.outer_radius_mm, self.inner_radius_mm - off)
        return of_ring(np.maximum(-along, along - self.length_mm), aside)

    def moved(self, to: Callable[[Vector3], Vector3]) -> Self:
        """Return the tube with both ends moved."""
        return replace(self, start_mm=to(self.start_mm), end_mm=to(self.end_mm))

    @property
    def media(self) -> tuple[tuple[str, Medium], ...]:
        """The glass, and what is inside if that is said."""
        filled = () if self.filled is None else ((f"in tube {self.name!r}", self.filled),)
        return ((f"tube {self.name!r}", self.medium), *filled)

    def with_media(self, media: Iterable[Medium]) -> Self:
        """Return the tube of other media."""
        own, *filled = media
        return replace(self, medium=own, filled=filled[0] if filled else None)

    @property
    def _nearest_mm(self) -> float:
        """Place on the axis nearest to the origin, about which the tube is moved and turned."""
        return float(np.clip(-np.array(self.start_mm) @ np.array(self.axis), 0.0, self.length_mm))

    def numbers(self, wavelength_nm: float) -> tuple[Number, ...]:
        """Place and tilt of the axis, radii and n; along its axis a tube may stand anywhere, and a rod is held."""
        if self.room is None:
            return ()
        axes, aside = sideways(self.axis)
        middle = np.array(self.start_mm) + self._nearest_mm * np.array(self.axis)
        places = [Number(axis, float(middle @ way), "place_mm") for axis, way in zip(axes, aside, strict=True)]
        tilts = [Number(f"tilt_{axis}", 0.0, "tilt_deg") for axis in axes]
        outer = Number("outer_radius", self.outer_radius_mm, "radius_mm")
        inner = Number("inner_radius", self.inner_radius_mm, "radius_mm")
        return (*places, *tilts, outer, inner, Number("n", self.medium.n(wavelength_nm), "n"))

    def with_numbers(self, values: Sequence[float], wavelength_nm: float) -> Self:
        """Return the tube moved sideways and turned about the point of its axis nearest to the origin."""
        if not values:
            return self
        one, other, first, second, outer, inner, n = values
        _, aside = sideways(self.axis)
        middle = np.array(self.start_mm) + self._nearest_mm * np.array(self.axis)
        middle = middle + (np.array([one, other]) - aside @ middle) @ aside
        axis = np.array(leaning(self.axis, (first, second)))
        return replace(
            self,
            start_mm=vector3(middle - self._nearest_mm * axis),
            end_mm=vector3(middle + (self.length_mm - self._nearest_mm) * axis),
            outer_radius_mm=outer,
            inner_radius_mm=inner,
            medium=shifted(self.medium, n - self.medium.n(wavelength_nm)),
        )

    @property
    def event_names(self) -> tuple[str, ...]:
        """Through the wall alone, and reflected by its inside."""
        return (self.name,) if self.inner_radius_mm == 0.0 else (self.name, f"{self.name} off inside")

    @property
    def may_cross_plane(self) -> bool:
        """A tube may: what flows in it is looked at inside."""
        return True

    @property
    def room(self) -> Room | None:
        """The inside, if there is one."""
        return None if self.inner_radius_mm == 0.0 else Room(self.filled, self._gaps_mm, surrounds=True)

    def _gaps_mm(self, corners_mm: NDArray[np.float64], radius_mm: float) -> tuple[float, float]:
        start, axis = np.array(self.start_mm), np.array(self.axis)
        along = (corners_mm - start) @ axis
        off = np.linalg.norm(corners_mm - start - along[:, None] * axis, axis=1)
        inside = min(self.inner_radius_mm - off.max(), along.min(), self.length_mm - along.max()) - radius_mm
        middle = corners_mm.mean(axis=0)
        beyond = max(-along.max(), along.min() - self.length_mm)
        towards = middle - start - float((middle - start) @ axis) * axis
        far = float(np.linalg.norm(towards))
        beside = -self.outer_radius_mm
        if far > 0.0:
            beside += float(((corners_mm - start) @ (towards / far)).min())
        return max(float(beyond), beside) - radius_mm, float(inside)
