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

import numpy as np

from correction.fit.seen.prediction import expect
from correction.fit.solve.ball_shape import balls_crossed, shape_rates
from correction.fit.solve.considered import SIZES_MM, ShapeRoot, likely_scale, shapes_to_consider
from correction.fit.solve.solver import Corners, free_rates
from correction.fit.solve.unknowns import unknowns_of
from correction.fitted.scene_sigma import SceneSigma
from correction.target import Chessboard
from rtpiv.templates.room import BOARD_MM
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose, landings_through
from tracer.strategies.trace import world_of

EDGE_PX, BEHIND = 0.036, 2.2  # sigma of a corner is EDGE_PX / sqrt(width of its square in px), times BEHIND
ENOUGH_BARE = 3  # heights without glass at which the focal length is fitted as well


def sigma_forecast(
    scene: Scene, square_mm: float, bare_mm: Sequence[float], glass_mm: Sequence[float], times: int = 1
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

    Returns
    -------
    SceneSigma
        As a fit would leave it.
    """
    unknowns = unknowns_of(scene, (*bare_mm, *glass_mm), FitTable(), len(bare_mm) >= ENOUGH_BARE)
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
    normal[free:, :free] = normal[:free, free:].T
    scale = np.ones(len(normal))
    scale[free:] = likely_scale(normal, None, len(sizes_mm))
    draws = np.linalg.cholesky(np.linalg.inv(normal * np.outer(scale, scale) + np.eye(len(normal))))
    root = unknowns.columns[: unknowns.others.stop] @ draws[:free]
    sizes = (scale[free:] * sizes_mm)[:, None]
    return SceneSigma(scene.content_hash(), root, shapes=ShapeRoot(balls, sizes * draws[free:]))
