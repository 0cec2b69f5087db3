"""Unknowns of a scene fit, as one vector of numbers measured in their own sigmas.

All numbers of the bench stand in one FULL vector:

    camera (14) | 5 of each sphere in front of the plane | those of windows and tubes (`other_bodies`)
                | 45 of each ball out of round | 6 of each pose of the target | 2 or 6 of the print

in the units of `tracer.strategies.sensitivity`; the last ones are by how much of itself the print is wider and
higher than it was measured, and of a plate with two levels by how much the step is deeper, how far the dots of the
lower level stand aside of their places, and by how much farther apart, as shadows of its grooves show them.  The
FREE vector x is shorter and in units of the prior's sigmas:

    full = full_0 + A x,        prior  p(x) ~ exp(-x . x / 2)

so "fixed" is a column that A lacks, and spheres of one glass share one column for n.  A ball out of round has the
harmonics of its shape [mm], of degree 2 and more: what its radius and its place could do as well is not among
them, and which way it is turned is said by them (``tracer.harmonics``).  Rotations are rotation
vectors from the nominal pose; the tracer's derivatives turn about the world's axes at the present pose,
which the left Jacobian of the rotation group turns into derivatives by the vector (Sola et al.,
arXiv:1812.01537, eq. 145):

    J(w) = I + (1 - cos |w|)/|w|^2 [w] + (|w| - sin |w|)/|w|^3 [w]^2
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.fit.solve.block_edges import EdgePoint
from correction.fit.solve.contact import carry_support, touching_pairs
from correction.fit.solve.other_bodies import OtherBodies
from tracer.bodies import Sphere
from tracer.camera import Camera, Lens, Vector3
from tracer.harmonics import COUNT, NAMES
from tracer.kernels.sphere import SOLID
from tracer.kernels.world import World
from tracer.media import Medium, shifted
from tracer.scene.fit_section import FOCAL_SHARE, FitTable
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import CAMERA, SPHERE, TARGET, TargetPose
from tracer.strategies.trace import world_from

LENS = ("k1", "k2", "k3", "p1", "p2")
ASIDE = ("print.aside_x", "print.aside_y")  # the lower level of a plate [mm]
WIDER = "print.wider"  # and by how much of itself it is larger than the face
PRINT = ("print.stretch_x", "print.stretch_y", "print.step", *ASIDE, WIDER)  # from the third on: two levels
BY_HAND = (1000.0, 1.0)  # mm, rad: sigma of a pose by hand, so wide that frames alone decide
NOTHING_BY_HAND: Mapping[str, NDArray[np.float64]] = {}
SAME_HEIGHT_MM = 1e-3  # frames whose planned heights agree this well show one pose of the target


@dataclass(frozen=True)
class Unknowns:
    """The numbers that a fit may move, around those of a nominal scene.

    Parameters
    ----------
    scene : Scene
        Nominal scene; its values are the centres of the priors.
    heights_mm : tuple of float
        Heights of the target, each once; number 0 is z = 0, which defines the world.
    names : tuple of str
        Free numbers.
    full_names : tuple of str
        All numbers.
    start : (F,) float64
        The full vector of the nominal scene.
    columns : (F, P) float64
        A: change of the full vector per sigma of each free number.
    contact_mm : float or None
        Standard deviation of the gap between balls that touch in the nominal scene; None: nothing is known of it.
    poses : tuple of str
        Names of poses by hand; their numbers follow those of the heights.
    edges : tuple of EdgePoint
        Points of frames on edges of blocks.
    origin_is_deep : bool
        The origin is on the lower level of a plate.
    """

    scene: Scene
    heights_mm: tuple[float, ...]
    names: tuple[str, ...]
    full_names: tuple[str, ...]
    start: NDArray[np.float64]
    columns: NDArray[np.float64]
    contact_mm: float | None = None
    poses: tuple[str, ...] = ()
    edges: tuple[EdgePoint, ...] = ()
    origin_is_deep: bool = False

    @cached_property
    def blocks(self) -> dict[str, slice]:
        """Place of each block of numbers in the full vector, in its order; of the target one for each pose."""
        sizes = {
            "camera": len(CAMERA),
            "spheres": len(SPHERE) * len(self.scene.spheres),
            "walls": len(self.other_bodies.names),
            "shapes": COUNT * len(self._uneven),
            **{f"target {number}": len(TARGET) for number in range(len(self.heights_mm) + len(self.poses))},
        }
        ends = np.cumsum(list(sizes.values())).tolist()
        blocks = {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}
        return {**blocks, "print": slice(ends[-1], len(self.full_names))}

    @cached_property
    def glass(self) -> slice:
        """Place of the spheres' numbers in the full vector."""
        return self.blocks["spheres"]

    @cached_property
    def others(self) -> slice:
        """Place of the numbers of windows and tubes in the full vector."""
        return self.blocks["walls"]

    @cached_property
    def all_shapes(self) -> slice:
        """Place of all harmonics in the full vector."""
        return self.blocks["shapes"]

    def place(self, height_number: int) -> slice:
        """Place of a pose of the target in the full vector."""
        return self.blocks[f"target {height_number}"]

    @property
    def on_stage(self) -> slice:
        """Place of the poses on the stage in the full vector, those by hand left out."""
        return slice(self.place(0).start, self.place(len(self.heights_mm) - 1).stop)

    @cached_property
    def print_place(self) -> slice:
        """Place of the print's width and height in the full vector."""
        first = self.blocks["print"].start
        return slice(first, first + 2)

    @cached_property
    def other_bodies(self) -> OtherBodies:
        """Windows and tubes, and which numbers of theirs there are."""
        return OtherBodies(self.scene)

    @cached_property
    def packing(self) -> dict[int, tuple[int, int]]:
        """Balls that are known to touch, by their row among the `contact.walls`."""
        return {} if self.contact_mm is None else touching_pairs(self._table)

    @cached_property
    def _uneven(self) -> list[int]:
        """Numbers of the balls with a shape, nominal or free."""
        named = set(self.full_names)
        return [n for n, sphere in enumerate(self.scene.spheres) if f"{sphere.name}.{NAMES[0]}" in named]

    @cached_property
    def uneven(self) -> dict[int, slice]:
        """Number of each ball with a shape, and the place of its harmonics in the full vector."""
        first = self.all_shapes.start
        return {ball: slice(first + COUNT * k, first + COUNT * (k + 1)) for k, ball in enumerate(self._uneven)}

    def stretch(self, full: NDArray[np.float64]) -> NDArray[np.float64]:
        """Scale (2 or 3,) of the print against its measured size: in width, height, and a plate's depth."""
        return np.asarray(1.0 + full[self.print_place.start :][:3])

    def deeper(self, full: NDArray[np.float64]) -> float:
        """Scale of the step of a plate against its measured one; 1 of all else."""
        return float(self.stretch(full)[2:].prod())

    def mark_places_mm(
        self, full: NDArray[np.float64], node_mm: NDArray[np.float64], depth_mm: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Places (N, 2) on the target of marks that were measured at `node_mm` (N, 2), at depths (N,)."""
        stretched = self.stretch(full)[:2] * node_mm
        if len(seen := full[self.print_place.stop + 1 :]):
            stretched += self.is_deep(depth_mm)[:, None] * (seen[:2] + seen[2] * node_mm)
        return np.asarray(stretched)

    def is_deep(self, depth_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which marks, at depths (N,), are on the lower level of a plate, in the shadow of grooves."""
        return np.asarray((depth_mm != 0.0) != self.origin_is_deep)

    def shapes(self, full: NDArray[np.float64]) -> dict[int, NDArray[np.float64]]:
        """Shapes (45,) [mm] of a full vector by the numbers of the balls."""
        return {number: full[place] for number, place in self.uneven.items()}

    @property
    def sigma(self) -> NDArray[np.float64]:
        """Prior sigma of each free number in its own unit (P,)."""
        return np.asarray(np.abs(self.columns).max(axis=0))

    def full(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the full vector (F,) at x (P,)."""
        return np.asarray(self.start + self.columns @ x)

    def free(self, full: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return x (P,) of a full vector that `full` made."""
        size = (self.columns**2).sum(axis=0)
        return np.asarray((full - self.start) @ self.columns / size)

    def only(self, prefixes: Sequence[str]) -> "Unknowns":
        """Return the same unknowns with only those numbers free whose name begins with one of `prefixes`."""
        kept = [i for i, name in enumerate(self.names) if name.startswith(tuple(prefixes))]
        return replace(self, names=tuple(self.names[i] for i in kept), columns=self.columns[:, kept])

    def without(self, prefix: str) -> "Unknowns":
        """Return the same unknowns with those numbers held whose name begins with `prefix`."""
        kept = [i for i, name in enumerate(self.names) if not name.startswith(prefix)]
        return replace(self, names=tuple(self.names[i] for i in kept), columns=self.columns[:, kept])

    def around(self, full: NDArray[np.float64]) -> "Unknowns":
        """Return the same unknowns with another centre for its fixed numbers and priors."""
        return replace(self, start=full)

    def loosen(self, names: Sequence[str], least: float) -> "Unknowns":
        """Return the same unknowns with the sigma of some free numbers raised to `least`, in their own unit."""
        chosen = np.array([name in names for name in self.names], dtype=np.bool_)
        factor = np.where(chosen, np.maximum(least / self.sigma, 1.0), 1.0)
        return replace(self, columns=self.columns * factor)

    def camera(self, full: NDArray[np.float64]) -> Camera:
        """Return the camera of a full vector."""
        return _camera_of(self.scene.camera, tuple(full[: len(CAMERA)].tolist()))

    def spheres(self, full: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the kernels' sphere table (N, 6) of a full vector; overlap is allowed."""
        table = self._table.copy()
        table[:, :5] = full[self.glass].reshape(-1, len(SPHERE))
        table[:, 4] /= self.n_around
        return table

    def world(self, full: NDArray[np.float64], glass: bool) -> World:
        """Return the bodies of a full vector for the kernels, with glass or without; overlap is allowed.

        Raises
        ------
        SceneError
            There is no such window or tube.
        """
        scene = self.scene if glass else self._bare
        spheres = self.spheres(full) if glass else np.zeros((0, SOLID))
        tables = self._tables(glass, full[self.others])
        return world_from(spheres, tables, scene.rooms(), self.shapes(full) if glass else {})

    def _tables(self, glass: bool, values: NDArray[np.float64]) -> tuple[Any, ...]:
        """Windows and tubes for the kernels; the last are kept: a search for balls asks thousands of times."""
        asked = glass, values.tobytes()
        if asked not in self._table_cache:
            scene = self.scene if glass else self._bare
            tables = scene.other_tables(self.other_bodies.bodies_at(values))
            self._table_cache.clear()
            self._table_cache[asked] = tables
        return self._table_cache[asked]

    @cached_property
    def _table_cache(self) -> dict[tuple[bool, bytes], tuple[Any, ...]]:
        return {}

    @cached_property
    def _bare(self) -> Scene:
        return self.scene.bare()

    def pose(self, full: NDArray[np.float64], height_number: int) -> TargetPose:
        """Return the target's pose at one of the heights, or one by hand."""
        return _pose_of(tuple(full[self.place(height_number)].tolist()))

    def scene_at(self, full: NDArray[np.float64]) -> Scene:
        """Return the scene of a full vector; supports go with the balls that they hold (`supports`).

        Raises
        ------
        SceneError
            Bodies overlap: make it legal first (`correction.fit.solve.contact`); or there is no such window or
            tube.
        """
        rows = full[self.glass].reshape(-1, len(SPHERE)).tolist()
        moved = self.other_bodies.bodies_at(full[self.others])
        shapes, olds = self.shapes(full), self.start_of_glass()
        for number, (sphere, (x, y, z, radius, n)) in enumerate(zip(self.scene.spheres, rows, strict=True)):
            medium = None if sphere.medium is None else shifted(sphere.medium, n - float(olds[number, 4]))
            shape = tuple((1e3 * shapes[number]).tolist()) if number in shapes else ()
            moved[sphere.name] = replace(
                sphere, centre_mm=(x, y, z), radius_mm=radius, medium=medium, shape_um=shape
            )
        balls = Sphere.among(moved.values())
        bodies = tuple(
            moved.get(body.name)
            or (body if isinstance(body, Sphere) or body.room else carry_support(body, self.scene.spheres, balls))
            for body in self.scene.bodies
        )
        return replace(self.scene, camera=self.camera(full), bodies=bodies)

    @cached_property
    def n_around(self) -> NDArray[np.float64]:
        """Index of the medium around each sphere (N,)."""
        return np.array([self.scene.n_around(sphere) for sphere in self.scene.spheres])

    @cached_property
    def _table(self) -> NDArray[np.float64]:
        """Sphere table (N, 6) of the nominal scene."""
        return self.scene.sphere_table()

    def start_of_glass(self) -> NDArray[np.float64]:
        """Numbers of the nominal spheres (N, 5), n absolute."""
        table = self.scene.sphere_table()[:, :5]
        table[:, 4] *= self.n_around
        return table


def lens_reach(camera: Camera) -> dict[str, float]:
    """Values of terms of the lens that each move a corner of the frame by its whole distance from the axis."""
    away = camera.focal_px / (0.5 * float(np.hypot(*camera.sensor_px)))
    return {"k1": away**2, "k2": away**4, "k3": away**6, "p1": away, "p2": away}


def unknowns_of(
    scene: Scene,
    heights_mm: Sequence[float],
    priors: FitTable,
    focal_free: bool = False,
    travel: Vector3 = (0.0, 0.0, 1.0),
    print_sigma: tuple[float, ...] = (0.0, 0.0),
    poses: Mapping[str, NDArray[np.float64]] = NOTHING_BY_HAND,
) -> Unknowns:
    """Number everything and decide what is free.

    Parameters
    ----------
    scene : Scene
        Nominal scene.
    heights_mm : sequence of float
        Heights of the target in the frames; 0 is added.
    priors : FitTable
        The scene file's ``fit:`` section.
    focal_free : bool
        Whether the focal length is free if the section does not say: the bare target was seen at several heights.
    travel : (float, float, float)
        Unit vector along which the stage moves the target to its heights.
    print_sigma : tuple of float
        How well width and height of the print are known, and the step of a plate, as shares of them; then how
        well the place of its lower level is, along x and y [mm], and its size, as a share.
    poses : dict
        Name of each pose by hand -> where it is looked for first (6,) [mm, rad]; nothing is known of it before.
    """
    heights = distinct_heights(heights_mm)
    start, columns, names = _Columns(), [], []
    sigma = priors.camera
    focal = sigma.focal_px
    if focal is None:
        focal = FOCAL_SHARE * scene.camera.focal_px if focal_free else 0.0
    camera = scene.camera
    values = [*camera.position_mm, 0.0, 0.0, 0.0, camera.focal_px, *camera.principal_px, *camera.lens.terms()]
    turn = float(np.deg2rad(sigma.rotation_deg))
    sigmas = [*[sigma.position_mm] * 3, *[turn] * 3, focal, *[sigma.principal_px] * 2]
    sigmas += [getattr(sigma, term) for term in LENS]
    start.add([f"camera.{part}" for part in CAMERA], values, sigmas)
    for sphere, row in zip(scene.spheres, scene.sphere_table(), strict=True):
        known = priors.sphere(sphere.name)
        names_here = [f"{sphere.name}.{part}" for part in SPHERE]
        spread = [0.0] * 5 if sphere.medium is None else [*[known.centre_mm] * 3, known.radius_mm, 0.0]
        start.add(names_here, [*row[:4], row[4] * scene.n_around(sphere)], spread)
    others = OtherBodies(scene)
    start.add(others.names, others.start, others.spread(priors))
    for sphere in scene.spheres:
        shape_sigma = priors.sphere(sphere.name).shape_mm() * float(sphere.may_be_uneven)
        if sphere.shape_um or shape_sigma.any():
            start.add([f"{sphere.name}.{term}" for term in NAMES], sphere.shape_mm.tolist(), shape_sigma.tolist())
    for height in heights:
        known_z = 0.0 if height == 0.0 else 1.0
        target = priors.target
        tilt = float(np.deg2rad(target.rotation_deg))
        spread = [*[target.sideways_mm] * 2, target.z_mm, *[tilt] * 3]
        label = f"target{height:+g}mm"
        start.add(
            [f"{label}.{part}" for part in TARGET],
            [*(height * along for along in travel), 0.0, 0.0, 0.0],
            [s * known_z for s in spread],
        )
    for pose, looked_for in poses.items():
        labels = [f"{pose_label(pose)}{part}" for part in TARGET]
        start.add(labels, looked_for.tolist(), np.repeat(BY_HAND, 3).tolist())
    start.add(PRINT[: len(print_sigma)], np.zeros(len(print_sigma)).tolist(), print_sigma)
    for place, spread_of in enumerate(start.sigmas):
        if spread_of > 0.0:
            column = np.zeros(len(start.names))
            column[place] = spread_of
            columns.append(column)
            names.append(start.names[place])
    for name, medium in glasses(scene).items():
        spread_of = priors.index(medium.name)
        if spread_of > 0.0:
            column = np.zeros(len(start.names))
            for sphere in scene.spheres:
                if sphere.medium == medium:
                    column[start.names.index(f"{sphere.name}.n")] = spread_of
            columns.append(column)
            names.append(name)
    matrix = np.stack(columns, axis=1) if columns else np.zeros((len(start.names), 0))
    every, middle = tuple(start.names), np.array(start.values)
    return Unknowns(scene, heights, tuple(names), every, middle, matrix, priors.contact_mm, tuple(poses))


def pose_label(pose: str) -> str:
    """Beginning of the names of a pose by hand."""
    return f"target {pose}."


@lru_cache(maxsize=16)  # one scene is asked by every frame, and on every level
def _camera_of(nominal: Camera, numbers: tuple[float, ...]) -> Camera:
    """A camera with other numbers; its rotation is that of the nominal one, turned."""
    x, y, z, *turn, focal, cu, cv = numbers[:9]
    turned = nominal.rotation_matrix @ scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix().T
    return replace(
        nominal,
        position_mm=(x, y, z),
        rotation=_rows(turned),
        focal_px=focal,
        principal_px=(cu, cv),
        lens=Lens(*numbers[9:]),
    )


@lru_cache(maxsize=64)
def _pose_of(numbers: tuple[float, ...]) -> TargetPose:
    """The pose of a target by its place and its turn."""
    x, y, z, *turn = numbers
    return TargetPose((x, y, z), _rows(scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix().T))


def unit_of(name: str) -> tuple[str, float]:
    """Unit in which a number is shown to people, and the factor to it from the unit of its value."""
    part = name.rsplit(".", 1)[-1]
    if part in ("x", "y", "z", "radius", "distance", "thickness", "outer_radius", "inner_radius") or name in ASIDE:
        return "mm", 1.0
    if part in ("rx", "ry", "rz", "tilt_x", "tilt_y", "tilt_z"):
        return "deg", float(np.rad2deg(1.0))
    if part in NAMES:
        return "um", 1e3
    return ("px", 1.0) if part in ("focal_px", "cu", "cv") else ("", 1.0)


def distinct_heights(heights_mm: Sequence[float]) -> tuple[float, ...]:
    """Return 0 and the other heights, each once, in order."""
    found = [0.0]
    for height in sorted(heights_mm):
        if all(abs(height - other) > SAME_HEIGHT_MM for other in found):
            found.append(float(height))
    return tuple(found)


def rotation_jacobian(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Left Jacobian (3, 3) of a rotation vector (3,)."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-4:
        return np.asarray(np.eye(3) + cross / 2.0 + cross @ cross / 6.0)
    half = (1.0 - np.cos(angle)) / angle**2
    third = (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + half * cross + third * cross @ cross)


def glasses(scene: Scene) -> dict[str, Medium]:
    """Name of the free number -> medium; spheres of equal media are of one glass."""
    found: dict[str, Medium] = {}
    for sphere in scene.spheres:
        if sphere.medium is not None and sphere.medium not in found.values():
            label = sphere.medium.name or "+".join(s.name for s in scene.spheres if s.medium == sphere.medium)
            found[f"glass {label}.n"] = sphere.medium
    return found


class _Columns:
    """Names, values and sigmas while the full vector grows."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.values: list[float] = []
        self.sigmas: list[float] = []

    def add(self, names: Sequence[str], values: Sequence[float], sigmas: Sequence[float]) -> None:
        """Add numbers at the end."""
        self.names += names
        self.values += [float(value) for value in values]
        self.sigmas += [float(sigma) for sigma in sigmas]


def _rows(matrix: NDArray[np.float64]) -> tuple[Vector3, Vector3, Vector3]:
    a, b, c = ((float(r[0]), float(r[1]), float(r[2])) for r in matrix)
    return a, b, c
