"""Effective number of independent corners, and the covariance with correlated ones.

Neighbouring corners err alike: edges meet the rows of pixels alike, and where the model is wrong the error is one
field.  Residuals r (in sigmas) of corners that lie h squares apart correlate by

    rho(h) = mean(r_a . r_b) / mean(r . r)

counted from h = 1 as long as it stands out of its noise by SIGNIFICANT, the beginning of the sequence only (the
tail is noise, and there are many pairs in it: Geyer's initial sequence, Stat. Sci. 7, 473 (1992)).  With J the
derivatives by the free vector and A = J^T J + 1 the information with the prior, least squares that take corners as
independent have the covariance

    A^-1 (A + E) A^-1,        E = sum over pairs of rho (J_a^T J_b + J_b^T J_a)

(the sandwich of White and of Conley, J. Econometrics 92, 1 (1999)); what E has of negative eigenvalues is left
out.  The effective number of independent corners is N / (1 + mean sum of rho).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

FURTHEST = 8  # squares
SIGNIFICANT = 3.0  # sigmas of a correlation of zero
MIN_PAIRS = 30  # pairs


@dataclass(frozen=True)
class Lattice:
    """Corners of one frame with what is left of them.

    Parameters
    ----------
    index : (N, 2) int64
        Corner of the board.
    branch_name : (N,) str
        Way through the glass.
    value : (N, 2) float64
        Residual in sigmas.
    rate : (N, 2, P) float64
        Derivatives by the free vector, in sigmas.
    """

    index: NDArray[np.int64]
    branch_name: NDArray[np.str_]
    value: NDArray[np.float64]
    rate: NDArray[np.float64]

    def pairs(self, behind: bool) -> Iterator[tuple[int, NDArray[np.int64], NDArray[np.int64]]]:
        """Rounded distance [squares] and numbers of the corners of every pair on one way, region by region."""
        for way in np.unique(self.branch_name):
            if (way != "") != behind:
                continue
            here = np.flatnonzero(self.branch_name == way)
            low = self.index[here].min(axis=0)
            size = np.ptp(self.index[here], axis=0) + 1
            place = np.full((size[0] + 2 * FURTHEST, size[1] + FURTHEST), -1)
            at = self.index[here] - low + np.array([FURTHEST, 0])
            place[at[:, 0], at[:, 1]] = here
            for step in range(-FURTHEST, FURTHEST + 1):
                for rise in range(FURTHEST + 1):
                    distance = round(float(np.hypot(step, rise)))
                    if not 1 <= distance <= FURTHEST or (rise == 0 and step < 0):
                        continue
                    other = place[at[:, 0] + step, at[:, 1] + rise]
                    if (met := other >= 0).any():
                        yield distance, here[met], other[met]


@dataclass(frozen=True)
class Correlation:
    """Correlation of the errors of a region's corners.

    Parameters
    ----------
    corners : int
        There are.
    by_distance : (H,) float64
        rho at 1, 2, ... squares, as far as it is counted.
    neighbours : float
        rho at one square, counted or not.
    independent : float
        Effective number of independent corners.
    """

    corners: int
    by_distance: NDArray[np.float64]
    neighbours: float
    independent: float


def correlation_of(frames: Sequence[Lattice], behind: bool) -> Correlation:
    """Correlation of the residuals of all frames, seen directly or behind glass."""
    product, count = np.zeros(FURTHEST + 1), np.zeros(FURTHEST + 1)
    square, corners = 0.0, 0
    for lattice in frames:
        chosen = (lattice.branch_name != "") == behind
        square += float(np.sum(lattice.value[chosen] ** 2))
        corners += int(np.count_nonzero(chosen))
        for distance, a, b in lattice.pairs(behind):
            product[distance] += float(np.sum(lattice.value[a] * lattice.value[b]))
            count[distance] += len(a)
    if not corners or square == 0.0:
        return Correlation(corners, np.zeros(0), 0.0, float(corners))
    rho = product[1:] / np.maximum(count[1:], 1.0) / (square / corners)
    clear = (rho * np.sqrt(2.0 * count[1:]) > SIGNIFICANT) & (count[1:] >= MIN_PAIRS)
    far = int(np.argmin(clear)) if not clear.all() else FURTHEST
    alike = float(2.0 * np.sum(rho[:far] * count[1 : 1 + far]) / corners)
    return Correlation(corners, np.minimum(rho[:far], 1.0), float(rho[0]), corners / (1.0 + alike))


def with_correlation(
    covariance: NDArray[np.float64], frames: Sequence[Lattice], found: dict[bool, Correlation]
) -> NDArray[np.float64]:
    """Covariance (P, P) of the free vector, enlarged by what neighbours have in common.

    Parameters
    ----------
    covariance : (P, P) float64
        A^-1, as if corners were independent.
    frames : sequence of Lattice
    found : dict
        Behind glass or not -> its correlation.
    """
    extra = np.zeros_like(covariance)
    for behind, correlation in found.items():
        rho = correlation.by_distance
        if not len(rho):
            continue
        for lattice in frames:
            near = [(rho[far - 1], a, b) for far, a, b in lattice.pairs(behind) if far <= len(rho)]
            if not near:
                continue
            count, _, free = lattice.rate.shape
            rhos, first, second = zip(*near, strict=True)
            places = np.concatenate(first), np.concatenate(second)
            weight = np.repeat(rhos, [len(a) for a in first])
            alike = scipy.sparse.coo_array((weight, places), shape=(count, count)).tocsr()
            around = alike @ lattice.rate.reshape(count, -1)  # of each corner: sum over neighbours of rho J_b
            both = lattice.rate.reshape(-1, free).T @ around.reshape(-1, free)
            extra += both + both.T
    values, vectors = np.linalg.eigh(extra)
    extra = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(covariance + covariance @ extra @ covariance)
