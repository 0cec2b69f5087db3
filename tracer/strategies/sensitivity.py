"""Landing points of pixels on a target plane, and their derivatives by every number of the scene.

For the acquired pixel (u, v) the landing point (s1, s2) in the target's own axes is a function of the camera
(position, rotation, focal length, principal point, lens terms), of every sphere crossed (centre, radius, n), of
the row of every window or tube (`tracer.kernels.world.Kind.numbers`) and of the target's pose.  `landings` returns
it with all derivatives, exactly (`tracer.kernels.landing`).  Parameters are named ``camera.x`` (mm), ``camera.rx``
(rad, about the world's axes through the pinhole), ``camera.focal_px``, ``camera.cu``, ``camera.k1``, ``NAME.x``,
``NAME.radius``, ``NAME.n``, ``NAME.thickness``, ``NAME.C20`` (mm, of a ball out of round), ``target.x``,
``target.rx`` ...  An index in a row is relative to
what is around the body.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ground.rows import run_rows
from tracer.camera import Camera
from tracer.harmonics import COUNT, NAMES, to_polynomials
from tracer.kernels.ball import EVEN, MEAN, SHAPE_NUMBERS
from tracer.kernels.landing import STATE, LandingArrays, SweepScratch, trace_landings
from tracer.kernels.rays import MAX_EVENTS
from tracer.kernels.world import KINDS, MOST_NUMBERS, World
from tracer.scene.scene import Scene
from tracer.strategies.trace import RayStatus, pack_camera, world_of

CAMERA = ("x", "y", "z", "rx", "ry", "rz", "focal_px", "cu", "cv", "k1", "k2", "k3", "p1", "p2")
SPHERE = ("x", "y", "z", "radius", "n")
TARGET = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class TargetPose:
    """Pose of a plane target: its origin in the world and its own axes (rows; orthonormal)."""

    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def to_world(self, target_mm: ArrayLike) -> NDArray[np.float64]:
        """World points (..., 3) of target points (..., 2) [mm]."""
        points = np.asarray(target_mm, dtype=np.float64)
        axes = np.array(self.axes)
        return np.asarray(np.array(self.origin_mm) + points @ axes[:2])

    def behind(self, depth_mm: float) -> "TargetPose":
        """Return the pose of the plane so far behind this one, along its normal."""
        x, y, z = (np.array(self.origin_mm) - depth_mm * np.array(self.axes[2])).tolist()
        return replace(self, origin_mm=(x, y, z)) if depth_mm else self

    def packed(self) -> NDArray[np.float64]:
        """Origin and axes as (12,) for the kernel."""
        return np.array([*self.origin_mm, *np.ravel(self.axes)])


@dataclass(frozen=True)
class Landings:
    """Landing points of N pixels on a target plane, with derivatives.

    Parameters
    ----------
    status : (N,) uint8
        RayStatus; everything else is NaN unless RECOVERED.
    key : (N,) int64
        Branch key.
    point_mm : (N, 2) float64
        Landing point in target coordinates.
    pixel_rate : (N, 2, 2) float64
        d point / d pixel [mm/px].
    rate : (N, 2, P) float64
        d point / d parameter, in the order of `names`.
    names : tuple of str
        Parameter names.
    """

    status: NDArray[np.uint8]
    key: NDArray[np.int64]
    point_mm: NDArray[np.float64]
    pixel_rate: NDArray[np.float64]
    rate: NDArray[np.float64]
    names: tuple[str, ...]

    @property
    def recovered(self) -> NDArray[np.bool_]:
        """Pixels that land (N,)."""
        return np.asarray(self.status == RayStatus.RECOVERED)

    def columns(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Derivatives (N, 2, len(names)) by the parameters asked for."""
        return self.rate[:, :, [self.names.index(name) for name in names]]

    def step_px(self, to: "Landings") -> NDArray[np.float64]:
        """Newton's step (N, 2) [px] of every pixel to where another one lands; NaN where either does not."""
        j, off = self.pixel_rate, to.point_mm - self.point_mm
        with np.errstate(invalid="ignore", divide="ignore"):
            det = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
            u = (j[:, 1, 1] * off[:, 0] - j[:, 0, 1] * off[:, 1]) / det
            v = (j[:, 0, 0] * off[:, 1] - j[:, 1, 0] * off[:, 0]) / det
        return np.stack((u, v), axis=-1)

    def where(self, chosen: NDArray[np.bool_], other: "Landings") -> "Landings":
        """Return these landings for the chosen pixels (N,), and others of the same pixels for the rest."""

        def of(name: str) -> NDArray[Any]:
            mine, theirs = getattr(self, name), getattr(other, name)
            return np.asarray(np.where(chosen.reshape(-1, *(1,) * (mine.ndim - 1)), mine, theirs))

        return Landings(of("status"), of("key"), of("point_mm"), of("pixel_rate"), of("rate"), self.names)

    def nowhere(self) -> "Landings":
        """Return the same pixels as they would be if none of them landed."""
        point, by_pixel, rate = (np.full_like(v, np.nan) for v in (self.point_mm, self.pixel_rate, self.rate))
        status = np.full_like(self.status, RayStatus.MISSED_PLANE)
        return Landings(status, self.key, point, by_pixel, rate, self.names)


def parameter_names(scene: Scene) -> tuple[str, ...]:
    """Names of all parameters of a scene and one target pose, in the order of `Landings.rate`."""
    others, spheres = [body.name for body in scene.others], [sphere.name for sphere in scene.spheres]
    names = _names(spheres, scene.other_tables(), others)
    return _with_shapes(names, [spheres[number] for number in scene.shapes()])


def _with_shapes(names: tuple[str, ...], uneven: Sequence[str]) -> tuple[str, ...]:
    """The same with the harmonics of balls of these names before the target."""
    of_shapes = [f"{name}.{term}" for name in uneven for term in NAMES]
    return (*names[: -len(TARGET)], *of_shapes, *names[-len(TARGET) :])


def _names(spheres: Sequence[str], tables: Sequence[Any], others: Sequence[str]) -> tuple[str, ...]:
    """All parameter names for spheres and other bodies of these names, the others in the order of their tables."""
    of_spheres = [f"{name}.{part}" for name in spheres for part in SPHERE]
    kinds = [KINDS[type(table)] for table in tables for _ in table.rows]
    of_others = [f"{name}.{part}" for name, kind in zip(others, kinds, strict=True) for part in kind.numbers]
    of_target = [f"target.{part}" for part in TARGET]
    return (*[f"camera.{part}" for part in CAMERA], *of_spheres, *of_others, *of_target)


def sweep_scratch() -> SweepScratch:
    """Memory of one thread for `trace_landings`."""
    return SweepScratch(np.empty(MAX_EVENTS, np.int32), np.empty((MAX_EVENTS, STATE)), np.zeros(MOST_NUMBERS))


def landings(scene: Scene, pixels: ArrayLike, target: TargetPose | None = None) -> Landings:
    """Trace acquired pixels onto a target plane, with the derivatives by every parameter.

    Parameters
    ----------
    scene : Scene
        The scene; all its bodies must stand on the camera's side of the target.
    pixels : array_like (N, 2)
        Acquired pixels u, v.
    target : TargetPose, optional
        Default: the investigation plane.

    Returns
    -------
    Landings
    """
    world = world_of(scene)
    if target is not None:
        world = world._replace(is_crossed=False)
    rays = landings_through(scene.camera, world, pixels, target or TargetPose(), scene.n_ambient)
    return replace(rays, names=parameter_names(scene))


def landings_through(
    camera: Camera,
    world: World,
    pixels: ArrayLike,
    target: TargetPose,
    n_ambient: float = 1.0,
    by_walls: bool = True,
) -> Landings:
    """`landings` for bare numbers: a fit on its way may pass through scenes in which bodies overlap.

    Parameters
    ----------
    camera : Camera
        The camera.
    world : World
        The bodies, as `tracer.strategies.trace.world_from` makes them.
    pixels : array_like (N, 2)
        Acquired pixels u, v.
    target : TargetPose
        The plane.
    n_ambient : float
        Index around the bodies; derivatives by n are by the absolute index.
    by_walls : bool
        Whether derivatives by the numbers of bodies other than spheres are asked for; those of windows and tubes
        take half of the time.

    Returns
    -------
    Landings
        Spheres are called 0, 1, ... in `names`, other bodies go on from there.
    """
    points = np.ascontiguousarray(np.asarray(pixels, dtype=np.float64).reshape(-1, 2))
    directions = np.ascontiguousarray(camera.directions(points))
    count, packed, pose = len(points), pack_camera(camera), target.packed()
    called = [str(number) for number in range(len(world.spheres) + sum(len(one.rows) for one in world.others))]
    uneven = [number for one in world.shapes for number in np.nonzero(one[:, MEAN] > 0.0)[0].tolist()]
    balls, others = called[: len(world.spheres)], called[len(world.spheres) :]
    names = _names(balls, world.others, others) if by_walls else _names(balls, (), ())
    by_shape = np.empty((count if uneven else 0, 2, len(world.spheres), SHAPE_NUMBERS))
    status, key = np.empty(count, np.uint8), np.empty(count, np.int64)
    point, by_pixel, rate = np.empty((count, 2)), np.empty((count, 2, 2)), np.empty((count, 2, len(names)))
    out, tables = LandingArrays(status, key, point, by_pixel, rate, by_shape), (packed, world)

    def work(first: int, last: int) -> None:
        trace_landings((points, directions), tables, pose, n_ambient, first, last, sweep_scratch(), out)

    run_rows(work, count, block=1024)
    if uneven:
        names = _with_shapes(names, [called[number] for number in uneven])
        of_shapes = by_shape[:, :, uneven, EVEN:] @ to_polynomials()
        parts = (
            rate[:, :, : -len(TARGET)],
            of_shapes.reshape(count, 2, COUNT * len(uneven)),
            rate[:, :, -len(TARGET) :],
        )
        rate = np.concatenate(parts, axis=2)
    return Landings(status, key, point, by_pixel, rate, names)
