"""Height of the light sheet from where it is bright: the mean frame of particles against the traced light.

Refraction keeps radiance along a ray, so the mean of many frames of particles, the background taken off, is at
each pixel as bright as the light where its ray crosses the lit surface, times a gain that changes slowly over the
frame (seeding, vignetting).  Shadows and foci move in the frame with the height z of the sheet: its light takes
another way through the balls, and an oblique view shows it elsewhere.  The light is traced for some z,

    sqrt(seen) = gain(u, v) sqrt(traced(z)),       gain of second order, least squares over all pixels,

with square roots because the number of particles in a pixel varies as their mean (Bartlett 1936).  Where glass
magnifies, a particle covers many pixels: each counts by its area on the plane, relative to a pixel without glass,
and not at all below LEAST_AREA, where few particles or none stand in it and the mean of roots is far below the
root of the mean.

All heights are allowed whose sum of squares exceeds the least one by at most MODEL_SHARE of the light: by so much
traced light differs from that of the simulator's own optics at the true height.  Only pixels count that some of
these heights light: in a bed most are glass or shadow, and the square root of their noise is not small.
The result is the middle of the range, its standard uncertainty that of an even distribution over it, and that of
the jackknife over blocks of the frame.

Light that passes a ball at a height h from its middle leaves it as it would at -h.  So a sheet through the middle
of a layer looks alike below and above it, but for the oblique view of shadows, and the range is as wide as the
sheet is thick; a scene that claims to know the height better is not confirmed.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.grid import grid_of
from correction.maps.lit import light_of
from correction.maps.slant import ray_slopes
from tracer.errors import SceneError
from tracer.light_sheet import LightSheet
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.trace import RayStatus

COMPARED_HEIGHTS = 9  # that are traced
SPLINE_PLACES = 961  # over all of them, at which the sum is interpolated
# Thicknesses of the sheet to either side of the given height
COMPARED_SPAN = 1.2
# Width of the frames for which the light is traced
TRACED_PX = 800
# Along and down a pixel of those compared: edges of glass are sharper than pixels
RAYS = 2
JACKKNIFE_BLOCKS = 4, 5  # of a frame, down and along
SPOT_PX = 1.2  # standard deviation of a particle's image
ELSEWHERE_SIGMAS = 3.0  # sigmas from which a sheet is said to lie elsewhere
# Of the undisturbed sheet's: below it at all heights, a pixel is dark
DARK_PIXEL = 0.02
# Of the light: true heights leave up to 0.0011 more in beds, tubes and random packings
MODEL_SHARE = 0.0012
LEAST_AREA = 0.25  # of a pixel on the plane, against one without glass


@dataclass(frozen=True)
class BrightnessHeight:
    """Height of the sheet by its brightness.

    Parameters
    ----------
    z_mm, sigma_mm : float
        Height over the target's plane; NaN where heights at an end of those compared are allowed.
    range_mm : (float, float)
        Lowest and highest of those allowed.
    given : LightSheet
        As the scene has it.
    """

    z_mm: float
    sigma_mm: float
    range_mm: tuple[float, float]
    given: LightSheet

    @property
    def is_elsewhere(self) -> bool:
        """Return whether the sheet lies elsewhere by more than chance."""
        return abs(self.z_mm - self.given.z_mm) > ELSEWHERE_SIGMAS * self.sigma_mm

    @property
    def sentence(self) -> str:
        """In words."""
        if not np.isfinite(self.z_mm):
            return "brightness does not tell the height of the light sheet: no height compared explains it best"
        low, high = self.range_mm
        found = (
            f"brightness puts the light sheet at z = {self.z_mm:.2f} +- {self.sigma_mm:.2f} mm"
            f" ({low:.2f} to {high:.2f})"
        )
        if self.is_elsewhere:
            return (
                f"{found}, {self.z_mm - self.given.z_mm:+.2f} mm from where the scene has it; correct sheet.z_mm"
            )
        if self.sigma_mm > self.given.sigma_mm:
            return (
                f"{found}; it agrees with the scene, but cannot confirm its sigma_mm of {self.given.sigma_mm:g}: a"
                " sheet through the middle of a layer looks alike below and above it"
            )
        return f"{found}, as the scene has it within that"


def height_by_brightness(scene: Scene, mean: NDArray[np.float64]) -> BrightnessHeight | None:
    """Compare a mean frame with the light of a scene, traced at several heights; None if no sheet can be compared.

    Parameters
    ----------
    scene : Scene
        With its sheet and the sources of its light.
    mean : (H, W) float64
        Mean of acquired frames of particles, without the background.
    """
    sheet = scene.sheet
    if sheet is None or not sheet.sources or sheet.thickness_mm is None:
        return None
    times = -(-mean.shape[1] // TRACED_PX)
    small, seen = scene.coarser(times), _bin_pixels(_bin_pixels(mean, times), RAYS)
    heights = sheet.z_mm + sheet.thickness_mm * np.linspace(-COMPARED_SPAN, COMPARED_SPAN, COMPARED_HEIGHTS)
    traced, areas = [], []
    for z in heights.tolist():
        try:
            lit, area = _brightness(replace(small, sheet=replace(sheet, z_mm=z)).in_light_sheet())
        except SceneError:  # no light there, or a body that no sheet may cross
            return None
        traced.append(_bin_pixels(lit, RAYS))
        areas.append(_bin_pixels(area, RAYS))
    weight = np.mean(areas, axis=0)
    use = np.asarray(np.isfinite(traced).all(axis=0), np.bool_)
    blur = SPOT_PX / times / RAYS
    roots = [np.sqrt(scipy.ndimage.gaussian_filter(np.nan_to_num(field), blur)) for field in traced]
    root = np.sqrt(np.maximum(scipy.ndimage.gaussian_filter(seen, blur), 0.0))
    use &= (np.max(roots, axis=0) > np.sqrt(DARK_PIXEL)) & (weight > LEAST_AREA)
    sums = np.array([_misfit(root, one, np.where(use, weight, 0.0)) for one in roots])  # (heights, blocks)
    margin = MODEL_SHARE * float(np.sum(weight[use] * root[use] ** 2))
    low, high = height_range(heights, sums.sum(axis=1), margin)
    rest = sums.sum(axis=1)[:, None] - sums  # without each block
    middles = [sum(height_range(heights, one, margin)) / 2.0 for one in rest.T]
    scatter = (len(middles) - 1) * float(np.nanvar(middles)) if np.isfinite(low) else low  # jackknife
    sigma = float(np.sqrt(scatter + (high - low) ** 2 / 12.0))
    return BrightnessHeight(0.5 * (low + high), sigma, (low, high), sheet)


def _bin_pixels(frame: NDArray[np.float64], times: int) -> NDArray[np.float64]:
    """Mean of each block of times x times pixels."""
    rows, columns = (side // times for side in frame.shape)
    blocks = frame[: rows * times, : columns * times].reshape(rows, times, columns, times)
    return np.asarray(blocks.mean(axis=(1, 3)))


def _brightness(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return traced light (H, W) of pixels, and their areas (H, W) on the plane.

    The light is 0 in glass, NaN where a ray is lost or leaves the map of the light.  Areas are relative to a pixel
    without glass, at most 1.
    """
    rays = build_ray_map(scene)
    lit = light_of(scene, grid_of(scene.camera))
    out = np.where(rays.status == RayStatus.IN_GLASS, 0.0, np.nan)
    places = np.where(rays.recovered[..., None], rays.plane_mm.astype(np.float64), np.nan)
    down, along = np.gradient(places, axis=(0, 1))
    area = np.abs(down[..., 0] * along[..., 1] - down[..., 1] * along[..., 0])
    bare = (scene.camera.position_mm[2] / scene.camera.focal_px) ** 2
    # A pixel at a rim has no area of its own: the least of its neighbours'
    area = np.minimum(scipy.ndimage.minimum_filter(np.where(np.isfinite(area), area, np.inf), 3) / bare, 1.0)
    if lit is None:
        return out, area
    v, u = np.nonzero(rays.recovered)
    feet = places[rays.recovered]
    slopes = ray_slopes(scene, np.stack((u, v), axis=-1).astype(np.float64))
    column, row = lit.grid.to_px(feet + lit.height_at(feet)[:, None] * slopes).T
    out[rays.recovered] = scipy.ndimage.map_coordinates(lit.light.brightness, [row, column], order=1, cval=np.nan)
    return out, area


def _misfit(
    seen: NDArray[np.float64], traced: NDArray[np.float64], weight: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Weighted sums of squares (B,) that the light traced leaves in each block of the frame."""
    rows, columns = seen.shape
    v, u = np.meshgrid(np.linspace(-1.0, 1.0, rows), np.linspace(-1.0, 1.0, columns), indexing="ij")
    use, root = weight > 0.0, np.sqrt(weight)
    seen, traced = root * seen, root * traced
    terms = np.stack([one[use] * traced[use] for one in (np.ones_like(u), u, v, u * u, u * v, v * v)], axis=1)
    gain, *_ = np.linalg.lstsq(terms, seen[use], rcond=None)
    left = np.zeros(seen.shape)
    left[use] = (seen[use] - terms @ gain) ** 2
    bands = np.array_split(left, JACKKNIFE_BLOCKS[0], axis=0)
    return np.array([part.sum() for band in bands for part in np.array_split(band, JACKKNIFE_BLOCKS[1], axis=1)])


def height_range(heights: NDArray[np.float64], sums: NDArray[np.float64], margin: float) -> tuple[float, float]:
    """Lowest and highest of the heights whose sum exceeds the least by at most a margin; NaN where at an end.

    Between heights the sum is interpolated by modified Akima splines, which hardly overshoot beside a steep side.
    """
    fine = np.linspace(heights[0], heights[-1], SPLINE_PLACES)
    between = scipy.interpolate.Akima1DInterpolator(heights, sums, method="makima")(fine)
    there = np.flatnonzero(between <= between.min() + margin)
    if there[0] == 0 or there[-1] == len(fine) - 1:
        return float("nan"), float("nan")
    return float(fine[there[0]]), float(fine[there[-1]])
