"""Consider parameters (Schmidt): numbers that a fit holds although their uncertainty was not given.

HELD.  A 0 in the fit section holds a number of the glass, be it a ball's or a wall's, without saying how well it
is known. The fit does not move it, but the map is not better for that: with J the derivatives of the residuals r
by the free numbers x, K those by the held ones a in units of what labs ordinarily do not know, and G = (J, K),

    C = (G^T G + 1)^-1,        (x, a) off by -C (G^T r + (x, 0)),

C is the covariance of both, so that the frames tell what they can of a.  Where residuals pull at a, the
Newton step says how far the map is likely off: one more column of the root of the covariance.  A sigma in the fit
section, however small, is believed.  A ball that shows no corner and is held is thus as unsure as one that is
free, for its map rests on what was said of it and on nothing else.

SHAPES.  A ball that is out of round by little bends residuals less than corners may err alike
(`model_test.SHARE`): it is not named, and yet the map is wrong.  So the five numbers s of its shape to first order
(`ball_shape`) stand with what is held in the covariance; what the frames leave open of them, and how far residuals
pull at them, is in the map's sigma, through their own derivatives:

    spread of a pixel's plane point = G root + G_s root_s.

How large they are in this lab is asked of the frames as well, or round balls would pay for others: bearing balls
are round to some 10 nm, drawn beads to tens of um.  Let s be of the size tau in all balls, evenly likely in its
logarithm up to LARGEST_UM, and D, b the normal matrix and the gradient by s when all else has followed
(eigenvalues l and parts b_l); then the residuals have the likelihood

    log L(tau) = sum 1/2 (tau^2 b_l^2 / (1 + tau^2 l) - log(1 + tau^2 l)),

and the considered size is the geometric mean of tau under it.  A model found wrong is not treated so: its cause is
counted by itself (`rank_hypotheses`).

A ball whose `out_of_round_um` is given is believed, as any sigma is.  Left out are rays through cores and scenes
with windows or tubes, whose rays `ball_shape` does not follow.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.ball_shape import SHAPES, ShapeRates, balls_crossed, shape_rates
from correction.fit.solve.solver import Corners, Residuals, land_corners
from correction.fit.solve.unknowns import Unknowns, glasses
from tracer.media import THINNEST_LIQUID
from tracer.scene.fit_section import FitTable

BELIEVED = FitTable()  # what is believed of a scene that says nothing
PLACE_MM = BELIEVED.spheres.centre_mm
ORDINARY = {"x": PLACE_MM, "y": PLACE_MM, "z": PLACE_MM, "radius": BELIEVED.spheres.radius_mm}
WALL = {"place_mm": 0.2, "tilt_deg": np.deg2rad(0.3), "thickness_mm": 0.1, "radius_mm": 0.1}  # mm, rad
ORDINARY_N = BELIEVED.n
LARGEST_UM = 5.0  # rms over the surface, of what need not be named
SCALES = np.geomspace(0.002, 1.0, 25)  # of it that are asked: from 10 nm on
_NORM2 = np.array([float(np.sum(shape**2)) for shape in SHAPES])
SIZES_MM = 1e-3 * LARGEST_UM / np.sqrt(len(SHAPES)) / np.sqrt(_NORM2 * 2.0 / 15.0)  # rms of e.S e: sqrt(2/15) |S|


def with_considered(unknowns: Unknowns) -> Unknowns:
    """Return the same unknowns with the held numbers of the glass behind the free ones, in their ordinary size."""
    held = list(_columns_of_held(unknowns))
    names = (*unknowns.names, *(name for name, _ in held))
    return replace(unknowns, names=names, columns=np.column_stack([unknowns.columns, *(one for _, one in held)]))


def _columns_of_held(unknowns: Unknowns) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Numbers of the glass that no free one moves, with their columns (F,); one n for all balls of a glass."""
    scene, free = unknowns.scene, np.any(unknowns.columns != 0.0, axis=1)

    def column(sizes: dict[str, float]) -> NDArray[np.float64]:
        return np.array([sizes.get(name, 0.0) for name in unknowns.full_names])

    for sphere in scene.spheres:
        for part, size in ORDINARY.items():
            name = f"{sphere.name}.{part}"
            if sphere.medium is not None and not free[unknowns.full_names.index(name)]:
                yield name, column({name: size})
    for body, numbers in unknowns.other_bodies.bodies:
        for number in numbers:
            name = f"{body.name}.{number.name}"
            if not free[unknowns.full_names.index(name)]:
                yield name, column({name: WALL.get(number.known, ORDINARY_N)})
    for label, medium in glasses(scene).items():
        sizes = {f"{sphere.name}.n": ORDINARY_N for sphere in scene.spheres if sphere.medium == medium}
        is_free = any(free[unknowns.full_names.index(name)] for name in sizes)
        if not is_free and medium.n(scene.wavelength_nm) > THINNEST_LIQUID:
            yield label, column(sizes)


@dataclass(frozen=True)
class ShapeRoot:
    """Uncertainty of the shapes of B balls.

    Parameters
    ----------
    balls : tuple of str
        Their names.
    root : (5 B, P) float64
        Of the covariance of their `SHAPES` [mm], in the same draws as the root of the scene's other numbers.
    """

    balls: tuple[str, ...] = ()
    root: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))

    def spread(self, names: Sequence[str], crossed: ShapeRates) -> NDArray[np.float64]:
        """Spread (N, 2, P) [mm] of landing points; `crossed` counts balls as `names` does."""
        out = np.zeros((len(crossed.row), 2, self.root.shape[1]))
        for place, ball in enumerate(self.balls):
            here, rate = crossed.by(names.index(ball))
            out[here] += rate @ self.root[len(SHAPES) * place : len(SHAPES) * (place + 1)]
        return out

    def of_balls(self, names: Sequence[str]) -> "ShapeRoot":
        """Return that of the balls of these names alone."""
        kept = np.array([ball in names for ball in self.balls], np.bool_)
        balls = tuple(ball for ball in self.balls if ball in names)
        return ShapeRoot(balls, self.root[np.repeat(kept, len(SHAPES))])

    def with_columns(self, count: int) -> "ShapeRoot":
        """Return the same with more draws, which do nothing to shapes."""
        return replace(self, root=np.column_stack((self.root, np.zeros((len(self.root), count)))))

    def with_change(self, ball: str, change: NDArray[np.float64]) -> "ShapeRoot":
        """Return the same, the last draws (5, K) of a ball's shape being these; as it is if K is 0."""
        if not change.size:
            return self
        root, first = self.root.copy(), len(SHAPES) * self.balls.index(ball)
        root[first : first + len(SHAPES), -change.shape[1] :] += change
        return replace(self, root=root)

    def rotate(self, axes: NDArray[np.float64]) -> "ShapeRoot":
        """Return the same as seen in other axes (3, 3), rows."""
        turn = np.array([[np.sum(one * (axes @ other @ axes.T)) for other in SHAPES] for one in SHAPES])
        by_ball = np.kron(np.eye(len(self.balls)), turn / _NORM2[:, None])
        return replace(self, root=by_ball @ self.root)


def shapes_to_consider(unknowns: Unknowns) -> tuple[str, ...]:
    """Names of the balls whose shape is not given."""
    scene = unknowns.scene
    if any(body.stays for body in scene.bodies) or unknowns.other_bodies.bodies:
        return ()
    glass = enumerate(scene.spheres)
    return tuple(ball.name for number, ball in glass if ball.medium is not None and number not in unknowns.uneven)


def likely_scale(normal: NDArray[np.float64], slope: NDArray[np.float64] | None, numbers: int) -> float:
    """Likely size of the shapes, as a share of LARGEST_UM; arguments are those of `likely_scales`."""
    return float(np.exp(likely_scales(normal, slope, numbers) @ np.log(SCALES))) if numbers else 1.0


def likely_scales(
    normal: NDArray[np.float64], slope: NDArray[np.float64] | None, numbers: int
) -> NDArray[np.float64]:
    """Probability of each of SCALES (S,) as the size of numbers of one kind; their sum is 1.

    Parameters
    ----------
    normal : (P, P) float64
        Normal matrix of the data, priors not counted; the numbers, at the largest size, are the last.
    slope : (P,) float64 or None
        Half the gradient of the squares, priors counted; None: as numbers that are 0 leave it on average.
    numbers : int
        Of the kind.
    """
    free = len(normal) - numbers
    followed = np.linalg.solve(normal[:free, :free] + np.eye(free), normal[:free, free:])
    known, vectors = np.linalg.eigh(normal[free:, free:] - normal[free:, :free] @ followed)
    known = np.maximum(known, 0.0)
    square = known if slope is None else (vectors.T @ (slope[free:] - followed.T @ slope[:free])) ** 2
    large = SCALES[:, None] ** 2
    likely = 0.5 * np.sum(large * square / (1.0 + large * known) - np.log1p(large * known), axis=1)
    weight = np.exp(likely - likely.max())
    return np.asarray(weight / weight.sum())


def with_shapes(wide: Unknowns, balls: Sequence[str]) -> Unknowns:
    """Return the same unknowns with the balls' shapes behind them, which the full vector does not hold."""
    names = tuple(f"{ball}.shape {number}" for ball in balls for number in range(len(SHAPES)))
    columns = np.zeros((len(wide.start), len(names)))
    return replace(wide, names=(*wide.names, *names), columns=np.column_stack((wide.columns, columns)))


def shape_parts(
    unknowns: Unknowns, full: NDArray[np.float64], corners: Corners, ways: NDArray[np.str_], part: Residuals
) -> Residuals:
    """Return residuals whose last derivatives are those by the considered shapes, in units of LARGEST_UM.

    Parameters
    ----------
    unknowns : Unknowns
        What was free.
    full : (F,) float64
        The fitted full vector.
    corners : Corners
        N of them, with their weights.
    ways : (N,) str
        Spheres crossed.
    part : Residuals
        Theirs, with derivatives (N, 2, P); the last 5 B of these are replaced.
    """
    balls = shapes_to_consider(unknowns)
    if not balls or not corners.glass:
        return part
    rays = land_corners(unknowns, full, corners)
    to_sigma = np.full_like(rays.pixel_rate, np.nan)
    to_sigma[rays.recovered] = np.linalg.inv(rays.pixel_rate[rays.recovered])
    pose, depth_mm = unknowns.pose(full, corners.height_number), unknowns.deeper(full) * corners.depth_mm
    names = [sphere.name for sphere in unknowns.scene.spheres]
    table, camera = unknowns.spheres(full), unknowns.camera(full)
    crossed = shape_rates(camera, table, balls_crossed(ways, names), corners.pixel, pose, depth_mm)
    rate = crossed.by_each([names.index(ball) for ball in balls])
    rate = np.asarray(corners.whiten) @ to_sigma @ rate * np.tile(SIZES_MM, len(balls))
    return replace(part, rate=np.concatenate((part.rate[:, :, : -rate.shape[2]], rate), axis=2))
