"""Common errors of corners because lines and points of the print are not where they were drawn.

A printer sets whole dots.  At 600 dpi each line of a board is moved to the nearest dot, by up to 21 um, with all
its corners, and every frame shows the same board: a thousand corners in five frames then err as some fifty
columns and as many rows, not as five thousand numbers.  (`rtpiv setup target` draws squares of whole dots, whose
lines are moved alike; prints of others, and paper that stretches here and there, are not so kind.)

With r the residuals of corners in sigmas, g how much of r one square of the print is, u = sum g . r over all
corners of a line, in whatever frame, and p the same over all views of one point of it, pairs of different points
say

    s^2 = sum over lines (u^2 - sum p^2) / sum over lines ((sum g^2)^2 - sum over points (sum g^2)^2)

the variance of lines, whose expectation is 0 if lines are where they were drawn.  It counts if it stands out of
its noise by SIGNIFICANT.  Points of the board are counted alike, by the pairs of their views, for what they share
beyond their lines.

Not all that views of a point share is the print's.  Camera and board stand still between the frame without glass
and that with it, so that a corner beside the glass falls on the same place of its pixels in both, and errs in both
by what these do to it.  Only views from elsewhere, through glass or at another height, tell the two apart: the
print errs there alike, the pixels do not.  So the variance of points is that of pairs of such views; where it does
not stand out, the mean of what they leave likely, a Gaussian between 0 and the variance of all pairs.  What views
on the same place share beyond it is theirs alone.  Taken for the print's, what a camera did to corners beside the
glass was in the sigma behind it, which it doubled.

What corners share by the standard deviation s pulls the free vector by s G, G = sum J^T g.  The covariance of the
fit takes corners as independent, each with all its error, so what it lacks is A^-1 E A^-1 with

    E = sum over groups s^2 (G G^T - sum over their corners (J^T g)(J^T g)^T),

less what E has of negative eigenvalues.

The variances are those of the print, so corners beside the glass tell them, where there are some: a ball has a few
corners and six numbers of its own, which follow the print and leave little in their residuals, and weigh much.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

SIGNIFICANT = 3.0  # sigmas of a variance of zero
MIN_LINES = 8  # lines or points


@dataclass(frozen=True)
class OnPrint:
    """Corners of one frame, as the print moves them.

    Parameters
    ----------
    index : (N, 2) int64
        Corner of the board.
    way : (N,) str
        Through the glass; empty beside it.
    height_number : int
        Of the target: corners that are seen at one height on one way lie on the same pixels in all frames.
    value : (N, 2) float64
        Residual in sigmas.
    per_square : (N, 2, 2) float64
        Columns: what one square along the board's x, along y is of it.
    rate : (N, 2, P) float64
        Derivatives of the residual by the free vector.
    """

    index: NDArray[np.int64]
    way: NDArray[np.str_]
    height_number: int
    value: NDArray[np.float64]
    per_square: NDArray[np.float64]
    rate: NDArray[np.float64]


@dataclass(frozen=True)
class PrintErrors:
    """Errors of a print, in squares.

    Parameters
    ----------
    lines : (float, float)
        Standard deviation of its columns along x, and of its rows along y; 0 if nothing stands out.
    points : (float, float)
        The same of single points, from where their lines are.
    pixels : (float, float)
        The same of what no print does: pixels, to corners that lie on the same ones in several frames.
    spread : (P, P) float64
        Covariance of what that pulls at the free vector with: between A^-1 and A^-1 it is that of the vector.
    """

    lines: tuple[float, float]
    points: tuple[float, float]
    pixels: tuple[float, float]
    spread: NDArray[np.float64]

    def __str__(self) -> str:
        """Say it; nothing if nothing stands out."""
        parts = [
            f"{what} of the print lie off by {100.0 * float(np.hypot(*off)) / np.sqrt(2.0):.2g} % of a square"
            for what, off in (("lines", self.lines), ("points", self.points))
            if any(off)
        ]
        return ", ".join(parts)


def print_errors(frames: Sequence[OnPrint]) -> PrintErrors:
    """Estimate how far a print is off, and what that does, from all frames of it."""
    index = np.concatenate([frame.index for frame in frames])
    value = np.concatenate([frame.value for frame in frames])
    per_square = np.concatenate([frame.per_square for frame in frames])
    way = np.concatenate([frame.way for frame in frames])
    height = np.concatenate([np.full(len(frame.way), frame.height_number) for frame in frames])
    direct = way == ""
    direct = direct if direct.any() else ~direct
    spread = np.zeros((frames[0].rate.shape[2],) * 2)
    point = np.unique(index, axis=0, return_inverse=True)[1].ravel()
    on_way = np.unique(way, return_inverse=True)[1]
    sight = np.unique(np.column_stack((point, height, on_way)), axis=0, return_inverse=True)[1].ravel()
    own, found = np.arange(len(index)), []
    for axis in range(2):
        g = per_square[:, :, axis]
        pull = np.concatenate(
            [np.einsum("nip,ni->np", f.rate, f.per_square[:, :, axis], optimize=True) for f in frames]
        )
        along, weight = np.sum(g * value, axis=1), np.sum(g * g, axis=1)
        of_direct = along * direct, weight * direct
        _, line = np.unique(index[:, axis], return_inverse=True)
        lines = _variance_shared(line, point, *of_direct).significant
        points = _variance_shared(point, own, *of_direct, lines).significant
        elsewhere = _variance_shared(point, sight, along, weight, lines)
        points = elsewhere.significant or elsewhere.likely(points)
        pixels = _variance_shared(sight, own, *of_direct, lines + points).significant
        for variance, member in ((lines, line), (points, point), (pixels, sight)):
            if variance:
                together = np.zeros((member.max() + 1, pull.shape[1]))
                np.add.at(together, member, pull)
                spread += variance * (together.T @ together - pull.T @ pull)
        found.append((lines, points, pixels))
    values, vectors = np.linalg.eigh(spread)
    spread = (vectors * np.maximum(values, 0.0)) @ vectors.T
    (x, y) = np.sqrt(found).tolist()
    lines_, points_, pixels_ = zip(x, y, strict=True)
    return PrintErrors(lines_, points_, pixels_, spread)


@dataclass(frozen=True)
class _Shared:
    """A variance that members of groups share, its standard deviation if it is 0, and how many groups tell."""

    variance: float
    noise: float
    groups: int

    @property
    def significant(self) -> float:
        """The variance; 0 if it does not stand out."""
        return (
            self.variance if self.groups >= MIN_LINES and self.variance > SIGNIFICANT * self.noise > 0.0 else 0.0
        )

    def likely(self, most: float) -> float:
        """Mean of what is likely between 0 and the most that it can be; that, where nothing tells."""
        if not self.noise > 0.0 or not most > 0.0:
            return most
        return self.variance + self.noise * _mean_between(
            -self.variance / self.noise, (most - self.variance) / self.noise
        )


def _mean_between(low: float, high: float) -> float:
    """Mean of a standard normal number that is known to lie between two others.

    (phi(low) - phi(high)) / (Phi(high) - Phi(low)), in a tail by logarithms.  ``scipy.stats.truncnorm`` says the
    same; to import it takes longer than to fit a camera.
    """
    ends = np.array((low, high))
    if low <= 0.0 < high:
        share = np.log1p(-scipy.special.ndtr(low) - scipy.special.ndtr(-high))
    else:
        near, far = scipy.special.log_ndtr(-ends if low > 0.0 else ends[::-1])
        share = near + np.log1p(-np.exp(far - near))
    density = np.exp(-0.5 * ends**2 - np.log(np.sqrt(2.0 * np.pi)) - share)
    return float(density[0] - density[1])


def _variance_shared(
    member: NDArray[np.intp],
    part: NDArray[np.intp],
    along: NDArray[np.float64],
    weight: NDArray[np.float64],
    known: float = 0.0,
) -> _Shared:
    """Variance that the members of each group share beyond one that is known.

    member (N,) number of the group; part (N,) of the part of it, in which pairs are not counted; along (N,) g . r;
    weight (N,) g . g.
    """
    own = np.bincount(part, along) ** 2
    whose = np.zeros(len(own), np.intp)
    whose[part] = member
    alike = np.sum(np.bincount(member, along) ** 2) - np.sum(own)
    pairs = np.sum(np.bincount(member, weight) ** 2) - np.sum(np.bincount(part, weight) ** 2)
    noise = np.sqrt(max(2.0 * (np.sum(np.bincount(whose, own) ** 2) - np.sum(own**2)), 0.0))  # of a sum over pairs
    groups = int(np.count_nonzero(np.bincount(whose) > 1))
    if not pairs > 0.0:
        return _Shared(0.0, 0.0, groups)
    return _Shared(float(alike / pairs - known), float(noise / pairs), groups)
