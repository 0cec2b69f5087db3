"""A sphere, solid or with others inside it, of glass or opaque; or a solid ball a little out of round."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from ground.config import Table, Triple
from ground.jit import Array
from tracer.bodies.body import CONTACT_TOL_MM, Ball, Body, BodySection, Capsule, Index, vector3
from tracer.bodies.shape import Shape, ShapeTable, reach_mm, shape_section
from tracer.camera import LONGEST_MM, SMALLEST_MM, Vector3, within_reach
from tracer.errors import SceneError
from tracer.harmonics import COUNT, bending_mm, largest_mm, rotate_harmonics, values
from tracer.kernels.sphere import REFRACTIVE_INDEX, SOLID
from tracer.media import Medium
from tracer.medium_table import OPAQUE, MediumTable, Positive, medium_entry, medium_of

UNTURNED = 1e-9  # what rounding makes of a movement without a turn


class CoreSection(Table):
    """Core of a sphere, about the same centre; it may have a core itself."""

    radius_mm: Positive
    material: str | MediumTable
    core: "CoreSection | None" = None


class SphereSection(BodySection):
    """A sphere."""

    kind: Literal["sphere"]
    centre_mm: Triple
    radius_mm: Positive
    material: str | MediumTable
    core: CoreSection | None = None
    shape: ShapeTable | None = None

    def body(self, name: str, media: Mapping[str, Medium]) -> "Sphere":
        """Return the sphere described.

        Raises
        ------
        SceneError
            It cannot be; names the part at fault, such as ``core``.
        """
        medium = None if self.material == OPAQUE else medium_of(self.material, media)
        radius_mm, shape = self.radius_mm, Shape()
        if self.shape is not None:
            radius_mm, shape = self.shape.radius_and_shape(name, radius_mm)
        return Sphere(name, vector3(self.centre_mm), radius_mm, medium, self._cores(name, media), shape)

    def _cores(self, name: str, media: Mapping[str, Medium]) -> tuple["Core", ...]:
        """Cores from the outside in."""
        cores, table, part = [], self.core, "core"
        while table is not None:
            try:
                if table.material == OPAQUE:
                    raise SceneError(f"a core of sphere {name!r} cannot be opaque; give it a medium")
                cores.append(Core(table.radius_mm, medium_of(table.material, media)))
            except SceneError as error:
                raise SceneError(problems=[(f"{part}.material", str(error))]) from None
            table, part = table.core, f"{part}.core"
        return tuple(cores)


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
class Sphere(Body):
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
    shape_um : tuple of float
        How far a ball is out of round: coefficients in the order of `tracer.harmonics.NAMES`; empty for a sphere.
    """

    kind: ClassVar[str] = "sphere"
    Section: ClassVar[type[BodySection]] = SphereSection

    name: str
    centre_mm: Vector3
    radius_mm: float
    medium: Medium | None
    cores: tuple[Core, ...] = ()
    shape_um: Shape = ()

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
        if self.shape_um and not any(self.shape_um):
            object.__setattr__(self, "shape_um", ())
        if self.shape_um:
            self._check_shape()

    def _check_shape(self) -> None:
        """Refuse a shape that cannot be traced."""
        if len(self.shape_um) != COUNT or not np.isfinite(self.shape_um).all():
            raise SceneError(problems=[("shape", f"sphere {self.name!r}: a shape is {COUNT} finite numbers")])
        if self.cores:
            text = f"sphere {self.name!r}: a ball with a shape has no core here; leave one of them out"
            raise SceneError(problems=[("shape", text)])
        bend_mm = float(bending_mm(self.shape_mm))
        if not bend_mm <= self.radius_mm:
            text = (
                f"sphere {self.name!r}: a ball of {self.radius_mm:g} mm with heights of"
                f" {float(largest_mm(self.shape_mm)):.3g} mm may have dents, which are not traced;"
                " harmonics_um are micrometres: are they too large?"
            )
            raise SceneError(problems=[("shape", text)])

    @property
    def shape_mm(self) -> NDArray[np.float64]:
        """Coefficients (45,) [mm], zeros for a sphere."""
        return 1e-3 * np.array(self.shape_um or (0.0,) * COUNT)

    @property
    def may_be_uneven(self) -> bool:
        """Return whether a fit could find a shape: of solid glass."""
        return self.medium is not None and not self.cores

    @property
    def uneven_mm(self) -> float:
        """Largest deviation of the surface from the radius; 0 for a sphere."""
        return float(largest_mm(self.shape_mm)) if self.shape_um else 0.0

    def radius_towards_mm(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from the centre to the surface in unit directions (..., 3)."""
        if not self.shape_um:
            return np.full(directions.shape[:-1], self.radius_mm)
        return np.asarray(self.radius_mm + values(directions) @ self.shape_mm)

    @classmethod
    def table_of(cls, bodies: Iterable[Self], index: Index) -> Array:
        """Spheres for the kernels: (N, 6) float64, rows x, y, z, radius [mm], n / n around, opaque (0 or 1).

        Longer where there are cores: radius [mm], n / n around of each follow, inwards; radius 0 is none.
        """
        spheres = tuple(bodies)
        most_cores = max((len(sphere.cores) for sphere in spheres), default=0)
        table = np.tile((0.0, 1.0), (len(spheres), SOLID // 2 + most_cores))
        for row, sphere in zip(table, spheres, strict=True):
            row[:SOLID] = (*sphere.centre_mm, sphere.radius_mm, 1.0, float(sphere.medium is None))
            if sphere.medium is not None:
                row[REFRACTIVE_INDEX] = index(sphere, sphere.medium)
            for k, core in enumerate(sphere.cores):
                row[SOLID + 2 * k :][:2] = core.radius_mm, index(sphere, core.medium)
        return table

    def section(self) -> dict[str, Any]:
        """Return the sphere as a scene file has it, its cores in one another."""
        inside: dict[str, Any] = {}
        for core in reversed(self.cores):
            inside = {"core": {"radius_mm": core.radius_mm, "material": medium_entry(core.medium), **inside}}
        place = {"name": self.name, "kind": self.kind, "centre_mm": list(self.centre_mm)}
        material = OPAQUE if self.medium is None else medium_entry(self.medium)
        shape = {"shape": shape_section(self.shape_um)} if self.shape_um else {}
        return {**place, "radius_mm": self.radius_mm, "material": material, **inside, **shape}

    @property
    def capsule(self) -> Capsule:
        """The sphere itself, or one around the ball."""
        return Capsule(self.centre_mm, self.centre_mm, self.radius_mm + self.uneven_mm)

    @property
    def lowest_mm(self) -> float:
        """Smallest z of the sphere."""
        return self.centre_mm[2] - self._reach_mm(-1.0)

    @property
    def highest_mm(self) -> float:
        """Largest z of the sphere."""
        return self.centre_mm[2] + self._reach_mm(1.0)

    @property
    def may_cross_plane(self) -> bool:
        """Return whether the body may reach through the investigation plane."""
        return True

    def _reach_mm(self, side: float) -> float:
        """Reach of the ball along z, up (1) or down (-1)."""
        return reach_mm(self.radius_mm, self.shape_um, side) if self.shape_um else self.radius_mm

    def distance_mm(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from the surface to points (..., 3), negative inside; of a shape along its radius."""
        off = points_mm - np.array(self.centre_mm)
        away = np.linalg.norm(off, axis=-1)
        if not self.shape_um:
            return np.asarray(away - self.radius_mm)
        return np.asarray(away - self.radius_towards_mm(off / np.maximum(away, SMALLEST_MM)[..., None]))

    def gap_to_ball_mm(self, ball: Ball) -> float:
        """Distance between balls; out of round, along the line of their centres, where balls apart have a gap."""
        if not (self.shape_um or ball.shape_um):
            return super().gap_to_ball_mm(ball)
        centre = np.array(ball.centre_mm)
        apart = np.array(self.centre_mm) - centre
        back = apart / max(float(np.linalg.norm(apart)), CONTACT_TOL_MM)
        return float(self.distance_mm(centre)) - float(ball.radius_towards_mm(back))

    def moved(self, to: Callable[[Vector3], Vector3]) -> Self:
        """Return the sphere with its centre moved, and its shape turned with it."""
        centre = to(self.centre_mm)
        if not self.shape_um:
            return replace(self, centre_mm=centre)
        x, y, z = self.centre_mm
        ahead = np.array([to((x + 1.0, y, z)), to((x, y + 1.0, z)), to((x, y, z + 1.0))]) - np.array(centre)
        if np.abs(ahead - np.eye(3)).max() < UNTURNED:
            return replace(self, centre_mm=centre)
        shape = rotate_harmonics(np.array(self.shape_um), ahead.T)
        return replace(self, centre_mm=centre, shape_um=tuple(shape.tolist()))

    @property
    def media(self) -> tuple[tuple[str, Medium], ...]:
        """Its own medium and those of its cores; none if it is opaque."""
        if self.medium is None:
            return ()
        of_cores = ((f"core of sphere {self.name!r}", core.medium) for core in self.cores)
        return ((f"sphere {self.name!r}", self.medium), *of_cores)

    def with_media(self, media: Iterable[Medium]) -> Self:
        """Return the sphere made of other media, itself first, then its cores."""
        if self.medium is None:
            return self
        own, *inner = media
        cores = tuple(replace(core, medium=medium) for core, medium in zip(self.cores, inner, strict=True))
        return replace(self, medium=own, cores=cores)

    @property
    def event_names(self) -> tuple[str, ...]:
        """Names of all ways through the sphere."""
        return tuple(self.event_name(way) for way in range(2 * len(self.cores) + 1))

    def event_name(self, way: int) -> str:
        """Name of a way through the sphere, as ``tracer.kernels.sphere`` counts them: the part of a branch.

        Its own name beside all cores; "NAME core" through the core, "NAME off core" totally reflected at it;
        "NAME core 2" ... for those further in.
        """
        if way == 0:
            return self.name
        which = (way + 1) // 2
        return f"{self.name} {'core' if way % 2 else 'off core'}{'' if which == 1 else f' {which}'}"
