"""Quantities derived from a mean field: derivatives with their sigma, profiles along lines, steps across a rim.

Fields lie on a regular raster on the plane: x and y rising, u to the right, v UP, (ny, nx, 2), NaN where there
is no vector. Units are those of the caller: velocities per length come out as derivatives.

**Derivatives** are differences over two steps, (f(x + h) - f(x - h))/(2 h), of the two neighbours: with the
error of neighbours correlated by c, their sigma is

    sigma^2 = (sigma_+^2 + sigma_-^2 - 2 c sigma_+ sigma_-)/(2 h)^2,     c = exp(-(2 h)^2/(4 l^2)),

l being the length over which windows and filters share what they see. (Errors by too few pairs of a turbulent
flow are correlated over its eddies, so that sigma is then an upper limit.)

**Rates** of a plane field, with a = du/dx, b = du/dy, c = dv/dx, d = dv/dy: vorticity c - b, divergence a + d,
shear b + c, and the swirling strength of Zhou et al. (J. Fluid Mech. 387, 1999), the imaginary part of the
eigenvalues of the gradients,

    lambda = sqrt(max(q, 0)),   q = -(a - d)^2/4 - b c,     sigma = sigma_q/(2 max(lambda, sqrt(sigma_q/2))),

as the root has no slope at zero.  The four differences are of different neighbours, and their errors independent.
What a flow through the sheet adds where rays are slanted is counted for each rate as a whole, as one w is behind
all four (`piv.statistics.out_of_plane`).  What a fitted map or the time between frames put off smoothly is in none
of these sigmas; across a rim the first may jump (below).

**Mass conservation.** A flow through a thin sheet has div = du/dx + dv/dy = -dw/dz, which is zero for a plane
flow only. The mean of a round jet has none when its third part is added: about an axis, div = du_s/ds + du_r/dr
+ u_r/r. Glass that is corrected wrongly shows as a divergence that changes at the rim.

**Step across a rim.** Around a piece of the rim vectors on both sides follow one smooth surface, a polynomial
of degree 4 in x and y, plus a step on one side; the step comes out of least squares with its sigma. A flow that
bends more within the reach (a jet narrower than that) shows in the residuals, and so in sigma.  The same
least squares of the slopes tells by how much a steady w is seen as a step.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.statistics.out_of_plane import Rate, ThroughSheet, neighbours

Floats = NDArray[np.float64]
# Of the surface: a jet as wide as the reach leaves a tenth of it with 2, a thousandth with 4
DEGREE = 4
LEAST_SIDE = 12  # vectors on each side of a rim that make a step
VORTICITY, DIVERGENCE, SHEAR = (
    Rate(0.0, -1.0, 1.0, 0.0), Rate(1.0, 0.0, 0.0, 1.0), Rate(0.0, 1.0, 1.0, 0.0)
)  # fmt: skip


@dataclass(frozen=True)
class PlaneField:
    """A field of vectors on the plane.

    Parameters
    ----------
    x, y : ndarray of float64, shapes (nx,), (ny,)
        Places, evenly spaced and rising.
    uv : ndarray of float64, shape (ny, nx, 2)
        Components to the right and up; NaN where there are none.
    sigma : ndarray of float64, shape (ny, nx, 2)
        Standard uncertainty of both.
    correlation_length : float
        Length l over which errors are alike, in the unit of x.
    through : ThroughSheet, optional
        What is not known of the velocity through the sheet; None where the rays' slopes are not known, or no such
        velocity can be.
    """

    x: Floats
    y: Floats
    uv: Floats
    sigma: Floats
    correlation_length: float
    through: ThroughSheet | None = None


@dataclass(frozen=True)
class Axis:
    """Axis of a round flow: it passes `point` (x, y) at `angle_rad` from +x."""

    point: tuple[float, float]
    angle_rad: float

    def across(self, x: Floats, y: Floats) -> Floats:
        """Signed distance from the axis, to its left."""
        dx, dy = x - self.point[0], y - self.point[1]
        distance: Floats = dy * np.cos(self.angle_rad) - dx * np.sin(self.angle_rad)
        return distance


def divergence(field: PlaneField, axis: Axis | None = None) -> tuple[Floats, Floats]:
    """Divergence and its sigma, (ny, nx): of a plane flow, or of one that is round about an axis."""
    along, along_sigma = _slope(field, 0, 1)
    up, up_sigma = _slope(field, 1, 0)
    total, variance = along + up, along_sigma**2 + up_sigma**2
    if axis is None:
        return total, np.sqrt(variance + _by_slant(field, DIVERGENCE))
    grid_x, grid_y = np.meshgrid(field.x, field.y)
    r = axis.across(grid_x, grid_y)
    normal = np.array([-np.sin(axis.angle_rad), np.cos(axis.angle_rad)])
    outwards = field.uv @ normal
    slope, slope_sigma = _slope_across(field, axis)
    step = float(field.x[1] - field.x[0])
    near = np.abs(r) < 1.5 * step  # on the axis u_r/r is du_r/dr
    seen = np.zeros((*r.shape, 2)) if field.through is None else field.through.slope
    with np.errstate(divide="ignore", invalid="ignore"):
        total = total + np.where(near, slope, outwards / r)
        off = np.sqrt(np.square(field.sigma) @ normal**2) / np.abs(r)
        of_w = np.where(near, 0.0, seen @ normal / r)
    variance = variance + np.where(near, slope_sigma, off) ** 2
    turned = np.outer(normal, normal).ravel()
    rate = Rate(*(part + np.where(near, share, 0.0) for part, share in zip(DIVERGENCE, turned, strict=True)))
    return total, np.sqrt(variance + _by_slant(field, rate, of_w))


def rates(field: PlaneField) -> dict[str, tuple[Floats, Floats]]:
    """Vorticity, divergence, shear and swirling strength of a plane field, each with its sigma, (ny, nx)."""
    (a, a_sigma), (b, b_sigma), (c, c_sigma), (d, d_sigma) = (
        _slope(field, component, axis) for component in (0, 1) for axis in (1, 0)
    )
    q = -0.25 * (a - d) ** 2 - b * c
    turns = np.sqrt(np.where(np.isfinite(q), np.maximum(q, 0.0), np.nan))
    of_q = (0.5 * (a - d)) ** 2 * (a_sigma**2 + d_sigma**2) + (c * b_sigma) ** 2 + (b * c_sigma) ** 2
    of_q = np.sqrt(of_q + _by_slant(field, Rate(-0.5 * (a - d), -c, -b, 0.5 * (a - d))))
    with np.errstate(divide="ignore", invalid="ignore"):
        of_turns = np.where(of_q > 0.0, 0.5 * of_q / np.maximum(turns, np.sqrt(0.5 * of_q)), 0.0 * of_q)
    return {
        "vorticity": (c - b, np.sqrt(c_sigma**2 + b_sigma**2 + _by_slant(field, VORTICITY))),
        "divergence": (a + d, np.sqrt(a_sigma**2 + d_sigma**2 + _by_slant(field, DIVERGENCE))),
        "shear": (b + c, np.sqrt(b_sigma**2 + c_sigma**2 + _by_slant(field, SHEAR))),
        "swirling_strength": (turns, of_turns),
    }


def jet_axis(field: PlaneField) -> Axis | None:
    """Axis of a jet that fills part of the view, by its momentum; None if there is no jet.

    The centroids of the square of the speed, line by line across the mean direction, lie on a straight line.
    """
    known: NDArray[np.bool_] = np.asarray(np.isfinite(field.uv).all(axis=-1))
    if not known.any():
        return None
    power = np.where(known, np.square(field.uv).sum(axis=-1), 0.0)
    heading = (np.where(known[..., None], field.uv, 0.0) * power[..., None]).sum(axis=(0, 1))
    upright = bool(abs(heading[1]) >= abs(heading[0]))
    lines, along, across = (power, field.y, field.x) if upright else (power.T, field.x, field.y)
    strong = lines.max(axis=1) > 0.25 * power.max()
    if strong.sum() < 5:
        return None
    lines = np.where(lines > 0.3 * lines.max(axis=1, keepdims=True), lines, 0.0)[strong]
    centre = (lines * across).sum(axis=1) / lines.sum(axis=1)
    slope, offset = np.polyfit(along[strong], centre, 1)
    middle = float(along[strong].mean())
    place = float(slope * middle + offset)
    turn = float(np.arctan2(1.0, slope)) if upright else float(np.arctan(slope))
    sign = np.sign(heading @ [np.cos(turn), np.sin(turn)])
    return Axis((place, middle) if upright else (middle, place), turn if sign >= 0 else turn + np.pi)


@dataclass(frozen=True)
class Profile:
    """Vectors along a line: distance (n,), points (n, 2), uv and sigma (n, 2); NaN where there is no vector."""

    distance: Floats
    points: Floats
    uv: Floats
    sigma: Floats


def profile(field: PlaneField, start: tuple[float, float], end: tuple[float, float]) -> Profile:
    """Vectors along the line from `start` to `end` (x, y), interpolated linearly at steps of the raster."""
    first, last = np.array(start, float), np.array(end, float)
    length = float(np.hypot(*(last - first)))
    count = max(round(length / float(field.x[1] - field.x[0])) + 1, 2)
    points = first + np.linspace(0.0, 1.0, count)[:, None] * (last - first)
    values = np.concatenate((field.uv, field.sigma), axis=-1)
    found = scipy.interpolate.RegularGridInterpolator((field.y, field.x), values, bounds_error=False)(
        points[:, ::-1]
    )
    return Profile(np.linspace(0.0, length, count), points, found[:, :2], found[:, 2:])


@dataclass(frozen=True)
class RimStep:
    """Step of a field across pieces of a rim: place (n, 2), step and sigma (n, 2), inside minus outside."""

    place: Floats
    step: Floats
    sigma: Floats


def rim_steps(
    field: PlaneField,
    outside: NDArray[np.bool_],
    inside: NDArray[np.bool_],
    centre: tuple[float, float],
    reach: float,
    pieces: int = 24,
) -> RimStep:
    """Steps across the rim between what is seen directly and through glass.

    Parameters
    ----------
    field : PlaneField
        Vectors.
    outside, inside : ndarray of bool, shape (ny, nx)
        Vectors of windows that lie on one side altogether.
    centre : (float, float)
        Of the round rim.
    reach : float
        How far from the rim vectors count.
    pieces : int
        Of the circle; those with too few vectors are left out.
    """
    grid_x, grid_y = np.meshgrid(field.x, field.y)
    dx, dy = grid_x - centre[0], grid_y - centre[1]
    r, turn = np.hypot(dx, dy), np.arctan2(dy, dx)
    known = np.isfinite(field.uv).all(axis=-1) & (field.sigma > 0.0).all(axis=-1)
    outside, inside = outside & known, inside & known
    found: list[tuple[Floats, Floats, Floats]] = []
    for angle in 2.0 * np.pi * (np.arange(pieces) + 0.5) / pieces - np.pi:
        here = np.abs(turn - angle) < np.pi / pieces
        beyond, within = r[here & outside], r[here & inside]
        if not beyond.size or not within.size:
            continue
        rim = 0.5 * (beyond.min() + within.max())
        place = np.array(centre) + rim * np.array([np.cos(angle), np.sin(angle)])
        near = np.hypot(grid_x - place[0], grid_y - place[1]) < reach
        one, two = near & outside, near & inside
        if min(np.count_nonzero(one), np.count_nonzero(two)) < LEAST_SIDE:
            continue
        both = one | two
        x, y = (grid_x[both] - place[0]) / reach, (grid_y[both] - place[1]) / reach
        terms = [x**k * y**m for m in range(DEGREE + 1) for k in range(DEGREE + 1 - m)]
        model = np.stack((two[both].astype(float), *terms), axis=-1)
        parts = [_sum_weighted(model, field.uv[both][:, k], field.sigma[both][:, k]) for k in range(2)]
        sigma = np.array([sigma for _, sigma in parts])
        if field.through is not None:
            slope, spread = np.nan_to_num(field.through.slope[both]), field.sigma[both]
            jump = np.array([_sum_weighted(model, slope[:, k], spread[:, k])[0] for k in range(2)])
            sigma = np.hypot(sigma, jump * np.nanmedian(field.through.sigma_w[both]))
        found.append((place, np.array([step for step, _ in parts]), sigma))
    places, steps, sigmas = (np.array([each[k] for each in found]).reshape(-1, 2) for k in range(3))
    return RimStep(places, steps, sigmas)


def _sum_weighted(model: Floats, values: Floats, sigma: Floats) -> tuple[float, float]:
    """First parameter of a weighted fit and its sigma, not less than what the residuals say."""
    weight = 1.0 / sigma
    inverse = np.linalg.pinv(model * weight[:, None])
    parameters = inverse @ (values * weight)
    rest = (values - model @ parameters) * weight
    free = max(len(values) - model.shape[1], 1)
    scatter = max(float(rest @ rest) / free, 1.0)
    return float(parameters[0]), float(np.sqrt(scatter * (inverse[0] ** 2).sum()))


def _slope(field: PlaneField, component: int, axis: int) -> tuple[Floats, Floats]:
    """Derivative of a component along an axis of the arrays, and its sigma by `field.sigma`; NaN at the ends."""
    span = _spans(field)[1 - axis]
    low, high = neighbours(field.uv[..., component], axis)
    a, b = neighbours(field.sigma[..., component], axis)
    alike = np.exp(-(span**2) / (4.0 * field.correlation_length**2)) if field.correlation_length > 0.0 else 0.0
    return (high - low) / span, np.sqrt(a**2 + b**2 - 2.0 * alike * a * b) / span


def _by_slant(field: PlaneField, rate: Rate, more: Floats | float = 0.0) -> Floats | float:
    """Variance (ny, nx) of a rate by the velocity through the sheet, which counts with `more` by itself."""
    return 0.0 if field.through is None else field.through.variance(rate, _spans(field), more)


def _spans(field: PlaneField) -> tuple[float, float]:
    """Length of two steps along x and along y."""
    return 2.0 * float(field.x[1] - field.x[0]), 2.0 * float(field.y[1] - field.y[0])


def _slope_across(field: PlaneField, axis: Axis) -> tuple[Floats, Floats]:
    """du_r/dr across an axis and its sigma, from the derivatives along x and y."""
    normal = np.array([-np.sin(axis.angle_rad), np.cos(axis.angle_rad)])
    total, variance = np.zeros(field.uv.shape[:2]), np.zeros(field.uv.shape[:2])
    for component in range(2):
        for direction in range(2):
            slope, sigma = _slope(field, component, 1 - direction)
            share = normal[component] * normal[direction]
            if share != 0.0:
                total, variance = total + share * slope, variance + (share * sigma) ** 2
    return total, np.sqrt(variance)
