"""Image route and velocity route side by side: which is better where, and one field of the better ones.

The regions are the direct view and the rings of r / R behind glass.  Better is the route with the smaller rms
error where the true shift is known, and with the smaller rms of its own sigma otherwise, if that is more than
chance; else they are equal, and the image route stays.  To join them, the
traced vectors are interpolated linearly, branch by branch, at nodes of the corrected image that lie among them;
a node at a rim keeps the image route, whose windows alone know both pictures.

Errors of N vectors are not N numbers.  Windows of w px that stand s px apart share particles, and with them their
errors: of N vectors at least N min(1, (s / w)^2) are independent, those whose windows do not overlap.  With two
components each that makes n = 2 N (s / w)^2 degrees of freedom.

BETTER.  The ratio of two mean square errors follows Fisher's F with n1 and n2 degrees of freedom if both have the
same expectation.  One is called better only if the ratio lies outside the middle 95 % of that distribution, and
the errors differ by 5 % at least, which is worth a word; else they are equal.  Both routes of a pair see the same
frames, so their errors go together and the rule errs towards "equal".

AS CLAIMED.  A sigma claims that errors scatter by it: n (scatter / sigma)^2 then follows chi^2 with n degrees of
freedom (and 68.3 % of normal errors lie within 1 sigma, 95.4 % within 2).  Outside the middle 95 %, and by more
than 10 %, the sigma is called too small or too large.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.evaluate.carried_vectors import PlaneVectors
from correction.evaluate.regions import Region, Regions, Scatter, by_radius, scatter_of, shift_errors
from correction.maps.correction_map import CorrectionMap
from piv.correlation.vector_field import VectorField
from tracer.scene.scene import Scene
from tracer.strategies.branches import last_sphere

CLEARLY = 0.95  # a smaller error is worth a word below this share of the other
FAIRLY = 1.1  # a sigma may be off by this factor
MIDDLE = (0.025, 0.975)  # of a distribution: where chance leads

Order = Literal["first", "second", "equal"]
Claim = Literal["as claimed", "too small", "too large", "too few vectors"]
DIRECT = "seen directly"
Rings = Mapping[tuple[float, float], Scatter]
Better = Literal["image", "velocity", "equal"]


def independent_share(step_px: float, window_px: float) -> float:
    """Share of the vectors whose windows do not overlap, 0 to 1."""
    return min(1.0, (step_px / window_px) ** 2)


def clearly_smaller(first: float, second: float) -> Order:
    """Which of two is smaller by 5 % at least: enough for mean sigmas, which chance hardly moves."""
    if not (np.isfinite([first, second]).all() and max(first, second) > 0.0):
        return "equal"
    if CLEARLY * max(first, second) <= min(first, second):
        return "equal"
    return "first" if first < second else "second"


def smaller(first: float, second: float, counts: tuple[int, int], share: float) -> Order:
    """Which of two rms errors is smaller, beyond chance.

    Parameters
    ----------
    first, second : float
        Root mean square errors of a component.
    counts : (int, int)
        Vectors behind each.
    share : float
        Of the vectors that are independent, see `independent_share`.
    """
    free = [2.0 * share * count for count in counts]
    order = clearly_smaller(first, second)
    if order == "equal" or min(free) < 2.0:
        return "equal"
    low, high = scipy.special.fdtri(*free, MIDDLE)  # quantiles of F, without waiting for scipy.stats
    is_chance = second > 0.0 and low <= (first / second) ** 2 <= high
    return "equal" if is_chance else order


def claim_of(scatter: float, sigma: float, count: int, share: float) -> Claim:
    """Whether the errors of `count` vectors scatter as their sigma claims; both are rms of a component."""
    free = 2.0 * share * count
    if free < 2.0 or not (np.isfinite([scatter, sigma]).all() and sigma > 0.0):
        return "too few vectors"
    ratio = scatter / sigma
    low, high = np.sqrt(2.0 * scipy.special.gammaincinv(0.5 * free, MIDDLE) / free)  # of chi-square
    if low <= ratio <= high or 1.0 / FAIRLY <= ratio <= FAIRLY:
        return "as claimed"
    return "too small" if ratio > high else "too large"


@dataclass(frozen=True)
class Routes:
    """Errors of both routes, in corrected pixels.

    Parameters
    ----------
    image, velocity : mapping of (from, to) r / R to Scatter
        Behind glass.
    direct : (Scatter, Scatter)
        Image and velocity route in the direct view.
    known : bool
        Whether the errors are against a true shift; otherwise only counts and sigmas mean something.
    independent : float
        Share of the vectors whose windows do not overlap.
    """

    image: Rings
    velocity: Rings
    direct: tuple[Scatter, Scatter]
    known: bool
    independent: float

    def better(self, image: Scatter, velocity: Scatter | None) -> Better:
        """Which route wins a region; one that found nothing loses."""
        if velocity is None or not velocity.count:
            return "image"
        if not image.count:
            return "velocity"
        if self.known:
            won = smaller(image.rms_px, velocity.rms_px, (image.count, velocity.count), self.independent)
        else:
            won = clearly_smaller(image.rms_sigma_px, velocity.rms_sigma_px)
        return "image" if won == "first" else "velocity" if won == "second" else "equal"

    def rows(self) -> list[tuple[str, Scatter, Scatter | None, Better]]:
        """Region, both scatters, and which is better."""
        regions: list[tuple[str, Scatter, Scatter | None]] = [(DIRECT, *self.direct)]
        regions += [(f"{low:.3f} to {high:.3f}", one, self.velocity.get((low, high)))
                    for (low, high), one in self.image.items()]  # fmt: skip
        return [(name, one, two, self.better(one, two)) for name, one, two in regions]


def compare_routes(
    field: VectorField,
    regions: Regions,
    traced: PlaneVectors,
    correction_map: CorrectionMap,
    scene: Scene,
    shift_px: tuple[float, float] | None,
) -> Routes:
    """Hold both routes against each other.

    Parameters
    ----------
    field, regions
        Image route.
    traced : PlaneVectors
        Velocity route.
    correction_map, scene
        Of both.
    shift_px : (float, float), optional
        True displacement, u right, v DOWN.
    """
    pitch, truth = correction_map.grid.pitch_mm, shift_px or (0.0, 0.0)
    errors = shift_errors(field, truth)
    sigma = np.stack((field.sigma_u_px, field.sigma_v_px), axis=-1)
    through = (regions.region == Region.GLASS) | (regions.region == Region.RIM)
    image = by_radius(errors, sigma, np.where(field.valid & through, regions.radius, np.nan))
    direct = scatter_of(errors, sigma, field.valid & (regions.region == Region.DIRECT))
    errors = traced.shift_mm / pitch * (1.0, -1.0) - truth
    sigma = traced.sigma_mm / pitch
    velocity = by_radius(errors, sigma, radius_of(traced, correction_map, scene))
    both = direct, scatter_of(errors, sigma, traced.branch == 0)
    return Routes(image, velocity, both, shift_px is not None, independent_share(field.step_px, field.window_px))


def joined(
    field: VectorField, regions: Regions, traced: PlaneVectors, correction_map: CorrectionMap, routes: Routes
) -> tuple[VectorField, NDArray[np.bool_]]:
    """Take the velocity route where it is better beyond chance.

    Returns
    -------
    VectorField
        One field; `peak_ratio`, `correlation` and `resolution_px` are NaN where a vector comes from the velocity
        route.
    (ny, nx) bool
        True there.
    """
    wanted = np.zeros(field.flags.shape, bool)
    if routes.better(*routes.direct) == "velocity":
        wanted |= regions.region == Region.DIRECT
    for (low, high), image in routes.image.items():
        if routes.better(image, routes.velocity.get((low, high))) == "velocity":
            wanted |= (regions.region == Region.GLASS) & (regions.radius >= low) & (regions.radius < high)
    values = _at_nodes(field, traced, correction_map)
    taken = wanted & np.isfinite(values).all(axis=-1)
    u, v, sigma_u, sigma_v = np.moveaxis(values, -1, 0)
    return (
        replace(
            field,
            u_px=np.where(taken, u, field.u_px),
            v_px=np.where(taken, v, field.v_px),
            sigma_u_px=np.where(taken, sigma_u, field.sigma_u_px),
            sigma_v_px=np.where(taken, sigma_v, field.sigma_v_px),
            resolution_px=None if field.resolution_px is None else np.where(taken, np.nan, field.resolution_px),
            peak_ratio=np.where(taken, np.nan, field.peak_ratio),
            correlation=np.where(taken, np.nan, field.correlation),
            flags=np.where(taken, np.uint8(0), field.flags),
        ),
        taken,
    )


def _at_nodes(field: VectorField, traced: PlaneVectors, correction_map: CorrectionMap) -> NDArray[np.float64]:
    """u, v and their sigmas (ny, nx, 4) [px] of traced vectors at the nodes of a field; NaN beside them."""
    grid = correction_map.grid
    nodes = field.grid_px
    row, column = np.rint(nodes[..., 1]).astype(int), np.rint(nodes[..., 0]).astype(int)
    branch = np.where(correction_map.recovered, correction_map.branch[0].astype(int), -1)[row, column]
    values = np.full((*branch.shape, 4), np.nan)
    for number in np.unique(traced.branch):
        here, mine = branch == number, traced.branch == number
        if not here.any() or mine.sum() < 4:
            continue
        place = grid.to_px(traced.place_mm[mine])
        what = np.hstack((traced.shift_mm[mine] * (1.0, -1.0), traced.sigma_mm[mine])) / grid.pitch_mm
        found = scipy.interpolate.LinearNDInterpolator(place, what)(nodes[here])
        far, _ = scipy.spatial.cKDTree(place).query(nodes[here])
        found[far > field.window_px] = np.nan
        values[here] = found
    return values


def radius_of(traced: PlaneVectors, correction_map: CorrectionMap, scene: Scene) -> NDArray[np.float64]:
    """R / R of traced vectors behind glass, NaN in the direct view."""
    radius = np.full(len(traced.branch), np.nan)
    for number in np.unique(traced.branch[traced.branch > 0]):
        last = last_sphere(scene, correction_map.branches[int(number)])
        if last is None:
            continue
        here = traced.branch == number
        radius[here] = np.linalg.norm(traced.place_mm[here] - last.centre_mm[:2], axis=1) / last.radius_mm
    return radius
