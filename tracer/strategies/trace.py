"""Trace rays through a scene: everything that is known about each one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ground.rows import run_rows
from ground.short_repr import short_repr
from tracer.camera import Camera
from tracer.kernels.maps import trace_rays
from tracer.scene.scene import Scene
from tracer.status import RayStatus
from tracer.strategies.branches import Branch, name_keys
from tracer.strategies.cells import world_of

RAY = np.dtype(
    [
        ("status", np.uint8),  # RayStatus
        ("events", np.int32),  # spheres crossed
        ("key", np.int64),  # hash of the sequence of spheres crossed, and of the ways through their cores
        ("x_mm", np.float64),  # plane point
        ("y_mm", np.float64),
        ("path_mm", np.float64),  # optical path from the start to the plane
        ("transmittance", np.float64),  # Fresnel, unpolarised
        ("direction", np.float64, (3,)),  # unit direction of the last straight piece
    ],
    align=True,
)


@short_repr
@dataclass(frozen=True)
class TraceResult:
    """Rays traced to the investigation plane.

    Parameters
    ----------
    rays : structured array of dtype RAY
        One record a ray, in the shape asked for; coordinates are NaN unless the status is RECOVERED.
    branches : dict
        Branch key -> names of the spheres crossed, in order, with the way through those that have a core
        (`Sphere.event_name`); () is the direct view.
    """

    rays: NDArray[np.void]
    branches: dict[int, Branch]

    @property
    def plane_mm(self) -> NDArray[np.float64]:
        """Plane points (..., 2) [mm]."""
        return np.stack((self.rays["x_mm"], self.rays["y_mm"]), axis=-1)

    @property
    def recovered(self) -> NDArray[np.bool_]:
        """Rays that reached the plane."""
        return np.asarray(self.rays["status"] == RayStatus.RECOVERED)


def pack_camera(camera: Camera) -> NDArray[np.float64]:
    """Pack a camera for the kernels (20,), see ``tracer.kernels.camera``."""
    return np.array(
        [
            *camera.position_mm,
            *np.ravel(camera.rotation),
            camera.focal_px,
            *camera.principal_px,
            *camera.lens.terms(),
        ]
    )


def trace(scene: Scene, pixels: ArrayLike) -> TraceResult:
    """Trace the rays of acquired pixels to the investigation plane.

    Parameters
    ----------
    scene : Scene
        The scene.
    pixels : array_like (..., 2) float
        Acquired pixels u, v; fractions and pixels off the sensor are allowed.

    Returns
    -------
    TraceResult
        Records of shape (...).
    """
    directions = scene.camera.directions(pixels)
    origins = np.broadcast_to(np.array(scene.camera.position_mm), directions.shape)
    return trace_from(scene, origins, directions)


def trace_from(scene: Scene, origins_mm: ArrayLike, directions: ArrayLike) -> TraceResult:
    """Trace rays from any points outside the bodies.

    Parameters
    ----------
    scene : Scene
        The scene; its camera does not matter here.
    origins_mm : array_like (..., 3)
        Where the rays start.
    directions : array_like (..., 3)
        Unit directions.
    """
    directions = np.asarray(directions, dtype=np.float64)
    shape = directions.shape[:-1]
    starts = np.ascontiguousarray(np.broadcast_to(np.asarray(origins_mm, dtype=np.float64), directions.shape))
    starts, rays_along = starts.reshape(-1, 3), np.ascontiguousarray(directions).reshape(-1, 3)
    rays = np.zeros(len(rays_along), RAY)
    world = world_of(scene)

    def work(first: int, last: int) -> None:
        trace_rays(starts, rays_along, world, first, last, rays)

    run_rows(work, len(rays), block=16384)
    rays["path_mm"] *= scene.n_ambient
    keys, firsts = np.unique(rays["key"], return_index=True)
    return TraceResult(rays.reshape(shape), name_keys(scene, starts[firsts], rays_along[firsts], keys))
