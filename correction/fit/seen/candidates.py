"""Saddles of a frame that may be seen through glass, each with the lattice corner that it shows.

Each candidate is traced to the target with the present scene and paired with the nearest lattice corner OF
ITS OWN KIND: seen through the local derivative of the trace, the saddle tells whether the square towards +x, +y is
bright.  Corners of one kind lie sqrt(2) squares apart, on a lattice turned by 45 degrees, so the pairing is
right up to 0.7 squares of error.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.solver import Corners, Residuals, free_rates, landed
from correction.fit.solve.unknowns import Unknowns
from correction.target import Chessboard
from correction.target.saddles import Saddles
from tracer.strategies.branches import DIRECT
from tracer.strategies.sensitivity import SPHERE, TARGET, Landings, parameter_names

SQUEEZED = 5.0  # a raw pixel that covers more corrected pixels than this shows no squares
WIDER = 1.15  # candidates are looked for in spheres wider by this


@dataclass(frozen=True)
class Candidates:
    """Saddles of one frame.

    Parameters
    ----------
    height_number : int
        Number of the target's height.
    pixel : (N, 2) float64
        u, v.
    bright : (N, 2) float64
        Image direction of the bright squares.
    inside : (N,) bool
        Within the outline of the nominal glass, made a little wider.
    bare : (N,) bool
        On the lattice as it would be seen without glass.
    """

    height_number: int
    pixel: NDArray[np.float64]
    bright: NDArray[np.float64]
    inside: NDArray[np.bool_]
    bare: NDArray[np.bool_]

    def take(self, chosen: NDArray[np.bool_]) -> "Candidates":
        """Return the candidates where `chosen`."""
        pixel, bright = self.pixel[chosen], self.bright[chosen]
        return Candidates(self.height_number, pixel, bright, self.inside[chosen], self.bare[chosen])


def candidates_of(
    saddles: Saddles,
    least: float,
    unknowns: Unknowns,
    full: NDArray[np.float64],
    height_number: int,
    board: Chessboard,
) -> Candidates:
    """Choose the saddles that may be seen through glass.

    Saddles weaker than `least` are noise; those that fit the bare lattice and lie well outside the nominal
    glass say nothing about it.
    """
    bright = saddles.edges.sum(axis=1)
    everything = Corners(height_number, False, saddles.position_px, np.zeros((len(saddles), 2)), 1.0)
    rays = landed(unknowns, full, everything)
    node = nearest_nodes(rays.point_mm, rays.pixel_rate, bright, board)
    bare = np.linalg.norm(rays.point_mm - node, axis=1) < 0.1 * board.square_mm
    wide = np.array(full)
    wide[unknowns.glass].reshape(-1, len(SPHERE))[:, 3] *= WIDER
    everything = replace(everything, glass=True)
    through = landed(unknowns, wide, everything, by_walls=True)
    inside = _behind_balls(unknowns, through, rays) & (saddles.strength > least)
    in_wall = rays.recovered & (rays.key != DIRECT)  # squeezed by the wall of a tube: no ball is there
    chosen = inside | (~bare & ~in_wall & (saddles.strength > least))
    return Candidates(height_number, saddles.position_px[chosen], bright[chosen], inside[chosen], bare[chosen])


def _behind_balls(unknowns: Unknowns, rays: Landings, bare: Landings) -> NDArray[np.bool_]:
    """Rays (N,) that a ball turns, or loses; going through a tube's wall alone does not count."""
    behind, scene = rays.key != DIRECT, unknowns.scene
    standing = {body.name for body in scene.bodies if body.stays}
    if not standing:
        return np.asarray(behind)
    owners = [name.rpartition(".")[0] for name in parameter_names(scene)[: -len(TARGET)]]
    of_glass = [place for place, owner in enumerate(owners) if owner not in {"camera", *standing}]
    turned = np.any(rays.rate[:, :, of_glass] != 0.0, axis=(1, 2))
    return np.asarray(behind & np.where(rays.recovered, turned, bare.recovered))


def nearest_nodes(
    point_mm: NDArray[np.float64],
    pixel_rate: NDArray[np.float64],
    bright: NDArray[np.float64],
    board: Chessboard,
) -> NDArray[np.float64]:
    """Nearest lattice corner of the right kind (N, 2) [mm] of landing points (N, 2); NaN stays NaN."""
    towards = (pixel_rate @ bright[:, :, None])[:, :, 0]
    odd = np.where(towards[:, 0] * towards[:, 1] > 0.0, 1.0, 0.0)
    x, y = point_mm.T / board.square_mm
    p = 2.0 * np.rint((x + y - odd) / 2.0) + odd
    q = 2.0 * np.rint((x - y - odd) / 2.0) + odd
    return np.asarray(np.stack((p + q, p - q), axis=-1) * 0.5 * board.square_mm)


def paired_residuals(
    unknowns: Unknowns, x: NDArray[np.float64], candidates: Candidates, board: Chessboard, pitch_mm: float
) -> Residuals:
    """Distance of each candidate to its nearest corner, in corrected or raw pixels, whichever are coarser.

    Near a rim a ray turns wildly with every number of the scene, and would dominate: there the distance is
    measured in raw pixels, and where the view is squeezed too much it is not asked at all.
    """
    full = unknowns.full(x)
    off, scale, rays, corners = distances(unknowns, full, candidates, board, pitch_mm)
    return Residuals(off, free_rates(unknowns, full, corners, rays) / scale[:, :, None])


def distances(
    unknowns: Unknowns, full: NDArray[np.float64], candidates: Candidates, board: Chessboard, pitch_mm: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], Landings, Corners]:
    """Distances (N, 2) to the nearest corners [px], mm a px (N, 1), and the rays they come from."""
    corners = Corners(candidates.height_number, True, candidates.pixel, np.zeros_like(candidates.pixel), 1.0)
    rays = landed(unknowns, full, corners)
    off = rays.point_mm - nearest_nodes(rays.point_mm, rays.pixel_rate, candidates.bright, board)
    spread = np.sqrt((rays.pixel_rate**2).sum(axis=(1, 2)))  # of a pixel, on the plane
    scale = np.maximum(spread, pitch_mm)[:, None]
    off[spread > SQUEEZED * pitch_mm] = np.nan
    return off / scale, scale, rays, corners
