"""A dome: a shell of glass between two spheres, with the camera or bodies inside; a flask is one too."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ground.config import Triple
from ground.jit import Array
from tracer.bodies.body import Body, BodySection, Capsule, Carrier, Index, Room, vector3
from tracer.bodies.rim import unit_vector
from tracer.camera import LONGEST_MM, SMALLEST_MM, Vector3, within_reach
from tracer.errors import SceneError
from tracer.kernels.dome import cross_dome, dome_rates, leave_dome, meets_dome
from tracer.kernels.world import KINDS, Kind
from tracer.media import Medium
from tracer.medium_table import MediumTable, Positive, medium_entry, medium_of

WHOLE_DEG = 180.0
UP = (0.0, 0.0, 1.0)
NO_MOUNT = -2.0  # no cosine is so small: nothing of a whole sphere is a mount


class Domes(NamedTuple):
    """Domes for the kernels: rows (N, 14), see ``tracer.kernels.dome``."""

    rows: Array


KINDS[Domes] = Kind(meets_dome, cross_dome, dome_rates, leave_dome)


class DomeSection(BodySection):
    """A dome in a scene file."""

    kind: Literal["dome"]
    centre_mm: Triple
    outer_radius_mm: Positive
    inner_radius_mm: Positive
    inner_centre_mm: Triple | None = None
    axis: Triple | None = None
    half_angle_deg: Annotated[float, Field(gt=0.0, le=WHOLE_DEG)] = WHOLE_DEG
    material: str | MediumTable
    filled: str | MediumTable | None = None
    carried_by: Carrier = "bench"

    def body(self, name: str, media: Mapping[str, Medium]) -> "Dome":
        """Return the dome described.

        Raises
        ------
        SceneError
            It cannot be; names the part at fault.
        """
        filled = None if self.filled is None else medium_of(self.filled, media)
        inner = None if self.inner_centre_mm is None else vector3(self.inner_centre_mm)
        if (self.axis is None) != (self.half_angle_deg == WHOLE_DEG):
            raise SceneError(
                f"dome {name!r}: axis and half_angle_deg say together how far it is glass; give both or neither"
            )
        axis = UP if self.axis is None else unit_vector(self.axis, f"dome {name!r}: axis")
        return Dome(
            name, vector3(self.centre_mm), self.outer_radius_mm, self.inner_radius_mm,
            medium_of(self.material, media), filled, inner, axis, self.half_angle_deg, self.carried_by,
        )  # fmt: skip


@dataclass(frozen=True)
class Dome(Body):
    """A shell of glass between two spheres.

    Parameters
    ----------
    name : str
        Name in messages, branches and files; unique in its scene.
    centre_mm : (float, float, float)
        Centre of the outer sphere.
    outer_radius_mm, inner_radius_mm : float
        Radii of the shell.
    medium : Medium
        The glass.
    filled : Medium or None
        What is in the dome; None: what is around it.
    inner_centre_mm : (float, float, float) or None
        Centre of the inner sphere; None: concentric.
    axis : (float, float, float)
        Unit vector from the centre to the middle of the part that is glass.
    half_angle_deg : float
        How far from the axis the glass reaches, seen from the centre; beyond is its opaque mount, 180: none.
    carried_by : "bench", "glass" or "camera"
        What it moves with on a bench.
    """

    kind: ClassVar[str] = "dome"
    Section: ClassVar[type[BodySection]] = DomeSection

    name: str
    centre_mm: Vector3
    outer_radius_mm: float
    inner_radius_mm: float
    medium: Medium
    filled: Medium | None = None
    inner_centre_mm: Vector3 | None = None
    axis: Vector3 = UP
    half_angle_deg: float = WHOLE_DEG
    carried_by: Carrier = "bench"

    def __post_init__(self) -> None:
        if not SMALLEST_MM <= self.inner_radius_mm < self.outer_radius_mm <= LONGEST_MM:
            raise SceneError(
                f"dome {self.name!r}: inner_radius_mm must be {SMALLEST_MM:g} mm at least and less than"
                f" outer_radius_mm, {self.outer_radius_mm:g} mm, not {self.inner_radius_mm:g} mm"
            )
        if not within_reach(self.centre_mm):
            raise SceneError(f"dome {self.name!r}: centre_mm must lie within {LONGEST_MM:g} mm of the origin")
        if not math.dist(self.inside_mm, self.centre_mm) + self.inner_radius_mm < self.outer_radius_mm:
            raise SceneError(
                f"dome {self.name!r}: the inner sphere reaches through the outer one; move inner_centre_mm towards"
                " centre_mm or make the wall thicker"
            )

    @property
    def inside_mm(self) -> Vector3:
        """Centre of the inner sphere."""
        return self.centre_mm if self.inner_centre_mm is None else self.inner_centre_mm

    @classmethod
    def table_of(cls, bodies: Iterable[Self], index: Index) -> Domes:
        """Domes for the kernels."""
        rows = [
            [
                *dome.centre_mm, *dome.inside_mm, dome.outer_radius_mm, dome.inner_radius_mm,
                index(dome, dome.medium), index(dome, dome.filled), *dome.axis,
                NO_MOUNT if dome.half_angle_deg == WHOLE_DEG else math.cos(math.radians(dome.half_angle_deg)),
            ]
            for dome in bodies
        ]  # fmt: skip
        return Domes(np.array(rows).reshape(-1, 14))

    def section(self) -> dict[str, Any]:
        """Return the dome as a scene file has it."""
        inner = {} if self.inner_centre_mm is None else {"inner_centre_mm": list(self.inner_centre_mm)}
        whole = self.half_angle_deg == WHOLE_DEG
        mount = {} if whole else {"axis": list(self.axis), "half_angle_deg": self.half_angle_deg}
        filled = {} if self.filled is None else {"filled": medium_entry(self.filled)}
        filled |= {} if self.carried_by == "bench" else {"carried_by": self.carried_by}
        radii = {"outer_radius_mm": self.outer_radius_mm, "inner_radius_mm": self.inner_radius_mm}
        place = {"centre_mm": list(self.centre_mm), **radii, **inner, **mount}
        return {"name": self.name, "kind": self.kind, **place, "material": medium_entry(self.medium), **filled}

    @property
    def carried(self) -> Carrier:
        """Support that it moves with."""
        return self.carried_by

    @property
    def capsule(self) -> Capsule:
        """The outer ball."""
        return Capsule(self.centre_mm, self.centre_mm, self.outer_radius_mm)

    def distance_mm(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from the shell, its mount included, to points (..., 3); negative in it."""
        outer = np.linalg.norm(points_mm - np.array(self.centre_mm), axis=-1) - self.outer_radius_mm
        inner = self.inner_radius_mm - np.linalg.norm(points_mm - np.array(self.inside_mm), axis=-1)
        return np.asarray(np.maximum(outer, inner))

    def moved(self, to: Callable[[Vector3], Vector3]) -> Self:
        """Return the dome with both spheres moved."""
        centre, top = to(self.centre_mm), to(vector3(np.array(self.centre_mm) + np.array(self.axis)))
        inner = None if self.inner_centre_mm is None else to(self.inner_centre_mm)
        axis = vector3(np.array(top) - np.array(centre))
        return replace(self, centre_mm=centre, inner_centre_mm=inner, axis=axis)

    @property
    def media(self) -> tuple[tuple[str, Medium], ...]:
        """The glass, and what is inside if that is said."""
        filled = () if self.filled is None else ((f"in dome {self.name!r}", self.filled),)
        return ((f"dome {self.name!r}", self.medium), *filled)

    def with_media(self, media: Iterable[Medium]) -> Self:
        """Return the dome of other media."""
        own, *filled = media
        return replace(self, medium=own, filled=filled[0] if filled else None)

    @property
    def event_names(self) -> tuple[str, ...]:
        """Through the glass alone, and reflected by its inside."""
        return self.name, f"{self.name} off inside"

    @property
    def may_cross_plane(self) -> bool:
        """A flask may: what flows in it is looked at inside."""
        return True

    @property
    def room(self) -> Room:
        """The inside."""
        return Room(self.filled, self._gaps_mm, surrounds=True)

    def _gaps_mm(self, corners_mm: NDArray[np.float64], radius_mm: float) -> tuple[float, float]:
        from_centre = corners_mm - np.array(self.centre_mm)
        towards = from_centre.mean(axis=0)
        far = float(np.linalg.norm(towards))
        outside = float((from_centre @ (towards / far)).min()) if far > 0.0 else 0.0
        deepest = float(np.linalg.norm(corners_mm - np.array(self.inside_mm), axis=1).max())
        return outside - self.outer_radius_mm - radius_mm, self.inner_radius_mm - deepest - radius_mm
