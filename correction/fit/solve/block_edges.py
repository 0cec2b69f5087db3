"""Edges of blocks as their outlines show them: residuals of a fit, in closed form.

The outline of a convex body with flat faces is made of edges between two of its corners.  A pixel on such an edge
has a ray in the plane of the pinhole and both corners: with the ray's direction d, and m the unit normal of that
plane, the residual is d . m / sigma.  Corners of a board show the faces of a block and not where these end, and
outlines show just that.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import Block
from tracer.camera import Camera
from tracer.errors import SceneError

if TYPE_CHECKING:
    from correction.fit.solve.unknowns import Unknowns

EDGE_STEP = 1e-3  # prior sigmas: the residuals are smooth over far more


@dataclass(frozen=True)
class EdgePoint:
    """A point of the frame on an edge of a block.

    Parameters
    ----------
    block : str
        Name of the block.
    ends : (int, int)
        Numbers of the corners that the edge joins.
    pixel : (float, float)
        Acquired pixel.
    sigma_rad : float
        Standard deviation across the edge, as an angle at the pinhole.
    """

    block: str
    ends: tuple[int, int]
    pixel: tuple[float, float]
    sigma_rad: float


def angles_beside(
    camera: Camera, block: Block, ends: tuple[int, int], pixels: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Angles [rad] (N,) of rays of pixels (N, 2) beside an edge of a block."""
    one, other = block.corners_mm[list(ends)] - np.array(camera.position_mm)
    normal = np.cross(one, other)
    return np.asarray(camera.directions(pixels) @ (normal / np.linalg.norm(normal)))


def edge_values(unknowns: "Unknowns", full: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances (K,) of the edge points of a fit from their edges, in sigmas."""
    camera, blocks = unknowns.camera(full), unknowns.other_bodies.bodies_at(full[unknowns.others])
    values = []
    for point in unknowns.edges:
        block = blocks[point.block]
        assert isinstance(block, Block)
        values.append(angles_beside(camera, block, point.ends, np.array([point.pixel]))[0] / point.sigma_rad)
    return np.array(values)


def edge_rates(unknowns: "Unknowns", x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values (K,) of the edge points at a free vector, and derivatives (K, P) by it; zeros where no block is."""
    full, rate = unknowns.full(x), np.zeros((len(unknowns.edges), len(x)))
    try:
        value = edge_values(unknowns, full)
        for number, column in enumerate(unknowns.columns.T):
            if column[unknowns.blocks["camera"]].any() or column[unknowns.others].any():
                ahead, back = (edge_values(unknowns, full + by * column) for by in (EDGE_STEP, -EDGE_STEP))
                rate[:, number] = (ahead - back) / (2.0 * EDGE_STEP)
    except SceneError:
        return np.zeros(len(unknowns.edges)), rate
    return value, rate
