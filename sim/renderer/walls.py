"""Rows of windows, tubes and domes for the renderer, as `sim.renderer.kernels.walls` reads them."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.renderer.kernels.walls import DOME, TUBE, WINDOW
from tracer.bodies import Body, Dome, Tube, Window
from tracer.media import Medium
from tracer.scene.scene import Scene


class Wall(NamedTuple):
    """What the renderer knows of a kind of wall.

    Parameters
    ----------
    inside : callable
        (wall, point) -> how deep inside of it the point lies [mm], how large its inside is, and what is in it.
    outside_mm : callable
        wall -> a point of its outside: its middle may be in what it holds.
    place : callable
        wall -> the first ten numbers of its row, from KIND to INNER, and the last three, INSIDE_AT.
    """

    inside: Callable[[Any, NDArray[np.float64]], tuple[float, float, Medium | None]]
    outside_mm: Callable[[Any], NDArray[np.float64]]
    place: Callable[[Any], tuple[list[float], list[float]]]


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


def _place_window(wall: Window) -> tuple[list[float], list[float]]:
    return [WINDOW, *wall.centre_mm, *wall.normal, wall.thickness_mm, wall.radius_mm, 0.0], [0.0, 0.0, 0.0]


def _place_tube(wall: Tube) -> tuple[list[float], list[float]]:
    start, end = np.array(wall.start_mm), np.array(wall.end_mm)
    length = float(np.linalg.norm(end - start))
    place = [TUBE, *start.tolist(), *((end - start) / length).tolist(), length]
    return [*place, wall.outer_radius_mm, wall.inner_radius_mm], [0.0, 0.0, 0.0]


def _place_dome(wall: Dome) -> tuple[list[float], list[float]]:
    place = [DOME, *wall.centre_mm, *wall.axis, float(np.deg2rad(wall.half_angle_deg))]
    return [*place, wall.outer_radius_mm, wall.inner_radius_mm], [*wall.inside_mm]


WALLS: dict[type[Body], Wall] = {
    Window: Wall(_in_window, lambda wall: np.array(wall.centre_mm), _place_window),
    Tube: Wall(_in_tube, _on_tube, _place_tube),
    Dome: Wall(_in_dome, _on_dome, _place_dome),
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
    """Rows of windows, tubes and domes, with indices / n_ambient."""
    air, nm = scene.ambient.n(scene.wavelength_nm), scene.wavelength_nm
    rows = []
    for wall in walls:
        kind = WALLS[type(wall)]
        around = n_at(scene, kind.outside_mm(wall), wall)
        (_, glass), *held = wall.media
        beyond = held[0][1].n(nm) if held else around
        place, inside_at = kind.place(wall)
        rows.append([*place, around / air, glass.n(nm) / air, beyond / air, *inside_at])
    return rows
