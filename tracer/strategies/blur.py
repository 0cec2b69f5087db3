"""Blur by the pupil behind glass: every part of it shows a point at another pixel.

The part a of the pupil sees with a pinhole of its own, moved by a; its pixels are those whose rays meet the chief
ones in the plane in focus.  With X_a(u) the plane point that pixel u shows through a, the point X that the chief
ray shows at u appears at u + d_a,

    X_a(u + d_a) = X,        found by Newton's method on traced rays.

The picture of the point is the distribution of d_a over the pupil: its mean is how far the centroid lies off the
chief ray, its spread is the blur.  A part counts by the light that passes, T_a, and in the picture of a particle
also by how large it shows it, 1 / |det dX_a/du|: so much more of the particle's light goes through it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.camera import Lens
from tracer.pupil import Pupil
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import Landings, TargetPose, landings_through
from tracer.strategies.trace import trace_from, world_of

NEWTON = 4  # steps
LARGEST_STEP_PX = 8.0
SETTLED_PX = 0.02
BLOCK = 16384  # points at a time


@dataclass(frozen=True)
class Blur:
    """Pictures of N points through a pupil.

    Parameters
    ----------
    shift_px : (N, 2) float64
        Centroid of the picture minus the chief ray's pixel; NaN where no part of the pupil shows the point.
    width_px : (N,) float64
        Standard deviation of the picture along its longer axis.
    lost : (N,) float64
        Share of points of the pupil, its border among them, that do not show the point on the chief ray's branch.
    spread_px2 : (N, 2, 2) float64
        Covariance of the picture along u and v.
    """

    shift_px: NDArray[np.float64]
    width_px: NDArray[np.float64]
    lost: NDArray[np.float64]
    spread_px2: NDArray[np.float64]


@dataclass(frozen=True)
class PupilViews:
    """Pixels at which K parts of a pupil show N points.

    Parameters
    ----------
    offset_px : (K, N, 2) float64
        From the chief ray's pixel; NaN where a part does not show the point on the same branch.
    light : (K, N) float64
        Share of the light that a part lets through, 0 where it does not show the point.
    size : (K, N) float64
        How large it shows the point, as an area in pixels, per mm^2.
    lost : (N,) float64
        Share of points of the pupil, its border among them, that do not show the point.
    """

    offset_px: NDArray[np.float64]
    light: NDArray[np.float64]
    size: NDArray[np.float64]
    lost: NDArray[np.float64]

    def of_particles(self) -> Blur:
        """Blur of points that shine by themselves."""
        weight = self.light * self.size
        total = weight.sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            weight = weight / total
        offset = np.nan_to_num(self.offset_px)
        mean = np.einsum("kn,kni->ni", weight, offset)
        off = offset - mean
        spread = np.einsum("kn,kni,knj->nij", weight, off, off)
        middle = 0.5 * np.trace(spread, axis1=1, axis2=2)
        apart = np.hypot(0.5 * (spread[:, 0, 0] - spread[:, 1, 1]), spread[:, 0, 1])
        return Blur(mean, np.sqrt(np.maximum(middle + apart, 0.0)), self.lost, spread)


def pupil_views(scene: Scene, pupil: Pupil, pixels: ArrayLike, pose: TargetPose | None = None) -> PupilViews:
    """Find where the parts of a pupil show the points that chief rays show.

    Parameters
    ----------
    scene : Scene
        The scene; its camera's own pupil does not matter here.
    pupil : Pupil
        The pupil.
    pixels : array_like (N, 2)
        Acquired pixels of the chief rays.
    pose : TargetPose, optional
        The plane; default the investigation plane.
    """
    every = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    parts = [
        _views(scene, pupil, every[first : first + BLOCK], pose or TargetPose())
        for first in range(0, max(len(every), 1), BLOCK)
    ]
    return PupilViews(
        np.concatenate([part.offset_px for part in parts], axis=1),
        np.concatenate([part.light for part in parts], axis=1),
        np.concatenate([part.size for part in parts], axis=1),
        np.concatenate([part.lost for part in parts]),
    )


def _views(scene: Scene, pupil: Pupil, pixels: NDArray[np.float64], pose: TargetPose) -> PupilViews:
    world, camera = world_of(scene), scene.camera
    ideal = replace(camera, lens=Lens())  # over a picture some pixels wide its terms change nothing
    start = camera.ideal(pixels)
    chief = landings_through(ideal, world, start, pose, scene.n_ambient)
    inside, border = pupil.points_mm(), pupil.border_mm()
    shape = (len(inside) + len(border), len(pixels))
    offset, light, size = np.full((*shape, 2), np.nan), np.zeros(shape), np.zeros(shape)
    for number, (right, down) in enumerate([*inside.tolist(), *border.tolist()]):
        place = np.array(camera.position_mm) + right * camera.rotation_matrix[0] + down * camera.rotation_matrix[1]
        middle = np.array(camera.principal_px) + camera.focal_px * np.array([right, down]) / pupil.focus_mm
        part = replace(
            ideal,
            position_mm=(float(place[0]), float(place[1]), float(place[2])),
            principal_px=(float(middle[0]), float(middle[1])),
        )
        at = start.copy()
        for _ in range(NEWTON):
            at += np.clip(_newton(landings_through(part, world, at, pose, scene.n_ambient), chief), *_LIMITS)
        seen = landings_through(part, world, at, pose, scene.n_ambient)
        step = _newton(seen, chief)
        shown = (seen.key == chief.key) & seen.recovered & (np.abs(step).max(axis=1) < SETTLED_PX)
        rays = trace_from(scene, np.broadcast_to(place, (len(at), 3)), part.directions(at)).rays
        offset[number, shown] = (at + step - start)[shown]
        light[number] = np.where(shown, rays["transmittance"], 0.0)
        area = np.abs(np.linalg.det(np.where(shown[:, None, None], seen.pixel_rate, np.eye(2))))
        size[number] = np.where(shown & (area > 0.0), 1.0 / np.maximum(area, 1e-300), 0.0)
    count = len(inside)
    return PupilViews(offset[:count], light[:count], size[:count], np.mean(light == 0.0, axis=0))


_LIMITS = (-LARGEST_STEP_PX, LARGEST_STEP_PX)


def _newton(seen: Landings, chief: Landings) -> NDArray[np.float64]:
    """Step (N, 2) [px] towards the points of the chief rays; 0 where a ray does not land."""
    return np.nan_to_num(seen.step_px(chief), nan=0.0, posinf=0.0, neginf=0.0)
