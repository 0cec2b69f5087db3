"""Plane cuts through a scene in which rays stay, and the rays in them.

A ball bends a ray in the plane of the ray and the ball's centre.  A plane through the pinhole and a ball's centre
therefore keeps every ray that starts in it, also through further balls whose centres lie in it.  Those that stand
upright on the investigation plane are drawn: each is a direction in x, y through the foot of the pinhole.  A ball
cut beside its centre deflects rays out of the plane; there a drawn ray ends.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import Body, Sphere
from tracer.scene.scene import Scene
from tracer.strategies.ray_path import ray_path

MOST_SECTIONS = 3
# Of a radius: a cut so near a centre bends rays out of its plane by less than a line is wide
CENTRAL = 0.02
RAYS = 41
GLASS, BESIDE, STOPPED = "through glass", "beside the glass", "stopped"
NEAR_MM = 1e-3

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Section:
    """A cut upright on the plane, through the pinhole.

    Parameters
    ----------
    letter : str
        Its name, as in technical drawings.
    foot_mm : (2,) float64
        Below the pinhole; s = 0 lies there.
    along : (2,) float64
        Unit vector of growing s.
    """

    letter: str
    foot_mm: Floats
    along: Floats

    def within(self, points_mm: Floats) -> Floats:
        """Places s, z (..., 2) [mm] of world points (..., 3)."""
        return np.stack(((points_mm[..., :2] - self.foot_mm) @ self.along, points_mm[..., 2]), axis=-1)

    def beside(self, points_mm: Floats) -> Floats:
        """Signed distances (...) [mm] of world points (..., 3) from the cut."""
        return np.asarray((points_mm[..., :2] - self.foot_mm) @ np.array([-self.along[1], self.along[0]]))

    def world(self, places_mm: Floats) -> Floats:
        """World points (..., 3) of places s, z (..., 2) [mm] in the cut."""
        flat = self.foot_mm + places_mm[..., :1] * self.along
        return np.concatenate((flat, places_mm[..., 1:]), axis=-1)


@dataclass(frozen=True)
class Ray:
    """Corners s, z (N, 2) [mm] of a ray, what becomes of it, and whether it leaves the cut at the last."""

    corners_mm: Floats
    fate: str
    leaves: bool


def sections_of(scene: Scene) -> tuple[Section, ...]:
    """Cuts through as many centres of balls as they can hold, the fullest first; at most `MOST_SECTIONS`."""
    foot = np.array(scene.camera.position_mm[:2])
    left = [body for body in scene.spheres if body.media] or list(scene.spheres)
    found: list[Section] = []
    while len(found) < MOST_SECTIONS and (left or not found):
        offsets = np.array([body.centre_mm[:2] for body in left]).reshape(-1, 2) - foot
        radii = np.array([body.radius_mm for body in left])
        ways = [np.array([1.0, 0.0]), *(_way(offset) for offset in offsets)]
        ways = sorted(ways, key=lambda way: -_is_central(way, offsets, radii).sum())
        found.append(Section("ABC"[len(found)], foot, ways[0]))
        left = [body for body, held in zip(left, _is_central(ways[0], offsets, radii), strict=True) if not held]
    return tuple(found)


def _way(offset: Floats) -> Floats:
    """Direction of an offset, its sign such that a picture has +x or +y to the right."""
    length = float(np.hypot(*offset))
    if length == 0.0:
        return np.array([1.0, 0.0])
    way = offset / length
    return np.asarray(-way if way[0] < -1e-9 or (abs(way[0]) <= 1e-9 and way[1] < 0.0) else way)


def _is_central(way: Floats, offsets: Floats, radii: Floats) -> NDArray[np.bool_]:
    """Return the balls that a cut along a direction meets in their centres."""
    return np.asarray(np.abs(offsets @ np.array([-way[1], way[0]])) <= CENTRAL * radii)


def is_central(section: Section, ball: Sphere) -> bool:
    """Return whether the cut goes through a ball's centre, so that rays stay in it."""
    return bool(abs(section.beside(np.array(ball.centre_mm))) <= CENTRAL * ball.radius_mm)


def reach_mm(scene: Scene, section: Section) -> tuple[float, float]:
    """From where to where on the plane, in s [mm], the camera looks along the cut without glass."""
    width, height = scene.camera.sensor_px
    far = 2.0 * scene.camera.position_mm[2] * max(width, height) / scene.camera.focal_px
    places = np.linspace(-far, far, 4001)
    points = section.world(np.stack((places, np.zeros_like(places)), axis=-1))
    u, v = np.moveaxis(scene.camera.project(points), -1, 0)
    seen = places[(u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)]
    return (float(seen.min()), float(seen.max())) if len(seen) else (-far / 4.0, far / 4.0)


def fan(scene: Scene, section: Section, low_mm: float, high_mm: float, count: int = RAYS) -> list[Ray]:
    """Rays that without glass would meet the plane evenly from `low_mm` to `high_mm`."""
    places = np.stack((np.linspace(low_mm, high_mm, count), np.zeros(count)), axis=-1)
    return [
        _ray(scene, section, pixel)
        for pixel in scene.camera.project(section.world(places))
        if np.isfinite(pixel).all()
    ]


def _ray(scene: Scene, section: Section, pixel: Floats) -> Ray:
    corners = ray_path(scene, pixel)
    if len(corners) == 1:
        corners = np.vstack((corners, _stop_point(scene, corners[0], scene.camera.directions(pixel))))
    on_plane = abs(corners[-1, 2]) < NEAR_MM
    fate = (GLASS if len(corners) > 2 else BESIDE) if on_plane else STOPPED
    smallest = min((ball.radius_mm for ball in scene.spheres), default=np.inf)
    away = np.flatnonzero(np.abs(section.beside(corners)) > 2.0 * CENTRAL * smallest)
    kept = corners[: max(2, away[0])] if len(away) else corners
    return Ray(section.within(kept), fate, bool(len(away)))


def _stop_point(scene: Scene, start: Floats, way: Floats) -> Floats:
    """Point at which a straight ray first comes to an opaque body, else where it is at the plane."""
    opaque: list[Body] = [body for body in scene.seen if not body.media]
    whole = start[2] / max(-way[2], 1e-9)
    gone = 0.0
    for _ in range(200):
        step = min((float(body.distance_mm(start + gone * way)) for body in opaque), default=np.inf)
        if step < NEAR_MM or gone + step > whole:
            break
        gone += step
    return np.asarray(start + min(gone, whole) * way)
