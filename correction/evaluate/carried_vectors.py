"""Vectors of raw frames carried through the glass: correlated (the velocity route), or particles tracked.

Kang et al. (2004) compared two ways: correct the images and correlate (the image route), or correlate the
distorted images and correct the vectors.  Their vector formula uses the map's gradient and is exact for small
displacements only; Minor et al. (2007) found terms missing in it.  Here neither is needed: the raw vector
(u - d/2 -> u + d/2) is traced at both ends, and

    plane displacement = X(u + d/2) - X(u - d/2),      plane position = midpoint of the two,

is exact for any displacement and any glass (of a camera with a pupil, between the chief rays of what the ends
show: `correction.maps.aperture`).  The route keeps windows of constant size on the sensor: it
resolves more where the view is magnified and less where it shrinks, and never resamples the frames.

TRACKS.  A particle's place in a raw frame is fitted where nobody has resampled it, and one traced ray carries it
to the plane, exactly, however strong the lens; the ray's derivative by the pixel carries its sigma along:

    sigma_i^2 = sum_j (dX_i / du_j)^2 sigma_j^2

There particles of A and B are matched.  On the sensor glass bends and stretches the flow, and a wrong partner may
well fit its neighbours; on the plane the flow is smooth, whatever stands before it.  So the correlation of the
corrected frames predicts, neighbours judge each other across the rims of balls, and distances are corrected pixels
everywhere.  Both ends of a track are seen the same way (one branch): between two ways lies a jump that is no flow.
An image at a rim, whose 5 x 5 px show two ways, is left out, and so is what the view squeezes below a half.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.maps.aperture import chief_pixels
from correction.masked import masked_pixels
from piv.correlation.outliers import outliers
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorField
from piv.errors import PairError
from piv.tracking.particles import SIDE, Particles, find_particles
from piv.tracking.tracks import track_particles
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import RayMap
from tracer.strategies.sensitivity import landings
from tracer.strategies.trace import trace

LEAST_MAGNIFICATION = 0.5  # of the view, sensor px a corrected px: the limit of the correction map
SMALLEST_VIEW_PX = 64  # pixels of a branch that is worth looking at
BLOCK = 8192  # particles traced at once: the derivatives of their rays are by every number of the scene
Floats = NDArray[np.float64]


def raw_settings(settings: PivSettings, shape: tuple[int, ...]) -> PivSettings:
    """Return settings for raw frames: displacements are larger, so a larger window goes first if it fits."""
    first = 2 * settings.windows_px[0]
    return replace(settings, windows_px=(first, *settings.windows_px)) if first <= min(shape) else settings


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
        Standard uncertainty of the displacement, from that of the raw vector through the map's gradient.
    pixel : (N, 2) float64
        Raw window centre.
    branch : (N,) uint16
        Branch of the ray map.
    """

    place_mm: NDArray[np.float64]
    shift_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float64]
    pixel: NDArray[np.float64]
    branch: NDArray[np.uint16]


def velocity_route(
    frame_a: NDArray[Any],
    frame_b: NDArray[Any],
    scene: Scene,
    ray_map: RayMap,
    settings: PivSettings | None = None,
) -> PlaneVectors:
    """Correlate two raw frames and trace the vectors onto the plane.

    Parameters
    ----------
    frame_a, frame_b : (H, W)
        Frames as acquired.
    scene : Scene
        The scene, with the camera's true pose and lens terms (a dewarp has no place here).
    ray_map : RayMap
        Its ray map.
    settings : PivSettings, optional
        Of the correlation; default those for raw frames.

    Returns
    -------
    PlaneVectors
        Vectors whose two ends stay on one branch, where the view is not squeezed below 0.5.

    Raises
    ------
    StaleMap
        The map belongs to another scene.
    PairError
        The frames do not make a pair.
    """
    ray_map.check(scene)
    if not ray_map.recovered.any():
        raise PairError("no ray of this scene reaches the plane; look at the scene with rtpiv trace")
    settings = settings or raw_settings(PivSettings(), frame_a.shape)
    parts = [
        _on_plane(evaluate_pair(frame_a, frame_b, mask, settings=settings), number, scene, settings)
        for number, mask in usable_branches(ray_map, scene, 8 * settings.windows_px[-1] ** 2)
    ]
    if not parts:
        raise PairError("no branch of this scene fills a window; look at the scene with rtpiv trace")
    return PlaneVectors(*(np.concatenate(column) for column in zip(*parts, strict=True)))


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
        calm = (largest < scale / LEAST_MAGNIFICATION) & (masked_pixels(scene, ray_map) == 0)
    found = []
    for number in np.unique(ray_map.branch[ray_map.recovered]):
        mask = ray_map.recovered & (ray_map.branch == number) & calm
        mask &= np.sign(det) == (1.0 if (det[mask] > 0).sum() * 2 > mask.sum() else -1.0)
        if mask.sum() > least_px:
            found.append((int(number), mask))
    return found


def _on_plane(
    field: VectorField, number: int, scene: Scene, settings: PivSettings
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.uint16]]:
    """Trace both ends of every measured vector of a branch; what then does not fit its neighbours is left out.

    Glass distorts raw displacements so much that a wrong one may well fit its neighbours on the sensor; on the
    plane the flow is smooth and it does not.
    """
    centre = field.grid_px[field.valid]
    shift = np.stack((field.u_px, field.v_px), axis=-1)[field.valid]
    sigma = np.stack((field.sigma_u_px, field.sigma_v_px), axis=-1)[field.valid]
    glass = np.full(len(centre), number != 0)
    ends = [chief_pixels(scene, centre + half * shift, glass) for half in (-0.5, 0.5)]
    first, last = (trace(scene, pixels) for pixels, _ in ends)
    rate = landings(scene, centre).pixel_rate
    good = ends[0][1] & ends[1][1] & first.recovered & last.recovered & (first.rays["key"] == last.rays["key"])
    good &= np.isfinite(rate).all(axis=(1, 2)) & np.isfinite(sigma).all(
        axis=1
    )  # without sigma, no peak to speak of
    step = last.plane_mm - first.plane_mm
    scale_px_mm = scene.camera.focal_px / scene.camera.position_mm[2]
    plane, measured = np.full((*field.flags.shape, 2), np.nan), np.zeros(field.flags.shape, bool)
    plane[field.valid], measured[field.valid] = scale_px_mm * step, good
    wrong = outliers(plane, measured, settings.outlier_threshold, settings.outlier_epsilon_px)
    good &= ~wrong[field.valid]
    sigma_mm = np.sqrt(np.einsum("nij,nj->ni", rate[good] ** 2, sigma[good] ** 2))
    middle = 0.5 * (first.plane_mm + last.plane_mm)[good]
    return middle, step[good], sigma_mm, centre[good], np.full(int(good.sum()), number, np.uint16)


class Carried(NamedTuple):
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
    a, b = (_carried(frame, views, scene, grid) for frame in (frame_a, frame_b))
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


def _carried(frame: NDArray[Any], views: NDArray[np.int32], scene: Scene, grid: PlaneGrid) -> Carried:
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
    return Carried(raw[lands], Particles(*(part[lands] for part in on_plane)), way[lands], branch[lands])
