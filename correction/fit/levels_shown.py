"""Levels of the dots of a plate, checked on the bare target.

A level d behind the plane is seen aside by d times the slant of the rays, in every second row, column or field: no
camera does that, nor lens.  With r the residuals of the bare target in sigmas, g how they change with the step of
a pattern of levels, and A how they change with all that is free,  g' = g - A (A^T A + 1)^-1 A^T g,  the pattern
explains

    share = (g' . r)^2 / (g' . g' r . r)

of all there is.  One that explains much is looked at: the camera is fitted with each pattern of levels and a step
that is free, and the one that fits is named.  A plate whose step, or whose level of the origin, is described
wrongly shows itself by the same fits, once its camera is refused.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.adjustment import Adjustment
from correction.fit.judge.verdict import PRIOR_LIMIT
from correction.fit.progress import Progress
from correction.fit.solve.solver import land_corners, residuals
from correction.fit.solve.unknowns import Unknowns
from correction.target.chessboard import LEVEL_BY, Chessboard
from tracer.board import Dots

MUCH = 0.25  # of the squares: lines that a printer has set aside look like levels by a fiftieth
CERTAIN = 30.0  # times what chance explains
LOOKED_AT, FREE = 0.2, 2.0  # pitches: step of a pattern that is tried where none is described, and how free it is
ON_BARE = ("camera.", "target", "print.st")  # a step that is free so far would be free aside as well
CLEAR_STEP_SIGMAS = 3.0  # sigmas


@dataclass(frozen=True)
class _Tried:
    """A pattern of levels, and what the bare target says of it: step with its sigma, pull in sigmas."""

    levels: str
    rms_px: float
    step_mm: float
    sigma_mm: float
    pull: float


def levels_shown(work: Progress, limit_px: float) -> str:
    """Name the levels on which the bare target shows its dots, if they are not those described.

    Parameters
    ----------
    work : Progress
    limit_px : float
        Largest residual of the bare target that is taken as a fit.
    """
    described = work.board.dots
    if described is None:
        return ""
    tried = [_try_levels(work, levels) for levels in _ways(work.board)]
    fits = [one for one in tried if one.rms_px <= limit_px and one.pull <= PRIOR_LIMIT]
    if not fits:
        return ""
    best = min(fits, key=lambda one: one.rms_px)
    if abs(best.step_mm) < CLEAR_STEP_SIGMAS * best.sigma_mm:
        return (
            "the frames show all dots on one level: leave levels and step_mm out of the board file, or show the"
            " plate that it describes"
        )
    if (
        best.levels == described.levels
        and abs(best.step_mm - described.step_mm) < CLEAR_STEP_SIGMAS * best.sigma_mm
    ):
        return ""
    name = "rows" if work.board.staggered else best.levels
    return (
        f"the frames show dots on two levels, by {name}, the other one {best.step_mm:.4g} mm behind that of"
        f" the origin, and the board file says {_describe_levels(described)}; say levels: {name} and"
        f" step_mm: {best.step_mm:.4g}, or show the plate that it describes"
    )


def look_like_levels(work: Progress, unknowns: Unknowns, x: NDArray[np.float64]) -> bool:
    """Return whether a pattern of levels explains much of the residuals of dots described as on one level."""
    if work.board.dots is None or work.board.dots.levels:
        return False
    full, share = unknowns.full(x), 0.0
    weighted = [work.fits.weigh_corners(frame) for frame in work.bare]
    parts = [residuals(unknowns, x, corners) for corners in weighted]
    value = np.concatenate([part.value.ravel() for part in parts])
    rate = np.concatenate([part.rate.reshape(-1, len(x)) for part in parts])
    by_depth = []
    for corners in weighted:
        rays = land_corners(unknowns, full, corners)
        normal = np.array(unknowns.pose(full, corners.height_number).axes[2])
        step = rays.rate[:, :, -6:-3] @ normal
        to_sigma = np.full_like(rays.pixel_rate, np.nan)
        to_sigma[rays.recovered] = np.linalg.inv(rays.pixel_rate[rays.recovered])
        by_depth.append((np.asarray(corners.whiten) @ to_sigma @ step[:, :, None])[:, :, 0])
    known = np.isfinite(value) & np.isfinite(rate).all(axis=1)
    value, rate = value[known], rate[known]
    inverse = np.linalg.inv(rate.T @ rate + np.eye(len(x)))
    for way in _ways(work.board).values():
        odd = [frame.index @ way % 2 != 0 for frame in work.bare]
        g = np.concatenate([(by * here[:, None]).ravel() for by, here in zip(by_depth, odd, strict=True)])[known]
        g = g - rate @ (inverse @ (rate.T @ g))
        share = max(share, float((g @ value) ** 2 / max(float(g @ g) * float(value @ value), 1e-300)))
    return share > MUCH and share * len(value) > CERTAIN


def _try_levels(work: Progress, levels: str) -> _Tried:
    """Fit the camera to the bare target as if its dots stood on such levels, by a step that is free."""
    dots, pitch_mm = work.board.dots, work.board.square_mm
    assert dots is not None
    step_mm = dots.step_mm or LOOKED_AT * pitch_mm
    board = replace(work.board, dots=replace(dots, levels=levels, step_mm=step_mm), step_sigma_mm=FREE * pitch_mm)
    unknowns = work.unknowns_of(work.nominal, work.priors, board=board).only((*ON_BARE, *work.walls))
    frames = [
        replace(frame, corners=replace(frame.corners, depth_mm=board.depth_mm(frame.index))) for frame in work.bare
    ]
    fits = Adjustment()
    solution = fits.solve(unknowns, unknowns.free(unknowns.start), frames)
    rms_px = float(np.sqrt(np.mean(fits.reprojection(unknowns, solution.x, frames) ** 2)))
    spread = np.sqrt(np.diag(np.linalg.inv(solution.normal + np.eye(len(solution.x)))))
    at = unknowns.names.index("print.step")
    sigma = float(unknowns.sigma[at] * spread[at])
    found_mm = step_mm * unknowns.deeper(unknowns.full(solution.x))
    return _Tried(levels, rms_px, found_mm, abs(step_mm) * sigma, solution.pull)


def _ways(board: Chessboard) -> dict[str, tuple[int, int]]:
    """Patterns of levels that a board may have: from row to row where they are staggered."""
    return {name: way for name, way in LEVEL_BY.items() if (name == "staggered") == board.staggered}


def _describe_levels(dots: Dots) -> str:
    """Describe the levels of a board file."""
    levels = "rows" if dots.levels == "staggered" else dots.levels
    return f"levels: {levels}, step_mm: {dots.step_mm:g}" if dots.levels else "nothing of levels"
