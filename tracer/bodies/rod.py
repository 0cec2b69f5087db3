"""An opaque rod with round ends: a support that hides part of the view."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from ground.config import Triple
from ground.jit import Array, kernel
from tracer.bodies.body import Body, BodySection, Capsule, Index, vector3
from tracer.camera import LONGEST_MM, SMALLEST_MM, Vector3, within_reach
from tracer.errors import SceneError
from tracer.kernels.vectors import Vector, dot, move, subtract, vector_at
from tracer.kernels.world import KINDS, Kind
from tracer.media import Medium
from tracer.medium_table import Positive


@kernel
def meets_rod(p: Vector, d: Vector, rod: Array) -> float:
    """Distance along the half-line p + t d, t >= 0, to its closest approach if that lies in the rod, else inf.

    Closest approach of a half-line and a segment: minimise |w + t d - s e|^2, w = p - start, e the axis,
    over t >= 0 and 0 <= s <= 1.  The function is convex, so clamping s and solving for t again suffices.
    """
    start, radius = vector_at(rod, 0), rod[6]
    e, w = subtract(vector_at(rod, 3), start), subtract(p, start)
    ee, de, wd, we = dot(e, e), dot(d, e), dot(w, d), dot(w, e)
    across = ee - de * de
    s = 0.0
    if across > 1e-14 * ee:  # else parallel: either end will do
        s = (we - wd * de) / across
    s = min(max(s, 0.0), 1.0)
    t = s * de - wd
    if t < 0.0:
        t = 0.0
        if ee > 0.0:
            s = min(max(we / ee, 0.0), 1.0)
    g = move(move(w, t, d), -s, e)
    return float(t) if dot(g, g) < radius * radius else math.inf


class Rods(NamedTuple):
    """Rods for the kernels: rows (N, 7) start x, y, z, end x, y, z, radius [mm]."""

    rows: Array


KINDS[Rods] = Kind(meets_rod)


class RodSection(BodySection):
    """A rod in a scene file."""

    kind: Literal["rod"]
    start_mm: Triple
    end_mm: Triple
    radius_mm: Positive

    def body(self, name: str, media: Mapping[str, Medium]) -> "Rod":
        """Return the rod described."""
        return Rod(name, vector3(self.start_mm), vector3(self.end_mm), self.radius_mm)


@dataclass(frozen=True)
class Rod(Body):
    """An opaque rod: every point within `radius_mm` of the segment `start_mm`-`end_mm`.

    Parameters
    ----------
    name : str
        Name in messages and files; unique in its scene.
    start_mm, end_mm : (float, float, float)
        Ends of the axis in world coordinates; equal ends make a ball.
    radius_mm : float
        Radius.
    """

    kind: ClassVar[str] = "rod"
    Section: ClassVar[type[BodySection]] = RodSection

    name: str
    start_mm: Vector3
    end_mm: Vector3
    radius_mm: float

    def __post_init__(self) -> None:
        if not (SMALLEST_MM <= self.radius_mm <= LONGEST_MM):
            raise SceneError(
                f"rod {self.name!r}: radius_mm must be positive, {SMALLEST_MM:g} to {LONGEST_MM:g} mm"
            )
        if not (within_reach(self.start_mm) and within_reach(self.end_mm)):
            raise SceneError(
                f"rod {self.name!r}: start_mm and end_mm must lie within {LONGEST_MM:g} mm of the origin"
            )

    @classmethod
    def table_of(cls, bodies: Iterable[Self], index: Index) -> Rods:
        """Rods for the kernels."""
        return Rods(np.array([[*rod.start_mm, *rod.end_mm, rod.radius_mm] for rod in bodies]).reshape(-1, 7))

    def section(self) -> dict[str, Any]:
        """Return the rod as a scene file has it."""
        ends = {"start_mm": list(self.start_mm), "end_mm": list(self.end_mm)}
        return {"name": self.name, "kind": self.kind, **ends, "radius_mm": self.radius_mm}

    @property
    def capsule(self) -> Capsule:
        """The rod itself."""
        return Capsule(self.start_mm, self.end_mm, self.radius_mm)

    def moved(self, to: Callable[[Vector3], Vector3]) -> Self:
        """Return the rod with both ends moved."""
        return replace(self, start_mm=to(self.start_mm), end_mm=to(self.end_mm))
