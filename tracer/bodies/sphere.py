"""A sphere, solid or with others inside it, of glass or opaque."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.camera import LONGEST_MM, SMALLEST_MM, Vector3, within_reach
from tracer.errors import SceneError
from tracer.media import Medium


@dataclass(frozen=True)
class Core:
    """A sphere inside another one, about the same centre: the gas in a hollow ball.

    Parameters
    ----------
    radius_mm : float
        Radius, smaller than that of what it is in.
    medium : Medium
        What it is made of.
    """

    radius_mm: float
    medium: Medium


@dataclass(frozen=True)
class Sphere:
    """A sphere.

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
    cores : tuple of Core
        What is inside it, about the same centre, from the outside in.
    """

    name: str
    centre_mm: Vector3
    radius_mm: float
    medium: Medium | None
    cores: tuple[Core, ...] = ()

    def __post_init__(self) -> None:
        if not (SMALLEST_MM <= self.radius_mm <= LONGEST_MM):
            raise SceneError(
                f"sphere {self.name!r}: radius_mm must be positive, {SMALLEST_MM:g} to {LONGEST_MM:g} mm"
            )
        if not within_reach(self.centre_mm):
            raise SceneError(f"sphere {self.name!r}: centre_mm must lie within {LONGEST_MM:g} mm of the origin")
        if self.cores and self.medium is None:
            text = f"sphere {self.name!r} is opaque: nothing in it can be seen; leave its core out"
            raise SceneError(problems=[("core", text)])
        around = self.radius_mm
        for depth, core in enumerate(self.cores, start=1):
            if not SMALLEST_MM <= core.radius_mm < around:
                text = (
                    f"sphere {self.name!r}: the radius of a core must be {SMALLEST_MM:g} mm at least and less than"
                    f" the {around:g} mm of what it is in, not {core.radius_mm:g} mm"
                )
                raise SceneError(problems=[(".".join(["core"] * depth), text)])
            around = core.radius_mm

    @property
    def event_names(self) -> tuple[str, ...]:
        """Names of all ways through the sphere."""
        return tuple(self.event_name(way) for way in range(2 * len(self.cores) + 1))

    def is_on(self, branch: Iterable[str]) -> bool:
        """Whether a branch goes through the sphere, on whatever way."""
        return not set(self.event_names).isdisjoint(branch)

    def event_name(self, way: int) -> str:
        """Name of a way through the sphere, as ``tracer.kernels.shell`` counts them: the part of a branch.

        Its own name beside all cores; "NAME core" through the core, "NAME off core" totally reflected at it;
        "NAME core 2" ... for those further in.
        """
        if way == 0:
            return self.name
        which = (way + 1) // 2
        return f"{self.name} {'core' if way % 2 else 'off core'}{'' if which == 1 else f' {which}'}"

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
