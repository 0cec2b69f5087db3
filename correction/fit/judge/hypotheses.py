"""Likely errors of a model that the residual test rejects.

Every hypothesis is a change that the fit was not free to make: a ball that is no sphere, a number that was held, a
board that is bent or has moved between bare and glass frames.  With K the derivatives of the residuals r by its
numbers a, J and A those of the fit (`correlation`), and B^-1 how large a is in ordinary labs, one
Newton step from the fit would give

    a = -D^-1 K^T r,        D = K^T K - K^T J A^-1 J^T K + B,

and lower the squares by g = (K^T r) . (D^-1 K^T r) (Rao's score test).  Balls that touch push each other as rows
of J and K of their own.  A large fault is no small step: the RIVALS that do best and are numbers of the scene, or
a board that is bent or has moved, are then fitted with what was free, one at a time, and g is by how much that
truly lowers the squares.  The hypothesis of the largest g, less ln M for each number (Schwarz's criterion, M
residuals), is named, if it explains EXPLAINS of what noise does not, or ALONE of it with a LEAD over every other;
else it is said that nothing on the list does.

Had it been known, the fit would have gone elsewhere: with a itself the `change`, an error of the map, and so is
what the frames leave open of a.  How well they know it, what the cause leaves of the residuals says (`left`), not
what is left without it: RIVALS are fitted REFIT_ROUNDS times, with the sigmas that their own residuals ask for.
Nor are numbers of one kind, such as those of a bent board, ordinarily larger than those of them that the frames
show (`likely_scales`): else a board that is seen to be bent by 0.1 mm might be bent by 1 mm in the one way that
the lens can follow, unseen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.judge.candidates import (
    CAMERA_ORDINARY,
    HARDLY,
    LENS_TERM,
    Candidate,
    Columns,
    Evidence,
    candidates_of,
)
from correction.fit.judge.model_test import RESIDUAL_CLIP
from correction.fit.seen.measurement import by_region, region_factors
from correction.fit.seen.pixel_lock import PixelLock, remove_lock
from correction.fit.solve.considered import SCALES, likely_scales, shapes_to_consider
from correction.fit.solve.linear_change import as_linear
from correction.fit.solve.moved_board import on_moved_board
from correction.fit.solve.solver import (
    Corners,
    Residuals,
    clear_spheres,
    minimise,
    residuals,
    step_with_walls,
    touching,
)
from correction.fit.solve.unknowns import Unknowns
from tracer.strategies.sensitivity import CAMERA

EXPLAINS = 0.5
ALONE, LEAD = 0.2, 4.0  # or so much, if no other explains a quarter of it: large faults are cut off with outliers
RIVALS = 4
REFIT_STEPS, KNEE = 40, 3.0  # sigmas beyond which a corner weighs less
REFIT_ROUNDS = 2
UNTOUCHED = 0.8  # weight of numbers that the file does not hold: rarer
NOTHING_NEW = 1e-6  # of a hypothesis' columns, when all the rest could be done with what was free
EITHER_MOVED = 0.7  # weight of a moved board and of a moved camera: either error is 1.2 sigma at most


@dataclass(frozen=True)
class ErrorHypothesis:
    """A change that would explain residuals.

    Parameters
    ----------
    ball : str
        The ball concerned, if it is one.
    sentence : str
        What is wrong, with its size.
    gain : float
        By how much the squares would go down.
    share : float
        Of the squares that noise does not explain.
    change : (F, .) float64 or None
        Of the full vector, if it is what is wrong, and what its q numbers leave open once they are free, 1 + q
        columns, twice where board or camera may have changed; None if no map can follow it: the shape of a ball
        seen through walls.
    shape : (5, 1 + q) float64
        The same of the ball's `SHAPES` [mm], if they are what is wrong; (0, 0) if not.
    left : tuple of (N, 2) float64
        What it leaves of the residuals, frame by frame, in the sigmas of the fit.
    unsaid_px : (float, float)
        Standard deviation per axis of what it does to the map and derivatives by `change` do not say, beside glass
        and behind it, raw px.
    """

    ball: str
    sentence: str
    gain: float
    share: float
    change: NDArray[np.float64] | None
    shape: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))
    left: tuple[NDArray[np.float64], ...] = ()
    unsaid_px: tuple[float, float] = (0.0, 0.0)

    def to_dict(self) -> dict[str, object]:
        """JSON-able."""
        return {"ball": self.ball, "sentence": self.sentence, "gain": self.gain, "share": self.share}


def likely_cause(found: Sequence[ErrorHypothesis]) -> ErrorHypothesis | None:
    """Return the first of the hypotheses, the most likely first, if it is enough to be named."""
    if not found:
        return None
    first, others = found[0], [one.gain for one in found[1:]]
    leads = first.share >= ALONE and first.gain >= LEAD * max(others, default=0.0)
    return first if leads or first.share >= EXPLAINS else None


@dataclass(frozen=True)
class _Found:
    """Worth of a candidate: gain less the cost of its numbers, values (q,) and sigmas (q,) in ordinary sizes.

    `change`, `of_own` (q, 1 + q) of its own numbers, `left` and `unsaid_px` as in `ErrorHypothesis`.
    """

    gain: float
    one: Candidate
    values: NDArray[np.float64]
    spreads: NDArray[np.float64]
    change: NDArray[np.float64]
    of_own: NDArray[np.float64]
    left: Columns
    unsaid_px: tuple[float, float] = (0.0, 0.0)


def rank_hypotheses(
    unknowns: Unknowns, full: NDArray[np.float64], seen: Evidence, excess: float
) -> list[ErrorHypothesis]:
    """List every hypothesis that lowers the squares by more than its numbers are worth, the most likely first.

    Parameters
    ----------
    unknowns : Unknowns
        What was free, the lock among it.
    full : (F,) float64
        The fitted full vector.
    seen : Evidence
    excess : float
        Squares that noise does not explain.
    """
    free, (depth, wall) = len(seen.x), touching(unknowns, seen.x)
    flat = [rate.reshape(-1, free) for rate in seen.rates]
    left = [value.ravel() for value in seen.values]
    # Rao's score test: one Newton step of each candidate's numbers with all that was free, from where the fit
    # ended.
    own = sum(j.T @ j for j in flat) + np.eye(free)
    slope = sum(j.T @ r for j, r in zip(flat, left, strict=True)) + seen.x
    already = step_with_walls(slope, own, depth, wall @ unknowns.columns)[2]  # nearly nothing: it is fitted
    count, found = sum(map(len, left)), list[_Found]()
    for one in candidates_of(unknowns, full, seen):
        size = len(one.ordinary)
        normal, gradient = np.eye(free + size), np.concatenate((slope, np.zeros(size)))
        normal[:free, :free] = own
        every = [np.nan_to_num(columns.reshape(-1, size)) * one.ordinary for columns in one.columns]
        for k, j, r in zip(every, flat, left, strict=True):
            normal[free:, free:] += k.T @ k
            normal[:free, free:] += j.T @ k
            gradient[free:] += k.T @ r
        normal[free:, :free] = normal[:free, free:].T
        moves = np.column_stack((unknowns.columns, one.moves * one.ordinary))
        step, inverse, gain = step_with_walls(gradient, normal, depth, wall @ moves)
        spread = inverse[free:, free:]
        if np.linalg.inv(spread).diagonal().max() - 1.0 < NOTHING_NEW * normal.diagonal()[free:].max():
            continue  # the fit could do the same with what was free
        gain -= already + size * np.log(count)  # Schwarz's criterion
        if gain > 0.0:
            spreads = np.sqrt(np.diag(spread)) * one.ordinary
            rest = [
                (r + j @ step[:free] + k @ step[free:]).reshape(-1, 2)
                for k, j, r in zip(every, flat, left, strict=True)
            ]
            of_own = (step[free:] * one.ordinary)[:, None]
            if one.is_alike:  # numbers of one kind are ordinarily no larger than those that the frames show
                scales = likely_scales(normal - np.eye(len(normal)), gradient, size)
                likely = float(np.sqrt(scales @ SCALES**2))
                one = replace(one, ordinary=likely * one.ordinary)
                step[free:] /= likely
            found.append(_Found(gain, one, step[free:], spreads, (moves @ step)[:, None], of_own, rest))
    found.sort(key=_rank)
    # The first few are fitted in full: a large fault is no small step, and may lose rank, or everything.
    for number, before in enumerate(found[:RIVALS]):
        found[number] = _refit(unknowns, full, seen, before, count)
    round_or_not = shapes_to_consider(unknowns)
    return [
        ErrorHypothesis(
            rival.one.ball,
            rival.one.say(rival.values * rival.one.ordinary, rival.spreads),
            rival.gain,
            min(rival.gain / max(excess, 1e-12), 1.0),
            None if rival.one.is_shape and rival.one.ball not in round_or_not else rival.change,
            rival.of_own if rival.one.is_shape else np.zeros((0, 0)),
            tuple(rival.left),
            rival.unsaid_px,
        )
        for rival in sorted(found, key=_rank)
        if rival.gain > 0.0
    ]


def _rank(found: _Found) -> float:
    """Sort key: the most likely first."""
    return -found.gain if found.one.by_hand else -UNTOUCHED * found.gain


def _refit(unknowns: Unknowns, full: NDArray[np.float64], seen: Evidence, before: _Found, count: int) -> _Found:
    """Return the worth of a hypothesis once its numbers are free, for `count` residuals.

    What moves board, not scene, moves residuals as the scene then shows the board: a camera aside sees a bent one
    otherwise.
    """
    one = before.one
    size, free = len(one.ordinary), len(seen.x)
    names = (*unknowns.names, *(f"hypothesis {number}" for number in range(size)))
    wider = replace(unknowns, names=names, columns=np.column_stack((unknowns.columns, one.moves * one.ordinary)))
    factors = {False: 1.0, True: 1.0}
    locks = [PixelLock.of(frame) for frame in seen.frames]

    def residuals_at(at: NDArray[np.float64], corners: Corners, number: int) -> Residuals:
        if one.board is not None:
            return on_moved_board(unknowns, at[:free], at[free:], one.board[number] * one.ordinary, corners)
        part = residuals(wider, at, corners)
        if not one.is_linear:
            return part
        to_scale = np.asarray(corners.whiten) @ np.linalg.inv(np.asarray(seen.frames[number].corners.whiten))
        beyond = to_scale @ one.columns[number] * one.ordinary
        rate = np.concatenate((part.rate[:, :, :free], beyond), axis=2)
        return Residuals(part.value + beyond @ at[free:], rate)

    def evaluate(at: NDArray[np.float64]) -> list[Residuals]:
        parts = []
        for number, frame in enumerate(seen.frames):
            scale = by_region(frame.behind, factors)[:, None, None]
            corners = replace(frame.corners, whiten=np.asarray(frame.corners.whiten) / scale)
            parts.append(remove_lock(wider, at, corners, locks[number], residuals_at(at, corners, number)))
        return parts

    def squares(at: NDArray[np.float64], parts: Sequence[Residuals]) -> float:
        lengths = [np.linalg.norm(part.value, axis=1) for part in parts]
        return float(sum(np.sum(np.fmin(length, RESIDUAL_CLIP) ** 2) for length in lengths) + at @ at)

    at = np.concatenate((seen.x, np.zeros(size)))
    gain, behind = squares(at, evaluate(at)), [frame.behind for frame in seen.frames]
    starts = starts_of_refit(wider, at)
    for turn in range(REFIT_ROUNDS):
        ends = [minimise(wider, evaluate, start, knee=KNEE, steps=REFIT_STEPS) for start in starts]
        found = min(ends, key=lambda end: squares(end.x, evaluate(end.x))) if len(ends) > 1 else ends[0]
        at, parts = found.x, evaluate(found.x)
        starts = [at]
        gain -= squares(at, parts) * (not turn)
        left = [part.value * by_region(own, factors)[:, None] for own, part in zip(behind, parts, strict=True)]
        factors = region_factors(behind, left)
    # Of the cause's own numbers the frames leave open a part, which all free numbers follow.
    inverse = np.linalg.inv(found.normal + np.eye(len(at)))[:, free:]
    open_still = inverse @ np.linalg.inv(np.linalg.cholesky(inverse[free:])).T
    moving = wider.columns[:, : free if one.board is not None or one.is_linear else None]
    moving = np.column_stack((moving, _camera_columns(unknowns)))
    # The change is that of a lab in which the cause was known; derivatives must reproduce it (`as_linear`).
    stands, other = clear_spheres(unknowns, full)[0], wider.full(at)
    added, unsaid_px = as_linear(unknowns, stands, other, moving)
    change = np.column_stack((other - stands + added, wider.columns @ open_still))
    of_own = one.ordinary[:, None] * np.column_stack((at[free:], open_still[free:]))
    if one.since is not None:
        seen_since = change + one.since @ of_own
        if one.board is not None:  # either the board has moved, or what looks at it
            seen_since = np.sqrt(EITHER_MOVED) * np.column_stack((change, seen_since))
        change = seen_since
    worth = gain - size * np.log(count)
    found_now = replace(before, gain=worth, values=at[free:], change=change, of_own=of_own, left=left)
    return replace(found_now, unsaid_px=unsaid_px)


def starts_of_refit(unknowns: Unknowns, at: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Starts of a refit: where the fit stands, and with the glass at its priors if the fit has left these.

    A fit that lacks the cause may have pushed a ball into another minimum, from which no descent leads back.
    """
    of_glass = np.any(unknowns.columns[unknowns.glass] != 0.0, axis=0)
    is_far = bool(np.any(np.abs(at[of_glass]) > HARDLY))
    return [at, np.where(of_glass, 0.0, at)] if is_far else [at]


def _camera_columns(unknowns: Unknowns) -> NDArray[np.float64]:
    """Columns (F, K) of the camera's numbers that nothing moved: a camera far aside differs as they do as well."""
    sizes = {name: CAMERA_ORDINARY.get(name, LENS_TERM) for name in CAMERA}
    held = [number for number in range(len(CAMERA)) if not unknowns.columns[number].any()]
    return np.eye(len(unknowns.start))[:, held] * [sizes[CAMERA[number]] for number in held]
