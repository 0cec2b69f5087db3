"""What a scene's glass will tell of its light sheet, before there is a frame.

A particle seen twice tells the disparity to about the width w of the peak that its two pictures and a sheet of
1 mm make.  Where pictures overlap, products of different particles are noise: with lambda particles on the area of
a corrected pixel, and pictures whose product covers A = 4 pi times the root of their covariance's determinant,

    sigma^2 = w^2 (1 + lambda A)

for each.  All particles of all pairs together then tell height and slopes like a weighted straight line.  Behind
three balls (pinhole, f/22) and a pyramid at 2016 px what was found was unsure by 0.7 to 1.3 of this.  Behind two
balls it was by 2 to 3 times, behind a pyramid at 1008 px by 2: what bends the second view is not in it.
"""

from dataclasses import dataclass

import numpy as np

from correction.light_sheet.double_views import AROUND, PARTICLE_PX2, DoubleViews
from tracer.light_sheet import UNMEASURED_DEG, UNMEASURED_MM

PAIRS, PER_PX, SPREAD_MM = 50, 0.03, 0.18  # usual ones; of particles in a sheet of 1 mm
LITTLE_MM, LITTLE_DEG = 0.3 * UNMEASURED_MM, 0.3 * UNMEASURED_DEG


@dataclass(frozen=True)
class SheetForecast:
    """What 50 pairs would tell.

    Parameters
    ----------
    area_mm2 : float
        Seen twice, where the views can be followed.
    sigma_mm, tilt_sigma_deg : float
        Expected standard deviations of height and tilt; what is known without frames where they tell nothing.
    """

    area_mm2: float
    sigma_mm: float
    tilt_sigma_deg: float

    @property
    def sentence(self) -> str:
        """In words."""
        if not self.area_mm2:
            return "of the light sheet nothing is seen twice: frames will not tell where it is, so measure it"
        doubt = ""
        if self.sigma_mm > LITTLE_MM or self.tilt_sigma_deg > LITTLE_DEG:
            doubt = ": too little to find it, so measure it"
        return (
            f"{self.area_mm2:.0f} mm\u00b2 of the light sheet are seen twice; {PAIRS} pairs with {PER_PX:g}"
            f" particles a pixel would tell its height to {self.sigma_mm:.2g} mm and its tilt to"
            f" {self.tilt_sigma_deg:.2g} degrees{doubt}"
        )


def sheet_forecast(views: DoubleViews) -> SheetForecast:
    """Forecast from the places seen twice."""
    views = views.at(views.free(AROUND))
    design = np.column_stack((np.ones(len(views.kind)), views.place_mm))
    rate = (views.parallax / views.pitch_mm) ** 2
    pictures = PARTICLE_PX2 * views.blob + views.smear
    peak_px2 = pictures[:, 0] + rate * SPREAD_MM**2
    covered = 4.0 * np.pi * np.sqrt(pictures.prod(axis=1))
    met = np.minimum(1.0, 0.25 * covered)  # much magnified: between places
    told = PAIRS * PER_PX * views.step**2 / (1.0 + PER_PX * covered)
    weight = told * met * rate / peak_px2
    before = np.diag([UNMEASURED_MM**-2.0, *[float(np.deg2rad(UNMEASURED_DEG)) ** -2.0] * 2])
    known = np.linalg.inv(design.T @ (weight[:, None] * design) + before)
    sigma = np.sqrt(np.diag(known))
    return SheetForecast(views.area_mm2, float(sigma[0]), float(np.rad2deg(sigma[1:].max())))
