"""Robust least squares over corners, with exact derivatives and without root finding.

A corner measured at pixel u that shows lattice point X_k of a print stretched by s has the residual

    e = W J^-1 (X(u; theta) - s X_k),        J = dX/du,        W^T W = covariance^-1 of u

the reprojection error in sigmas, to first order: tracing goes from pixels to the plane, so no inverse has to
be iterated.  Its derivative is W J^-1 dX/dtheta (the missing term is proportional to the residual itself).
Marks of a plate's other level land on its plane, d behind the target's along its normal n:  with Y = dX/do by
the target's origin o, the derivative by the target's turn has  -d n x Y  more, that by d is  -Y n.
Far from the solution J says little; there e = (X - X_k) / scale is used, on the plane.

The cost is  sum rho(|e|^2) + x . x + walls,  rho(s) = c^2 log(1 + s/c^2) (Cauchy) on data only: priors are
Gaussian.  Minimised by Levenberg-Marquardt on the normal equations with iteratively reweighted corners.
Why not scipy's least_squares: its loss bends priors as well, its set of residuals must not change, and here
rays leave and enter the glass from step to step.  A ray that does not land costs as much as one LOST
sigmas off and pulls nowhere.

Walls: balls stay out of each other (`contact`) and on their side of windows and tubes.  Which side that is the
nominal scene says; how far a ball is from crossing over, the wall itself (`Room.gaps_mm`), and differences of it
say how that changes with the ball's place and the wall's numbers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.block_edges import edge_rates
from correction.fit.solve.contact import CONTACT_ROUNDS, WALL_MM, push_apart, walls
from correction.fit.solve.other_bodies import NUMBER_STEP
from correction.fit.solve.unknowns import Unknowns, rotation_jacobian
from tracer.bodies import CONTACT_TOL_MM, Body
from tracer.errors import SceneError
from tracer.strategies.sensitivity import CAMERA, SPHERE, TARGET, Landings, TargetPose, landings_through

FAR_MM = 5.0  # a ball so far from a wall does not come to it in one step
LOST = 12.0  # [residual units] what a ray that lands nowhere costs
MAX_LM_STEPS = 40


def room_depths(
    unknowns: Unknowns, full: NDArray[np.float64], asked: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Depth (K,) [mm] of each ball in each wall, negative for a gap, and derivatives (K, F) where `asked` (F,)."""
    sides = unknowns.other_bodies.sides
    depth, rate = np.full(len(sides), -FAR_MM), np.zeros((len(sides), len(full)))
    if not sides:
        return depth, rate
    try:
        walls = unknowns.other_bodies.bodies_at(full[unknowns.others])
    except SceneError:
        return depth, rate
    table, first = unknowns.spheres(full), unknowns.others.start
    moved: dict[int, tuple[dict[str, Body], dict[str, Body]]] = {}
    for number, pair in enumerate(sides):
        gap = pair.gap_mm(table, walls)
        if gap > FAR_MM:
            continue
        depth[number] = -gap
        place = unknowns.glass.start + len(SPHERE) * pair.ball
        if asked[place : place + 3].any():
            rate[number, place : place + 3] = -pair.way_in(table, walls)
        rate[number, place + 3] = 1.0
        for at, name in enumerate(unknowns.other_bodies.names, start=first):
            if asked[at] and name.startswith(f"{pair.wall.name}."):
                if at not in moved:
                    moved[at] = (
                        _change_walls(unknowns, full, at, NUMBER_STEP),
                        _change_walls(unknowns, full, at, -NUMBER_STEP),
                    )
                ahead, back = moved[at]
                rate[number, at] = (pair.gap_mm(table, back) - pair.gap_mm(table, ahead)) / (2.0 * NUMBER_STEP)
    return depth, rate


def push_clear(unknowns: Unknowns, full: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Sphere table (N, 6) with balls clear of each other, the plane and the walls, and the deepest cut."""
    sides, walls = unknowns.other_bodies.sides, unknowns.other_bodies.bodies_at(full[unknowns.others])
    table, shapes = unknowns.spheres(full), unknowns.shapes(full)
    deepest = max((-pair.gap_mm(table, walls) for pair in sides), default=0.0)
    for _ in range(CONTACT_ROUNDS):
        table, clean = push_apart(table, shapes=shapes), True
        for pair in sides:
            gap = pair.gap_mm(table, walls)
            if gap < 0.0:
                way = pair.way_in(table, walls)
                table[pair.ball, :3] += (0.1 * CONTACT_TOL_MM - gap) * way / max(float(np.linalg.norm(way)), 1e-9)
                clean = False
        if clean:
            break
    return table, max(deepest, 0.0)


def clear_spheres(unknowns: Unknowns, full: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Full vector (F,) with balls pushed clear, of which scenes can be made, and the deepest overlap [mm]."""
    moved, (pushed, deepest) = np.array(full), push_clear(unknowns, full)
    moved[unknowns.glass].reshape(-1, len(SPHERE))[:, :3] = pushed[:, :3]
    return moved, deepest


def _change_walls(unknowns: Unknowns, full: NDArray[np.float64], at: int, by: float) -> dict[str, Body]:
    """Walls with one number of the full vector changed."""
    return unknowns.other_bodies.bodies_at((full + by * _one(full.shape, (at,)))[unknowns.others])


def _one(shape: tuple[int, ...], place: tuple[int, ...]) -> NDArray[np.float64]:
    """Zeros with a single one."""
    one = np.zeros(shape)
    one[place] = 1.0
    return one


@dataclass(frozen=True)
class Corners:
    """Measured corners of one frame.

    Parameters
    ----------
    height_number : int
        Number of the target's height in the bench.
    glass : bool
        Whether the glass stood before the camera.
    pixel : (N, 2) float64
        Acquired pixels.
    node_mm : (N, 2) float64
        Their points on the target.
    whiten : (N, 2, 2) float64 or float
        W; a number means: residuals on the plane, in units of that many mm.
    depth_mm : (N,) float64, optional
        How far they lie behind the plane of the target, as its step was measured; all on it, without.
    """

    height_number: int
    glass: bool
    pixel: NDArray[np.float64]
    node_mm: NDArray[np.float64]
    whiten: NDArray[np.float64] | float
    depth_mm: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not len(self.depth_mm):
            object.__setattr__(self, "depth_mm", np.zeros(len(self)))

    def __len__(self) -> int:
        return len(self.pixel)

    def take(self, chosen: NDArray[np.bool_]) -> "Corners":
        """Return the corners where `chosen`."""
        whiten = self.whiten if isinstance(self.whiten, float) else self.whiten[chosen]
        pixel, node, depth = self.pixel[chosen], self.node_mm[chosen], self.depth_mm[chosen]
        return replace(self, pixel=pixel, node_mm=node, whiten=whiten, depth_mm=depth)


@dataclass(frozen=True)
class Residuals:
    """Residuals (N, 2), derivatives (N, 2, P) by the free vector; NaN where the ray does not land."""

    value: NDArray[np.float64]
    rate: NDArray[np.float64]


@dataclass(frozen=True)
class Solution:
    """Result of a minimisation.

    Parameters
    ----------
    x : (P,) float64
        Free vector.
    normal : (P, P) float64
        Normal matrix of the data, without priors and walls.
    """

    x: NDArray[np.float64]
    normal: NDArray[np.float64]

    @property
    def pull(self) -> float:
        """Largest distance from the priors, in sigmas."""
        return float(np.abs(self.x).max(initial=0.0))


def land_corners(
    unknowns: Unknowns, full: NDArray[np.float64], corners: Corners, by_walls: bool = False
) -> Landings:
    """Landing points of the corners' pixels on their target; none if there are no such bodies.

    Derivatives by the numbers of windows and tubes are there where these are free, or asked for.
    """
    by_walls = by_walls or bool(unknowns.columns[unknowns.others].any())
    pose, camera = unknowns.pose(full, corners.height_number), unknowns.camera(full)
    try:
        world = unknowns.world(full, corners.glass)
    except SceneError:
        world = unknowns.world(unknowns.start, corners.glass)
        return landings_through(camera, world, corners.pixel, pose, unknowns.scene.n_ambient, by_walls).nowhere()
    depth = unknowns.deeper(full) * corners.depth_mm
    return on_levels(
        lambda plane, pixels: landings_through(camera, world, pixels, plane, unknowns.scene.n_ambient, by_walls),
        pose,
        corners.pixel,
        depth,
    )


def on_levels(
    land: Callable[[TargetPose, NDArray[np.float64]], Landings],
    pose: TargetPose,
    pixels: NDArray[np.float64],
    depth_mm: NDArray[np.float64],
) -> Landings:
    """Landings of pixels (N, 2) on planes so far (N,) behind a target, derivatives by the pose of that target.

    Parameters
    ----------
    land : callable
        Plane and pixels (M, 2) -> landings there.
    pose, pixels, depth_mm
        Of the target, and of each pixel.
    """
    levels = np.unique(depth_mm)
    if len(levels) < 2 and not levels.any():
        return land(pose, pixels)
    parts = [(depth_mm == level, land(pose.behind(float(level)), pixels[depth_mm == level])) for level in levels]
    first = parts[0][1]

    def put(name: str) -> NDArray[Any]:
        of_first = getattr(first, name)
        out = np.zeros((len(pixels), *of_first.shape[1:]), of_first.dtype)
        for here, part in parts:
            out[here] = getattr(part, name)
        return out

    rate, normal = put("rate"), np.array(pose.axes[2])
    by_place = rate[:, :, -6:-3]
    rate[:, :, -3:] -= depth_mm[:, None, None] * np.cross(normal, by_place)
    return Landings(put("status"), put("key"), put("point_mm"), put("pixel_rate"), rate, first.names)


def free_rates(
    unknowns: Unknowns, full: NDArray[np.float64], corners: Corners, rays: Landings
) -> NDArray[np.float64]:
    """Derivatives (N, 2, P) [mm per sigma] of the landing points, seen from their corners, by the free vector."""
    if not rays.recovered.any():
        return np.full((len(rays.status), 2, len(unknowns.names)), np.nan)
    camera, place = slice(len(CAMERA)), unknowns.place(corners.height_number)
    glass = unknowns.columns[unknowns.glass][: None if corners.glass else 0]
    by_number = unknowns.columns[unknowns.others]
    shapes = unknowns.columns[unknowns.all_shapes][: None if corners.glass else 0]
    known = len(CAMERA) + len(glass) + len(shapes) + len(TARGET)
    rows = np.zeros((rays.rate.shape[2] - known, len(unknowns.names)))
    if by_number.any():
        rows = unknowns.other_bodies.row_rates(full[unknowns.others], corners.glass) @ by_number
    turned = np.concatenate((unknowns.columns[camera], glass, rows, shapes, unknowns.columns[place]))
    turned[3:6] = rotation_jacobian(full[3:6]) @ turned[3:6]
    turned[-3:] = rotation_jacobian(full[place][3:]) @ turned[-3:]
    count, _, numbers = rays.rate.shape
    of_rays = (rays.rate.reshape(-1, numbers) @ turned).reshape(count, 2, -1)
    # By the print too where the ray lands, not at its corner: a bench that grows with its print, which no frame
    # tells, must move nothing, or noise beside the corners would shrink it.
    on_print = rays.point_mm / unknowns.stretch(full)[:2]
    by_print = on_print[:, :, None] * unknowns.columns[unknowns.print_place]
    if len(levels := unknowns.columns[unknowns.print_place.stop :]):
        normal = np.array(unknowns.pose(full, corners.height_number).axes[2])
        by_depth = rays.rate[:, :, -len(TARGET) : -3] @ normal
        by_print += (by_depth * corners.depth_mm[:, None])[:, :, None] * levels[0]
        if len(seen := levels[1:]):
            by_level = seen[:2] + corners.node_mm[:, :, None] * seen[2]
            by_print += unknowns.is_deep(corners.depth_mm)[:, None, None] * by_level
    return np.asarray(of_rays - by_print)


def residuals(unknowns: Unknowns, x: NDArray[np.float64], corners: Corners) -> Residuals:
    """Residuals of corners at the free vector x."""
    full = unknowns.full(x)
    rays = land_corners(unknowns, full, corners)
    off = rays.point_mm - unknowns.mark_places_mm(full, corners.node_mm, corners.depth_mm)
    rate = free_rates(unknowns, full, corners, rays)
    if isinstance(corners.whiten, float):
        return Residuals(off / corners.whiten, rate / corners.whiten)
    j = rays.pixel_rate
    det = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
    inverse = np.stack((j[:, 1, 1], -j[:, 0, 1], -j[:, 1, 0], j[:, 0, 0]), axis=-1).reshape(-1, 2, 2)
    to_sigma = corners.whiten @ (inverse / det[:, None, None])
    return Residuals((to_sigma @ off[:, :, None])[:, :, 0], to_sigma @ rate)


Evaluate = Callable[[NDArray[np.float64]], list[Residuals]]


def normal_equations(
    unknowns: Unknowns, x: NDArray[np.float64], parts: Sequence[Residuals], knee: float
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Cost with walls, gradient (P,) of data and priors, normal matrix (P, P) of data alone."""
    free = len(x)
    cost, gradient, normal = float(x @ x), x.copy(), np.zeros((free, free))
    for part in parts:
        square = (part.value**2).sum(axis=1)
        seen = np.isfinite(square)
        cost += float(np.count_nonzero(~seen)) * knee**2 * np.log1p(LOST**2 / knee**2)
        cost += float(np.sum(knee**2 * np.log1p(square[seen] / knee**2)))
        root = np.sqrt(1.0 / (1.0 + square[seen] / knee**2))
        flat = (part.rate[seen] * root[:, None, None]).reshape(-1, free)
        gradient += flat.T @ (part.value[seen] * root[:, None]).ravel()
        normal += flat.T @ flat
    if unknowns.edges:
        off, by_free = edge_rates(unknowns, x)
        cost, gradient, normal = cost + float(off @ off), gradient + by_free.T @ off, normal + by_free.T @ by_free
    for part in packing_residuals(unknowns, x):  # as priors are, Gaussian: few corners must not outvote them
        flat, gap = part.rate[:, 0], part.value[:, 0]
        cost, gradient, normal = cost + float(gap @ gap), gradient + flat.T @ gap, normal + flat.T @ flat
    full = unknowns.full(x)
    depth = contacts(unknowns, full, np.zeros(len(full), np.bool_))[0] / WALL_MM
    return cost + float(np.sum(np.maximum(depth, 0.0) ** 2)), gradient, normal


def contacts(
    unknowns: Unknowns, full: NDArray[np.float64], asked: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Depth (K,) [mm] of each ball in the plane, in each other ball and in each wall, negative for a gap.

    Returns
    -------
    depth_mm : (K,) float64
    rate : (K, F) float64
        Derivatives by the full vector; of walls, by what is `asked` of it (F,) alone.
    """
    depth, by_ball, by_shape = walls(unknowns.spheres(full), unknowns.shapes(full))
    rate = np.zeros((len(depth), len(full)))
    rate[:, unknowns.glass] = by_ball.reshape(len(depth), by_ball.shape[1] * by_ball.shape[2])
    rate[:, unknowns.all_shapes] = by_shape
    of_rooms, room_rate = room_depths(unknowns, full, np.ones(len(full), np.bool_) if asked is None else asked)
    return np.concatenate((depth, of_rooms)), np.concatenate((rate, room_rate))


def packing_residuals(unknowns: Unknowns, x: NDArray[np.float64]) -> list[Residuals]:
    """Residuals (K, 1) of the K contacts that are known, in units of `contact_mm`; [] if none is."""
    if unknowns.contact_mm is None or not unknowns.packing:
        return []
    rows, full = list(unknowns.packing), unknowns.full(x)
    depth, by_ball, by_shape = (part[rows] for part in walls(unknowns.spheres(full), unknowns.shapes(full)))
    by_free = by_ball.reshape(len(rows), -1) @ unknowns.columns[unknowns.glass]
    by_free = by_free + by_shape @ unknowns.columns[unknowns.all_shapes]
    return [Residuals(depth[:, None] / unknowns.contact_mm, by_free[:, None, :] / unknowns.contact_mm)]


def touching(unknowns: Unknowns, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Overlaps (K,) that push at x, in units of WALL_MM, and their derivatives (K, F) by the full vector."""
    depth, rate = contacts(unknowns, unknowns.full(x))
    return depth[depth > 0.0] / WALL_MM, rate[depth > 0.0] / WALL_MM


def _walls(unknowns: Unknowns, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Signed overlaps (K,) in units of WALL_MM and their derivatives (K, P) by the free vector."""
    depth, rate = contacts(unknowns, unknowns.full(x), np.asarray(unknowns.columns.any(axis=1)))
    return depth / WALL_MM, rate @ unknowns.columns / WALL_MM


def _step(
    gradient: NDArray[np.float64],
    normal: NDArray[np.float64],
    damping: float,
    depth: NDArray[np.float64],
    rate: NDArray[np.float64],
) -> tuple[NDArray[np.float64], float]:
    """Damped step that does not run through walls: those that it would enter push back beforehand.

    Returns the step and the decrease of the cost that the linear model promises.
    """
    eye = np.eye(len(gradient))
    active = depth > 0.0
    for _ in range(6):
        a = rate[active]
        matrix = normal + eye + a.T @ a
        slope = gradient + a.T @ depth[active]
        step = -np.linalg.solve(matrix + damping * np.diag(np.diag(normal + eye)), slope)
        entered = depth + rate @ step > 0.0
        if not np.any(entered & ~active):
            break
        active |= entered
    return np.asarray(step, dtype=np.float64), float(-slope @ step)


def newton_step(
    unknowns: Unknowns, x: NDArray[np.float64], gradient: NDArray[np.float64], normal: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Step (P,) from x to the minimum of the linear model: gradient (P,), normal matrix (P, P) of data alone."""
    depth, wall = touching(unknowns, x)
    return step_with_walls(gradient, normal + np.eye(len(x)), depth, wall @ unknowns.columns)[0]


def step_with_walls(
    gradient: NDArray[np.float64],
    normal: NDArray[np.float64],
    depth: NDArray[np.float64],
    wall: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Newton step of a linear model with walls, which push and do not pull: what they would pull lets them go.

    Parameters
    ----------
    gradient, normal : (P,), (P, P) float64
        Half the gradient of the squares, priors counted, and its derivative.
    depth, wall : (K,), (K, P) float64
        Overlaps of what touches, and their derivatives.

    Returns
    -------
    step : (P,) float64
    inverse : (P, P) float64
        Of the normal matrix with the walls that push on.
    gain : float
        By how much the squares go down, those of the overlaps counted.
    """
    pushing = np.ones(len(depth), np.bool_)
    while True:
        rows, by = wall[pushing], depth[pushing]
        inverse = np.linalg.inv(normal + rows.T @ rows)
        slope = gradient + rows.T @ by
        step = -inverse @ slope
        let_go = pushing & (depth + wall @ step < 0.0)
        if not let_go.any():
            free_of = float(np.sum(depth[~pushing] ** 2))
            return np.asarray(step), np.asarray(inverse), float(-slope @ step) + free_of
        pushing &= ~let_go


def minimise(
    unknowns: Unknowns,
    evaluate: Evaluate,
    x: NDArray[np.float64],
    *,
    knee: float,
    steps: int = MAX_LM_STEPS,
    tolerance: float = 1e-5,
) -> Solution:
    """Levenberg-Marquardt from x.

    Parameters
    ----------
    unknowns : Unknowns
        What is free.
    evaluate : callable
        x -> residuals of every frame.
    x : (P,) float64
        Start.
    knee : float
        c of the loss, in residual units.
    steps : int
        Most steps.
    tolerance : float
        A step below this many posterior sigmas in every number is negligible.
    """
    x = np.array(x, dtype=np.float64)
    cost, gradient, normal = normal_equations(unknowns, x, evaluate(x), knee)
    damping = 1e-4
    for _ in range(steps):
        step, decrement = _step(gradient, normal, damping, *_walls(unknowns, x))
        if decrement <= tolerance**2:
            break
        trial = normal_equations(unknowns, x + step, evaluate(x + step), knee)
        if trial[0] <= cost:
            small = cost - trial[0] <= 1e-9 * cost and decrement <= 1e-6 * cost
            x = x + step
            cost, gradient, normal = trial
            damping = max(0.1 * damping, 1e-12)
            if small:
                break
        else:
            damping = max(10.0 * damping, 1e-6)
            if damping > 1e10:
                break
    return Solution(x, normal)
