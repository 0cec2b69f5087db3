"""A window: a plane round plate of glass in a wall, with another medium behind it if need be."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ground.config import Triple
from ground.jit import Array
from tracer.bodies.body import Body, BodySection, Capsule, Carrier, Index, Number, Piece, Room, vector3
from tracer.bodies.rim import disc, leaning, of_ring, rims, sideways, unit_vector
from tracer.camera import LONGEST_MM, SMALLEST_MM, Vector3, within_reach
from tracer.errors import SceneError
from tracer.kernels.window import cross_window, leave_window, meets_window, window_rates
from tracer.kernels.world import KINDS, Kind
from tracer.media import Medium, shifted
from tracer.medium_table import MediumTable, Positive, medium_entry, medium_of


class Windows(NamedTuple):
    """Windows for the kernels: rows (N, 10), see ``tracer.kernels.window``."""

    rows: Array


ROW = ("x", "y", "z", "normal_x", "normal_y", "normal_z", "thickness", "n", "n_behind", "radius")
KINDS[Windows] = Kind(meets_window, cross_window, window_rates, leave_window, ROW)


class WindowSection(BodySection):
    """A window in a scene file."""

    kind: Literal["window"]
    centre_mm: Triple
    normal: Triple
    thickness_mm: Positive
    radius_mm: Positive
    material: str | MediumTable
    behind: str | MediumTable | None = None
    carried_by: Carrier = "bench"

    def body(self, name: str, media: Mapping[str, Medium]) -> "Window":
        """Return the window described.

        Raises
        ------
        SceneError
            It cannot be; names the part at fault.
        """
        behind = None if self.behind is None else medium_of(self.behind, media)
        normal = unit_vector(self.normal, f"window {name!r}: normal")
        material = medium_of(self.material, media)
        place = vector3(self.centre_mm), normal, self.thickness_mm, self.radius_mm
        return Window(name, *place, material, behind, self.carried_by)


@dataclass(frozen=True)
class Window(Body):
    """A plane plate in an opaque wall; what stands behind it is seen through it alone.

    Parameters
    ----------
    name : str
        Name in messages and files; unique in its scene.
    centre_mm : (float, float, float)
        Middle of the face towards the camera.
    normal : (float, float, float)
        Unit normal of the faces, towards the camera.
    thickness_mm : float
        Thickness.
    radius_mm : float
        Radius of the free opening; what passes beside it is lost.
    medium : Medium
        The glass.
    behind : Medium or None
        What fills the room behind; None: what is before it.
    carried_by : "bench", "glass" or "camera"
        What it moves with on a bench.
    """

    kind: ClassVar[str] = "window"
    Section: ClassVar[type[BodySection]] = WindowSection
    undetermined_note: ClassVar[str] = (
        "n and thickness count as one; between equal media its distance moves no ray"
    )

    name: str
    centre_mm: Vector3
    normal: Vector3
    thickness_mm: float
    radius_mm: float
    medium: Medium
    behind: Medium | None = None
    carried_by: Carrier = "bench"

    def __post_init__(self) -> None:
        if not (SMALLEST_MM <= self.thickness_mm <= LONGEST_MM and SMALLEST_MM <= self.radius_mm <= LONGEST_MM):
            raise SceneError(
                f"window {self.name!r}: thickness_mm and radius_mm must be {SMALLEST_MM:g} to {LONGEST_MM:g} mm"
            )
        if not within_reach(self.centre_mm):
            raise SceneError(f"window {self.name!r}: centre_mm must lie within {LONGEST_MM:g} mm of the origin")

    @classmethod
    def table_of(cls, bodies: Iterable[Self], index: Index) -> Windows:
        """Windows for the kernels."""
        rows = [
            [*w.centre_mm, *w.normal, w.thickness_mm, index(w, w.medium), index(w, w.behind), w.radius_mm]
            for w in bodies
        ]
        return Windows(np.array(rows).reshape(-1, 10))

    def section(self) -> dict[str, Any]:
        """Return the window as a scene file has it."""
        behind = {} if self.behind is None else {"behind": medium_entry(self.behind)}
        behind |= {} if self.carried_by == "bench" else {"carried_by": self.carried_by}
        size = {"thickness_mm": self.thickness_mm, "radius_mm": self.radius_mm}
        place = {"centre_mm": list(self.centre_mm), "normal": list(self.normal)}
        return {
            "name": self.name, "kind": self.kind, **place, **size, "material": medium_entry(self.medium), **behind
        }  # fmt: skip

    @property
    def capsule(self) -> Capsule:
        """A ball around the plate: no good bound, see `distance_mm`."""
        middle = self._inwards(0.5 * self.thickness_mm)
        return Capsule(middle, middle, math.hypot(self.radius_mm, 0.5 * self.thickness_mm))

    @property
    def carried(self) -> Carrier:
        """Support that it moves with."""
        return self.carried_by

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """The plate, its rim rounded outwards."""
        edges = disc(self.normal, self.radius_mm)
        middle = np.array(self._inwards(0.5 * self.thickness_mm))
        return (Piece(middle - 0.5 * edges.sum(axis=0), edges, 0.5 * self.thickness_mm),)

    @property
    def outline_mm(self) -> tuple[NDArray[np.float64], float]:
        """Points of both rims."""
        return rims(self.centre_mm, self._inwards(self.thickness_mm), self.radius_mm), 0.0

    def distance_mm(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from the plate to points (..., 3), negative inside."""
        w, normal = points_mm - np.array(self.centre_mm), np.array(self.normal)
        along = w @ normal
        over = np.maximum(along, -along - self.thickness_mm)
        beside = np.linalg.norm(w - along[..., None] * normal, axis=-1) - self.radius_mm
        return of_ring(over, beside)

    def moved(self, to: Callable[[Vector3], Vector3]) -> Self:
        """Return the window with both faces moved."""
        centre, ahead = to(self.centre_mm), to(self._inwards(-1.0))
        return replace(self, centre_mm=centre, normal=vector3(np.array(ahead) - np.array(centre)))

    @property
    def media(self) -> tuple[tuple[str, Medium], ...]:
        """The glass, and what is behind if that is said."""
        behind = () if self.behind is None else ((f"behind window {self.name!r}", self.behind),)
        return ((f"window {self.name!r}", self.medium), *behind)

    def with_media(self, media: Iterable[Medium]) -> Self:
        """Return the window of other media."""
        own, *behind = media
        return replace(self, medium=own, behind=behind[0] if behind else None)

    def numbers(self, wavelength_nm: float) -> tuple[Number, ...]:
        """Tilt, thickness and n; the distance too where another medium is behind: else no ray feels it."""
        tilts = [Number(f"tilt_{axis}", 0.0, "tilt_deg") for axis in sideways(self.normal)[0]]
        size = Number("thickness", self.thickness_mm, "thickness_mm")
        own = (*tilts, size, Number("n", self.medium.n(wavelength_nm), "n"))
        far = Number("distance", float(np.array(self.centre_mm) @ np.array(self.normal)), "place_mm")
        return own if self.behind is None else (far, *own)

    def with_numbers(self, values: Sequence[float], wavelength_nm: float) -> Self:
        """Return the window turned about the middle of its front face, and moved along its normal."""
        *far, first, second, thickness, n = values
        centre = np.array(self.centre_mm)
        if far:
            normal = np.array(self.normal)
            centre += (far[0] - float(centre @ normal)) * normal
        medium = shifted(self.medium, n - self.medium.n(wavelength_nm))
        turned = leaning(self.normal, (first, second))
        return replace(self, centre_mm=vector3(centre), normal=turned, thickness_mm=thickness, medium=medium)

    @property
    def room(self) -> Room:
        """All that lies behind the plate's plane."""
        return Room(self.behind, self._gaps_mm, surrounds=False)

    def _gaps_mm(self, corners_mm: NDArray[np.float64], radius_mm: float) -> tuple[float, float]:
        heights = (corners_mm - np.array(self.centre_mm)) @ np.array(self.normal)
        return float(heights.min()) - radius_mm, -float(heights.max()) - radius_mm - self.thickness_mm

    def _inwards(self, depth_mm: float) -> Vector3:
        """Point on the axis of the plate, so far behind its front face."""
        return vector3(np.array(self.centre_mm) - depth_mm * np.array(self.normal))
