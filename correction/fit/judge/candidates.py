"""Candidates for the error of a model: changes that a fit was not free to make, with derivatives of the residuals.

A number that was held or pulled, the shape of a ball, a board that is bent or has moved between bare and glass
frames, a lens that was focused between them.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from correction.fit.judge import hypothesis_words as words
from correction.fit.seen.measurement import MeasuredFrame
from correction.fit.solve.ball_shape import SHAPES, balls_crossed, shape_rates
from correction.fit.solve.considered import WALL
from correction.fit.solve.moved_board import motion_as_board
from correction.fit.solve.solver import free_rates, land_corners
from correction.fit.solve.unknowns import LENS, Unknowns, lens_reach
from tracer.harmonics import DEGREES, HIGHEST, LOWEST
from tracer.strategies.sensitivity import TARGET

HARDLY = 3.0  # sigmas by which a free number is pulled, from which those may be wrong
HEIGHTS_ORDINARY = 0.02  # share by which all heights of the target are off
CAMERA_ORDINARY = {"focal_px": 30.0, "cu": 30.0, "cv": 30.0}  # sizes of changes
LENS_TERM, DISTORTED = 1.0, 0.02  # of short lenses; of a corner's distance from the axis, of long ones
BALL_ORDINARY = {"radius": 0.1, "n": 0.01}
GIVEN_ORDINARY = CAMERA_ORDINARY | BALL_ORDINARY | dict.fromkeys("xyz", 0.5)
PLACE_MM, SHAPE_MM, MOVED_MM, MOVED_RAD, SAG_MM = 0.5, 0.05, 0.2, 0.003, 4.0


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
class Candidate:
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


def candidates_of(unknowns: Unknowns, full: NDArray[np.float64], seen: Evidence) -> Iterator[Candidate]:
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
        yield Candidate(ball, size, columns, not_round, still, is_shape=True, is_alike=True)
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
        yield Candidate(
            "", ordinary, columns, say, still[:, : len(ordinary)], board=board, is_alike=since is None, since=since
        )
    focus = unknowns.full_names.index("camera.focal_px")
    behind = [rate[:, :, [focus]] * frame.corners.glass for rate, frame in zip(rates, seen.frames, strict=True)]
    longer = np.eye(len(full))[:, [focus]]
    yield Candidate(
        "",
        np.array([CAMERA_ORDINARY["focal_px"]]),
        behind,
        words.describe_refocused_lens,
        still[:, :1],
        since=longer,
    )


def _candidates_held(
    unknowns: Unknowns, full: NDArray[np.float64], rates: Sequence[NDArray[np.float64]]
) -> Iterator[Candidate]:
    """Numbers of camera and balls that the fit could not move, or not on their own."""
    names, spheres = list(unknowns.full_names), [s for s in unknowns.scene.spheres if s.medium is not None]
    alone = (unknowns.columns != 0.0).sum(axis=0) == 1
    free = np.any(unknowns.columns[:, alone] != 0.0, axis=1)
    held = [name for name, is_free in zip(names, free, strict=True) if not is_free]
    every = np.eye(len(names))

    def candidate(
        ball: str, ordinary: NDArray[np.float64], at: list[int], say: Say, by_hand: bool = False
    ) -> Candidate:
        return Candidate(ball, ordinary, [rate[:, :, at] for rate in rates], say, every[:, at], by_hand)

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
        yield Candidate("", np.array([BALL_ORDINARY["n"]]), columns, say, moves, True)


def _candidates_given(
    unknowns: Unknowns, x: NDArray[np.float64], rates: Sequence[NDArray[np.float64]]
) -> Iterator[Candidate]:
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
            yield Candidate(ball, size, [rate @ move for rate in rates], say, move)
    heights = np.zeros((len(unknowns.start), 1))
    heights[unknowns.on_stage, 0] = unknowns.start[unknowns.on_stage]
    if heights.any():
        size = np.array([HEIGHTS_ORDINARY])
        yield Candidate("", size, [rate @ heights for rate in rates], words.target_heights, heights)


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
