"""Offsets of the rims of the listed balls from a fitted scene, to a fraction of a pixel.

Corners tell a ball by what is seen through it.  Its outline is found by what is seen beside it: a bright square of
the board goes on up to the rim and ends there, where no light passes.  Of the pixels that show a bright square of
the bare board, at the distance d outside the rim of the scene, a share is bright inside and nearly all are
outside.  In each of SECTORS the rim is where

    sum over pixels with d > s of  log P(bright or not | outside) - log P(bright or not | inside)

is largest, and s = s0 + a cos + b sin over the sectors: s0 is how much larger the ball is seen, a and b how far
aside.  Sectors in which other bodies are seen beside the rim, or too few bright squares, are left out.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.fit.seen.view_agreement import DIRECT_VIEW, Bounds, Shown
from correction.target import Chessboard
from tracer.bodies import Sphere
from tracer.camera import Camera
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose

SECTORS, FEWEST_SECTORS = 32, 8
REACH_PX, STEP_PX = 8.0, 0.125  # of rims from their places, both ways
CLEAR_OF_RIM_PX = 3.0  # from the rim, where inside and outside are surely that
MIN_SECTOR_PIXELS = 8  # pixels of a sector that are surely inside, and surely outside
OUTSIDE = 0.98  # chance that a pixel beside the ball is as bright as the board
INSIDE = (0.02, 0.5)  # bounds of that within, sector by sector: beyond the last one little tells the two apart
SECTOR_LOG_ODDS = 15.0  # logarithm of the odds against no rim, from which a sector shows it
RANSAC_DRAWS = 300  # of three sectors each, of which the one that most others agree with begins (RANSAC)
ALIKE_PX, MOST = 0.4, 0.75  # sectors agree that are so near; a share of them must: some balls have a bright ring
LEAST_SIGMA_PX = 0.1  # blur, and the pixels' grid
SECTOR_PX = 0.3  # to which one sector shows a rim
CERTAIN_PX, SURE = 0.35, 3.0  # rims of right scenes are within 0.2 px; standard deviations beyond that
AWAY_PX = 9  # side of what must be seen beside the balls where the board's brightness is taken


@dataclass(frozen=True)
class RimSeen:
    """The rim of one ball as a frame shows it.

    Parameters
    ----------
    ball : str
        Its name.
    larger_px : float
        By how much its radius is seen larger.
    aside_px : (float, float)
        How far to the right and down it is seen.
    larger_sigma_px : float
        Standard deviation of the first.
    off_px, sigma_px : float
        How far it is from its place where that is surest, and the standard deviation of that.
    radius_mm, pixel_mm : float
        Its radius in the scene, and how large a pixel is at its distance.
    """

    ball: str
    larger_px: float
    aside_px: tuple[float, float]
    larger_sigma_px: float
    off_px: float
    sigma_px: float
    radius_mm: float
    pixel_mm: float

    def is_off(self, place_mm: float, size_mm: float) -> bool:
        """True if place or size differ by more than chance and the uncertainty of both explain."""
        size_px, place_px = size_mm / self.pixel_mm, np.hypot(place_mm, size_mm) / self.pixel_mm
        return bool(
            self.off_px > CERTAIN_PX + SURE * np.hypot(self.sigma_px, place_px)
            or abs(self.larger_px) > CERTAIN_PX + SURE * np.hypot(self.larger_sigma_px, size_px)
        )

    def __str__(self) -> str:
        """Return one sentence."""
        size = self.larger_px * self.pixel_mm
        seen = f"{abs(self.larger_px):.1f} px {'larger' if size > 0.0 else 'smaller'}"
        x, y = self.aside_px
        return (
            f"the rim of `{self.ball}` is not where the corners put it: it is seen {seen} and"
            f" {float(np.hypot(x, y)):.1f} px aside, as if its radius were {self.radius_mm + size:.2f} and not"
            f" {self.radius_mm:.2f} mm, or as if it stood elsewhere; it is masked in every map; check its radius"
            " and place, and its glass"
        )


def rims_off(
    scene: Scene,
    shown: Shown,
    image: NDArray[Any],
    board: Chessboard,
    bounds_mm: Bounds,
    known_mm: Mapping[str, tuple[float, float]],
) -> list[RimSeen]:
    """Rims of a scene's balls that a frame shows elsewhere, by more than chance and than is known of their places.

    Parameters
    ----------
    scene : Scene
        As fitted, in the frame of the target.
    shown : Shown
        What it shows.
    image : (H, W)
        The frame.
    board : Chessboard
    bounds_mm : (2,) and (2,) float64
        Least and largest x, y of the board that is there.
    known_mm : mapping
        Ball -> standard deviations of its place sideways and of its radius; those not in it are known exactly.
    """
    import cv2

    walls = any(body.stays for body in scene.bodies)
    if not scene.spheres or walls or len(board.depths_mm) > 1 or not all(map(scene.in_camera_room, scene.spheres)):
        return []  # a ball is then not seen in the direction in which it stands
    bare = Shown.of(scene.bare(), TargetPose(), board, bounds_mm)
    beside = (shown.rays.branch == DIRECT_VIEW) & shown.rays.recovered
    apart = cv2.erode(beside.astype(np.uint8), np.ones((AWAY_PX, AWAY_PX), np.uint8)) != 0
    light = image.astype(np.float32)
    grey = bare.grey(light, bare.clear & apart)
    bright = bare.clear & bare.bright & np.isfinite(grey)
    found = rims_seen(scene.spheres, scene.camera, bright, light > grey, beside)
    return [rim for rim in found if rim.is_off(*known_mm.get(rim.ball, (0.0, 0.0)))]


def rims_seen(
    balls: tuple[Sphere, ...],
    camera: Camera,
    bright: NDArray[np.bool_],
    is_light: NDArray[np.bool_],
    beside: NDArray[np.bool_],
) -> Iterator[RimSeen]:
    """Measure the rims of balls, of those that show enough of one.

    Parameters
    ----------
    balls : tuple of Sphere
        As fitted.
    camera : Camera
    bright : (H, W) bool
        Pixels that would show a bright square, off its edges, if there were no ball.
    is_light : (H, W) bool
        Pixels of the frame that are as bright as that.
    beside : (H, W) bool
        Pixels whose rays, in the fitted scene, reach the board beside all balls.
    """
    rows, columns = np.nonzero(bright)
    away = camera.directions(np.stack((columns, rows), axis=1).astype(np.float64))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    eye = np.array(camera.position_mm)
    angles, halves = [], []
    for ball in balls:
        towards = np.array(ball.centre_mm) - eye
        distance = float(np.linalg.norm(towards))
        angles.append(np.arccos(np.clip(away @ (towards / distance), -1.0, 1.0)))
        halves.append(np.arcsin(min(ball.radius_mm / distance, 0.99)))
    outside = (np.array(angles).reshape(len(balls), -1) - np.array(halves)[:, None]) * camera.focal_px
    light, free = is_light[rows, columns], beside[rows, columns]
    for number, ball in enumerate(balls):
        alone = np.delete(outside, number, axis=0).min(axis=0, initial=np.inf) > REACH_PX
        off = outside[number]
        here = (np.abs(off) < REACH_PX) & alone & (free | (off < 0.0))
        middle = camera.project(np.array(ball.centre_mm)[None])[0]
        turn = np.arctan2(rows[here] - middle[1], columns[here] - middle[0])
        if (found := _fit_sectors(turn, off[here], light[here])) is not None:
            distance = float(np.linalg.norm(np.array(ball.centre_mm) - eye))
            larger, right, down, of_size, off_px, sigma = found
            aside, pixel_mm = (right, down), distance / camera.focal_px
            yield RimSeen(ball.name, larger, aside, of_size, off_px, sigma, ball.radius_mm, pixel_mm)


def _fit_sectors(
    turn: NDArray[np.float64], off: NDArray[np.float64], light: NDArray[np.bool_]
) -> tuple[float, float, float, float, float, float] | None:
    """Return the first numbers of `RimSeen` [px] as sectors show a rim."""
    inside, places = off < -CLEAR_OF_RIM_PX, np.arange(-REACH_PX, REACH_PX, STEP_PX)
    sector = np.floor((turn + np.pi) / (2.0 * np.pi) * SECTORS).astype(np.int64) % SECTORS
    angle, rim = [], []
    for number in range(SECTORS):
        own = sector == number
        if (
            min(np.count_nonzero(own & inside), np.count_nonzero(own & (off > CLEAR_OF_RIM_PX)))
            < MIN_SECTOR_PIXELS
        ):
            continue
        share = max(float(np.mean(light[own & inside])), INSIDE[0])
        if share > INSIDE[1]:
            continue
        order = np.argsort(-off[own])
        worth = np.where(light[own], np.log(OUTSIDE / share), np.log((1.0 - OUTSIDE) / (1.0 - share)))[order]
        likely = np.concatenate(([0.0], np.cumsum(worth)))[np.searchsorted(-off[own][order], -places)]
        if likely.max() - max(likely[0], likely[-1]) > SECTOR_LOG_ODDS:
            angle.append(float(np.mean(turn[own])))
            rim.append(float(places[likely > likely.max() - 1e-9].mean()))
    if len(rim) < FEWEST_SECTORS:
        return None
    at, seen = np.array(angle), np.array(rim)
    ways = np.stack((np.ones_like(at), np.cos(at), np.sin(at)), axis=1)
    prior = (SECTOR_PX / REACH_PX) ** 2 * np.eye(3)
    draws = np.random.default_rng(0).integers(len(at), size=(RANSAC_DRAWS, 3))
    tries = np.linalg.solve(
        ways[draws].swapaxes(1, 2) @ ways[draws] + prior, ways[draws].swapaxes(1, 2) @ seen[draws][:, :, None]
    )[:, :, 0]
    near = np.abs(seen - tries @ ways.T) < ALIKE_PX
    chosen = near[np.argmax(near.sum(axis=1))]
    if np.count_nonzero(chosen) < max(FEWEST_SECTORS, MOST * len(at)):
        return None
    ways, seen = ways[chosen], seen[chosen]
    normal = ways.T @ ways + prior
    rim_px = np.linalg.solve(normal, ways.T @ seen)
    scatter = max(1.48 * float(np.median(np.abs(seen - ways @ rim_px))), SECTOR_PX)
    larger, right, down = rim_px.tolist()
    off_px = ways @ rim_px  # where sectors show it: of an arc, size and place are known together only
    covariance = scatter**2 * np.linalg.inv(normal)
    sigma = np.sqrt(np.sum((ways @ covariance) * ways, axis=1) + LEAST_SIGMA_PX**2)
    worst = int(np.argmax(np.abs(off_px) / sigma))
    of_size = float(np.hypot(np.sqrt(covariance[0, 0]), LEAST_SIGMA_PX))
    return larger, right, down, of_size, abs(float(off_px[worst])), float(sigma[worst])
