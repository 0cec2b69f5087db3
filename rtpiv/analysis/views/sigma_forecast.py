"""Expected uncertainty of the map of a scene that is not built yet, by a scene fit.

Every corner of the board that the camera would see, at every height of a target run, adds its information; the
covariance is (N + 1)^-1 in units of the priors' sigmas, as after a real fit (`correction.fit.adjustment`).  Which
corners are seen and wide enough to be measured is asked of the same function that a fit asks.

A corner is found along its edges: its sigma falls with the root of their length.  Behind glass edges bend, shade
and double, and corners scatter more.  Both factors are such that the sigma of the map, which the heights of the
target limit as well, is that of fits on simulated benches; darker frames have larger ones.  The shape of balls is
doubted as by a fit whose frames find them round.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from correction.fit.seen.prediction import expect
from correction.fit.solve.ball_shape import balls_crossed, shape_rates
from correction.fit.solve.considered import SIZES_MM, ShapeRoot, likely_scale, shapes_to_consider
from correction.fit.solve.solver import Corners, free_rates, packing_residuals
from correction.fit.solve.unknowns import unknowns_of
from correction.fitted.scene_sigma import SceneSigma
from correction.target import Chessboard
from rtpiv.templates.room import BOARD_MM
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import CAMERA, SPHERE, TargetPose, landings_through
from tracer.strategies.trace import world_of

EDGE_PX, BEHIND = 0.036, 2.2  # sigma of a corner is EDGE_PX / sqrt(width of its square in px), times BEHIND
SQUARE_PX = 22.0  # width of a square, seen directly
BARE_MM, BEHIND_MM = (0.0, -10.0, -20.0, 10.0, 20.0), (0.0, -10.0, -20.0)  # heights of the board
ENOUGH_BARE = 3  # heights without glass at which the focal length is fitted as well


def sigma_forecast(
    scene: Scene,
    square_mm: float,
    bare_mm: Sequence[float],
    glass_mm: Sequence[float],
    times: int = 1,
    contact_mm: float | None = None,
) -> SceneSigma:
    """Uncertainty of the scene after a fit to a target run whose light is known.

    Parameters
    ----------
    scene : Scene
        The scene, its camera with the pixels that it will have; balls and opaque bodies.
    square_mm : float
        Square of the board.
    bare_mm, glass_mm : sequence of float
        Heights of the board without and behind the glass; 0, the plane, is among them.
    times : int
        So much coarser a camera may say which corners are seen.
    contact_mm : float, optional
        Standard deviation of the gaps of balls that touch; None: nothing is known of them.

    Returns
    -------
    SceneSigma
        As a fit would leave it.
    """
    priors = FitTable(contact_mm=contact_mm)
    unknowns = unknowns_of(scene, (*bare_mm, *glass_mm), priors, len(bare_mm) >= ENOUGH_BARE)
    board = Chessboard(square_mm, 0.4 * square_mm)
    free, balls, names = len(unknowns.names), shapes_to_consider(unknowns), [ball.name for ball in scene.spheres]
    doubted = [names.index(ball) for ball in balls]
    sizes_mm = np.tile(SIZES_MM, len(balls))
    normal = np.zeros((free + len(sizes_mm), free + len(sizes_mm)))
    for glass, heights_mm in ((False, bare_mm), (True, glass_mm)):
        seen = scene if glass else scene.bare()
        bodies = world_of(seen)
        for z in heights_mm:
            pose = TargetPose((0.0, 0.0, z))
            expected = expect(seen, pose, board, times)
            on_board = np.all(np.abs(expected.index) * square_mm <= 0.5 * BOARD_MM, axis=1)
            expected = expected.take(np.asarray(on_board))
            rays = landings_through(scene.camera, bodies, expected.pixel, pose, scene.n_ambient)
            use = rays.recovered
            corners = Corners(unknowns.heights_mm.index(z), glass, expected.pixel, rays.point_mm, 1.0)
            jacobian = rays.pixel_rate[use]
            square_px = square_mm / np.sqrt(np.abs(np.linalg.det(jacobian)))
            behind = expected.branch[use] != 0
            sigma_px = EDGE_PX / np.sqrt(square_px) * np.where(behind, BEHIND, 1.0)
            to_sigma = np.linalg.inv(jacobian) / sigma_px[:, None, None]
            by_free = to_sigma @ free_rates(unknowns, unknowns.start, corners, rays)[use]
            flat = by_free.reshape(-1, free)
            normal[:free, :free] += flat.T @ flat
            rows = balls_crossed(expected.ways[use][behind], names)
            crossed = shape_rates(scene.camera, scene.sphere_table(), rows, expected.pixel[use][behind], pose)
            by_shape = to_sigma[behind] @ crossed.by_each(doubted) * sizes_mm
            by_shape = by_shape.reshape(2 * len(rows), len(sizes_mm))
            normal[free:, free:] += by_shape.T @ by_shape
            normal[:free, free:] += by_free[behind].reshape(-1, free).T @ by_shape
    for part in packing_residuals(unknowns, np.zeros(free)):
        normal[:free, :free] += part.rate[:, 0].T @ part.rate[:, 0]
    normal[free:, :free] = normal[:free, free:].T
    scale = np.ones(len(normal))
    scale[free:] = likely_scale(normal, None, len(sizes_mm))
    draws = np.linalg.cholesky(np.linalg.inv(normal * np.outer(scale, scale) + np.eye(len(normal))))
    root = unknowns.columns[: unknowns.others.stop] @ draws[:free]
    sizes = (scale[free:] * sizes_mm)[:, None]
    return SceneSigma(scene.content_hash(), root, shapes=ShapeRoot(balls, sizes * draws[free:]))


@dataclass(frozen=True)
class CentreSigma:
    """Standard deviation of the centres of balls after a calibration: median and worst [mm].

    Parameters
    ----------
    known_by : str
        What the calibration goes by.
    sideways_mm, along_mm : (float, float)
        Along x or y, the worse of both, and along z.
    """

    known_by: str
    sideways_mm: tuple[float, float]
    along_mm: tuple[float, float]


def packing_forecast(scene: Scene, contact_mm: float) -> list[CentreSigma]:
    """Expect how well the balls of a packing are known by their contacts, a board behind them, and both.

    Parameters
    ----------
    scene : Scene
        With the board, of squares of SQUARE_PX, in z = 0 and at the usual heights.
    contact_mm : float
        Standard deviation of the gaps.
    """
    square_mm = SQUARE_PX * float(scene.camera.position_mm[2]) / scene.camera.focal_px
    found = []
    for known_by, heights, contact in (
        ("contacts", (), contact_mm),
        ("the board behind", BEHIND_MM, None),
        ("the board and contacts", BEHIND_MM, contact_mm),
    ):
        root = sigma_forecast(scene, square_mm, BARE_MM, heights, contact_mm=contact).root
        sigma = np.sqrt(np.square(root[len(CAMERA) :]).sum(axis=1)).reshape(-1, len(SPHERE))
        sideways, along = sigma[:, :2].max(axis=1), sigma[:, 2]
        median_and_worst = [(float(np.median(one)), float(one.max())) for one in (sideways, along)]
        found.append(CentreSigma(known_by, *median_and_worst))
    return found
