"""Viewing slope of the rays at the light sheet, behind glass and beside it, for pages and `trace`."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from correction.maps.correction_map import CorrectionMap
from correction.maps.slant import SLOPE_NODE_STEP, node_slopes
from tracer.scene.scene import Scene

STEEP_QUANTILE = 0.9  # of the places are no steeper than the second figure


@dataclass(frozen=True)
class Steepness:
    """Size of the slopes dX/dz, dY/dz of rays at the plane: median, and what 90 % of the places stay below.

    Parameters
    ----------
    behind, beside : (float, float) or None
        Of what is seen through glass, and directly; None where nothing is.
    """

    behind: tuple[float, float] | None
    beside: tuple[float, float] | None

    @classmethod
    def of(
        cls, slopes: NDArray[np.float64], is_behind: NDArray[np.bool_], is_beside: NDArray[np.bool_]
    ) -> "Steepness":
        """Of slopes (..., 2) of places behind glass and beside it (...); NaN counts nowhere."""
        size = np.hypot(slopes[..., 0], slopes[..., 1])

        def figures(where: NDArray[np.bool_]) -> tuple[float, float] | None:
            known = size[where & np.isfinite(size)]
            return (float(np.median(known)), float(np.quantile(known, STEEP_QUANTILE))) if known.size else None

        return cls(figures(is_behind), figures(is_beside))

    @property
    def sentence(self) -> str:
        """Sentence about the perspective error of out-of-plane motion; empty where nothing is seen."""
        parts = [
            f"{median:.2f} m/s {name} ({most:.2f} at {100 * STEEP_QUANTILE:.0f} % of the places)"
            for figures, name in ((self.behind, "behind glass"), (self.beside, "seen directly"))
            if figures is not None
            for median, most in (figures,)
        ]
        if not parts:
            return ""
        return f"oblique view: 1 m/s out of plane appears in plane as {', '.join(parts)}"


@dataclass(frozen=True, eq=False)
class ShownSlant:
    """Slopes (h, w, 2) of the best view of some nodes of a map, every so many along each axis, and its figures."""

    slopes: NDArray[np.float64]
    every: int
    steepness: Steepness

    @classmethod
    def of(cls, found: CorrectionMap, scene: Scene) -> "ShownSlant":
        """Of a map and its scene; StaleMap if it belongs to another."""
        slopes, every = node_slopes(found, scene, SLOPE_NODE_STEP)[0], slice(None, None, SLOPE_NODE_STEP)
        seen, glass = (each[every, every] for each in (found.recovered, found.behind_glass))
        return cls(slopes, SLOPE_NODE_STEP, Steepness.of(slopes, glass, seen & ~glass))
