"""The pupil of a lens: what it lets in beside the chief ray."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.errors import SceneError

RINGS = (0.5 - 12.0**-0.5, 0.5 + 12.0**-0.5)  # squares of the radii of two rings: Gauss's rule over the area
SPOKES = 6


@dataclass(frozen=True)
class Pupil:
    """A round pupil at the pinhole; all rays of a pixel meet again in the plane in focus.

    Parameters
    ----------
    radius_mm : float
        Half of f / f-number.
    focus_mm : float
        Distance from the pinhole to the plane in focus, along the optical axis.
    """

    radius_mm: float
    focus_mm: float

    def __post_init__(self) -> None:
        if not (0.0 < self.radius_mm <= 1e6 and 0.0 < self.focus_mm <= 1e9):
            raise SceneError("the camera's pupil and its focus must be positive, 1e6 and 1e9 mm at most")

    def points_mm(self) -> NDArray[np.float64]:
        """Points (K, 2) of the pupil, right and down, that stand for equal shares of its area.

        Means over them are exact for every polynomial of degree 5.
        """
        return np.concatenate([self._ring_mm(np.sqrt(square)) for square in RINGS])

    def border_mm(self) -> NDArray[np.float64]:
        """Points (K, 2) of its border, right and down."""
        return self._ring_mm(1.0)

    def _ring_mm(self, share: float) -> NDArray[np.float64]:
        """Points around a circle of a share of its radius."""
        angle = 2.0 * np.pi * (np.arange(SPOKES) + 0.25) / SPOKES
        return np.asarray(share * self.radius_mm * np.stack((np.cos(angle), np.sin(angle)), axis=-1))
