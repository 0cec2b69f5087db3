"""Depth of field of a diffraction-limited camera, and the f-number that gives a wanted one.

    depth = 4.88 ((M + 1)/M)^2 f#^2 lambda

with the magnification M (image size / object size), the f-number f# and the wavelength (Raffel et al.,
Particle Image Velocimetry; equation 1 of Martins et al., Opt. Lasers Eng. 2018): the depth over which the
blur of a point stays below its diffraction disc.  The arrangement of spheres needs a depth at least as long
as itself, because its far and near parts are seen through different lengths of glass.
"""

import math

from tracer.errors import SceneError


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
