"""A solid sphere, of glass or opaque."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.camera import LONGEST_MM, SMALLEST_MM, Vector3, within_reach
from tracer.errors import SceneError
from tracer.media import Medium


@dataclass(frozen=True)
class Sphere:
    """A solid sphere.

    Parameters
    ----------
    name : str
        Name in messages, branches and files; unique in its scene.
    centre_mm : (float, float, float)
        Centre in world coordinates.
    radius_mm : float
        Radius.
    medium : Medium or None
        What it is made of; None is opaque.
    """

    name: str
    centre_mm: Vector3
    radius_mm: float
    medium: Medium | None

    def __post_init__(self) -> None:
        if not (SMALLEST_MM <= self.radius_mm <= LONGEST_MM):
            raise SceneError(
                f"sphere {self.name!r}: radius_mm must be positive, {SMALLEST_MM:g} to {LONGEST_MM:g} mm"
            )
        if not within_reach(self.centre_mm):
            raise SceneError(f"sphere {self.name!r}: centre_mm must lie within {LONGEST_MM:g} mm of the origin")

    @property
    def lowest_mm(self) -> float:
        """Smallest z of the body."""
        return self.centre_mm[2] - self.radius_mm

    @property
    def highest_mm(self) -> float:
        """Largest z of the body."""
        return self.centre_mm[2] + self.radius_mm

    def distance_mm(self, point_mm: NDArray[np.float64]) -> float:
        """Distance from the surface to a point (3,), negative inside."""
        return float(np.linalg.norm(point_mm - np.array(self.centre_mm))) - self.radius_mm
