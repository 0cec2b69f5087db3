"""The light sheet from two cameras at the same time: disparity of their corrected frames (Wieneke 2005).

Frames are corrected for the plane where the sheet is believed to be.  A particle at the height h over it stands,
in the frame of a view whose ray has the slope a = dX/dz, at X - a h; so from view 1 to view 2 it is displaced by

    d = -(a_2 - a_1) h,        h = z + s_x x + s_y y

at every place that both views see: two equations a place for three unknowns.  What no h explains, the residual, is
across the difference of slopes, or changes otherwise than a plane does: a camera or a ball that stands elsewhere
than calibrated.

**Which camera.**  If the pose p of camera k is off by dp, the frame shows at X what stands at X + G_k dp, with the
derivatives G_k = dX/dp of the landing points: the disparity of view 2 against view 1 becomes

    d = -(a_2 - a_1) h - G_2 dp_2 + G_1 dp_1

Beside glass a shift of one camera looks like the opposite one of the other; behind a ball G is another, and only
one of them looks through that ball at that place.  So each camera alone is fitted with the sheet, and the one is
named that explains the residual where the others do not; where several do, each of them.

B. Wieneke, Stereo-PIV using self-calibration on particle images, Exp. Fluids 39, 267 (2005).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.errors import SheetError
from correction.light_sheet.self_calibration import plane_of, sheet_with_plane
from tracer.light_sheet import LightSheet

HUBER_SIGMA = 2.0  # residual from which a place counts less: rims, where two pictures meet in one window
MIN_PLACES = 12
POSE_SIGMA = np.array([1.0, 1.0, 1.0, *[np.deg2rad(0.2)] * 3])  # mm, rad: of a camera's pose
LIKELIER = 20.0  # by how much a camera that is named lowers chi^2, and more than the others
NO_HEIGHT = 1e-9  # mm of the sheet by 1 mm of a camera
LEAST_MOVED_MM = 0.005  # of places: a calibration is no surer; without a move 0.002 mm were fitted
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SheetByViews:
    """Plane of the sheet over the plane for which frames were corrected.

    Parameters
    ----------
    plane : ndarray of float64, shape (3,)
        z [mm], and the slopes dz/dx and dz/dy.
    covariance : ndarray of float64, shape (3, 3)
        Theirs.
    residual_mm, residual_sigma : float
        Root mean square of the disparity that no plane explains, robust; and in sigmas of its measurement.
    places : int
        Vectors of the disparity.
    moved : tuple of int
        Numbers of the views, from 0, of which one has a camera that does not stand where it was calibrated.
    moved_mm : float
        By how much its places on the plane are off at least (rms), beside what another sheet explains.
    unseen : ndarray of float64, shape (6,), optional
        Moves [mm] and turns [rad] of either camera below which it is not named, each alone.
    as_height : ndarray of float64, shape (6,)
        Heights of the sheet [mm] for which 1 mm or 1 rad of each is taken, of the camera where it is less.
    """

    plane: Floats
    covariance: Floats
    residual_mm: float
    residual_sigma: float
    places: int
    moved: tuple[int, ...] = ()
    moved_mm: float = 0.0
    unseen: Floats | None = None
    as_height: Floats = field(default_factory=lambda: np.zeros(6))

    def least_noticed(self, height_mm: float) -> Floats | None:
        """Return the least of each number (6,) at which a camera is named or the sheet seems off by the height."""
        if self.unseen is None:
            return None
        return np.minimum(self.unseen, height_mm / np.maximum(self.as_height, NO_HEIGHT))

    def sheet(self, known: LightSheet) -> LightSheet:
        """Return the sheet, for frames that were corrected for the known one."""
        return sheet_with_plane(plane_of(known) + self.plane, self.covariance, known)


def name_moved(
    found: SheetByViews,
    data: tuple[Floats, Floats, Floats, Floats],
    pose_rates: Sequence[Floats],
    independent: float,
) -> SheetByViews:
    """Return the fit with the views of which one has a camera that stands elsewhere, if that explains it.

    Parameters
    ----------
    found : SheetByViews
        Fit of the sheet alone.
    data : tuple of ndarray
        Places, disparities, their sigmas and differences of slopes, as for `fit_sheet`.
    pose_rates : sequence of ndarray of float64, shape (N, 2, 6)
        For each view, derivative of the disparity by its camera's position [mm] and rotation [rad].
    independent : float
        As for `fit_sheet`.
    """
    place, disparity, sigma, slope = data
    good = np.isfinite(disparity * sigma * slope).all(axis=-1) & (sigma > 0.0).all(axis=-1)
    good &= np.all([np.isfinite(rates).all(axis=(1, 2)) for rates in pose_rates], axis=0)
    if np.count_nonzero(good) < MIN_PLACES:
        return found
    height = np.column_stack((np.ones(np.count_nonzero(good)), place[good]))
    sheet = (-slope[good][..., None] * height[:, None, :]).reshape(-1, 3)
    values, unsure = disparity[good].ravel(), sigma[good].ravel()
    of_poses = [rates[good].reshape(-1, 6) * POSE_SIGMA for rates in pose_rates]
    parts = [(sheet / unsure[:, None], of_pose / unsure[:, None]) for of_pose in of_poses]
    alone, *fits = (
        _fit_pose(values / unsure, *part, independent) for part in ((parts[0][0], 0.0 * parts[0][1]), *parts)
    )
    costs = np.array([cost for cost, _ in fits])
    best = int(np.argmin(costs))
    # Only what no sheet explains is known of its change: a shift, a turn and a height replace each other.
    shift, height_of = of_poses[best] @ fits[best][1], parts[best][0]
    left = shift - sheet @ np.linalg.lstsq(height_of, shift / unsure)[0]
    moved_mm = float(np.sqrt(np.square(left.reshape(-1, 2)).sum(axis=1).mean()))
    # Disparities that scatter more than is stated for them vary by as much more with each number that is fitted.
    enough = LIKELIER * max(1.0, costs[best] / (independent * len(values)))
    if alone[0] - costs[best] < enough or moved_mm < LEAST_MOVED_MM:
        least = [_least_moves(*part, enough / independent) for part in parts]
        shown = [np.sqrt(np.square(one).reshape(-1, 2, 6).sum(axis=1).mean(axis=0)) for one in of_poses]
        unseen = POSE_SIGMA * np.maximum(least, LEAST_MOVED_MM / np.array(shown)).max(axis=0)
        height = np.min([np.abs(np.linalg.lstsq(*part)[0][0]) for part in parts], axis=0) / POSE_SIGMA
        return replace(found, unseen=unseen, as_height=height)
    return replace(found, moved=tuple(np.flatnonzero(costs - costs[best] < enough).tolist()), moved_mm=moved_mm)


def _fit_pose(values: Floats, sheet: Floats, of_pose: Floats, independent: float) -> tuple[float, Floats]:
    """Return chi^2 of a sheet and a pose fitted to disparities, all in their sigmas, and the pose (6,)."""
    rows = np.column_stack((sheet, of_pose))
    scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-12)
    known = np.concatenate((np.zeros((6, 3)), np.eye(6)), axis=1) / np.sqrt(independent)

    def residual(x: Floats) -> Floats:
        return np.concatenate((values - rows @ (x / scale), known @ (x / scale)))

    fit = scipy.optimize.least_squares(residual, np.zeros(9), loss="huber", f_scale=HUBER_SIGMA)
    return 2.0 * fit.cost * independent, (fit.x / scale)[3:]


def _least_moves(sheet: Floats, of_pose: Floats, enough: float) -> Floats:
    """Return the least of each number of a pose (6,) whose disparity, but for a sheet, is of that chi^2."""
    across, _ = np.linalg.qr(sheet)
    left = np.linalg.norm(of_pose - across @ (across.T @ of_pose), axis=0)
    return np.asarray(np.sqrt(enough) / np.maximum(left, 1e-12))


def fit_sheet(
    place_mm: Floats,
    disparity_mm: Floats,
    sigma_mm: Floats,
    slope: Floats,
    independent: float,
    common_mm: float = 0.0,
) -> SheetByViews:
    """Fit the plane of the sheet to disparities.

    Parameters
    ----------
    place_mm : ndarray of float64, shape (N, 2)
        Places x, y.
    disparity_mm, sigma_mm : ndarray of float64, shape (N, 2)
        Displacement from the first view to the second, y up, and its standard uncertainty.
    slope : ndarray of float64, shape (N, 2)
        Difference a_2 - a_1 of the slopes dX/dz and dY/dz.
    independent : float
        Share of the places that are worth an independent one; windows that overlap are not.
    common_mm : float
        Standard uncertainty of the disparity, along x and along y, that all places have in common.

    Raises
    ------
    SheetError
        Too few places are known, or their slopes do not differ enough to tell the plane.
    """
    good = np.isfinite(disparity_mm * sigma_mm * slope).all(axis=-1) & (sigma_mm > 0.0).all(axis=-1)
    if np.count_nonzero(good) < MIN_PLACES:
        raise SheetError("the views have too few places in common to tell the light sheet")
    x, y = place_mm[good].T
    height = np.column_stack((np.ones(len(x)), x, y))
    rows = (-slope[good][..., None] * height[:, None, :]).reshape(-1, 3)
    data, sigma = disparity_mm[good].ravel(), sigma_mm[good].ravel()
    design = rows / sigma[:, None]
    if np.linalg.matrix_rank(design) < 3:
        raise SheetError("the views look alike: no disparity tells the light sheet")
    scale = np.linalg.norm(design, axis=0)

    def residual(scaled: Floats) -> Floats:
        return np.asarray((data - rows @ (scaled / scale)) / sigma)

    # Twice: what is left of the first fit says how far beyond their sigma places scatter.
    spread = 1.0
    for _ in range(2):
        fit = scipy.optimize.least_squares(residual, np.zeros(3), loss="huber", f_scale=HUBER_SIGMA * spread)
        left = residual(fit.x)
        spread = max(1.0, float(1.4826 * np.median(np.abs(left))))
    inverse = np.linalg.inv(design.T @ design)
    covariance = inverse * spread**2 / independent
    for axis in (0, 1):  # a shift of all places along x, then along y, as the plane sees it
        shift = np.zeros((len(x), 2))
        shift[:, axis] = common_mm
        gain = inverse @ (design.T @ (shift.ravel() / sigma))
        covariance += np.outer(gain, gain)
    robust = 1.4826 * np.median(np.abs(left * sigma))
    in_sigma = 1.4826 * float(np.median(np.abs(left)))
    return SheetByViews(fit.x / scale, covariance, float(robust), in_sigma, int(np.count_nonzero(good)))
