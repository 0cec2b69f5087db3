"""Rims that are not known well enough: what lies beside them may be seen directly or through the ball.

Nodes next to a ball are placed by the camera alone, and their sigma says so; but if the ball stands a little
elsewhere than the fit could tell, some of them are seen through it, which is another place altogether.  No sigma
holds that, so the band is masked.  Where a ray from the eye touches the ball, of normal n there, the rim moves by

    n . dc + dr,    n = -(r / d) t + sqrt(1 - (r / d)^2) s,

t the direction of the centre at distance d, s the unit vector aside; with the rows of the covariance's root that
belong to centre and radius its sigma follows for every direction.  The band reaches RIM_SIGMAS sigmas to either
side. A ball that corners tell well has a band much narrower than a pixel, and none is made.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from correction.fit.seen.measurement import MeasuredFrame
from correction.masked import points_in
from tracer.bodies import Sphere
from tracer.camera import Camera
from tracer.masked import UNCONFIRMED, MaskedPart
from tracer.scene.scene import Scene

RIM_SIGMAS = 3.0  # standard deviations of a rim
MIN_BAND_PX = 0.5  # half widths of bands that are masked: nodes nearer than that to a rim are mixed anyway
POINTS = 96  # of each outline
# Rad from the middle of a ball: wider bands reach behind the camera, and no view goes so far
MAX_BAND_ANGLE = 0.7
REACH = (-0.5, -0.25, 0.25, 0.5)  # of windows, in squares along both edges


@dataclass(frozen=True)
class UnsureRim:
    """A ball whose rim is not known to a fraction of a pixel.

    Parameters
    ----------
    ball : str
        Its name.
    sigma_px : float
        Standard deviation of the rim where it is worst [raw px].
    masked : MaskedPart
        The band that no map is to use.
    """

    ball: str
    sigma_px: float
    masked: MaskedPart


def unsure_rims(scene: Scene, root: NDArray[np.float64], but: Collection[str] = ()) -> tuple[UnsureRim, ...]:
    """Return bands around the rims of a fitted scene's balls that are worth masking.

    Parameters
    ----------
    scene : Scene
        As fitted.
    root : (B, 4, P) float64
        Of each sphere's x, y, z and radius: root root^T is their covariance [mm^2].
    but : collection of str
        Balls that are masked as a whole.
    """
    bands = [
        _band(ball, scene.camera, own)
        for ball, own in zip(scene.spheres, root, strict=True)
        if ball.name not in but
    ]
    return tuple(band for band in bands if band is not None)


def beside_rim(rims: Sequence[UnsureRim], pixels: ArrayLike) -> NDArray[np.bool_]:
    """Pixels u, v (..., 2) that may lie on either side of a rim, as a mask."""
    at = np.asarray(pixels, np.float64)
    inside = [points_in(rim.masked.outline_px, at) for rim in rims]
    return np.any(inside, axis=0) if inside else np.zeros(at.shape[:-1], np.bool_)


def windows_beside(rims: Sequence[UnsureRim], frame: MeasuredFrame) -> NDArray[np.bool_]:
    """Corners (N,) of a frame that are seen directly, and whose windows may meet a rim.

    What they measured may be no crossing of squares.  Those seen through a ball are what its place is known by.
    """
    ends = np.concatenate([share * frame.axes_px for share in REACH], axis=2).swapaxes(1, 2)
    places = np.concatenate((frame.corners.pixel[:, None], frame.corners.pixel[:, None] + ends), axis=1)
    return np.asarray(beside_rim(rims, places).any(axis=1) & ~frame.behind)


def in_words(rims: Collection[UnsureRim]) -> str:
    """One sentence on all of them."""
    each = ", ".join(f"`{rim.ball}` {rim.sigma_px:.1f} px" for rim in rims)
    return (
        f"too few corners are seen through some balls to tell their rims (one sigma: {each}): what lies within"
        f" {RIM_SIGMAS:g} of these of a rim is masked in every map; smaller squares would show more corners"
    )


def _band(ball: Sphere, camera: Camera, root: NDArray[np.float64]) -> UnsureRim | None:
    eye, centre = np.array(camera.position_mm), np.array(ball.centre_mm)
    distance = float(np.linalg.norm(centre - eye))
    towards = (centre - eye) / distance
    sine = min(ball.radius_mm / distance, 0.99)
    cosine = np.sqrt(1.0 - sine**2)
    right, up = np.linalg.svd(towards[None, :])[2][1:]
    angle = np.linspace(0.0, 2.0 * np.pi, POINTS, endpoint=False)
    aside = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up
    normal = cosine * aside - sine * towards
    sigma_mm = np.linalg.norm(np.column_stack((normal, np.ones(POINTS))) @ root, axis=1)
    half = RIM_SIGMAS * sigma_mm / (distance * cosine)  # as an angle at the eye
    px = camera.focal_px / cosine  # a unit of angle
    if not (half * px > MIN_BAND_PX).any():
        return None

    def outline(widths: NDArray[np.float64], beyond: float = 1.0) -> NDArray[np.float64]:
        at = np.clip(np.arcsin(sine) + widths, 0.0, MAX_BAND_ANGLE)[:, None] * beyond
        return camera.project(eye + distance * (np.cos(at) * towards + np.sin(at) * aside))

    outer = outline(half, 1.0 / np.cos(np.pi / POINTS))  # chords touch the circle
    inner = outline(-half)
    # along a cut to the inner outline, around it and back: what a ray crosses twice there it does not cross
    points = np.vstack((outer, outer[:1], inner, inner[:1]))
    band = tuple((round(u, 2), round(v, 2)) for u, v in points.tolist())
    return UnsureRim(ball.name, float(half.max() * px / RIM_SIGMAS), MaskedPart(UNCONFIRMED, band))
