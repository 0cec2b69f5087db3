"""An opaque rod with round ends: a support that hides part of the view."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.camera import LONGEST_MM, SMALLEST_MM, Vector3, within_reach
from tracer.errors import SceneError


@dataclass(frozen=True)
class Rod:
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

    @property
    def lowest_mm(self) -> float:
        """Smallest z of the body."""
        return min(self.start_mm[2], self.end_mm[2]) - self.radius_mm

    @property
    def highest_mm(self) -> float:
        """Largest z of the body."""
        return max(self.start_mm[2], self.end_mm[2]) + self.radius_mm

    def distance_mm(self, point_mm: NDArray[np.float64]) -> float:
        """Distance from the surface to a point (3,), negative inside."""
        start, end = np.array(self.start_mm), np.array(self.end_mm)
        axis = end - start
        length2 = float(axis @ axis)
        along = float(np.clip((point_mm - start) @ axis / length2, 0.0, 1.0)) if length2 > 0.0 else 0.0
        return float(np.linalg.norm(point_mm - start - along * axis)) - self.radius_mm
