"""Windows, tubes and domes of the renderer: every surface a quadratic or a plane, with a medium on each side.

A ray goes to the nearest surface a hair ahead of it; which way it crosses says which of the two media is beyond.
What is around a wall, or around a ball, is asked of a point of it: a tube behind a window stands in the window's
liquid. (The tracer knows rooms, and which surface comes next; nothing here is shared with it.)
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.jit import kernel
from sim.renderer.surfaces import Float64
from tracer.bodies import Body, Dome, Tube, Window
from tracer.media import Medium
from tracer.scene.scene import Scene

HAIR_MM = 1e-7
FACE, INSIDE, LOST = range(3)
WINDOW, TUBE, DOME = 0.0, 1.0, 2.0
# Row of a wall: kind, point, direction, thickness, length or half angle [rad], radii, n around, of the glass and
# beyond, point of the inside.
KIND, POINT, AXIS, DEPTH, RADIUS, INNER, AROUND, GLASS, BEYOND, INSIDE_AT, NUMBERS = (
    0, 1, 4, 7, 8, 9, 10, 11, 12, 13, 16,
)  # fmt: skip


@kernel
def next_wall(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, walls: Float64
) -> tuple[float, float, float, float, float, float, bool, int]:
    """Nearest surface ahead: distance (inf for none), normal against the ray, n before and behind it.

    Then whether the ray is in glass behind it, and which surface it is: FACE, INSIDE of a tube, or none (LOST).
    """
    best, nx, ny, nz, before, behind, in_glass, which = np.inf, 0.0, 0.0, 0.0, 1.0, 1.0, False, FACE
    for index in range(walls.shape[0]):
        w = walls[index]
        kx, ky, kz = w[AXIS], w[AXIS + 1], w[AXIS + 2]
        px, py, pz = ox - w[POINT], oy - w[POINT + 1], oz - w[POINT + 2]
        at, slope = px * kx + py * ky + pz * kz, dx * kx + dy * ky + dz * kz
        fx, fy, fz = px - at * kx, py - at * ky, pz - at * kz
        ex, ey, ez = dx - slope * kx, dy - slope * ky, dz - slope * kz
        if w[KIND] == WINDOW:
            for face in range(2):
                t = -(at + face * w[DEPTH]) / slope if slope != 0.0 else np.inf
                if HAIR_MM < t < best:
                    x, y, z = fx + t * ex, fy + t * ey, fz + t * ez
                    best, which = t, LOST if x * x + y * y + z * z >= w[RADIUS] * w[RADIUS] else FACE
                    side = -1.0 if slope > 0.0 else 1.0
                    nx, ny, nz = side * kx, side * ky, side * kz
                    in_glass = (face == 0) == (slope < 0.0)
                    other = w[AROUND] if face == 0 else w[BEYOND]
                    before, behind = (other, w[GLASS]) if in_glass else (w[GLASS], other)
            continue
        if w[KIND] == DOME:
            for surface in range(2):
                place, radius = (POINT, w[RADIUS]) if surface == 0 else (INSIDE_AT, w[INNER])
                gx, gy, gz = ox - w[place], oy - w[place + 1], oz - w[place + 2]
                b = 2.0 * (gx * dx + gy * dy + gz * dz)
                root = b * b - 4.0 * (gx * gx + gy * gy + gz * gz - radius * radius)
                if root <= 0.0:
                    continue
                for sign in (-1.0, 1.0):
                    t = 0.5 * (-b + sign * np.sqrt(root))
                    if HAIR_MM < t < best:
                        x, y, z = px + t * dx, py + t * dy, pz + t * dz
                        turn = np.arccos(min(1.0, (x * kx + y * ky + z * kz) / np.sqrt(x * x + y * y + z * z)))
                        best, which = t, LOST if turn > w[DEPTH] else (INSIDE if surface == 1 else FACE)
                        inward = sign < 0.0
                        out = 1.0 if inward else -1.0
                        nx = out * (gx + t * dx) / radius
                        ny = out * (gy + t * dy) / radius
                        nz = out * (gz + t * dz) / radius
                        in_glass = inward == (surface == 0)
                        other = w[AROUND] if surface == 0 else w[BEYOND]
                        before, behind = (other, w[GLASS]) if in_glass else (w[GLASS], other)
            continue
        a, b = ex * ex + ey * ey + ez * ez, 2.0 * (ex * fx + ey * fy + ez * fz)
        for surface in range(2):
            radius = w[RADIUS] if surface == 0 else w[INNER]
            root = b * b - 4.0 * a * (fx * fx + fy * fy + fz * fz - radius * radius)
            if a == 0.0 or root <= 0.0:
                continue
            for sign in (-1.0, 1.0):
                t = 0.5 * (-b + sign * np.sqrt(root)) / a
                if HAIR_MM < t < best and 0.0 < at + t * slope < w[DEPTH]:
                    best, which = t, INSIDE if surface == 1 else FACE
                    inward = sign < 0.0
                    out = 1.0 if inward else -1.0
                    nx, ny, nz = (
                        out * (fx + t * ex) / radius,
                        out * (fy + t * ey) / radius,
                        out * (fz + t * ez) / radius,
                    )
                    in_glass = inward == (surface == 0)
                    other = w[AROUND] if surface == 0 else w[BEYOND]
                    before, behind = (other, w[GLASS]) if in_glass else (w[GLASS], other)
        if slope != 0.0:
            for end in (0.0, w[DEPTH]):
                t = (end - at) / slope
                x, y, z = fx + t * ex, fy + t * ey, fz + t * ez
                off2 = x * x + y * y + z * z
                wall = w[INNER] * w[INNER] <= off2 < w[RADIUS] * w[RADIUS]
                liquid = off2 < w[INNER] * w[INNER] and w[AROUND] != w[BEYOND]
                if HAIR_MM < t < best and (wall or liquid):
                    best, which = t, LOST
    return best, nx, ny, nz, before, behind, in_glass, which


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
