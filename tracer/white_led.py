"""A white LED by its colour temperature: the blue light of its pump and the broad light of its phosphor.

Both are Gaussians.  Their places, widths and heights (TYPICAL) were fitted to the typical lamps LED-B1 to LED-B5
of CIE 15:2018, from 2733 to 6598 K, whose mean wavelengths they give to 4 nm; between them they follow the
reciprocal of the temperature.  Lamps of one colour temperature differ, by UNSURE_NM in mean wavelength: a spectrum
that was measured, given point by point, says ten times more.
"""

from dataclasses import replace

import numpy as np

from tracer.errors import SceneError
from tracer.light import FULL_WIDTH, Light, Numbers, continuous

TYPICAL = np.array(  # temperature [K]; pump: height against the phosphor, nm, full width; phosphor: nm, full width
    [
        [6598.0, 1.77, 451.7, 24.4, 563.9, 147.0],
        [5109.0, 1.40, 450.9, 24.2, 573.8, 142.3],
        [4103.0, 0.96, 448.2, 21.9, 580.7, 157.9],
        [2998.0, 0.47, 452.8, 26.3, 598.9, 144.5],
        [2733.0, 0.33, 453.1, 31.5, 603.2, 138.1],
    ]
)
WARMEST_K, COLDEST_K = 2500.0, 7000.0
UNSURE_NM = 8.0
ENDS_NM = (390.0, 780.0)


def white_led(temperature_k: float) -> Light:
    """Light of a white LED of a colour temperature [K], before any filter or camera.

    Raises
    ------
    SceneError
        Not within 2500-7000 K.
    """
    if not WARMEST_K <= temperature_k <= COLDEST_K:
        raise SceneError(
            f"a white LED has {WARMEST_K:g}-{COLDEST_K:g} K, not {temperature_k:g}; give its spectrum by points"
        )
    at = 1e6 / temperature_k
    pump, pump_nm, pump_width, peak_nm, peak_width = (
        float(np.interp(at, 1e6 / TYPICAL[:, 0], column)) for column in TYPICAL.T[1:]
    )

    def density(nm: Numbers) -> Numbers:
        return pump * _bell(nm, pump_nm, pump_width) + _bell(nm, peak_nm, peak_width)

    return replace(continuous(*ENDS_NM, density), unsure_nm=UNSURE_NM)


def _bell(nm: Numbers, mean_nm: float, width_nm: float) -> Numbers:
    """Gaussian of height 1 by its full width at half height."""
    return np.asarray(np.exp(-0.5 * ((nm - mean_nm) * FULL_WIDTH / width_nm) ** 2))
