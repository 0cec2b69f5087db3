"""Derivatives of pixels that have no neighbour of their branch: traced along the way that the branch names.

Differences need a neighbour.  Behind a bed of a thousand balls one pixel in ten has none, and to look for the
balls that its ray meets takes several times as long as to go through those that are known.
"""

from typing import NamedTuple

import numpy as np

from correction.inversion.kernels.newton import (
    DX,
    DY,
    DZ,
    FX,
    FY,
    FZ,
    GX,
    GY,
    GZ,
    PZ,
    UX,
    UY,
    UZ,
    VX,
    VY,
    VZ,
    follow_sequence,
)
from correction.inversion.kernels.newton import U as PIXEL_U
from correction.inversion.kernels.newton import V as PIXEL_V
from ground.jit import Array, kernel, kernel_inlined, unowned


class Ways(NamedTuple):
    """Spheres of every branch, in order: of branch k events[begin[k] : begin[k + 1]]; empty: not asked by them.

    Parameters
    ----------
    begin, events : (B + 1,) int64, (E,) int64
        As above.
    windows : (K, 10) float64
        In front of all spheres.
    """

    begin: Array
    events: Array
    windows: Array


NO_WAYS = Ways(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 10)))


@kernel_inlined
def unowned_ways(ways: Ways) -> Ways:
    """Arrays that no reference counter knows."""
    return Ways(unowned(ways.begin), unowned(ways.events), unowned(ways.windows))


@kernel
def slopes_along(
    u: float, v: float, branch: int, ways: Ways, camera: Array, spheres: Array, block: Array
) -> tuple[float, float, float, float]:
    """dx/du, dx/dv, dy/du, dy/dv of the plane at pixel u, v; ``block`` (NEWTON_NUMBERS,) is scratch."""
    block[PIXEL_U], block[PIXEL_V] = u, v
    sequence = ways.events[ways.begin[branch] : ways.begin[branch + 1]]
    follow_sequence(1, camera, ways.windows, spheres, sequence, block)
    inverse = -1.0 / block[DZ]
    t = block[PZ] * inverse
    tu, tv = (block[FZ] + t * block[UZ]) * inverse, (block[GZ] + t * block[VZ]) * inverse
    xu, xv = block[FX] + tu * block[DX] + t * block[UX], block[GX] + tv * block[DX] + t * block[VX]
    yu, yv = block[FY] + tu * block[DY] + t * block[UY], block[GY] + tv * block[DY] + t * block[VY]
    return xu, xv, yu, yv
