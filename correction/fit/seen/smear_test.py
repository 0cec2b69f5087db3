"""Test of the colours that smear corners behind glass: as specified, more of them, or fewer.

A lamp of many colours, taken for one, leaves no residual: every corner stands where the mean index shows it.  What
it does is to smear edges behind glass along the way on which glass spreads colours.  With b_k^2 the variance of
edge k of a corner, as fitted, less what a fitted edge takes up of the specified light (`smear.smear_by_colour`)
and what the specified pupil adds, m_k the edge's normal and J the derivative of the landing point X by the pixel,

    b_k^2 = b_way + p P_k + c V_k,        V_k = (m_k . J^-1 dX/dn g)^2,        P_k = |m_k . J^-1 D|^2 / 4,

V_k is the variance that a white lamp would add (g how much the index of each ball spreads in it), P_k that of a
pupil of 1 mm (D how the landing point moves with the pinhole, while rays meet again in the plane in focus): a stop
that is not specified, or a print magnified, must not pass for colours.  b_way, p and c come from least squares
with weights for outliers.  c stands out, to either side, where it exceeds MIN_SMEAR, and of what the specified
light adds UNCERTAIN, by SMEAR_SIGMAS sigmas, which are NEIGHBOUR_FACTOR times those of corners that err
independently. It is below zero where the specified light has too many colours.

A fitted edge takes up 0.2-1 of a smear's variance: the fit wishes both edges of a corner to be blurred alike, and
where squares are small it has its way; of a wide smear the rest goes into the shape of its tails.  So c =
MIN_SMEAR is light of some 25-40 nm standard deviation.  A narrower lamp, such as an LED of one colour, shows
nowhere what its mean is.

Light given by a width may have another shape, which moves its mean index.  What the smear leaves open of that
(`ColourSmear.open_share`) is counted in the map's sigma.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.light import ORDINARY_GLASS
from tracer.camera import Camera
from tracer.light import Light, white_led
from tracer.media import MEDIA, THINNEST_LIQUID, ConstantMedium, Medium
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import CAMERA, SPHERE, Landings

LAMP_K = 4000.0
COLOURS = 12
MIN_SMEAR = 0.1  # of the white lamp's variance; rendered frames in one colour show up to 0.04
# Of what edges take up of the specified light: rendered frames in specified light show up to 0.13
UNCERTAIN = 0.15
SMEAR_SIGMAS = 4.0  # sigmas
UNSEEN_SIGMAS = 2.0  # sigmas that a light may be off by without being seen
NEIGHBOUR_FACTOR = 2.0  # neighbours err alike: what a sigma counts more than that of independent corners
MIN_WAY_CORNERS = 20  # corners of a way
SMEAR_ROUNDS = 12
SMEAR_KNEE = 2.0  # sigmas


@dataclass(frozen=True)
class EdgeSpread:
    """Measured edge widths of N corners; N = 0 where they were not measured.

    Parameters
    ----------
    variance_px2 : (N, 2) float64
        Of the edges along the board's +x and +y, less what the specified light adds.
    by_pupil_px2, by_light_px2 : (N, 2) float64
        What the specified pupil adds, and the light.
    """

    variance_px2: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    by_pupil_px2: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    by_light_px2: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))

    def take(self, which: NDArray[np.bool_]) -> "EdgeSpread":
        """Return that of the chosen corners."""
        if not len(self.variance_px2):
            return self
        return EdgeSpread(self.variance_px2[which], self.by_pupil_px2[which], self.by_light_px2[which])


@dataclass(frozen=True)
class SmearedView:
    """Corners behind glass of one frame, N of them, with what would smear them.

    Parameters
    ----------
    way : (N,) str
        Way through the glass.
    spread : EdgeSpread
        As measured.
    by_lamp_px2, by_pupil_px2 : (N, 2) float64
        V and P.
    """

    way: NDArray[np.str_]
    spread: EdgeSpread
    by_lamp_px2: NDArray[np.float64]
    by_pupil_px2: NDArray[np.float64]


@dataclass(frozen=True)
class ColourSmear:
    """Smear of corners as by colours.

    Parameters
    ----------
    share, sigma : float
        c, and its standard deviation.
    width_px : float
        Root mean square of the smear that it is, raw px.
    expected : float
        What edges take up of the specified light, in the same unit as c.
    """

    share: float
    sigma: float
    width_px: float
    expected: float = 0.0

    @property
    def alarm(self) -> bool:
        """True if the light cannot be the specified one; a line cannot have too many colours."""
        off = abs(self.share) if self.expected else self.share
        return off > MIN_SMEAR + UNCERTAIN * self.expected + SMEAR_SIGMAS * self.sigma

    def open_share(self, medium: Medium, light: Light, rival: Light) -> float:
        """Share (0-1) of the way from the specified light to a rival that the smear leaves open."""
        white, *shown = (_index_variance(medium, one) for one in (white_led(LAMP_K), light, rival))
        given, other = shown[0] / white, shown[1] / white
        taken_up = self.expected / given if given > 0.0 else 1.0  # of a smear's variance
        left = (abs(self.share) + UNSEEN_SIGMAS * self.sigma) / max(taken_up, MIN_SMEAR) + UNCERTAIN * given
        return float(min(1.0, left / max(abs(other - given), 1e-12)))

    def __str__(self) -> str:
        """Return one sentence."""
        many, smeared = ("more", "more") if self.share > 0.0 else ("fewer", "less")
        return (
            f"the light of the target frames has {many} colours than fit.light gives: edges behind glass are"
            f" smeared by {self.width_px:.2g} px {smeared} along the way on which glass spreads colours"
            f" ({abs(self.share) / self.sigma:.0f} sigma); give its spectrum as fit.light, or take these frames in"
            " the light of the measurement"
        )


def smear_in_view(
    scene: Scene,
    camera: Camera,
    way: NDArray[np.str_],
    axes_px: NDArray[np.float64],
    spread: EdgeSpread,
    rays: Landings,
) -> SmearedView:
    """Say what would smear the corners of a frame with glass.

    Parameters
    ----------
    scene : Scene
        For its media.
    camera : Camera
        As fitted.
    way : (N,) str
    axes_px : (N, 2, 2) float64
        Columns: one square along the board's +x, +y in the frame.
    spread : EdgeSpread
    rays : Landings
        Of the corners.
    """
    behind = (way != "") & rays.recovered & np.isfinite(spread.variance_px2).all(axis=1)
    along = axes_px[behind].transpose(0, 2, 1)  # (N, edge, 2)
    normal = np.stack((-along[:, :, 1], along[:, :, 0]), axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    rate, back = rays.rate[behind], np.linalg.inv(rays.pixel_rate[behind])
    widths = np.array([index_width(sphere.medium) for sphere in scene.spheres])
    by_n = rate[:, :, len(CAMERA) : len(CAMERA) + len(SPHERE) * len(widths)]
    by_ball = by_n.reshape(len(rate), 2, len(widths), len(SPHERE))
    colours = back @ (by_ball[..., SPHERE.index("n")] @ widths)[:, :, None]
    focus_mm = camera.pupil.focus_mm if camera.pupil else float(camera.position_mm[2])
    aside = rate[:, :, :3] @ camera.rotation_matrix[:2].T
    parts = back @ aside - camera.focal_px / focus_mm * np.eye(2)
    return SmearedView(
        way[behind],
        spread.take(behind),
        (normal @ colours)[:, :, 0] ** 2,
        np.sum((normal @ parts) ** 2, axis=2) / 4.0,
    )


def colour_smear(views: Sequence[SmearedView]) -> ColourSmear | None:
    """Find c in all frames together; None where too few corners tell it."""
    wide, columns, lamp, light = [], [], [], []
    for number, view in enumerate(views):
        for way in np.unique(view.way):
            here = view.way == way
            if np.count_nonzero(here) >= MIN_WAY_CORNERS:
                wide.append(view.spread.variance_px2[here].ravel())
                lamp.append(view.by_lamp_px2[here].ravel())
                light.append(view.spread.by_light_px2[here].ravel())
                own = np.stack((view.by_pupil_px2[here], view.spread.by_pupil_px2[here]), axis=-1)
                columns.append((f"{number} {way}", own.reshape(-1, 2)))
    if not wide:
        return None
    level = [np.full(len(own), number) for number, (_, own) in enumerate(columns)]
    levels = (np.concatenate(level)[:, None] == np.arange(len(columns))).astype(np.float64)
    of_lamp, of_light = np.concatenate(lamp), np.concatenate(light)
    terms = np.column_stack((of_lamp, levels, np.concatenate([own for _, own in columns])))
    terms = terms[:, np.ptp(terms, axis=0) + np.abs(terms).max(axis=0) > 0.0]
    seen, weight = np.concatenate(wide), np.ones(len(terms))
    if not of_lamp.any() or len(seen) < 4 * terms.shape[1]:
        return None
    for _ in range(SMEAR_ROUNDS):
        found, *_ = np.linalg.lstsq(terms * weight[:, None], seen * weight, rcond=None)
        left = seen - terms @ found
        size = max(1.4826 * float(np.median(np.abs(left))), 1e-12)
        weight = np.sqrt(1.0 / np.maximum(1.0, np.abs(left) / (SMEAR_KNEE * size)))
    used = terms * weight[:, None]
    sigma = NEIGHBOUR_FACTOR * size * float(np.sqrt(np.linalg.pinv(used.T @ used)[0, 0]))
    width = np.sqrt(abs(float(found[0])) * 2.0 * float(np.mean(of_lamp)))
    return ColourSmear(float(found[0]), sigma, float(width), float(of_light @ of_lamp / (of_lamp @ of_lamp)))


@cache
def index_width(medium: Medium | None) -> float:
    """Standard deviation of a medium's index over the colours of a white lamp; of ordinary glass for a number."""
    if medium is None:
        return 0.0
    if isinstance(medium, ConstantMedium):
        if medium.index < THINNEST_LIQUID:
            return 0.0
        medium = MEDIA[ORDINARY_GLASS]
    return float(np.sqrt(_index_variance(medium, white_led(LAMP_K))))


def _index_variance(medium: Medium, light: Light) -> float:
    """Variance of a medium's index over the colours of a light."""
    lengths, weight = light.colours(COLOURS)
    n = np.array([medium.n(float(nm)) for nm in lengths])
    return float(weight @ (n - weight @ n) ** 2)
