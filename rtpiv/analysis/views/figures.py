"""Figures of merit of an arrangement of camera and glass, before it is built.

At places spread evenly over what is recovered behind the glass, X(u) is the point of the plane that pixel u shows
and P(u) the one it would show without glass; both Jacobians are traced.  With s the smallest singular value of
dP/dX, one corrected pixel is seen s pixels wide there, so the noise of a displacement is

    noise = NOISE_PX d / (PARTICLE_PX s),       d^2 = PARTICLE_PX^2 + (4 blur)^2       [corrected px]

NOISE_PX is that of windows of 32 px with sharp particles seen directly; it grows with the diameter d of their
pictures (Raffel et al., Particle Image Velocimetry, 5.5.2).  What the map itself is off by comes on top
(`sigma_forecast`).  A pupil of radius r = f / 2 f# moves the rays through a point of the focal plane by
B a = (dX/da - dX/dP) a on the plane, a the place in the pupil; the standard deviation of a disc is r / 2 along
each axis, so to first order

    blur = r / 2 * largest singular value of (dP/dX) B / pitch        [px of the camera]

Light: a particle sends (r / L)^2 / 4 of its light into the pupil, |det dP/dX| as much behind glass (a lens between
them collects more), less what the surfaces reflect; its picture is compared with those of the other arrangements.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.light import light_uncertainty
from correction.fitted.scene_sigma import SceneSigma
from correction.maps.correction_map import CorrectionMap
from daq.errors import RunUsageError
from rtpiv.analysis.through_glass import behind, coarse_map, hiding, reach
from rtpiv.analysis.views.field_of_view import FieldOfView, field_of_view
from rtpiv.analysis.views.sigma_forecast import sigma_forecast
from rtpiv.templates.files import scene_of
from rtpiv.templates.lab import Lab
from rtpiv.templates.room import GLASS_HEIGHTS_MM, bare_heights_mm, room_of
from tracer.errors import SceneError
from tracer.pupil import depth_of_field_mm
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import CAMERA, SPHERE, landings

PLACES = 300  # behind glass, at which the rest is known
NOISE_PX, PARTICLE_PX = 0.03, 3.0  # of displacements of 32 px windows seen directly; diameter of sharp particles
STEP_MM = 0.01  # a ball is off by so much


@dataclass(frozen=True)
class ViewFigures:
    """Figures of one arrangement; NaN where nothing is recovered behind glass.

    Parameters
    ----------
    lab : Lab
        The arrangement.
    inside, total : float or None
        FOV_in and FOV_total of balls in a row (``rtpiv.analysis.views.field_of_view``), as shares.
    recovered : float
        Recovered share of what the balls hide of the plane.
    usable : float
        Share of it where the noise of displacements stays below what was asked for.
    glass_mm2 : float
        Area recovered through glass.
    magnification : float
        Size of what is seen behind glass, as a share of that beside it: median.
    noise_px : float
        Median noise of a displacement behind glass [corrected px].
    sensitivity_px : float
        Median shift of the picture behind glass if the worst ball is 10 um off, sideways [corrected px].
    blur_px : float
        Median width (standard deviation) of a particle's picture behind glass at the f-number, by the depth.
    depth_mm : float
        Depth of field beside the glass.
    light : float
        Share of its light that a particle behind glass sends into its picture.
    sigma_px, unsaid_px : float
        Median sigma of the map behind glass after a fit [corrected px], where it was asked for: the light of the
        target frames known; and if it is not known which it was.
    """

    lab: Lab
    inside: float | None
    total: float | None
    recovered: float
    usable: float
    glass_mm2: float
    magnification: float
    noise_px: float
    sensitivity_px: float
    blur_px: float
    depth_mm: float
    light: float
    sigma_px: float = math.nan
    unsaid_px: float = math.nan


def view_figures(lab: Lab, f_number: float, error_px: float) -> ViewFigures:
    """Figures of one arrangement.

    Parameters
    ----------
    lab : Lab
        What would be built.
    f_number : float
        Of the lens.
    error_px : float
        Largest noise of a displacement that counts as usable [corrected px].

    Returns
    -------
    ViewFigures

    Raises
    ------
    RunUsageError
        There is no room for the glass before the lens, or the camera sees the balls smaller than a node of a map.
    """
    scene = scene_of(lab)
    room_of(lab)
    found = coarse_map(scene)
    seen = _Seen.of(scene, found, lab, f_number)
    noise = NOISE_PX * np.hypot(1.0, 4.0 * seen.blur_px / PARTICLE_PX) / seen.least
    hidden, everywhere = _nodes_behind(scene, found)
    if everywhere == 0:
        raise RunUsageError(
            f"a lens of {lab.lens_mm:g} mm at {lab.distance_mm:g} mm sees balls of {lab.ball_mm:g} mm with no more"
            " than a few pixels; take a longer lens, or go nearer"
        )
    counted = noise[hidden[seen.node]]
    recovered = float(np.count_nonzero(found.recovered & hidden)) / everywhere
    radial = _radial(
        replace(lab, name="lab", lens_mm=0.1 * lab.distance_mm, sensor_px=(16, 16), pixel_pitch_um=1.0)
    )
    return ViewFigures(
        lab=lab,
        inside=None if radial is None else radial.inside,
        total=None if radial is None else radial.total,
        recovered=recovered,
        usable=recovered * float((counted <= error_px).mean()) if len(counted) else 0.0,
        glass_mm2=float(found.behind_glass.sum()) * found.grid.pitch_mm**2,
        magnification=_median(np.sqrt(seen.area)),
        noise_px=_median(noise),
        sensitivity_px=_median(seen.sensitivity_px),
        blur_px=_median(seen.blur_px),
        depth_mm=depth_of_field_mm(lab.lens_mm / (lab.distance_mm - lab.lens_mm), f_number, lab.wavelength_nm),
        light=_median(seen.light),
    )


def with_sigma(view: ViewFigures) -> ViewFigures:
    """Return the same figures with those of the map after a fit to the target run that `rtpiv init` writes."""
    lab, room, scene = view.lab, room_of(view.lab), scene_of(view.lab)
    found = coarse_map(scene)
    pixel = _Seen.of(scene, found, lab, 1.0).pixel
    times = scene.camera.sensor_px[0] // found.sensor_px[0]
    known = sigma_forecast(scene, lab.board_mm, bare_heights_mm(room), GLASS_HEIGHTS_MM, times)
    step = light_uncertainty(scene, None).step  # none of glass that is a number
    unsaid = known.with_draw(step) if step.size else known

    def median_px(sure: SceneSigma) -> float:
        return _median(np.linalg.norm(sure.sigma(scene, pixel), axis=1)) * lab.px_per_mm

    return replace(view, sigma_px=median_px(known), unsaid_px=median_px(unsaid))


@dataclass(frozen=True)
class _Seen:
    """N places behind glass, spread evenly over the plane, and what is known of each."""

    node: tuple[NDArray[np.int64], NDArray[np.int64]]  # rows and columns
    pixel: NDArray[np.float64]
    least: NDArray[np.floating[Any]]  # singular value of dP/dX
    area: NDArray[np.float64]  # |det dP/dX|
    sensitivity_px: NDArray[np.float64]
    blur_px: NDArray[np.floating[Any]]
    light: NDArray[np.float64]

    @classmethod
    def of(cls, scene: Scene, found: CorrectionMap, lab: Lab, f_number: float) -> "_Seen":
        rows, columns = np.nonzero(found.behind_glass)
        step = max(1, len(rows) // PLACES)
        rows, columns = rows[::step], columns[::step]
        times = scene.camera.sensor_px[0] // found.sensor_px[0]
        pixel = (found.pixel[0, rows, columns] + 0.5) * times - 0.5
        rays = landings(scene, pixel)
        hit = rays.recovered  # a view at its very edge may be lost between two sizes of pixels
        rows, columns, pixel, rate = rows[hit], columns[hit], pixel[hit], rays.rate[hit]
        shown = rays.pixel_rate[hit] @ np.diag([lab.px_per_mm, -lab.px_per_mm])  # dX/dP: P moves with u, against v
        back = np.linalg.inv(shown)
        least, area = np.linalg.svd(back, compute_uv=False)[:, 1], np.abs(np.linalg.det(back))
        radius_mm = lab.lens_mm / (2.0 * f_number)
        spread = np.linalg.svd(back @ (rate[:, :, :2] - shown), compute_uv=False)[:, 0]
        balls = rate[:, :, len(CAMERA) :][:, :, : len(SPHERE) * len(scene.spheres)]
        sideways = balls.reshape(len(pixel), 2, len(scene.spheres), len(SPHERE))[..., :2]
        return cls(
            node=(rows, columns),
            pixel=pixel,
            least=least,
            area=area,
            sensitivity_px=np.linalg.norm(sideways, axis=1).max(axis=(1, 2)) * STEP_MM * lab.px_per_mm,
            blur_px=0.5 * radius_mm * spread * lab.px_per_mm,
            light=found.transmittance[0, rows, columns] * area * (radius_mm / lab.distance_mm) ** 2 / 4.0,
        )


@lru_cache(maxsize=256)
def _radial(lab: Lab) -> FieldOfView | None:
    """Field of view of balls in a row; it asks neither lens nor pixels."""
    try:
        return field_of_view(scene_of(lab))
    except SceneError:
        return None


def _nodes_behind(scene: Scene, found: CorrectionMap) -> tuple[NDArray[np.bool_], int]:
    """Nodes of the map before which a ball stands, and how many there are of them, those beyond the frame too."""
    height, width = found.grid.shape
    reaches = [window for body in hiding(scene) if (window := reach(body, scene, found.grid)) is not None]
    (top, bottom), (left, right) = (
        (min(0, *(window[axis][0] for window in reaches)), max(side, *(window[axis][1] for window in reaches)))
        for axis, side in enumerate((height, width))
    )
    marks = behind(hiding(scene), scene, found.grid, ((top, bottom), (left, right)))
    return marks[-top : height - top, -left : width - left], int(np.count_nonzero(marks))


def _median(values: NDArray[Any]) -> float:
    return float(np.median(values)) if len(values) else math.nan
