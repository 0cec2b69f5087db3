"""Windows, tubes and domes of the renderer: every surface a quadratic or a plane, with a medium on each side.

A ray goes to the nearest surface a hair ahead of it; which way it crosses says which of the two media is beyond.
What is around a wall, or around a ball, is asked of a point of it: a tube behind a window stands in the window's
liquid. (The tracer knows rooms, and which surface comes next; nothing here is shared with it.)
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ground.jit import kernel
from sim.renderer.surfaces import Float64
from tracer.bodies import Body, Dome, Tube, Window
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


def n_at(scene: Scene, point_mm: NDArray[np.float64], but: Body | None = None) -> float:
    """Index of the medium at a point, a wall aside: that of the smallest inside around it that has one."""
    found = [(np.inf, scene.ambient)]
    for wall in scene.bodies:
        if isinstance(wall, Window):
            depth = float((np.array(wall.centre_mm) - point_mm) @ np.array(wall.normal)) - wall.thickness_mm
            size, medium = 1e9 + depth, wall.behind
        elif isinstance(wall, Tube):
            start, axis = np.array(wall.start_mm), np.array(wall.end_mm) - np.array(wall.start_mm)
            along = float((point_mm - start) @ axis / (axis @ axis))
            off = float(np.linalg.norm(point_mm - start - along * axis))
            depth = wall.inner_radius_mm - off if 0.0 < along < 1.0 else -1.0
            size, medium = wall.inner_radius_mm, wall.filled
        elif isinstance(wall, Dome):
            depth = wall.inner_radius_mm - float(np.linalg.norm(point_mm - np.array(wall.inside_mm)))
            size, medium = wall.inner_radius_mm, wall.filled
        else:
            continue
        if wall is not but and depth > 0.0 and medium is not None:
            found.append((size, medium))
    return min(found, key=lambda one: one[0])[1].n(scene.wavelength_nm)


def wall_rows(scene: Scene, walls: Sequence[Body]) -> list[list[float]]:
    """Rows of windows, tubes and domes, with indices / n_ambient.

    What is around a wall is asked at a point of it: its middle may be in what it holds.
    """
    air, nm = scene.ambient.n(scene.wavelength_nm), scene.wavelength_nm
    rows = []
    for wall in walls:
        if isinstance(wall, Window):
            around = n_at(scene, np.array(wall.centre_mm), wall)
            beyond = around if wall.behind is None else wall.behind.n(nm)
            place = [WINDOW, *wall.centre_mm, *wall.normal, wall.thickness_mm, wall.radius_mm, 0.0]
            rows.append([*place, around / air, wall.medium.n(nm) / air, beyond / air, 0.0, 0.0, 0.0])
        if isinstance(wall, Tube):
            start, end = np.array(wall.start_mm), np.array(wall.end_mm)
            length = float(np.linalg.norm(end - start))
            aside = np.cross(end - start, np.eye(3)[int(np.argmin(np.abs(end - start)))])
            on_wall = 0.5 * (start + end) + wall.outer_radius_mm * aside / np.linalg.norm(aside)
            around = n_at(scene, on_wall, wall)
            beyond = around if wall.filled is None else wall.filled.n(nm)
            place = [TUBE, *start.tolist(), *((end - start) / length).tolist(), length]
            radii = [wall.outer_radius_mm, wall.inner_radius_mm]
            rows.append([*place, *radii, around / air, wall.medium.n(nm) / air, beyond / air, 0.0, 0.0, 0.0])
        if isinstance(wall, Dome):
            around = n_at(scene, np.array(wall.centre_mm) + wall.outer_radius_mm * np.array(wall.axis), wall)
            beyond = around if wall.filled is None else wall.filled.n(nm)
            place = [DOME, *wall.centre_mm, *wall.axis, np.deg2rad(wall.half_angle_deg)]
            radii = [wall.outer_radius_mm, wall.inner_radius_mm]
            index = [around / air, wall.medium.n(nm) / air, beyond / air]
            rows.append([*place, *radii, *index, *wall.inside_mm])
    return rows
