"""Share of the gaps of a bed that is seen: of the gas between the balls that the plane cuts.

The gaps are what is no glass within the hull of the discs that the plane cuts out of the balls, as far as the
corrected image reaches: gas around the bed does not count.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from correction.maps.correction_map import CorrectionMap, nodes_in_glass
from correction.masked import points_in
from rtpiv.analysis.through_glass import percent
from tracer.scene.scene import Scene

CORNERS = 64  # of a disc's outline: they lie inside it by 0.1 % of its radius


@dataclass(frozen=True)
class Gaps:
    """Gaps between balls that the plane cuts.

    Parameters
    ----------
    gas_mm2 : float
        Their area within the corrected image.
    recovered_mm2 : float
        Part of it that is recovered.
    glass : float
        Share of the corrected image inside bodies.
    """

    gas_mm2: float
    recovered_mm2: float
    glass: float

    @property
    def share(self) -> float:
        """Recovered over whole area, 0 to 1."""
        return self.recovered_mm2 / self.gas_mm2

    @property
    def sentence(self) -> str:
        """The figure that `trace` begins with inside a bed."""
        areas = f"{self.recovered_mm2:.4g} of {self.gas_mm2:.4g} mm\u00b2"
        return f"inside a bed: {percent(self.share)} of the gaps is seen ({areas}); {percent(self.glass)} is glass"


def gap_share(scene: Scene, found: CorrectionMap) -> Gaps | None:
    """Measure how much of the gaps a map recovers; None where the plane cuts fewer than two balls."""
    inside = nodes_in_glass(scene, found.grid)
    discs = [
        (ball.centre_mm[:2], np.sqrt(max(ball.radius_mm**2 - ball.centre_mm[2] ** 2, 0.0)))
        for ball in scene.spheres_in_plane
    ]
    if inside is None or len(discs) < 2:
        return None
    angle = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
    circle = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    points = np.concatenate([np.array(centre) + radius * circle for centre, radius in discs])
    gas = points_in(points[scipy.spatial.ConvexHull(points).vertices], found.grid.nodes_mm()) & ~inside
    if not gas.any():
        return None
    node_mm2 = found.grid.pitch_mm**2
    return Gaps(node_mm2 * int(gas.sum()), node_mm2 * int((gas & found.recovered).sum()), float(inside.mean()))
