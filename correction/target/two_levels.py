"""Grow the dots of a plate level by level, and join both levels to one lattice.

At oblique viewing one level is displaced against the other, by more than what tells neighbours apart in a lattice
of both.  Dots of one level form a lattice of their own, which no step displaces: every second row of upright rows,
a lattice turned by 45 degrees where levels alternate.  Its two steps at a dot lead to dots at known distances on
both sides, in the frame in which the dot is a circle; those of the other level have no partner opposite.  A dot
may look larger or smaller than it is, so two steps count where dots of the other level stand amid the four.

The second level stands in the middle between dots of the first, beside it by the parallax.  That is far less than
half a step, so the nearest whole step is the right one.
"""

from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.target.lattice_growth import (
    MIN_PATCH_CORNERS,
    Patch,
    Saddles,
    grow_patches,
    lattice_axes,
)
from tracer.board import Dots

# Nearest dots that are asked for the directions of a level
LEVEL_NEIGHBOURS = 24
# Cosine between both directions at most, in the frame in which the dot is a circle
RIGHT_ANGLE = 0.5
# Of a step: how far its partner on the other side of the dot is off
OPPOSITE = 0.25
# Of a dot as it looks, over what it is
DOT_SIZES = 1.0, 0.78, 1.25
# Logarithm of a distance over what the size of the dot says
MOST_OFF = 0.36
SIGNS = np.array(((1, 1), (1, -1), (-1, 1), (-1, -1)))
# Nearest dots, and how many of them show the same steps
ASKED, MIN_AGREEING = 8, 3
# How far these differ, of a step
MOST_UNLIKE = 0.2
# Of the places amid four dots of one level, that show one of the other
AMID = 0.75
# Of a step of one level, between both
MOST_PARALLAX = 0.36
QUARTERS = [np.linalg.matrix_power(np.array(((0, -1), (1, 0))), k) for k in range(4)]
# Of a level: two steps of the lattice of both levels (columns), and the step to the other level.
LATTICES = {
    "alternating": (np.array(((1, -1), (1, 1))), (0, 1)),
    "rows": (np.array(((1, 0), (0, 2))), (0, 1)),
}
LATTICES |= {"staggered": LATTICES["alternating"], "columns": LATTICES["rows"]}


def level_steps(
    mean: NDArray[np.float64], covariance: NDArray[np.float64], dots: Dots, pitch_mm: float
) -> NDArray[np.float64]:
    """Steps (N, 2, 2: rows) [px] from dots to the next ones of their level; NaN where no lattice is around.

    Parameters
    ----------
    mean, covariance : (N, 2) and (N, 2, 2) float64
        Of the pixels of each dot [px, px^2].
    dots : Dots
    pitch_mm : float
        From dot to dot in the lattice of both levels.
    """
    out = np.full((len(mean), 2, 2), np.nan)
    if len(mean) <= LEVEL_NEIGHBOURS:
        return out
    values, vectors = np.linalg.eigh(covariance)
    narrow = vectors / np.sqrt(values)[:, None, :] @ vectors.transpose(0, 2, 1)  # C^(-1/2)
    near = scipy.spatial.cKDTree(mean).query(mean, k=LEVEL_NEIGHBOURS + 1)[1][:, 1:]
    step = mean[near] - mean[:, None]
    there = np.einsum("nij,nmj->nmi", narrow, step)
    # A disc of radius r has the covariance r^2 / 4: a circle of radius 2 there.
    lengths = np.linalg.norm(LATTICES[dots.levels][0], axis=0) * pitch_mm * 4.0 / dots.dot_mm
    first, second = np.zeros((2, len(mean)), np.int64)
    good = np.zeros(len(mean), bool)
    for size in DOT_SIZES:
        one, other, found = _pick_steps(there, lengths / size, dots.levels)
        found &= ~good
        first[found], second[found], good = one[found], other[found], good | found
    rows = np.arange(len(mean))
    for k, which in enumerate((first, second)):
        out[good, k] = step[rows, which][good]
    out[_agreeing(out, near[:, :ASKED]) < MIN_AGREEING] = np.nan
    return out


def _agreeing(steps: NDArray[np.float64], near: NDArray[np.intp]) -> NDArray[np.int64]:
    """Count dots (N,) among those near each (N, M) that show the same two steps, whatever their sense."""
    own, other = steps[:, None], steps[near]
    off = np.minimum(np.linalg.norm(own - other, axis=3), np.linalg.norm(own + other, axis=3))
    same = (off < MOST_UNLIKE * np.linalg.norm(own, axis=3)).all(axis=2)  # False for NaN
    return np.asarray(same.sum(axis=1))


def _pick_steps(
    there: NDArray[np.float64], lengths: NDArray[np.float64], levels: str
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Pick two of the steps (N, M, 2) around each dot, of about two lengths, and whether one level has them."""
    far = np.linalg.norm(there, axis=2)
    partner = np.linalg.norm(there[:, :, None] + there[:, None], axis=3).min(axis=2)
    rows, unit = np.arange(len(there)), there / far[..., None]
    wrong = [np.abs(np.log(far / length)) + partner / far for length in lengths]
    for score, length in zip(wrong, lengths, strict=True):
        score[(partner > OPPOSITE * far) | (np.abs(np.log(far / length)) > MOST_OFF)] = np.inf
    first = wrong[0].argmin(axis=1)
    along = np.abs(np.einsum("nmi,ni->nm", unit, unit[rows, first]))
    other = np.where(along < RIGHT_ANGLE, wrong[1], np.inf)
    second = other.argmin(axis=1)
    good = np.isfinite(wrong[0][rows, first]) & np.isfinite(other[rows, second])
    # Amid four of one level stands one of the other; amid four of both levels none.
    half = np.linalg.solve(LATTICES[levels][0], np.array(LATTICES[levels][1], np.float64))
    steps = np.stack((there[rows, first], there[rows, second]), axis=1)
    middle = np.einsum("sk,nkc->nsc", half * SIGNS, steps)
    seen = np.linalg.norm(middle[:, :, None] - there[:, None], axis=3).min(axis=2) < MOST_PARALLAX * lengths[0]
    return first, second, good & (seen.mean(axis=1) >= AMID)


def grow_levels(saddles: Saddles) -> list[Patch]:
    """Return patches of the lattice of both levels, largest first."""
    levels = saddles.levels
    joined: list[Patch] = []
    left = grow_patches(saddles)
    while left:
        main, left = left[0], left[1:]
        both, rest = [_on_both(main, levels)], []
        for patch in left:
            fitted = _beside(main, patch, levels)
            if fitted is None:
                rest.append(patch)
            else:
                both.append(fitted)
        joined.append(_merge(both))
        left = rest
    return sorted(joined, key=lambda patch: -len(patch.index))


def _on_both(patch: Patch, levels: str, shift: tuple[int, int] = (0, 0)) -> Patch:
    """Return a patch of one level with indices and axes of the lattice of both."""
    steps = LATTICES[levels][0]
    return replace(
        patch, index=patch.index @ steps.T + np.array(shift), axes_px=patch.axes_px @ np.linalg.inv(steps)
    )


def _beside(main: Patch, patch: Patch, levels: str) -> Patch | None:
    """Return a patch in the lattice of both levels, where it is the other one beside `main`; else None."""
    nearest = scipy.spatial.cKDTree(main.position_px).query(patch.position_px)[1]
    axes = main.axes_px[nearest]
    off = np.linalg.solve(axes, (patch.position_px - main.position_px[nearest])[..., None])[..., 0]
    near = np.abs(off).max(axis=1) < 1.0
    if np.count_nonzero(near) < min(MIN_PATCH_CORNERS, len(near)) or not near.any():
        return None
    place = (main.index[nearest] + off)[near]
    steps, to_other = LATTICES[levels]
    half = np.linalg.solve(steps, np.array(to_other, np.float64))
    best: tuple[float, Patch] | None = None
    for turn in QUARTERS:
        over = place - patch.index[near] @ turn.T - half
        shift = np.rint(np.median(over, axis=0))
        parallax = over - shift
        spread = float(np.abs(parallax - np.median(parallax, axis=0)).max(axis=1).mean())
        if np.abs(np.median(parallax, axis=0)).max() > MOST_PARALLAX or (best and spread >= best[0]):
            continue
        index = patch.index @ turn.T + shift.astype(np.int64)
        moved = replace(patch, index=index, axes_px=patch.axes_px @ turn.T)
        best = spread, _on_both(moved, levels, to_other)
    return best[1] if best and best[0] < MOST_PARALLAX else None


def _merge(patches: list[Patch]) -> Patch:
    """Join patches; of two claims to a place the earlier patch wins."""
    index = np.concatenate([patch.index for patch in patches])
    _, first = np.unique(index, axis=0, return_index=True)
    first.sort()
    position, axes, sign = (
        np.concatenate([getattr(patch, name) for patch in patches])[first]
        for name in ("position_px", "axes_px", "sign")
    )
    lattice_axes(index[first], position, axes, True)
    return Patch(index[first], position, axes, sign)


def dot_spread_mm(
    sigma_px: NDArray[np.float64], axes_px: NDArray[np.float64], side_mm: float
) -> NDArray[np.float64]:
    """Standard deviations (N,) of dots on the plate [mm], both directions together.

    Parameters
    ----------
    sigma_px, axes_px
        As in `BoardDetection`.
    side_mm : float
        Side of the lattice.
    """
    per_px = side_mm / np.sqrt(np.abs(np.linalg.det(axes_px)))
    return np.asarray(np.linalg.norm(sigma_px, axis=1) * per_px)
