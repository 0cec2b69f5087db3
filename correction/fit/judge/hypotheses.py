"""Likely errors of a model that the residual test rejects.

Every suspect is a change that the fit was not free to make: a ball that is no sphere, a number that was held, a
board that is bent or has moved between bare and glass frames.  With K the derivatives of the residuals r by its
numbers a, J and A those of the fit (`correlation`), and B^-1 how large a is in ordinary labs, one
Newton step from the fit would give

    a = -D^-1 K^T r,        D = K^T K - K^T J A^-1 J^T K + B,

and lower the squares by g = (K^T r) . (D^-1 K^T r) (Rao's score test).  Balls that touch push each other as rows
of J and K of their own.  A large fault is no small step: the RIVALS that do best and are numbers of the scene, or
a board that is bent or has moved, are then fitted with what was free, one at a time, and g is by how much that
truly lowers the squares.  The suspect of the largest g, less ln M for each number (Schwarz's criterion, M
residuals), is named, if it explains EXPLAINS of what noise does not, or ALONE of it with a LEAD over every other;
else it is said that nothing on the list does.

Had it been known, the fit would have gone elsewhere: with a itself the `change`, an error of the map, and so is
what the frames leave open of a.  How well they know it, what the cause leaves of the residuals says (`left`), not
what is left without it: RIVALS are fitted REFIT_ROUNDS times, with the sigmas that their own residuals ask for.
Nor are numbers of one kind, such as those of a bent board, ordinarily larger than those of them that the frames
show (`likely_scales`): else a board that is seen to be bent by 0.1 mm might be bent by 1 mm in the one way that
the lens can follow, unseen.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from correction.fit.judge import hypothesis_words as words
from correction.fit.judge.model_test import RESIDUAL_CLIP
from correction.fit.seen.measurement import MeasuredFrame, by_region, region_factors
from correction.fit.seen.pixel_lock import PixelLock, remove_lock
from correction.fit.solve.ball_shape import SHAPES, balls_crossed, shape_rates
from correction.fit.solve.considered import SCALES, WALL, considered_shapes, likely_scales
from correction.fit.solve.linear_change import as_linear
from correction.fit.solve.moved_board import motion_as_board, on_moved_board
from correction.fit.solve.solver import (
    Corners,
    Residuals,
    clear_spheres,
    constrained_step,
    free_rates,
    land_corners,
    minimise,
    residuals,
    touching,
)
from correction.fit.solve.unknowns import LENS, Unknowns, lens_reach
from tracer.harmonics import DEGREES, HIGHEST, LOWEST
from tracer.strategies.sensitivity import CAMERA, TARGET

EXPLAINS = 0.5
ALONE, LEAD = 0.2, 4.0  # or so much, if no other explains a quarter of it: large faults are cut off with outliers
RIVALS = 4
REFIT_STEPS, KNEE = 40, 3.0  # sigmas beyond which a corner weighs less
REFIT_ROUNDS = 2
UNTOUCHED = 0.8  # weight of numbers that the file does not hold: rarer
NOTHING_NEW = 1e-6  # of a suspect's columns, when all the rest could be done with what was free
HARDLY = 3.0  # sigmas by which a free number is pulled, from which those may be wrong
HEIGHTS_ORDINARY = 0.02  # share by which all heights of the target are off
EITHER_MOVED = 0.7  # weight of a moved board and of a moved camera: either error is 1.2 sigma at most
CAMERA_ORDINARY = {"focal_px": 30.0, "cu": 30.0, "cv": 30.0}  # sizes of changes
LENS_TERM, DISTORTED = 1.0, 0.02  # of short lenses; of a corner's distance from the axis, of long ones
BALL_ORDINARY = {"radius": 0.1, "n": 0.01}
GIVEN_ORDINARY = CAMERA_ORDINARY | BALL_ORDINARY | dict.fromkeys("xyz", 0.5)
PLACE_MM, SHAPE_MM, MOVED_MM, MOVED_RAD, SAG_MM = 0.5, 0.05, 0.2, 0.003, 4.0


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
    """Return the first of the suspects, the most likely first, if it is enough to be named."""
    if not found:
        return None
    first, others = found[0], [one.gain for one in found[1:]]
    leads = first.share >= ALONE and first.gain >= LEAD * max(others, default=0.0)
    return first if leads or first.share >= EXPLAINS else None


@dataclass(frozen=True)
class Evidence:
    """Corners with what is left of them, one entry a frame.

    Parameters
    ----------
    frames : sequence of MeasuredFrame
    values : sequence of (N, 2) float64
        Residuals in sigmas.
    rates : sequence of (N, 2, P) float64
        Their derivatives by the free vector.
    x : (P,) float64
        The fitted free vector.
    """

    frames: Sequence[MeasuredFrame]
    values: Sequence[NDArray[np.float64]]
    rates: Sequence[NDArray[np.float64]]
    x: NDArray[np.float64]


Columns = list[NDArray[np.float64]]  # (N, ., q) for each frame, residuals in sigmas
Say = Callable[[NDArray[np.float64], NDArray[np.float64]], str]


@dataclass(frozen=True)
class _Candidate:
    """A change: the ball concerned, ordinary sizes (q,), derivatives, and words for values (q,) with sigmas.

    `moves` (F, q) is what it does to the full vector: all zero if it is no change of the map by itself, or one
    that the vector cannot say, `is_shape`. `by_hand`: the fit section held it, which it need not. `board`: how it
    moves each corner's piece of the board (N, 6, q), for each frame, if that is what it moves. `is_alike`: its
    numbers are of one kind and size. `since` (F, q): how the full vector is otherwise, per number, since the
    frames with glass were taken, if it is that, and not the board, what has changed.
    """

    ball: str
    ordinary: NDArray[np.float64]
    columns: Columns
    say: Say
    moves: NDArray[np.float64]
    by_hand: bool = False
    board: Columns | None = None
    is_shape: bool = False
    is_alike: bool = False
    since: NDArray[np.float64] | None = None

    @property
    def is_linear(self) -> bool:
        """True if it moves residuals by its columns alone: the full vector cannot express it."""
        return self.is_shape or (self.since is not None and self.board is None)


@dataclass(frozen=True)
class _Found:
    """Worth of a candidate: gain less the cost of its numbers, values (q,) and sigmas (q,) in ordinary sizes.

    `change`, `of_own` (q, 1 + q) of its own numbers, `left` and `unsaid_px` as in `ErrorHypothesis`.
    """

    gain: float
    one: _Candidate
    values: NDArray[np.float64]
    spreads: NDArray[np.float64]
    change: NDArray[np.float64]
    of_own: NDArray[np.float64]
    left: Columns
    unsaid_px: tuple[float, float] = (0.0, 0.0)


def rank_hypotheses(
    unknowns: Unknowns, full: NDArray[np.float64], seen: Evidence, excess: float
) -> list[ErrorHypothesis]:
    """Every suspect that lowers the squares by more than its numbers are worth, the most likely first.

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
    own = sum(j.T @ j for j in flat) + np.eye(free)
    slope = sum(j.T @ r for j, r in zip(flat, left, strict=True)) + seen.x
    already = constrained_step(slope, own, depth, wall @ unknowns.columns)[2]  # nearly nothing: it is fitted
    count, found = sum(map(len, left)), list[_Found]()
    for one in _candidates(unknowns, full, seen):
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
        step, inverse, gain = constrained_step(gradient, normal, depth, wall @ moves)
        spread = inverse[free:, free:]
        if np.linalg.inv(spread).diagonal().max() - 1.0 < NOTHING_NEW * normal.diagonal()[free:].max():
            continue  # the fit could do the same with what was free
        gain -= already + size * np.log(count)
        if gain > 0.0:
            spreads = np.sqrt(np.diag(spread)) * one.ordinary
            rest = [
                (r + j @ step[:free] + k @ step[free:]).reshape(-1, 2)
                for k, j, r in zip(every, flat, left, strict=True)
            ]
            of_own = (step[free:] * one.ordinary)[:, None]
            if one.is_alike:
                scales = likely_scales(normal - np.eye(len(normal)), gradient, size)
                likely = float(np.sqrt(scales @ SCALES**2))
                one = replace(one, ordinary=likely * one.ordinary)
                step[free:] /= likely
            found.append(_Found(gain, one, step[free:], spreads, (moves @ step)[:, None], of_own, rest))
    found.sort(key=_rank)
    for number, before in enumerate(found[:RIVALS]):
        found[number] = _refit(unknowns, full, seen, before, count)
    round_or_not = considered_shapes(unknowns)
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
    """Return what a suspect is worth once its numbers are free, for `count` residuals.

    What moves board, not scene, moves residuals as the scene then shows the board: a camera aside sees a bent one
    otherwise.
    """
    one = before.one
    size, free = len(one.ordinary), len(seen.x)
    names = (*unknowns.names, *(f"suspect {number}" for number in range(size)))
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
    starts = _starts(wider, at)
    for turn in range(REFIT_ROUNDS):
        ends = [minimise(wider, evaluate, start, knee=KNEE, steps=REFIT_STEPS) for start in starts]
        found = min(ends, key=lambda end: squares(end.x, evaluate(end.x))) if len(ends) > 1 else ends[0]
        at, parts = found.x, evaluate(found.x)
        starts = [at]
        gain -= squares(at, parts) * (not turn)
        left = [part.value * by_region(own, factors)[:, None] for own, part in zip(behind, parts, strict=True)]
        factors = region_factors(behind, left)
    inverse = np.linalg.inv(found.normal + np.eye(len(at)))[:, free:]
    open_still = inverse @ np.linalg.inv(np.linalg.cholesky(inverse[free:])).T
    moving = wider.columns[:, : free if one.board is not None or one.is_linear else None]
    moving = np.column_stack((moving, _camera_columns(unknowns)))
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


def _starts(unknowns: Unknowns, at: NDArray[np.float64]) -> list[NDArray[np.float64]]:
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


def _candidates(unknowns: Unknowns, full: NDArray[np.float64], seen: Evidence) -> Iterator[_Candidate]:
    """All changes that the fit was not free to make."""
    every = replace(unknowns, columns=np.eye(len(full)), names=unknowns.full_names)
    rates, whitened = [], []
    for frame in seen.frames:
        rays = land_corners(every, full, frame.corners)
        inverse = np.full_like(rays.pixel_rate, np.nan)
        inverse[rays.recovered] = np.linalg.inv(rays.pixel_rate[rays.recovered])
        whitened.append(np.asarray(frame.corners.whiten) @ inverse)
        rates.append(whitened[-1] @ free_rates(every, full, frame.corners, rays))
    yield from _candidates_held(unknowns, full, rates)
    yield from _candidates_given(unknowns, seen.x, rates)
    for ball, columns in _shape_columns(unknowns, full, seen, whitened).items():
        still = np.zeros((len(full), len(SHAPES)))
        not_round, size = partial(words.shape_of_ball, ball), np.full(len(SHAPES), SHAPE_MM)
        yield _Candidate(ball, size, columns, not_round, still, is_shape=True, is_alike=True)
    still = np.zeros((len(full), len(TARGET)))
    places = [unknowns.place(frame.corners.height_number) for frame in seen.frames]
    posed = [rate[:, :, place] for rate, place in zip(rates, places, strict=True)]
    nodes_mm = np.concatenate([frame.corners.node_mm for frame in seen.frames])
    aside = -motion_as_board(unknowns, full)
    moves: tuple[tuple[NDArray[np.float64], Say, Columns, NDArray[np.float64] | None], ...] = (
        (
            np.array([*[MOVED_MM] * 3, *[MOVED_RAD] * 3]),
            words.describe_moved_board,
            _ways_of_moved_board(seen),
            aside,
        ),
        (np.full(3, SAG_MM), partial(words.describe_bent_board, nodes_mm), _ways_of_bent_board(seen), None),
    )
    for ordinary, say, board, since in moves:
        columns = [rate @ ways for rate, ways in zip(posed, board, strict=True)]
        yield _Candidate(
            "", ordinary, columns, say, still[:, : len(ordinary)], board=board, is_alike=since is None, since=since
        )
    focus = unknowns.full_names.index("camera.focal_px")
    behind = [rate[:, :, [focus]] * frame.corners.glass for rate, frame in zip(rates, seen.frames, strict=True)]
    longer = np.eye(len(full))[:, [focus]]
    yield _Candidate(
        "",
        np.array([CAMERA_ORDINARY["focal_px"]]),
        behind,
        words.describe_refocused_lens,
        still[:, :1],
        since=longer,
    )


def _candidates_held(
    unknowns: Unknowns, full: NDArray[np.float64], rates: Sequence[NDArray[np.float64]]
) -> Iterator[_Candidate]:
    """Numbers of camera and balls that the fit could not move, or not on their own."""
    names, spheres = list(unknowns.full_names), [s for s in unknowns.scene.spheres if s.medium is not None]
    alone = (unknowns.columns != 0.0).sum(axis=0) == 1
    free = np.any(unknowns.columns[:, alone] != 0.0, axis=1)
    held = [name for name, is_free in zip(names, free, strict=True) if not is_free]
    every = np.eye(len(names))

    def candidate(
        ball: str, ordinary: NDArray[np.float64], at: list[int], say: Say, by_hand: bool = False
    ) -> _Candidate:
        return _Candidate(ball, ordinary, [rate[:, :, at] for rate in rates], say, every[:, at], by_hand)

    terms = [f"camera.{term}" for term in LENS if f"camera.{term}" in held]
    if terms:
        far = lens_reach(unknowns.camera(full))
        size = np.array([max(LENS_TERM, DISTORTED * far[term.partition(".")[2]]) for term in terms])
        yield candidate("", size, list(map(names.index, terms)), partial(words.lens_terms, terms))
    for name in held:
        ball, part = name.split(".")
        ordinary = CAMERA_ORDINARY.get(part) if ball == "camera" else BALL_ORDINARY.get(part)
        if ordinary is not None and (ball == "camera" or any(sphere.name == ball for sphere in spheres)):
            at = names.index(name)
            of = "" if ball == "camera" else ball
            by_hand = ball != "camera" and not unknowns.columns[at].any()  # else it moves with others of its glass
            yield candidate(
                of, np.array([ordinary]), [at], partial(words.describe_held_number, name, full[at]), by_hand
            )
    for body, numbers in unknowns.other_bodies.bodies:
        for number in numbers:
            name = f"{body.name}.{number.name}"
            if name in held:
                size = np.array([2.0 * WALL.get(number.known, 0.5 * BALL_ORDINARY["n"])])
                at = names.index(name)
                yield candidate(body.name, size, [at], partial(words.describe_held_number, name, full[at]), True)
    for ball_number, place_of in unknowns.uneven.items():
        ball = unknowns.scene.spheres[ball_number].name
        every_term = list(zip(range(place_of.start, place_of.stop), DEGREES.tolist(), strict=True))
        closed = [degree for place, degree in every_term if names[place] in held]
        highest = min(min(closed, default=HIGHEST) + 1, HIGHEST)
        more = [(place, degree) for place, degree in every_term if degree <= highest and names[place] in held]
        if more:
            size = np.array([SHAPE_MM * (LOWEST / degree) ** 2 for _, degree in more])
            yield candidate(ball, size, [place for place, _ in more], partial(words.finer_shape, ball, highest))
    for sphere in spheres:
        place = [f"{sphere.name}.{axis}" for axis in "xyz"]
        if set(place) <= set(held):
            say = partial(words.place_of_ball, sphere.name)
            yield candidate(sphere.name, np.full(3, PLACE_MM), list(map(names.index, place)), say, True)
    if spheres and not any(name.startswith("glass ") for name in unknowns.names):
        alike = [names.index(f"{sphere.name}.n") for sphere in spheres]
        columns = [rate[:, :, alike].sum(axis=2, keepdims=True) for rate in rates]
        moves = every[:, alike].sum(axis=1, keepdims=True)
        say = partial(words.index_of_glass, full[alike[0]])
        yield _Candidate("", np.array([BALL_ORDINARY["n"]]), columns, say, moves, True)


def _candidates_given(
    unknowns: Unknowns, x: NDArray[np.float64], rates: Sequence[NDArray[np.float64]]
) -> Iterator[_Candidate]:
    """Free numbers that are pulled far beyond their sigmas, and the heights of the target by one factor."""
    pulled = [*zip(unknowns.names, unknowns.columns.T, x.tolist(), strict=False)]
    for name, column, off in pulled:
        known = float(np.abs(column).max())
        if abs(off) > HARDLY and known > 0.0:
            move = (column / known)[:, None]
            given = float(unknowns.start[np.argmax(move != 0.0)])
            size = np.array([max(GIVEN_ORDINARY.get(name.rpartition(".")[2], 0.0), HARDLY * known)])
            say = partial(words.tight_number, name, given, known)
            ball = name.partition(".")[0]
            yield _Candidate(ball, size, [rate @ move for rate in rates], say, move)
    heights = np.zeros((len(unknowns.start), 1))
    heights[unknowns.place(0).start :, 0] = unknowns.start[unknowns.place(0).start :]
    if heights.any():
        size = np.array([HEIGHTS_ORDINARY])
        yield _Candidate("", size, [rate @ heights for rate in rates], words.target_heights, heights)


def _ways_of_moved_board(seen: Evidence) -> Columns:
    """Return the moves (N, 6, 6) of each frame's corners with a board that moved before the frames with glass."""
    moved = [frame.corners.height_number == 0 and frame.corners.glass for frame in seen.frames]
    every = np.eye(len(TARGET))
    return [np.tile(every * is_so, (len(frame), 1, 1)) for is_so, frame in zip(moved, seen.frames, strict=True)]


def _ways_of_bent_board(seen: Evidence) -> Columns:
    """Return the moves (N, 6, 3) of corners by a, b, c of a board at z = (a x^2 + b x y + c y^2) / reach^2."""
    reach = max(float(np.abs(frame.corners.node_mm).max(initial=1.0)) for frame in seen.frames)
    bent = []
    for frame in seen.frames:
        x, y = (frame.corners.node_mm / reach).T
        ways = np.zeros((len(frame), len(TARGET), 3))
        ways[:, 2] = np.stack((x * x, x * y, y * y), axis=1)
        bent.append(ways)
    return bent


def _shape_columns(
    unknowns: Unknowns, full: NDArray[np.float64], seen: Evidence, whitened: Columns
) -> dict[str, Columns]:
    """Derivatives by the shapes of the balls that rays cross whole, by their names."""
    spheres = unknowns.scene.spheres
    names = [sphere.name for sphere in spheres]
    camera, table = unknowns.camera(full), unknowns.spheres(full)
    crossed = []
    for frame in seen.frames:
        rows = balls_crossed(frame.branch_name, names)
        pose = unknowns.pose(full, frame.corners.height_number)
        depth_mm = unknowns.deeper(full) * frame.corners.depth_mm
        crossed.append(shape_rates(camera, table, rows, frame.corners.pixel, pose, depth_mm))
    return {
        ball: [to_sigma @ one.by_each([number]) for to_sigma, one in zip(whitened, crossed, strict=True)]
        for number, ball in enumerate(names)
        if any(np.any(one.row == number) for one in crossed)
    }
