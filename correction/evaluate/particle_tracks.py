"""Single particles tracked between two raw frames, each traced through the glass to the investigation plane.

The place of a particle is fitted in the raw frame, which has not been resampled, and one traced ray projects it
onto the plane, exactly, however strong the lens (with a pupil, the chief ray: `correction.maps.aperture`).
The ray's derivative by the pixel propagates its sigma:

    sigma_i^2 = sum_j (dX_i / du_j)^2 sigma_j^2

There particles of A and B are matched.  On the sensor glass bends and stretches the flow, and a wrong partner may
well fit its neighbours; on the plane the flow is smooth, whatever stands before it.  So the correlation of the
corrected frames predicts, neighbours judge each other across the rims of balls, and distances are corrected pixels
everywhere.  Both ends of a track belong to one branch: between two branches lies a jump that is no flow.  An image
at a rim, whose 5 x 5 px show two branches, is left out, and so is what the view demagnifies below a half.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.maps.aperture import chief_pixels
from correction.maps.correction_map import CorrectionMap
from correction.masked import mask_pixels
from piv.correlation.vector_field import VectorField
from piv.errors import PairError
from piv.tracking.particles import SIDE, Particles, find_particles
from piv.tracking.tracks import track_particles
from tracer.scene.scene import Scene
from tracer.strategies.branches import last_sphere
from tracer.strategies.ray_map import RayMap
from tracer.strategies.sensitivity import landings

LEAST_MAGNIFICATION = 0.5  # of the view, sensor px a corrected px: the limit of the correction map
SMALLEST_VIEW_PX = 64  # pixels of a branch that is worth looking at
BLOCK = 8192  # particles traced at once: the derivatives of their rays are by every number of the scene
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PlaneVectors:
    """Vectors on the investigation plane, N of them, not on a grid.

    Parameters
    ----------
    place_mm : (N, 2) float64
        Plane position.
    shift_mm : (N, 2) float64
        Plane displacement.
    sigma_mm : (N, 2) float64
        Standard uncertainty of the displacement.
    pixel : (N, 2) float64
        Middle between both raw images.
    branch : (N,) uint16
        Branch of the ray map.
    """

    place_mm: NDArray[np.float64]
    shift_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float64]
    pixel: NDArray[np.float64]
    branch: NDArray[np.uint16]


def usable_branches(ray_map: RayMap, scene: Scene, least_px: int) -> list[tuple[int, NDArray[np.bool_]]]:
    """Pixels of each branch that are worth measuring in, for branches that have more than `least_px` of them.

    Only one branch is valid at a time, so no window mixes two pictures of the plane.  Left out are pixels whose
    view is squeezed too much, and those on the far side of a fold (the sign of the map's determinant is not that
    of the larger part), where the picture runs backwards; and parts that the scene says are masked.
    """
    scale = scene.camera.position_mm[2] / scene.camera.focal_px
    by_v: NDArray[np.float64] = np.asarray(np.gradient(ray_map.plane_mm, axis=0))
    by_u: NDArray[np.float64] = np.asarray(np.gradient(ray_map.plane_mm, axis=1))
    det = by_u[..., 0] * by_v[..., 1] - by_u[..., 1] * by_v[..., 0]
    with np.errstate(invalid="ignore"):
        largest = np.maximum(np.hypot(by_u[..., 0], by_u[..., 1]), np.hypot(by_v[..., 0], by_v[..., 1]))
        calm = (largest < scale / LEAST_MAGNIFICATION) & (mask_pixels(scene, ray_map) == 0)
    found = []
    for number in np.unique(ray_map.branch[ray_map.recovered]):
        mask = ray_map.recovered & (ray_map.branch == number) & calm
        mask &= np.sign(det) == (1.0 if (det[mask] > 0).sum() * 2 > mask.sum() else -1.0)
        if mask.sum() > least_px:
            found.append((int(number), mask))
    return found


class PlaneParticles(NamedTuple):
    """Particles of a raw frame on the plane.

    `raw_px` (N, 2), `on_plane` in corrected pixels, `way` (N,): key of the branch, and `branch` (N,): its number.
    """

    raw_px: Floats
    on_plane: Particles
    way: NDArray[np.int64]
    branch: NDArray[np.uint16]


def track_through_glass(
    frame_a: NDArray[Any],
    frame_b: NDArray[Any],
    scene: Scene,
    ray_map: RayMap,
    guide: VectorField,
    grid: PlaneGrid,
) -> PlaneVectors:
    """Displacement on the plane of every particle that is alone in both raw frames and seen the same way in both.

    Parameters
    ----------
    frame_a, frame_b : (H, W)
        Frames as acquired.
    scene : Scene
        The scene, with the camera's true pose and lens terms (a dewarp has no place here).
    ray_map : RayMap
        Its ray map.
    guide : VectorField
        Correlation of the corrected frames.
    grid : PlaneGrid
        Their raster.

    Returns
    -------
    PlaneVectors
        One a track; `pixel` is its raw middle.

    Raises
    ------
    StaleMap
        The map belongs to another scene.
    PairError
        Fewer than nine particles match.
    """
    ray_map.check(scene)
    views = np.zeros(ray_map.status.shape, np.int32)  # number of the branch + 1; 0 is of no use
    for number, mask in usable_branches(ray_map, scene, SMALLEST_VIEW_PX):
        views[mask] = number + 1
    if not views.any():
        raise PairError("no ray of this scene reaches the plane; look at the scene with rtpiv trace")
    a, b = (_project_particles(frame, views, scene, grid) for frame in (frame_a, frame_b))
    tracks = track_particles(a.on_plane, b.on_plane, guide, a.way, b.way)
    first, last = tracks.first, tracks.last
    pitch = grid.pitch_mm
    return PlaneVectors(
        place_mm=grid.to_mm(tracks.place_px),
        shift_mm=tracks.shift_px * (pitch, -pitch),
        sigma_mm=tracks.sigma_px * pitch,
        pixel=0.5 * (a.raw_px[first] + b.raw_px[last]),
        branch=a.branch[first],
    )


def _project_particles(
    frame: NDArray[Any], views: NDArray[np.int32], scene: Scene, grid: PlaneGrid
) -> PlaneParticles:
    """Particles of a raw frame whose images lie in one view, on the plane."""
    found = find_particles(frame, views > 0)
    column, row = np.rint(found.place_px).astype(int).T
    side = len(SIDE)
    whole = scipy.ndimage.minimum_filter(views, side) == scipy.ndimage.maximum_filter(views, side)
    inside = whole[row, column] & (views[row, column] > 0)
    raw, sigma_px, height = (part[inside] for part in found)
    branch = (views[row, column][inside] - 1).astype(np.uint16)
    chief, usable = chief_pixels(scene, raw, branch != 0)
    point, rate = np.zeros((len(raw), 2)), np.zeros((len(raw), 2, 2))
    way, lands = np.zeros(len(raw), np.int64), np.zeros(len(raw), bool)
    for begin in range(0, len(raw), BLOCK):
        some = slice(begin, begin + BLOCK)
        rays = landings(scene, chief[some])
        point[some], rate[some], way[some], lands[some] = rays.point_mm, rays.pixel_rate, rays.key, rays.recovered
    lands &= usable & np.isfinite(rate).all(axis=(1, 2))
    sigma_mm = np.sqrt(np.einsum("nij,nj->ni", rate**2, sigma_px**2))
    on_plane = Particles(grid.to_px(point), sigma_mm / grid.pitch_mm, height)
    return PlaneParticles(raw[lands], Particles(*(part[lands] for part in on_plane)), way[lands], branch[lands])


def track_radius(tracks: PlaneVectors, correction_map: CorrectionMap, scene: Scene) -> NDArray[np.float64]:
    """Return r / R of tracks behind glass, NaN in the direct view."""
    radius = np.full(len(tracks.branch), np.nan)
    for number in np.unique(tracks.branch[tracks.branch > 0]):
        last = last_sphere(scene, correction_map.branches[int(number)])
        if last is None:
            continue
        here = tracks.branch == number
        radius[here] = np.linalg.norm(tracks.place_mm[here] - last.centre_mm[:2], axis=1) / last.radius_mm
    return radius
