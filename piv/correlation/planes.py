"""Local planes through the vectors of a grid: they fill gaps, and they smooth.

Around each node a plane is fitted to the valid vectors, weighted by a Gaussian of their distance. Unlike a mean or
a median it continues gradients, also out of the valid area, where one-sided neighbours would otherwise shift it.
With the moments of the weights w and of the values f about a node, each a convolution with g, x g or x^2 g,

    W = <w>,  X = <x w>/W,  Y = <y w>/W,  <x^2 w>, <xy w>, <y^2 w>,      F = <w f>,  <x w f>,  <y w f>,

the plane at the node itself is a sum of the last three, whose shares depend on the weights alone.
"""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

FILL_SIGMA = 1.5  # grid steps; the fit sees neighbours up to 6 steps away
LEAST_FILL, LEAST_SMOOTH = 1e-3, 0.02  # of all weights, on valid vectors: with less there is no plane
GAUSSIAN_REACH = 4.0  # standard deviations at which a Gaussian ends
RIDGE = 0.02  # steps^2: keeps slopes finite where neighbours stand in one line

Floats = NDArray[np.float64]


class PlaneFit:
    """Planes around every node of a grid, for several fields of the same weights.

    Parameters
    ----------
    weight : ndarray of float64, shape (ny, nx)
        Weights of the vectors, about 1; 0 where there is none.
    sigma_steps : float
        Standard deviation of the Gaussian in grid steps.
    """

    def __init__(self, weight: Floats, sigma_steps: float) -> None:
        reach = int(np.ceil(GAUSSIAN_REACH * sigma_steps))
        place = np.arange(-reach, reach + 1.0)
        bell = np.exp(-0.5 * np.square(place / sigma_steps))
        bell /= bell.sum()
        self._kernels = bell, place * bell, np.square(place) * bell
        self._weight = _of_both(weight)
        self.total = self._moment(weight, 0, 0)
        whole = np.where(self.total > 0.0, self.total, 1.0)
        mx, my = self._moment(weight, 1, 0) / whole, self._moment(weight, 0, 1) / whole
        xx = self._moment(weight, 2, 0) / whole - mx * mx + RIDGE
        yy = self._moment(weight, 0, 2) / whole - my * my + RIDGE
        xy = self._moment(weight, 1, 1) / whole - mx * my
        determinant = xx * yy - xy * xy
        by_x, by_y = (xy * my - yy * mx) / determinant, (xy * mx - xx * my) / determinant
        shares = (1.0 - by_x * mx - by_y * my) / whole, by_x / whole, by_y / whole
        self._shares = [_of_both(share) for share in shares]

    def _moment(self, values: NDArray[Any], along_x: int, along_y: int) -> NDArray[Any]:
        """Sums (ny, nx[, 2]) of values x^a y^b over the weights of a Gaussian around each node."""
        import cv2

        kernels = self._kernels[along_x], self._kernels[along_y]
        return np.asarray(cv2.sepFilter2D(values, -1, *kernels, borderType=cv2.BORDER_CONSTANT))

    def of(self, field: Floats) -> Floats:
        """Planes of a field (ny, nx, 2) at its nodes; finite everywhere, anything where all weights are 0."""
        level = field.mean(axis=(0, 1))  # a plane of less is one of fewer digits
        weighted = self._weight * (field - level).astype(np.float32)
        plane = self._shares[0] * self._moment(weighted, 0, 0)
        plane += self._shares[1] * self._moment(weighted, 1, 0)
        plane += self._shares[2] * self._moment(weighted, 0, 1)
        found: Floats = plane + level
        return found


def _of_both(values: Floats) -> NDArray[np.float32]:
    """Values (ny, nx) once for each component (ny, nx, 2): products of whole arrays are fast."""
    return np.repeat(values.astype(np.float32)[..., None], 2, axis=-1)


def fill_gaps(field: Floats, valid: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.bool_]]:
    """Put the plane through valid neighbours wherever a vector is not valid.

    Parameters
    ----------
    field : ndarray of float64, shape (ny, nx, 2)
        Displacements [px], anything where not valid.
    valid : ndarray of bool, shape (ny, nx)
        Vectors to keep and to learn from; at least one.

    Returns
    -------
    ndarray of float64, shape (ny, nx, 2)
        The field; valid vectors unchanged.  Far from any valid vector it takes the nearest value.
    ndarray of bool, shape (ny, nx)
        Vectors with at least three valid ones among their 5 x 5 neighbours: near enough to be interpolated.
    """
    if valid.all():
        return field, valid
    weight = valid.astype(float)
    near = scipy.ndimage.convolve(weight, np.ones((5, 5)), mode="constant") >= 3
    fit = PlaneFit(weight, FILL_SIGMA)
    fill = np.where(valid[..., None], field, fit.of(np.where(valid[..., None], field, 0.0)))
    known = valid | (fit.total > LEAST_FILL)
    if not known.all():
        nearest: Any = scipy.ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        fill = fill[nearest[0], nearest[1]]
    return fill, near


def smooth_field(
    field: Floats, valid: NDArray[np.bool_], sigma_steps: float, order: int = 1, trust: Floats | None = None
) -> Floats:
    """Field of the valid vectors, smoothed over `sigma_steps` nodes and continued where there are none.

    Inside it is plain Gaussian smoothing, at edges it still follows gradients.

    Parameters
    ----------
    field : ndarray of float64, shape (ny, nx, 2)
        Displacements [px], anything where not valid.
    valid : ndarray of bool, shape (ny, nx)
        At least one is True.
    sigma_steps : float
        Standard deviation of the Gaussian in grid steps; 0 fills only.
    order : int
        How often what the smoothing has left out is smoothed and added: long waves then pass whole, and the
        step from those that pass to those that do not is steeper.
    trust : ndarray of float64, shape (ny, nx), optional
        Weights of the valid vectors, about 1; default all 1.

    Returns
    -------
    ndarray of float64, shape (ny, nx, 2)
        Finite everywhere.
    """
    if sigma_steps <= 0.0 or min(valid.shape) < 2:
        return fill_gaps(field, valid)[0]
    fit = PlaneFit(valid.astype(float) if trust is None else np.where(valid, trust, 0.0), sigma_steps)
    result, rest = np.zeros(field.shape), np.where(valid[..., None], field, 0.0)
    for _ in range(order):
        plane = fit.of(rest)
        result += plane
        rest = np.where(valid[..., None], rest - plane, 0.0)
    known = fit.total > LEAST_SMOOTH
    return result if known.all() else np.where(known[..., None], result, fill_gaps(field, valid)[0])
