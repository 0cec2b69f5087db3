"""Where pixels land on a target plane, and how that depends on every number of the scene.

For the acquired pixel (u, v) the landing point (s1, s2) in the target's own axes is a function of the camera
(position, rotation, focal length, principal point, lens terms), of every sphere crossed (centre, radius, n)
and of the target's pose.  `landings` returns it with all derivatives, exactly: the kernel's backward sweep
gives d landing / d (origin, direction) and d landing / d spheres; the camera's part is closed form, because
the pinhole ray is d = Rot(omega) R^T v / |v| with v = (x_ideal, y_ideal, 1):

    d d / d v = R^T (1 - v v^T / |v|^2) / |v|,      d d / d omega = omega x d,

and the target's follows from the last straight piece.  Parameters are named ``camera.x`` (mm),
``camera.rx`` (rad, about the world's axes through the pinhole), ``camera.focal_px``, ``camera.cu``,
``camera.k1``, ``NAME.x``, ``NAME.radius``, ``NAME.n``, ``target.x``, ``target.rx`` ...
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.camera import Camera
from tracer.kernels.adjoint import STATE, trace_adjoint
from tracer.kernels.march import MAX_EVENTS
from tracer.rows import run_rows
from tracer.scene import Scene
from tracer.status import RayStatus
from tracer.trace import pack_camera

CAMERA = ("x", "y", "z", "rx", "ry", "rz", "focal_px", "cu", "cv", "k1", "k2", "k3", "p1", "p2")
SPHERE = ("x", "y", "z", "radius", "n")
TARGET = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class TargetPose:
    """Where a plane target stands: its origin in the world and its own axes (rows; orthonormal)."""

    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def to_world(self, target_mm: ArrayLike) -> NDArray[np.float64]:
        """World points (..., 3) of target points (..., 2) [mm]."""
        points = np.asarray(target_mm, dtype=np.float64)
        axes = np.array(self.axes)
        return np.asarray(np.array(self.origin_mm) + points @ axes[:2])

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


def parameter_names(scene: Scene) -> tuple[str, ...]:
    """Names of all parameters of a scene and one target pose, in the order of `Landings.rate`."""
    return _names([sphere.name for sphere in scene.spheres])


def _names(spheres: Sequence[str]) -> tuple[str, ...]:
    """All parameter names for spheres of these names."""
    of_spheres = [f"{name}.{part}" for name in spheres for part in SPHERE]
    return (*[f"camera.{part}" for part in CAMERA], *of_spheres, *[f"target.{part}" for part in TARGET])


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
    rays = landings_through(
        scene.camera, scene.sphere_table(), scene.rod_table(), pixels, target or TargetPose(), scene.n_ambient
    )
    return replace(rays, names=parameter_names(scene))


def landings_through(
    camera: Camera,
    spheres: NDArray[np.float64],
    rods: NDArray[np.float64],
    pixels: ArrayLike,
    target: TargetPose,
    n_ambient: float = 1.0,
) -> Landings:
    """`landings` for bare numbers: a fit on its way may pass through scenes in which bodies overlap.

    Parameters
    ----------
    camera : Camera
        The camera.
    spheres, rods : (N, 6), (M, 7) float64
        As `Scene.sphere_table` and `Scene.rod_table`.
    pixels : array_like (N, 2)
        Acquired pixels u, v.
    target : TargetPose
        The plane.
    n_ambient : float
        Index around the bodies; derivatives by n are by the absolute index.

    Returns
    -------
    Landings
        Spheres are called 0, 1, ... in `names`.
    """
    points = np.ascontiguousarray(np.asarray(pixels, dtype=np.float64).reshape(-1, 2))
    directions, camera_rates, pixel_rates = _camera_rays(camera, points)
    origins = np.ascontiguousarray(np.broadcast_to(np.array(camera.position_mm), directions.shape))
    count = len(points)
    status, key = np.empty(count, np.uint8), np.empty(count, np.int64)
    point, exit_ray = np.empty((count, 2)), np.empty((count, 7))
    ray_rates, sphere_rates = np.empty((count, 2, 6)), np.empty((count, 2, len(spheres), 5))
    pose = target.packed()

    def work(first: int, last: int) -> None:
        trail, state = np.empty(MAX_EVENTS, np.int32), np.empty((MAX_EVENTS, STATE))
        trace_adjoint(
            origins,
            directions,
            spheres,
            rods,
            pose,
            first,
            last,
            trail,
            state,
            status,
            key,
            point,
            exit_ray,
            ray_rates,
            sphere_rates,
        )

    run_rows(work, count, block=1024)
    sphere_rates[..., 4] /= n_ambient
    by_direction = ray_rates[:, :, 3:]
    rate = np.concatenate(
        (
            ray_rates[:, :, :3],
            by_direction @ camera_rates,
            sphere_rates.reshape(count, 2, -1),
            _target_rates(target, point, exit_ray),
        ),
        axis=2,
    )
    names = _names([str(number) for number in range(len(spheres))])
    return Landings(status, key, point, by_direction @ pixel_rates, rate, names)


def _camera_rays(
    camera: Camera, pixels: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Directions (N, 3), rates (N, 3, 11) by rotation, focal length, centre and lens, and (N, 3, 2) by pixel."""
    focal, (cu, cv) = camera.focal_px, camera.principal_px
    k1, k2, k3, p1, p2 = pack_camera(camera)[15:]
    x, y = (pixels[:, 0] - cu) / focal, (pixels[:, 1] - cv) / focal
    r2 = x * x + y * y
    radial, slope = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    cross = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    lens = np.empty((len(x), 2, 2))  # d ideal / d acquired, in units of the focal length
    lens[:, 0, 0] = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    lens[:, 1, 1] = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    lens[:, 0, 1] = lens[:, 1, 0] = cross
    ideal = np.stack((x, y), axis=-1) * radial[:, None]
    ideal[:, 0] += 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    ideal[:, 1] += p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    v = np.concatenate((ideal, np.ones((len(x), 1))), axis=1)
    length = np.linalg.norm(v, axis=1)
    unit = v / length[:, None]
    turn = camera.rotation_matrix.T
    directions = unit @ turn.T
    across = (np.eye(3) - unit[:, :, None] * unit[:, None, :]) / length[:, None, None]
    by_ideal = (turn @ across)[:, :, :2]
    by_acquired = by_ideal @ lens
    rates = np.empty((len(x), 3, 11))
    rates[:, :, :3] = -np.cross(directions[:, None, :], np.eye(3)).swapaxes(1, 2)
    rates[:, :, 3] = -(by_acquired @ np.stack((x, y), axis=-1)[:, :, None])[:, :, 0] / focal
    rates[:, :, 4:6] = -by_acquired / focal
    radials = np.stack((x, y), axis=-1)[:, :, None] * np.stack((r2, r2**2, r2**3), axis=-1)[:, None, :]
    rates[:, :, 6:9] = by_ideal @ radials
    decentring = np.empty((len(x), 2, 2))
    decentring[:, 0, 0] = decentring[:, 1, 1] = 2.0 * x * y
    decentring[:, 0, 1], decentring[:, 1, 0] = r2 + 2.0 * x * x, r2 + 2.0 * y * y
    rates[:, :, 9:11] = by_ideal @ decentring
    return np.ascontiguousarray(directions), rates, by_acquired / focal


def _target_rates(
    target: TargetPose, point: NDArray[np.float64], exit_ray: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Rates (N, 2, 6) of the landing point by the target's position and rotation (world axes, about its origin).

    Moving the target's material points by D changes the landing point on it as moving the ray by -D does:
    the part of D along the ray slides along it, so D acts through the projection along d onto the plane.
    """
    e1, e2, normal = np.array(target.axes)
    d = exit_ray[:, 3:6]
    slope = d @ normal
    plane = np.stack((e1, e2))
    onto = plane[None] - (d @ plane.T)[:, :, None] * normal[None, None, :] / slope[:, None, None]
    arm = point @ plane
    rates = np.empty((len(point), 2, 6))
    rates[:, :, :3] = -onto
    lever = np.cross(np.eye(3)[None], arm[:, None, :])  # omega x arm for the three unit rotations
    rates[:, :, 3:] = -(onto @ lever.swapaxes(1, 2))
    return rates
