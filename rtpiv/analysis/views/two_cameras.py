"""Forecast for two cameras at the same time: union, velocity through the sheet, and balls that move.

At nodes of the plane that both see, with slopes a = dX/dz, s the smallest singular value of dP/dX of a view (a
corrected pixel is seen s pixels wide) and noise n = NOISE_PX / s of a displacement, two views u - a w give

    sigma_w^2 = (n_1^2 + n_2^2) / |a_2 - a_1|^2.

A particle at height h over the sheet and a ball that is off by d displace what the second view shows against the
first by

    (J_2 - J_1) d - (a_2 - a_1) h + noise,        J = dX/dd,

with noise of LOCATION_PX in each picture and h of SPREAD_MM.  All particles of a pair together, PER_PX on a
corrected pixel, give d as if nothing else moved: (sum J^T C^-1 J)^-1, as `correction.self_check.knocks` finds it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.grid import PlaneGrid, grid_of
from correction.light_sheet.double_views import DoubleViews
from correction.light_sheet.forecast import PER_PX, SPREAD_MM
from correction.maps.correction_map import build_correction_map
from correction.maps.slant import ray_slopes
from correction.self_check.knocks import least_move, weakest_sigma
from correction.self_check.moved_sphere import FLOOR_MM, MOVE_FALSE_ALARMS, MOVE_PRIOR_MM
from piv.statistics.three_components import MAX_SIGMA_W_PX
from rtpiv.analysis.through_glass import COMPARED_WIDTH_PX, behind, coarsen_scene, hiding, percent
from rtpiv.analysis.views.figures import NOISE_PX
from tracer.camera import look_at
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.sensitivity import TARGET, landings

LOCATION_PX = 0.1  # of a particle's picture in a frame; a pair has two frames
DEGREES = tuple(range(-30, 31, 5))  # of cameras on an arc about the y axis
SHARE_STEP = 0.01  # by which shares must differ for one pair of places to be better
RUN_PAIRS = 100
SAID_BALLS = 6
MAX_PLACES = 3000  # seen twice
MAX_SIGMA_MM = 0.1  # by one pair, of a ball that the views locate
Floats = NDArray[np.float64]
Balls = dict[str, Floats]


@dataclass(frozen=True, eq=False)
class _Plane:
    """Nodes (h, w) on which views are compared, those that glass hides from the first camera, and common balls.

    `pitch_mm` is a corrected pixel of full frames; places of balls are columns of `by_ball`, three each.
    """

    grid: PlaneGrid
    hidden: NDArray[np.bool_]
    names: tuple[str, ...]
    pitch_mm: float

    @classmethod
    def of(cls, first: Scene, names: Sequence[str]) -> "_Plane":
        """Return that of a first camera; without glass all nodes count as hidden."""
        grid = grid_of(coarsen_scene(first, COMPARED_WIDTH_PX).camera)
        hidden = behind(hiding(first), first, grid, ((0, grid.shape[0]), (0, grid.shape[1])))
        return cls(grid, hidden if hidden.any() else ~hidden, tuple(names), grid_of(first.camera).pitch_mm)

    @property
    def columns(self) -> list[str]:
        """Names of the places of balls."""
        return [f"{name}.{axis}" for name in self.names for axis in "xyz"]


@dataclass(frozen=True, eq=False)
class _View:
    """One camera at the nodes (h, w): slopes, noise and derivatives by balls where it recovers them."""

    recovered: NDArray[np.bool_]
    slope: Floats
    noise_px: Floats
    by_ball: Floats
    location_mm2: Floats

    @classmethod
    def of(cls, scene: Scene, plane: _Plane) -> "_View":
        """Return that of a scene."""
        small = coarsen_scene(scene, COMPARED_WIDTH_PX)
        found = build_correction_map(small, build_ray_map(small), plane.grid)
        seen = found.recovered
        pixel = np.asarray(found.pixel[0][seen], np.float64)
        rays = landings(small, pixel)
        per_px = rays.pixel_rate * (small.camera.sensor_px[0] / scene.camera.sensor_px[0])
        noise = NOISE_PX * np.linalg.norm(per_px, 2, axis=(1, 2)) / plane.pitch_mm
        parts = ray_slopes(small, pixel), noise, rays.columns(plane.columns), _location_mm2(per_px)
        fields = [np.full((*seen.shape, *part.shape[1:]), np.nan) for part in parts]
        for field, part in zip(fields, parts, strict=True):
            field[seen] = part
        return cls(seen, *fields)


@dataclass(frozen=True)
class TwoCameras:
    """Forecast for two cameras.

    Parameters
    ----------
    degrees : (float, float)
        Angles of the cameras about the y axis, as seen from the origin.
    union, with_w : float
        Share of what the glass hides from the first camera that either recovers, and that has w with a standard
        uncertainty of at most the limit; of the first camera's view without glass.
    sigma_w_px : float
        Median of a pair's w where it is reported [corrected px]; NaN if nowhere.
    balls : dict
        For each ball that the views locate, covariance (3, 3) of its position by one pair [mm^2].
    """

    degrees: tuple[float, float]
    union: float
    with_w: float
    sigma_w_px: float
    balls: Balls

    @property
    def sentences(self) -> list[str]:
        """In words, a line each."""
        found = [
            f"two cameras: {percent(self.union)} of what the glass hides from the first is recovered,"
            f" {percent(self.with_w)} with w; uncertainty of w from one pair {self.sigma_w_px:.3f} px (median)"
        ]
        for name, least in self.least_um.items():
            found.append(
                f"{name}: {_places(self.balls[name])}, if nothing else moves; smallest detectable knock"
                f" halfway through {RUN_PAIRS} pairs {least:.2g} um, in half of all runs"
            )
        return found

    @property
    def least_um(self) -> dict[str, float]:
        """Least knock sideways of each ball that half of all runs show in the middle of `RUN_PAIRS` pairs."""
        moving = len(self.balls) + 3  # beside both cameras and the sheet
        return {
            name: 1e3 * least_move(covariance, RUN_PAIRS, RUN_PAIRS // 2, moving)
            for name, covariance in self.balls.items()
        }


def sentences_of(balls: Balls) -> list[str]:
    """Describe the uncertainty of ball positions, by particles that one camera shows twice, best first.

    A move counts beside what calibration leaves unsure, by the test of `correction.self_check.moved_sphere`.
    """
    found = list[tuple[float, str]]()
    for name, covariance in balls.items():
        whole = covariance / RUN_PAIRS + np.diag(np.square(FLOOR_MM))
        ratio = scipy.special.fdtri(3, RUN_PAIRS - 3, 1.0 - MOVE_FALSE_ALARMS / len(balls))
        least = 1e3 * weakest_sigma(whole) * float(np.sqrt(3.0 * (RUN_PAIRS - 1) / (RUN_PAIRS - 3) * ratio))
        said = f"{name}: {_places(covariance, FLOOR_MM)}; smallest detectable move since its calibration"
        found.append((least, f"{said} {least:.2g} um, in half of all runs"))
    return [said for _, said in sorted(found)[:SAID_BALLS]]


def _places(covariance: Floats, floor_mm: Floats | float = 0.0) -> str:
    """Describe the uncertainty of a position by one pair, and by `RUN_PAIRS`."""
    each, every = (
        ", ".join(f"{um:.2g}" for um in 1e3 * np.sqrt(np.diag(covariance) / count + np.square(floor_mm)))
        for count in (1, RUN_PAIRS)
    )
    return f"position uncertainty (x, y, z) from one pair ({each}) um, from {RUN_PAIRS} pairs ({every}) um"


def two_cameras(first: Scene, second: Scene) -> TwoCameras:
    """Forecast for two scenes of one bench, whose balls have the same names."""
    known = {ball.name for ball in second.spheres}
    plane = _Plane.of(first, [ball.name for ball in first.spheres if ball.name in known])
    one, two = (_View.of(scene, plane) for scene in (first, second))
    places = [scene.camera.position_mm for scene in (first, second)]
    left, right = (math.degrees(math.atan2(x, z)) for x, _, z in places)
    return _with_balls(_forecast(plane, one, two, (left, right)), plane, one, two)


def best_places(scene: Scene, degrees: Sequence[float] = DEGREES) -> list[TwoCameras]:
    """Forecast two cameras like the scene's on an arc; return the pairs of places that no other beats.

    Sorted by `with_w`, then by `union`; pairs whose shares differ by less than `SHARE_STEP` by sigma of w.
    """
    plane = _Plane.of(scene, [ball.name for ball in scene.spheres])
    views = {angle: _View.of(at_degrees(scene, angle), plane) for angle in degrees}
    found = [_forecast(plane, views[one], views[two], (one, two)) for one, two in combinations(degrees, 2)]
    found.sort(key=lambda pair: (np.nan_to_num(pair.sigma_w_px, nan=np.inf), abs(sum(pair.degrees))))
    steps: dict[tuple[int, int], TwoCameras] = {}
    for pair in found:
        steps.setdefault((round(pair.with_w / SHARE_STEP), round(pair.union / SHARE_STEP)), pair)
    front = [
        _with_balls(pair, plane, *(views[angle] for angle in pair.degrees))
        for at, pair in steps.items()
        if not any(other != at and other[0] >= at[0] and other[1] >= at[1] for other in steps)
    ]
    return sorted(front, key=lambda pair: (-pair.with_w, -pair.union))


def at_degrees(scene: Scene, degrees: float) -> Scene:
    """Return the scene with its camera on an arc about the y axis, at its distance and aimed at the origin."""
    distance, angle = float(np.linalg.norm(scene.camera.position_mm)), math.radians(degrees)
    place = distance * math.sin(angle), 0.0, distance * math.cos(angle)
    return scene.with_camera(replace(scene.camera, position_mm=place, rotation=look_at(place, (0.0, 0.0, 0.0))))


def _forecast(plane: _Plane, one: _View, two: _View, degrees: tuple[float, float]) -> TwoCameras:
    """Forecast shares and w."""
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma_w = np.hypot(one.noise_px, two.noise_px) / np.linalg.norm(two.slope - one.slope, axis=-1)
    sure = sigma_w <= MAX_SIGMA_W_PX  # NaN is not
    union, with_w = (float(seen[plane.hidden].mean()) for seen in (one.recovered | two.recovered, sure))
    typical = float(np.median(sigma_w[sure])) if sure.any() else math.nan
    return TwoCameras(degrees, union, with_w, typical, {})


def _with_balls(found: TwoCameras, plane: _Plane, one: _View, two: _View) -> TwoCameras:
    """Return the forecast with that of the places of balls."""
    both = one.recovered & two.recovered
    slope, by_ball = (two.slope - one.slope)[both], (two.by_ball - one.by_ball)[both]
    location, particles = (
        (one.location_mm2 + two.location_mm2)[both],
        PER_PX * (plane.grid.pitch_mm / plane.pitch_mm) ** 2,
    )
    return replace(found, balls=_balls(plane.names, by_ball, slope, location, particles))


def double_view_forecast(scene: Scene, views: DoubleViews) -> Balls:
    """Forecast the places of balls from particles that one camera shows twice, as `TwoCameras.balls`."""
    names = [ball.name for ball in scene.spheres]
    every = max(1, len(views.kind) // MAX_PLACES)
    views = views.at(np.arange(0, len(views.kind), every))
    one, two = (landings(scene, pixel) for pixel in (views.first_px, views.second_px))
    places = [f"{name}.{axis}" for name in names for axis in "xyz"]
    by_ball = two.columns(places) - one.columns(places)
    slope = (two.rate - one.rate)[:, :, TARGET.index("z") - len(TARGET)]
    location = _location_mm2(one.pixel_rate) + _location_mm2(two.pixel_rate)
    return _balls(names, by_ball, slope, location, PER_PX * views.step**2 * every)


def _location_mm2(per_px: Floats) -> Floats:
    """Covariance (N, 2, 2) of the place of a particle in both frames of a pair."""
    return np.asarray(0.5 * LOCATION_PX**2 * per_px @ np.swapaxes(per_px, 1, 2))


def _balls(names: Sequence[str], by_ball: Floats, slope: Floats, location_mm2: Floats, particles: float) -> Balls:
    """Forecast the places of balls from N nodes, with so many particles each."""
    covariance = location_mm2 + SPREAD_MM**2 * slope[:, :, None] * slope[:, None, :]
    balls: Balls = {}
    for number, name in enumerate(names):
        rate = by_ball[:, :, 3 * number : 3 * number + 3]
        known = np.isfinite(rate).all(axis=(1, 2)) & np.isfinite(covariance).all(axis=(1, 2))
        weight = np.linalg.inv(covariance[known])
        normal = particles * np.einsum("nij,nik,nkl->jl", rate[known], weight, rate[known])
        of_place = np.asarray(np.linalg.inv(normal + np.eye(3) / MOVE_PRIOR_MM**2), np.float64)
        if weakest_sigma(of_place) < MAX_SIGMA_MM:
            balls[name] = of_place
    return balls
