"""Forecast of the light sheet's uncertainty from a scene's glass, before there is a frame.

A particle seen twice tells the disparity to about the width w of the peak that its two pictures and a sheet of
1 mm make.  Where pictures overlap, products of different particles are noise: with lambda particles on the area of
a corrected pixel, and pictures whose product covers A = 4 pi times the root of their covariance's determinant,

    sigma^2 = w^2 (1 + lambda A)

for each.  All particles of all pairs together then tell height and slopes like a weighted straight line.  Beside
chance stands what bend and fading of the views make of a height, by traced layers and to the share that is not
modelled, and what the scene's fit is unsure of: both as unknowns that places share, as in `fit_plane`.

Left out are particles that differ in light, views of one cell that bend unlike each other, and what the model of
the products leaves: sheets that were found were known to FOUND times what is foreseen.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from correction.fitted.scene_sigma import SceneSigma
from correction.light_sheet.disparities import MODELLED_TO, USUAL_SPREAD2
from correction.light_sheet.double_views import AROUND, PARTICLE_PX2, DoubleViews, some_of_each
from correction.light_sheet.layers import SIZES, Model, layers
from correction.light_sheet.self_calibration import scene_doubt
from tracer.light_sheet import UNMEASURED_DEG, UNMEASURED_MM
from tracer.scene.scene import Scene

PAIRS, PER_PX, SPREAD_MM = 50, 0.03, 0.18  # usual ones; of particles in a sheet of 1 mm
FOUND = 0.6, 7.0  # sheets drawn by another optics: 0.7 to 5; 6.5 in discs before the focus of three balls
TRACED_PLACES, DEPTH_MM = 40, 0.7  # places of a kind, heights to either side
LITTLE_MM, LITTLE_DEG = 0.3 * UNMEASURED_MM, 0.3 * UNMEASURED_DEG


@dataclass(frozen=True)
class SheetForecast:
    """Forecast for 50 pairs.

    Parameters
    ----------
    area_mm2 : float
        Seen twice, where the views can be followed.
    sigma_mm, tilt_sigma_deg : float
        Expected standard deviations of height and tilt; what is known without frames where they tell nothing. In
        truth they are `FOUND` times these.
    """

    area_mm2: float
    sigma_mm: float
    tilt_sigma_deg: float

    @property
    def range_mm(self) -> tuple[float, float]:
        """Least and most that `sigma_mm` is in truth."""
        return _range(self.sigma_mm, UNMEASURED_MM)

    @property
    def sentence(self) -> str:
        """In words."""
        if not self.area_mm2:
            return "of the light sheet nothing is seen twice: frames will not tell where it is, so measure it"
        warning = ""
        if self.sigma_mm > LITTLE_MM or self.tilt_sigma_deg > LITTLE_DEG:
            warning = ": too little to find it, so measure it"
        return (
            f"{self.area_mm2:.0f} mm\u00b2 of the light sheet are seen twice; {PAIRS} pairs with {PER_PX:g}"
            f" particles a pixel would tell its height to {_format_range(*self.range_mm)} mm and its tilt to"
            f" {_format_range(*_range(self.tilt_sigma_deg, UNMEASURED_DEG))} degrees{warning}"
        )


def _range(sigma: float, without_frames: float) -> tuple[float, float]:
    """Least and most of what is foreseen; frames never make it worse than it is without them."""
    low, high = (min(factor * sigma, without_frames) for factor in FOUND)
    return low, high


def _format_range(low: float, high: float) -> str:
    return f"{low:.2g}" if low == high else f"{low:.2g} to {high:.2g}"


def sheet_forecast(
    scene: Scene, views: DoubleViews, sigma: SceneSigma | None = None, pairs: int = PAIRS
) -> SheetForecast:
    """Forecast from the places seen twice.

    Parameters
    ----------
    scene : Scene
        That of the views, in the plane of the map.
    views : DoubleViews
        The places.
    sigma : SceneSigma, optional
        Of the scene, as seen in this plane; without it the scene is taken to be exact.
    pairs : int
        Of frames.
    """
    views = views.at(views.free(AROUND))
    kinds, kind = np.unique(views.kind, return_inverse=True)
    shared = np.zeros((len(views.kind), len(kinds) + 1))
    for number, (height_mm, deeper_mm) in enumerate(_bend_mm(scene, views, kind, len(kinds))):
        shared[kind == number, number] = MODELLED_TO * height_mm
        shared[kind == number, -1] = deeper_mm - height_mm
    if sigma is not None and len(kinds):
        shared = np.column_stack((shared, scene_doubt(scene, views, kind, sigma)[kind]))
    design = np.column_stack((np.ones(len(views.kind)), views.place_mm, shared))
    rate = (views.parallax / views.pitch_mm) ** 2
    pictures = PARTICLE_PX2 * views.blob + views.smear
    peak_px2 = pictures[:, 0] + rate * SPREAD_MM**2
    covered = 4.0 * np.pi * np.sqrt(pictures.prod(axis=1))
    met = np.minimum(1.0, 0.25 * covered)  # much magnified: between places
    seen = pairs * PER_PX * views.step**2 / (1.0 + PER_PX * covered)
    weight = seen * met * rate / peak_px2
    before = [UNMEASURED_MM**-2.0, *[float(np.deg2rad(UNMEASURED_DEG)) ** -2.0] * 2, *[1.0] * shared.shape[1]]
    known = np.linalg.inv(design.T @ (weight[:, None] * design) + np.diag(before))
    unsure = np.sqrt(np.diag(known)[:3])
    return SheetForecast(views.area_mm2, float(unsure[0]), float(np.rad2deg(unsure[1:].max())))


def _bend_mm(scene: Scene, views: DoubleViews, kind: NDArray[np.int64], kinds: int) -> list[tuple[float, float]]:
    """Bias of the height of a sheet at z = 0 from bend and fading, of each kind, by some of its places.

    Also of one that is deeper by what is not known of its depth.
    """
    if not kinds:
        return []
    some = some_of_each(kind, TRACED_PLACES)
    seen, units = views.at(some), views.units()[some]
    bells = layers(scene, seen, DEPTH_MM, SIZES[0])
    planes = bells.planes(seen, units, kind[some], AROUND)
    out = []
    for number in range(kinds):
        model, here = Model(bells.height_mm, planes[number], planes[number]), kind[some] == number
        lag_mm = float(np.median(units[here, 0] * views.pitch_mm / seen.parallax[here]))
        depths = SPREAD_MM**2, SPREAD_MM**2 + USUAL_SPREAD2[1]
        first, second = (model.offset(depth, 0.0) * lag_mm for depth in depths)
        out.append((first, second))
    return out
