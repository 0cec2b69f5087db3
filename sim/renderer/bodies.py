"""Bodies as the renderer's kernels read them: one row of numbers a body, indices relative to what is around it."""

from collections.abc import Callable, Sequence
from math import factorial, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.renderer.kernels.surfaces import SOLID
from sim.renderer.kernels.uneven import LOWEST, UNEVEN
from sim.renderer.kernels.walls import DOME, TRIANGLE, TUBE, WINDOW
from tracer.bodies import Block, Body, Box, Dome, Prism, Rod, Sphere, Tube, Window
from tracer.harmonics import HIGHEST, TERMS
from tracer.media import Medium
from tracer.scene.scene import Scene


def uneven_numbers(ball: Sphere) -> list[float]:
    """Further numbers in the row of a ball out of round, as `sim.renderer.kernels.uneven` reads them."""
    heights = {
        (degree, order): 1e-3 * um
        for (_, degree, order), um in zip(TERMS, ball.shape_um, strict=True)
        if um != 0.0
    }
    highest = max(degree for degree, _ in heights)
    numbers = [UNEVEN, float(highest)]
    for order in range(highest + 1):
        for degree in range(max(order, LOWEST), highest + 1):
            ratio = factorial(degree - order) / factorial(degree + order)
            norm = sqrt((1 if order == 0 else 2) * (2 * degree + 1) * ratio)
            numbers += [
                norm * heights.get((degree, order), 0.0),
                norm * heights.get((degree, -order), 0.0) * (order > 0),
            ]
    assert highest <= HIGHEST
    return numbers


class Wall(NamedTuple):
    """A kind of wall as the renderer knows it.

    Parameters
    ----------
    inside : callable
        (wall, point) -> how deep inside of it the point lies [mm], how large its inside is, and what is in it.
    outside_mm : callable
        wall -> a point of its outside: its middle may be in what it holds.
    places : callable
        wall -> of each of its rows the first ten numbers, from KIND to INNER, and the last three, INSIDE_AT.
    """

    inside: Callable[[Any, NDArray[np.float64]], tuple[float, float, Medium | None]]
    outside_mm: Callable[[Any], NDArray[np.float64]]
    places: Callable[[Any], list[tuple[list[float], list[float]]]]


def _in_window(wall: Window, point_mm: NDArray[np.float64]) -> tuple[float, float, Medium | None]:
    depth = float((np.array(wall.centre_mm) - point_mm) @ np.array(wall.normal)) - wall.thickness_mm
    return depth, 1e9 + depth, wall.behind


def _in_tube(wall: Tube, point_mm: NDArray[np.float64]) -> tuple[float, float, Medium | None]:
    start, axis = np.array(wall.start_mm), np.array(wall.end_mm) - np.array(wall.start_mm)
    along = float((point_mm - start) @ axis / (axis @ axis))
    off = float(np.linalg.norm(point_mm - start - along * axis))
    depth = wall.inner_radius_mm - off if 0.0 < along < 1.0 else -1.0
    return depth, wall.inner_radius_mm, wall.filled


def _in_dome(wall: Dome, point_mm: NDArray[np.float64]) -> tuple[float, float, Medium | None]:
    depth = wall.inner_radius_mm - float(np.linalg.norm(point_mm - np.array(wall.inside_mm)))
    return depth, wall.inner_radius_mm, wall.filled


def _on_tube(wall: Tube) -> NDArray[np.float64]:
    start, end = np.array(wall.start_mm), np.array(wall.end_mm)
    aside = np.cross(end - start, np.eye(3)[int(np.argmin(np.abs(end - start)))])
    return np.asarray(0.5 * (start + end) + wall.outer_radius_mm * aside / np.linalg.norm(aside))


def _on_dome(wall: Dome) -> NDArray[np.float64]:
    return np.asarray(np.array(wall.centre_mm) + wall.outer_radius_mm * np.array(wall.axis))


def _place_window(wall: Window) -> list[tuple[list[float], list[float]]]:
    return [([WINDOW, *wall.centre_mm, *wall.normal, wall.thickness_mm, wall.radius_mm, 0.0], [0.0, 0.0, 0.0])]


def _place_tube(wall: Tube) -> list[tuple[list[float], list[float]]]:
    start, end = np.array(wall.start_mm), np.array(wall.end_mm)
    length = float(np.linalg.norm(end - start))
    place = [TUBE, *start.tolist(), *((end - start) / length).tolist(), length]
    return [([*place, wall.outer_radius_mm, wall.inner_radius_mm], [0.0, 0.0, 0.0])]


def _place_dome(wall: Dome) -> list[tuple[list[float], list[float]]]:
    place = [DOME, *wall.centre_mm, *wall.axis, float(np.deg2rad(wall.half_angle_deg))]
    return [([*place, wall.outer_radius_mm, wall.inner_radius_mm], [*wall.inside_mm])]


def _polygons(block: Block, depth_mm: float) -> list[NDArray[np.float64]]:
    """Corners of each face (K, 3) in the world, counterclockwise from outside, all faces moved in by a depth.

    A corner of a moved profile is where two moved sides cross: p + depth (a + b) / (1 + a . b) with their inward
    normals a and b.
    """
    profile, half = np.array(block.profile_mm), 0.5 * block.length_mm - depth_mm
    way = np.roll(profile, -1, axis=0) - profile
    inward = np.stack((-way[:, 1], way[:, 0]), axis=1) / np.hypot(*way.T)[:, None]
    before = np.roll(inward, 1, axis=0)
    shrunk = profile + depth_mm * (inward + before) / (1.0 + (inward * before).sum(axis=1))[:, None]
    back, front = (np.column_stack((shrunk, np.full(len(shrunk), z))) for z in (-half, half))
    sides = [np.array([back[k - 1], back[k], front[k], front[k - 1]]) for k in range(len(shrunk))]
    return [own @ np.array(block.rotation) + np.array(block.centre_mm) for own in (*sides, back[::-1], front)]


def _place_block(wall: Block) -> list[tuple[list[float], list[float]]]:
    """Rows of the triangles of all faces, each about the middle of its face; see `sim.renderer.kernels.walls`."""
    rows = []
    for is_inner, depth_mm in enumerate((0.0, wall.wall_mm) if wall.wall_mm > 0.0 else (0.0,)):
        for corners in _polygons(wall, depth_mm):
            middle = corners.mean(axis=0)
            for one, other in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                a, b = one - middle, other - middle
                height = np.linalg.norm(np.cross(a, b)) / np.linalg.norm(b - a)
                place = [TRIANGLE, *middle.tolist(), *a.tolist(), *b.tolist()]
                rows.append((place, [float(wall.edge_mm / height), float(is_inner), 0.0]))
    return rows


def _in_block(wall: Block, point_mm: NDArray[np.float64]) -> tuple[float, float, Medium | None]:
    if wall.wall_mm == 0.0:
        return -1.0, 0.0, None
    heights = []
    for corners in _polygons(wall, wall.wall_mm):
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        heights.append(float((corners[0] - point_mm) @ normal / np.linalg.norm(normal)))
    return min(heights), wall.length_mm, wall.filled


WALLS: dict[type[Body], Wall] = {
    Window: Wall(_in_window, lambda wall: np.array(wall.centre_mm), _place_window),
    Tube: Wall(_in_tube, _on_tube, _place_tube),
    Dome: Wall(_in_dome, _on_dome, _place_dome),
    Box: Wall(_in_block, lambda wall: _polygons(wall, 0.0)[-1].mean(axis=0), _place_block),
    Prism: Wall(_in_block, lambda wall: _polygons(wall, 0.0)[-1].mean(axis=0), _place_block),
}


def n_at(scene: Scene, point_mm: NDArray[np.float64], but: Body | None = None) -> float:
    """Index of the medium at a point, a wall aside: that of the smallest inside around it that has one."""
    found = [(np.inf, scene.ambient)]
    for wall in scene.bodies:
        if wall is but or type(wall) not in WALLS:
            continue
        depth, size, medium = WALLS[type(wall)].inside(wall, point_mm)
        if depth > 0.0 and medium is not None:
            found.append((size, medium))
    return min(found, key=lambda one: one[0])[1].n(scene.wavelength_nm)


def wall_rows(scene: Scene, walls: Sequence[Body]) -> list[list[float]]:
    """Rows of all walls as `sim.renderer.kernels.walls` reads them, with indices / n_ambient."""
    air, nm = scene.ambient.n(scene.wavelength_nm), scene.wavelength_nm
    rows = []
    for wall in walls:
        kind = WALLS[type(wall)]
        around = n_at(scene, kind.outside_mm(wall), wall)
        (_, glass), *held = wall.media
        beyond = held[0][1].n(nm) if held else around
        for place, inside_at in kind.places(wall):
            rows.append([*place, around / air, glass.n(nm) / air, beyond / air, *inside_at])
    return rows


def ball_rows(scene: Scene, spheres: Sequence[Sphere]) -> NDArray[np.float64]:
    """Rows of the spheres, filled up with zeros to the longest, with the most cores or the finest shape."""
    rows = []
    for s in spheres:
        around, nm = n_at(scene, np.array(s.centre_mm)), scene.wavelength_nm
        glass = [1.0, 1.0] if s.medium is None else [s.medium.n(nm) / around, 0.0]  # opaque, or not
        cores = [number for core in s.cores for number in (core.radius_mm, core.medium.n(nm) / around)]
        rows.append([*s.centre_mm, s.radius_mm, *glass, *(uneven_numbers(s) if s.shape_um else cores)])
    width = max(map(len, rows), default=SOLID)
    return as_rows([row + [0.0] * (width - len(row)) for row in rows], width)


def as_rows(values: list[list[float]], width: int) -> NDArray[np.float64]:
    """Rows as an array (N, width), also of none."""
    return np.array(values, dtype=np.float64).reshape(-1, width)


def ball_around(rod: Rod) -> list[float]:
    """Centre and radius of the ball around a rod."""
    start, end = np.array(rod.start_mm), np.array(rod.end_mm)
    return [*(0.5 * (start + end)).tolist(), 0.5 * float(np.linalg.norm(end - start)) + rod.radius_mm]
