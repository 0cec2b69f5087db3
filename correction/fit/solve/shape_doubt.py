"""How round balls are, where nobody said so: the shape of every ball taken for a sphere, as doubted numbers.

A ball that is out of round by little bends residuals less than corners may err alike (`model_test.SHARE`): nobody
names it, and yet the map is wrong.  So the five numbers s of its shape to first order (`ball_shape`) stand with
what is held (`held`) in the covariance; what the frames leave open of them, and how far residuals pull at them,
is in the map's sigma, through their own derivatives:

    spread of a pixel's plane point = G root + G_s root_s.

How large they are in this lab is asked of the frames as well, or round balls would pay for others: bearing balls
are round to some 10 nm, drawn beads to tens of um.  Let s be of the size tau in all balls, evenly likely in its
logarithm up to LARGEST_UM, and D, b the normal matrix and the gradient by s when all else has followed
(eigenvalues l and parts b_l); then the residuals have the likelihood

    log L(tau) = sum 1/2 (tau^2 b_l^2 / (1 + tau^2 l) - log(1 + tau^2 l)),

and the doubted size is the geometric mean of tau under it.  A model found wrong is not doubted so: its cause is
counted by itself (`suspects`).

A ball whose `out_of_round_um` is given is believed, as any sigma is.  Left out are rays through cores and scenes
with windows or tubes, whose rays `ball_shape` does not follow.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.ball_shape import SHAPES, ShapeRates, balls_crossed, shape_rates
from correction.fit.solve.solver import Corners, Residuals, landed
from correction.fit.solve.unknowns import Unknowns

LARGEST_UM = 5.0  # rms over the surface, of what nobody need name
SCALES = np.geomspace(0.002, 1.0, 25)  # of it that are asked: from 10 nm on
_NORM2 = np.array([float(np.sum(shape**2)) for shape in SHAPES])
SIZES_MM = 1e-3 * LARGEST_UM / np.sqrt(len(SHAPES)) / np.sqrt(_NORM2 * 2.0 / 15.0)  # rms of e.S e: sqrt(2/15) |S|


@dataclass(frozen=True)
class ShapeRoot:
    """What is not known of the shapes of balls, B of them.

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

    def with_columns(self, count: int) -> "ShapeRoot":
        """Return the same with more draws, which do nothing to shapes."""
        return replace(self, root=np.column_stack((self.root, np.zeros((len(self.root), count)))))

    def turned(self, axes: NDArray[np.float64]) -> "ShapeRoot":
        """Return the same as seen in other axes (3, 3), rows."""
        turn = np.array([[np.sum(one * (axes @ other @ axes.T)) for other in SHAPES] for one in SHAPES])
        by_ball = np.kron(np.eye(len(self.balls)), turn / _NORM2[:, None])
        return replace(self, root=by_ball @ self.root)


def doubted_shapes(unknowns: Unknowns) -> tuple[str, ...]:
    """Names of the balls whose shape nobody told."""
    scene = unknowns.scene
    if any(body.stays for body in scene.bodies) or unknowns.other_bodies.bodies:
        return ()
    glass = enumerate(scene.spheres)
    return tuple(ball.name for number, ball in glass if ball.medium is not None and number not in unknowns.uneven)


def likely_scale(normal: NDArray[np.float64], slope: NDArray[np.float64] | None, numbers: int) -> float:
    """How large the shapes are, as a share of LARGEST_UM.

    Parameters
    ----------
    normal : (P, P) float64
        Normal matrix of the data, priors not counted; the numbers of the shapes, at LARGEST_UM, are the last.
    slope : (P,) float64 or None
        Half the gradient of the squares, priors counted; None: as round balls leave it on average.
    numbers : int
        Of the shapes.
    """
    if not numbers:
        return 1.0
    free = len(normal) - numbers
    followed = np.linalg.solve(normal[:free, :free] + np.eye(free), normal[:free, free:])
    known, vectors = np.linalg.eigh(normal[free:, free:] - normal[free:, :free] @ followed)
    known = np.maximum(known, 0.0)
    square = known if slope is None else (vectors.T @ (slope[free:] - followed.T @ slope[:free])) ** 2
    large = SCALES[:, None] ** 2
    likely = 0.5 * np.sum(large * square / (1.0 + large * known) - np.log1p(large * known), axis=1)
    weight = np.exp(likely - likely.max())
    return float(np.exp(weight @ np.log(SCALES) / weight.sum()))


def with_shapes(wide: Unknowns, balls: Sequence[str]) -> Unknowns:
    """Return the same unknowns with the balls' shapes behind them, which the full vector does not hold."""
    names = tuple(f"{ball}.shape {number}" for ball in balls for number in range(len(SHAPES)))
    columns = np.zeros((len(wide.start), len(names)))
    return replace(wide, names=(*wide.names, *names), columns=np.column_stack((wide.columns, columns)))


def shape_parts(
    unknowns: Unknowns, full: NDArray[np.float64], corners: Corners, ways: NDArray[np.str_], part: Residuals
) -> Residuals:
    """Return residuals whose last derivatives are those by the doubted shapes, in units of LARGEST_UM.

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
    balls = doubted_shapes(unknowns)
    if not balls or not corners.glass:
        return part
    rays = landed(unknowns, full, corners)
    to_sigma = np.full_like(rays.pixel_rate, np.nan)
    to_sigma[rays.recovered] = np.linalg.inv(rays.pixel_rate[rays.recovered])
    pose = unknowns.pose(full, corners.height_number)
    names = [sphere.name for sphere in unknowns.scene.spheres]
    table, camera = unknowns.spheres(full), unknowns.camera(full)
    crossed = shape_rates(camera, table, balls_crossed(ways, names), corners.pixel, pose)
    rate = crossed.by_each([names.index(ball) for ball in balls])
    rate = np.asarray(corners.whiten) @ to_sigma @ rate * np.tile(SIZES_MM, len(balls))
    return replace(part, rate=np.concatenate((part.rate[:, :, : -rate.shape[2]], rate), axis=2))
