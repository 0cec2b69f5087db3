"""Particles that a frame shows twice, directly and through glass or in two ways through it; how far they differ.

Each particle is fitted in the raw frame and carried to the light sheet by the ray of its pixel (as tracks are,
`correction.evaluate.particle_tracks`). Two pictures of one particle must meet there. What is left between
them is

    r = X_b - X_a = (J_a - J_b) d + (p_a - p_b) h + noise,

J being what the landing moves by with the places of the spheres (d, three numbers each), p what it moves by with
height, and h the particle's height over the map's sheet: the sheet's own, and that of a particle in a sheet that
has a thickness. So noise is wide along p_a - p_b and narrow across, which its covariance holds.

Places seen twice are those of `light_sheet.double_views`: no rim cuts a picture, views are nearly straight. Two
pictures are taken for one particle if each is the other's nearest and they are no farther apart than `GATE`
deviations; where seeding is dense, some pairs are chance, which spreads evenly within that and adds no shift.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.light_sheet.double_views import double_views
from piv.tracking.particles import find_particles
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.sensitivity import TARGET, landings

GATE = 4.0
SHEET_DEPTH_SIGMA_MM = 0.18  # standard deviation of a particle's height in a sheet of 1 mm
MIN_PICTURE_SIGMA_PX = 0.05  # standard deviation of a picture's place, whatever its fit says
PLACE_STEP_PX = 2  # corrected pixels between places that are looked for
ROOM_PX = 4  # around a place seen twice, for the pictures of its particles
PARTICLES_AT_ONCE = 8192
MOST_PX = 4.0  # corrected pixels between two pictures of one particle


@dataclass(frozen=True)
class SeenTwice:
    """M particles seen twice.

    Parameters
    ----------
    frame_pair : (M,) int64
        Which pair of frames showed them.
    place_mm : (M, 2) float64
        On the sheet.
    apart_mm : (M, 2) float64
        From the first picture to the second, on the sheet.
    weight : (M, 2, 2) float64
        Inverse of its covariance [1/mm^2].
    by_sphere : (M, 2, 3 B) float64
        What it would be for a millimetre of each sphere along x, y, z.
    by_height : (M, 2) float64
        What it would be for a millimetre of the sheet's height.
    """

    frame_pair: NDArray[np.int64]
    place_mm: NDArray[np.float64]
    apart_mm: NDArray[np.float64]
    weight: NDArray[np.float64]
    by_sphere: NDArray[np.float64]
    by_height: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.frame_pair)


def join_pairs(parts: list[SeenTwice]) -> SeenTwice:
    """Return particles of several frames together."""
    names = ("frame_pair", "place_mm", "apart_mm", "weight", "by_sphere", "by_height")
    return SeenTwice(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class Finder:
    """Finds particles seen twice in the frames of one scene.

    Parameters
    ----------
    scene : Scene
        Fitted; in its light sheet (`Scene.in_light_sheet`).
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.spheres = tuple(ball.name for ball in scene.spheres)
        self.views = double_views(scene, build_ray_map(scene), PLACE_STEP_PX)
        self._names = [f"{name}.{part}" for name in self.spheres for part in "xyz"]
        mask = np.zeros(scene.camera.shape, np.bool_)
        for pixel in (self.views.first_px, self.views.second_px):
            column, row = np.rint(pixel).astype(np.int64).T
            inside = (row >= 0) & (row < mask.shape[0]) & (column >= 0) & (column < mask.shape[1])
            mask[row[inside], column[inside]] = True
        side = 2 * ROOM_PX + 1
        self.mask = np.asarray(scipy.ndimage.binary_dilation(mask, np.ones((side, side), np.bool_)))
        self.pitch_mm = self.views.pitch_mm

    def find(self, frame: NDArray[Any], frame_pair: int) -> SeenTwice:
        """Return the particles that a raw frame (H, W), free of its background, shows twice."""
        found = find_particles(frame, self.mask)
        pixel, sigma_px = found.place_px, np.maximum(found.sigma_px, MIN_PICTURE_SIGMA_PX)
        parts = []
        for begin in range(0, len(pixel), PARTICLES_AT_ONCE):
            rays = landings(self.scene, pixel[begin : begin + PARTICLES_AT_ONCE])
            height = rays.rate[:, :, TARGET.index("z") - len(TARGET)]
            parts.append(
                (rays.point_mm, rays.pixel_rate, rays.key, rays.recovered, rays.columns(self._names), height)
            )
        if not parts:
            return self._none()
        point, by_pixel, key, lands, by_sphere, by_height = (
            np.concatenate(part) for part in zip(*parts, strict=True)
        )
        lands &= np.isfinite(by_pixel).all(axis=(1, 2)) & np.isfinite(by_sphere).all(axis=(1, 2))
        covariance = np.einsum("nij,nj,nkj->nik", by_pixel, sigma_px**2, by_pixel)
        ways = [np.flatnonzero(lands & (key == way)) for way in np.unique(key[lands])]
        matched = [self._match(point, covariance, by_height, one, two) for one, two in combinations(ways, 2)]
        if not matched:
            return self._none()
        first, second = (np.concatenate(part) for part in zip(*matched, strict=True))
        depth = by_height[second] - by_height[first]
        return SeenTwice(
            np.full(len(first), frame_pair, np.int64),
            0.5 * (point[first] + point[second]),
            point[second] - point[first],
            np.asarray(np.linalg.inv(_spread(covariance[first] + covariance[second], depth)), np.float64),
            by_sphere[first] - by_sphere[second],
            -depth,
        )

    def _match(
        self,
        point: NDArray[np.float64],
        covariance: NDArray[np.float64],
        by_height: NDArray[np.float64],
        one: NDArray[np.intp],
        two: NDArray[np.intp],
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Particles of two ways that are each other's nearest and within the gate."""
        reach = MOST_PX * self.pitch_mm
        there = scipy.spatial.cKDTree(point[two])
        away, nearest = there.query(point[one], distance_upper_bound=reach)
        near = np.isfinite(away)
        one, nearest = one[near], nearest[near]
        if not len(one):
            return one, one
        _, back = scipy.spatial.cKDTree(point[one]).query(point[two[nearest]])
        mutual = back == np.arange(len(one))
        first, second = one[mutual], two[nearest[mutual]]
        spread = _spread(covariance[first] + covariance[second], by_height[second] - by_height[first])
        apart = point[second] - point[first]
        far = np.einsum("ni,nij,nj->n", apart, np.linalg.inv(spread), apart)
        kept = far < GATE**2
        return first[kept], second[kept]

    def _none(self) -> SeenTwice:
        count = 3 * len(self.spheres)
        return SeenTwice(
            np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2, 2)),
            np.zeros((0, 2, count)), np.zeros((0, 2)),
        )  # fmt: skip


def _spread(covariance: NDArray[np.float64], depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance (N, 2, 2) with that of heights within the sheet."""
    return np.asarray(covariance + SHEET_DEPTH_SIGMA_MM**2 * depth[:, :, None] * depth[:, None, :])
