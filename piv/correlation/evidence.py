"""Evidence of a window's correlation for or against its vector, whatever the neighbours show.

**For.** At 50 % overlap a wave of two windows has four nodes. The median of 5 x 5 neighbours on a crest is zero
and they hardly deviate from it, so the test of `outliers` rejects every crest, however clear its peak; the gap is
filled by a plane, and the wave is gone from the predictor of all later passes. A wrong vector has another origin:
its peak is one of many of about the same height, and it points anywhere within the window. So a rejected vector
is kept if its peak stands out (`PROVEN` times the second one) and if it lies no farther than a tenth of a window
from the median of its 3 x 3 neighbours, where chance would put one in thirty. Only what was rejected is asked for
its second peak: a field without suspects pays nothing.

A jet of one or two windows in a fluid at rest is an outlier to every median, in all of its vectors, and so is
its shear layer. But it goes on along its axis: of three suspects in a row, in any of four directions, whose
peaks stand out a little (`WEAK`) and that agree to a tenth of a window, none is there by chance.

**Against.** Two frames that are no pair have vectors that support each other by chance. A peak that hardly stands
out (`WEAK`) and whose correlation statistics make no sense (no sigma) is no measurement. Right vectors show both
only where there is next to nothing in the window.

Windows closer than half their side see the same light, and support each other where there is nothing. Of what is
unsure by half a pixel and more among them, the frames around must match by more than chance: N pieces that have
nothing in common match to 0 +- 1/sqrt(N), and passes find the places where it is most. Nine of ten vectors of two
unrelated pictures stay below `BY_CHANCE` times that, and one or two in a hundred right ones where a fifth of the
range is noise or two of five particles are lost (ADR 39).
"""

import numpy as np
from numpy.typing import NDArray

# Highest peak over the second one
PROVEN = 2.0
WEAK = 1.5
NEIGHBOUR_REACH = 0.1  # of the window's side
BY_CHANCE = 2.3  # standard deviations
ROWS_OF_THREE = (0, 1), (1, 0), (1, 1), (1, -1)  # steps along rows and columns


def is_supported_by_peak(
    vectors: NDArray[np.float64],
    candidates: NDArray[np.bool_],
    suspects: NDArray[np.bool_],
    peak_ratio: NDArray[np.float64],
    window_px: int,
) -> NDArray[np.bool_]:
    """Return the suspects (ny, nx) whose own peak supports them.

    Parameters
    ----------
    vectors : ndarray of float64, shape (ny, nx, 2)
        Displacements [px].
    candidates, suspects : ndarray of bool, shape (ny, nx)
        Vectors that were measured, and those of them that their neighbours contradict.
    peak_ratio : ndarray of float64, shape (ny, nx)
        Highest peak over the second one, at least of the suspects.
    window_px : int
        Side of the windows.
    """
    clear = suspects & (peak_ratio > PROVEN)
    rows, columns = np.nonzero(clear)
    in_rows = _in_rows(vectors, suspects & (peak_ratio > WEAK), NEIGHBOUR_REACH * window_px)
    if not len(rows):
        return in_rows
    known = np.full((vectors.shape[0] + 2, vectors.shape[1] + 2, 2), np.nan)
    known[1:-1, 1:-1][candidates] = vectors[candidates]
    around = np.stack([known[rows + i, columns + j] for i in range(3) for j in range(3)])
    off_px = np.linalg.norm(vectors[rows, columns] - np.nanmedian(around, axis=0), axis=-1)
    clear[rows, columns] = off_px <= NEIGHBOUR_REACH * window_px
    return clear | in_rows


def _in_rows(vectors: NDArray[np.float64], which: NDArray[np.bool_], near_px: float) -> NDArray[np.bool_]:
    """Those of `which` (ny, nx) that are one of three in a row of which the middle one is near both others."""
    found = np.zeros_like(which)
    rows, columns = np.nonzero(which)
    known = np.full((which.shape[0] + 2, which.shape[1] + 2, 2), np.nan)
    known[1:-1, 1:-1][which] = vectors[which]
    for j, i in ROWS_OF_THREE:
        ends = np.stack([known[rows + 1 + k * j, columns + 1 + k * i] for k in (-1, 1)])
        agree = (np.linalg.norm(ends - vectors[rows, columns], axis=-1) <= near_px).all(axis=0)
        for k in (-1, 0, 1):
            found[rows[agree] + k * j, columns[agree] + k * i] = True
    return found


def is_low_confidence(peak_ratio: NDArray[np.float64], sigma_px: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Vectors (ny, nx) with a weak peak and no uncertainty (ny, nx, 2): nothing was measured there."""
    return np.asarray((peak_ratio < WEAK) & np.isnan(sigma_px).any(axis=-1))


def is_chance_match(match: NDArray[np.float64], pieces: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return where (ny, nx) unrelated frames match as well by chance, with this number of pieces compared."""
    return np.asarray(match * np.sqrt(pieces) < BY_CHANCE)
