"""The pupil of a lens: what it lets in beside the chief ray, and the depth of field that it leaves.

For a diffraction-limited camera

    depth = 4.88 ((M + 1)/M)^2 f#^2 lambda

with the magnification M (image size / object size), the f-number f# and the wavelength (Raffel et al.,
Particle Image Velocimetry; equation 1 of Martins et al., Opt. Lasers Eng. 2018): the depth over which the
blur of a point stays below its diffraction disc.  The arrangement of spheres needs a depth at least as long
as itself, because its far and near parts are seen through different lengths of glass.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.errors import SceneError

RINGS = (0.5 - 12.0**-0.5, 0.5 + 12.0**-0.5)  # squares of the radii of two rings: Gauss's rule over the area
SPOKES = 6


def depth_of_field_mm(magnification: float, f_number: float, wavelength_nm: float) -> float:
    """Depth of field [mm].

    Raises
    ------
    SceneError
        An argument is not positive.
    """
    if not all(value > 0.0 for value in (magnification, f_number, wavelength_nm)):
        raise SceneError("magnification, f_number and wavelength_nm must be positive")
    return 4.88 * ((magnification + 1.0) / magnification * f_number) ** 2 * wavelength_nm * 1e-6


def f_number_for_depth(depth_mm: float, magnification: float, wavelength_nm: float) -> float:
    """F-number at which the depth of field is `depth_mm`: the inverse of `depth_of_field_mm`.

    Raises
    ------
    SceneError
        An argument is not positive.
    """
    if not all(value > 0.0 for value in (depth_mm, magnification, wavelength_nm)):
        raise SceneError("depth_mm, magnification and wavelength_nm must be positive")
    return math.sqrt(depth_mm / depth_of_field_mm(magnification, 1.0, wavelength_nm))


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
