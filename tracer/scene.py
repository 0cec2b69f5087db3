"""The scene: camera, bodies, ambient medium, wavelength.

The investigation plane is z = 0 and the camera looks at it from z > 0.  Bodies may touch each other, the
plane, and nothing more: contact is legal, overlap is refused.  Bodies wholly behind the plane are legal
and never seen.

A scene is a value: frozen, comparable, with a content hash over every number that changes a ray (names
and the order of the bodies do not).  The hash travels into every map and every corrected frame.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import Body, Rod, Sphere
from tracer.camera import Camera
from tracer.errors import SceneError, StaleMap
from tracer.kernels.shell import SOLID
from tracer.media import LARGEST_INDEX, VACUUM, Medium, check_wavelength

CONTACT_TOL_MM = 1e-6  # a nanometre of overlap is contact: coordinates come from decimal files


class SceneBound:
    """What was made from one scene and serves no other; `scene_hash` says which."""

    scene_hash: str
    noun: ClassVar[str] = "map"
    cure: ClassVar[str] = "trace the scene again"

    def check(self, scene: "Scene") -> None:
        """Refuse to serve another scene.

        Raises
        ------
        StaleMap
            The scene has other numbers than the one this was made from.
        """
        wanted = scene.content_hash()
        if self.scene_hash != wanted:
            raise StaleMap(f"the {self.noun} belongs to scene {self.scene_hash}, not to {wanted}; {self.cure}")


@dataclass(frozen=True)
class Scene:
    """Camera and bodies in front of the investigation plane z = 0.

    Parameters
    ----------
    camera : Camera
        The camera.
    bodies : tuple of Body
        Any order, any arrangement.
    wavelength_nm : float
        Vacuum wavelength at which every index is taken.
    ambient : Medium
        What fills the room between the bodies.

    Raises
    ------
    SceneError
        Bodies overlap, one reaches through the plane, the camera is inside one, n < 1, or two share a name.
    """

    camera: Camera
    bodies: tuple[Body, ...] = ()
    wavelength_nm: float = 532.0
    ambient: Medium = VACUUM

    def __post_init__(self) -> None:
        check_wavelength(self.wavelength_nm)
        problems = [*self._index_problems(), *self._place_problems(), *self._overlap_problems()]
        if problems:
            raise SceneError(problems=problems)

    @property
    def n_ambient(self) -> float:
        """Index of the ambient medium at the scene's wavelength."""
        return self.ambient.n(self.wavelength_nm)

    @property
    def spheres(self) -> tuple[Sphere, ...]:
        """The spheres in front of the plane, in file order."""
        return tuple(body for body in self.bodies if isinstance(body, Sphere) and body.highest_mm > CONTACT_TOL_MM)

    @property
    def rods(self) -> tuple[Rod, ...]:
        """The rods in front of the plane, in file order."""
        return tuple(body for body in self.bodies if isinstance(body, Rod) and body.highest_mm > CONTACT_TOL_MM)

    def with_bodies(self, bodies: Sequence[Body]) -> "Scene":
        """Return the same scene with other bodies."""
        return replace(self, bodies=tuple(bodies))

    def with_camera(self, camera: Camera) -> "Scene":
        """Return the same scene with another camera."""
        return replace(self, camera=camera)

    def sphere_table(self) -> NDArray[np.float64]:
        """Spheres for the kernels: (N, 6) float64, rows x, y, z, radius [mm], n / n_ambient, opaque (0 or 1).

        Longer where there are cores: radius [mm], n / n_ambient of each follow, inwards; radius 0 is none.
        """
        spheres = self.spheres
        table = np.tile((0.0, 1.0), (len(spheres), SOLID // 2 + self._most_cores))
        for row, sphere in zip(table, spheres, strict=True):
            row[:SOLID] = (*sphere.centre_mm, sphere.radius_mm, 1.0, float(sphere.medium is None))
            if sphere.medium is not None:
                row[4] = sphere.medium.n(self.wavelength_nm) / self.n_ambient
            for k, core in enumerate(sphere.cores):
                row[SOLID + 2 * k :][:2] = core.radius_mm, core.medium.n(self.wavelength_nm) / self.n_ambient
        return table

    def event_names(self) -> list[str]:
        """Names of the events that rays number (``tracer.kernels.shell``); branches are made of them."""
        ways = range(2 * self._most_cores + 1)
        return [sphere.event_name(way) for way in ways for sphere in self.spheres]

    def sphere_of(self, event: str) -> Sphere:
        """Return the sphere to which the name of an event belongs."""
        return self.spheres[self.event_names().index(event) % len(self.spheres)]

    @property
    def _most_cores(self) -> int:
        return max((len(sphere.cores) for sphere in self.spheres), default=0)

    def rod_table(self) -> NDArray[np.float64]:
        """Rods for the kernels: (N, 7) float64, rows start x, y, z, end x, y, z, radius [mm]."""
        table = np.empty((len(self.rods), 7))
        for row, rod in zip(table, self.rods, strict=True):
            row[:] = (*rod.start_mm, *rod.end_mm, rod.radius_mm)
        return table

    def content_hash(self) -> str:
        """Hex digest (16 characters) of every number that changes a ray."""
        camera = self.camera
        numbers = [
            [*camera.position_mm, *np.ravel(camera.rotation), camera.focal_px, *camera.principal_px],
            [*map(float, camera.sensor_px), *camera.lens.terms(), self.n_ambient],
        ]
        numbers += sorted([0.0, *row] for row in self.sphere_table().tolist())
        numbers += sorted([1.0, *row] for row in self.rod_table().tolist())
        text = "\n".join(" ".join((float(x) + 0.0).hex() for x in row) for row in numbers)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def _index_problems(self) -> list[tuple[str, str]]:
        media = [("", "ambient", self.ambient)]
        for body in self.bodies:
            if isinstance(body, Sphere) and body.medium is not None:
                media.append((body.name, f"sphere {body.name!r}", body.medium))
                media += [(body.name, f"core of sphere {body.name!r}", core.medium) for core in body.cores]
        problems = []
        for name, who, medium in media:
            try:
                n = medium.n(self.wavelength_nm)
            except SceneError as error:
                problems.append((name, f"{who}: {error}"))
                continue
            if not 1.0 <= n <= LARGEST_INDEX:
                text = f"n = {n:g} at {self.wavelength_nm:g} nm is {'below 1' if n < 1.0 else 'no index'}"
                problems.append((name, f"{who}: {text}; give 1 to {LARGEST_INDEX:g}"))
        return problems

    def _place_problems(self) -> list[tuple[str, str]]:
        camera = np.array(self.camera.position_mm)
        names = [body.name for body in self.bodies]
        problems = [
            (name, f"two bodies are called {name!r}; give each its own name")
            for name in sorted({name for name in names if names.count(name) > 1})
        ]
        ways = {way: body.name for body in self.bodies if isinstance(body, Sphere) for way in body.event_names[1:]}
        problems += [
            (name, f"body {name!r} is called like a way through {ways[name]!r}, which has a core; rename it")
            for name in sorted(set(names) & ways.keys())
        ]
        for body in self.bodies:
            if body.distance_mm(camera) <= 0.0:
                problems.append((body.name, f"the camera is inside body {body.name!r}"))
            if body.lowest_mm < -CONTACT_TOL_MM and body.highest_mm > CONTACT_TOL_MM:
                text = f"body {body.name!r} reaches {-body.lowest_mm:.6g} mm through the investigation plane"
                problems.append((body.name, f"{text}; it may touch z = 0, not cross it"))
        return problems

    def _overlap_problems(self) -> list[tuple[str, str]]:
        spheres = [body for body in self.bodies if isinstance(body, Sphere)]
        pairs: list[tuple[Body, Sphere]] = [*_near_pairs(spheres)]
        pairs += [(body, sphere) for body in self.bodies if isinstance(body, Rod) for sphere in spheres]
        problems = []
        for one, other in pairs:
            gap = one.distance_mm(np.array(other.centre_mm)) - other.radius_mm
            if gap < -CONTACT_TOL_MM:
                text = f"bodies {one.name!r} and {other.name!r} overlap by {-gap:.6g} mm"
                problems.append((other.name, f"{text}; they may touch, not overlap"))
        return problems


def _near_pairs(spheres: list[Sphere]) -> list[tuple[Sphere, Sphere]]:
    """Pairs whose extents in x meet; sorting along x keeps a bed of a thousand spheres quick."""
    ordered = sorted(spheres, key=lambda s: s.centre_mm[0] - s.radius_mm)
    pairs = []
    for index, one in enumerate(ordered):
        right = one.centre_mm[0] + one.radius_mm
        for other in ordered[index + 1 :]:
            if other.centre_mm[0] - other.radius_mm > right:
                break
            pairs.append((one, other))
    return pairs
