"""What is most likely wrong with a model that the test has found wrong.

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
else it is said that nothing on the list does.  Had it been known, the fit would have gone elsewhere by
-A^-1 J^T K a: with a itself, and with what the frames leave open of a, the `change`, an error of the map.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from correction.fit.judge.model_test import CLIP
from correction.fit.seen.measurement import MeasuredFrame
from correction.fit.seen.pixel_lock import unlocked
from correction.fit.solve.ball_shape import SHAPES, balls_crossed, shape_rates
from correction.fit.solve.doubted import WALL
from correction.fit.solve.solver import Residuals, free_rates, landed, minimise, pushed_step, residuals, touching
from correction.fit.solve.unknowns import LENS, Unknowns, unit_of
from tracer.harmonics import DEGREES, HIGHEST, LOWEST
from tracer.strategies.sensitivity import TARGET

EXPLAINS = 0.5
ALONE, LEAD = 0.2, 4.0  # or so much, if no other explains a quarter of it: large faults are cut off with outliers
RIVALS = 4
REFIT_STEPS, KNEE = 8, 3.0  # sigmas beyond which a corner weighs less
UNTOUCHED = 0.8  # weight of what nobody held by hand, which is rarer
NOTHING_NEW = 1e-6  # of a suspect's columns, when all the rest could be done with what was free
CAMERA_ORDINARY = {"focal_px": 30.0, "cu": 30.0, "cv": 30.0}  # sizes of changes
LENS_TERM = 1.0
BALL_ORDINARY = {"radius": 0.1, "n": 0.01}
CLEAR = 4.0  # sigmas from which a lens term is named
PLACE_MM, SHAPE_MM, MOVED_MM, MOVED_RAD, SAG_MM = 0.5, 0.05, 0.2, 0.003, 1.0


@dataclass(frozen=True)
class Suspect:
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
    change : (F, 1 + q) float64 or None
        Of the full vector, if it is what is wrong, and what its q numbers leave open once they are free; None if
        no vector can say it: a ball's shape.
    """

    ball: str
    sentence: str
    gain: float
    share: float
    change: NDArray[np.float64] | None

    def to_dict(self) -> dict[str, object]:
        """JSON-able."""
        return {"ball": self.ball, "sentence": self.sentence, "gain": self.gain, "share": self.share}


def likely_cause(found: Sequence[Suspect]) -> Suspect | None:
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

    `moves` (F, q) is what it does to the full vector: all zero if it is no change of the map by itself, None if it
    is one that the vector cannot say. `by_hand`: the fit section held it, which it need not. `board`: how it moves
    each corner's piece of the board (N, 6, q), for each frame, if that is what it moves.
    """

    ball: str
    ordinary: NDArray[np.float64]
    columns: Columns
    say: Say
    moves: NDArray[np.float64] | None
    by_hand: bool = False
    board: Columns | None = None


_Found = tuple[float, _Candidate, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64] | None]


def suspects(unknowns: Unknowns, full: NDArray[np.float64], seen: Evidence, excess: float) -> list[Suspect]:
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
    already = pushed_step(slope, own, depth, wall @ unknowns.columns)[2]  # nearly nothing: it is fitted
    count, found = sum(map(len, left)), list[_Found]()
    for one in _candidates(unknowns, full, seen):
        size = len(one.ordinary)
        normal, gradient = np.eye(free + size), np.concatenate((slope, np.zeros(size)))
        normal[:free, :free] = own
        for columns, j, r in zip(one.columns, flat, left, strict=True):
            k = np.nan_to_num(columns.reshape(-1, size)) * one.ordinary
            normal[free:, free:] += k.T @ k
            normal[:free, free:] += j.T @ k
            gradient[free:] += k.T @ r
        normal[free:, :free] = normal[:free, free:].T
        direct = np.zeros((len(full), size)) if one.moves is None else one.moves * one.ordinary
        moves = np.column_stack((unknowns.columns, direct))
        step, inverse, gain = pushed_step(gradient, normal, depth, wall @ moves)
        spread = inverse[free:, free:]
        if np.linalg.inv(spread).diagonal().max() - 1.0 < NOTHING_NEW * normal.diagonal()[free:].max():
            continue  # the fit could do the same with what was free
        gain -= already + size * np.log(count)
        if gain > 0.0:
            spreads = np.sqrt(np.diag(spread)) * one.ordinary
            change = None if one.moves is None else (moves @ step)[:, None]
            found.append((gain, one, step[free:], spreads, change))
    found.sort(key=_rank)
    for number, (_, one, values, spreads, _) in enumerate(found[:RIVALS]):
        if one.moves is not None:
            gain, values, change = _refitted(unknowns, full, seen, one)
            found[number] = (gain - len(values) * np.log(count), one, values, spreads, change)
    return [
        Suspect(
            one.ball,
            one.say(values * one.ordinary, spreads),
            gain,
            min(gain / max(excess, 1e-12), 1.0),
            change,
        )
        for gain, one, values, spreads, change in sorted(found, key=_rank)
        if gain > 0.0
    ]


def _rank(found: _Found) -> float:
    """What suspects are sorted by, the most likely first."""
    gain, one = found[:2]
    return -gain if one.by_hand else -UNTOUCHED * gain


def _refitted(
    unknowns: Unknowns, full: NDArray[np.float64], seen: Evidence, one: _Candidate
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Gain once a suspect's numbers are free, its values (q,), and the changes of the full vector (F, 1 + q).

    What moves board, not scene, moves residuals by derivatives of their own, those where the scene then stands: a
    camera aside sees a bent board otherwise.
    """
    size, free = len(one.ordinary), len(seen.x)
    still = np.zeros((len(full), size)) if one.moves is None else one.moves * one.ordinary
    names = (*unknowns.names, *(f"suspect {number}" for number in range(size)))
    wider = replace(unknowns, names=names, columns=np.column_stack((unknowns.columns, still)))
    every = np.eye(len(full))

    def by_board(at: NDArray[np.float64], frame: MeasuredFrame, ways: NDArray[np.float64]) -> Residuals:
        pose = every[:, unknowns.place(frame.corners.height_number)]
        posed = replace(
            unknowns, names=(*unknowns.names, *TARGET), columns=np.column_stack((unknowns.columns, pose))
        )
        part = residuals(posed, np.concatenate((at[:free], np.zeros(len(TARGET)))), frame.corners)
        beyond = part.rate[:, :, free:] @ ways * one.ordinary
        return Residuals(part.value + beyond @ at[free:], np.concatenate((part.rate[:, :, :free], beyond), axis=2))

    def evaluate(at: NDArray[np.float64]) -> list[Residuals]:
        if one.board is None:
            parts = [residuals(wider, at, frame.corners) for frame in seen.frames]
        else:
            parts = [by_board(at, frame, ways) for frame, ways in zip(seen.frames, one.board, strict=True)]
        return [unlocked(wider, at, f.corners, f, part) for f, part in zip(seen.frames, parts, strict=True)]

    def squares(at: NDArray[np.float64]) -> float:
        lengths = [np.linalg.norm(part.value, axis=1) for part in evaluate(at)]
        return float(sum(np.sum(np.fmin(length, CLIP) ** 2) for length in lengths) + at @ at)

    start = np.concatenate((seen.x, np.zeros(size)))
    found = minimise(wider, evaluate, start, knee=KNEE, steps=REFIT_STEPS)
    inverse = np.linalg.inv(found.normal + np.eye(len(start)))[:, free:]
    open_still = wider.columns @ inverse @ np.linalg.inv(np.linalg.cholesky(inverse[free:])).T
    change = np.column_stack((wider.full(found.x) - full, open_still))
    return squares(start) - squares(found.x), found.x[free:], change


def _candidates(unknowns: Unknowns, full: NDArray[np.float64], seen: Evidence) -> Iterator[_Candidate]:
    """All changes that the fit was not free to make."""
    every = replace(unknowns, columns=np.eye(len(full)), names=unknowns.full_names)
    rates, whitened = [], []
    for frame in seen.frames:
        rays = landed(every, full, frame.corners)
        inverse = np.full_like(rays.pixel_rate, np.nan)
        inverse[rays.recovered] = np.linalg.inv(rays.pixel_rate[rays.recovered])
        whitened.append(np.asarray(frame.corners.whiten) @ inverse)
        rates.append(whitened[-1] @ free_rates(every, full, frame.corners, rays))
    yield from _held_numbers(unknowns, full, rates)
    for ball, columns in _shape_columns(unknowns, full, seen, whitened).items():
        yield _Candidate(ball, np.full(len(SHAPES), SHAPE_MM), columns, partial(_not_round, ball), None)
    still = np.zeros((len(full), len(TARGET)))
    places = [unknowns.place(frame.corners.height_number) for frame in seen.frames]
    posed = [rate[:, :, place] for rate, place in zip(rates, places, strict=True)]
    for ordinary, say, board in (
        (np.array([*[MOVED_MM] * 3, *[MOVED_RAD] * 3]), _moved, _moved_ways(seen)),
        (np.full(3, SAG_MM), _bent, _bent_ways(seen)),
    ):
        columns = [rate @ ways for rate, ways in zip(posed, board, strict=True)]
        yield _Candidate("", ordinary, columns, say, still[:, : len(ordinary)], board=board)


def _held_numbers(
    unknowns: Unknowns, full: NDArray[np.float64], rates: Sequence[NDArray[np.float64]]
) -> Iterator[_Candidate]:
    """Numbers of camera and balls that the fit could not move, or not on their own."""
    names, spheres = list(unknowns.full_names), [s for s in unknowns.scene.spheres if s.medium is not None]
    alone = (unknowns.columns != 0.0).sum(axis=0) == 1
    free = np.any(unknowns.columns[:, alone] != 0.0, axis=1)
    held = [name for name, is_free in zip(names, free, strict=True) if not is_free]
    every = np.eye(len(names))

    def numbered(
        ball: str, ordinary: NDArray[np.float64], at: list[int], say: Say, by_hand: bool = False
    ) -> _Candidate:
        return _Candidate(ball, ordinary, [rate[:, :, at] for rate in rates], say, every[:, at], by_hand)

    terms = [f"camera.{term}" for term in LENS if f"camera.{term}" in held]
    if terms:
        yield numbered("", np.full(len(terms), LENS_TERM), list(map(names.index, terms)), partial(_lens, terms))
    for name in held:
        ball, part = name.split(".")
        ordinary = CAMERA_ORDINARY.get(part) if ball == "camera" else BALL_ORDINARY.get(part)
        if ordinary is not None and (ball == "camera" or any(sphere.name == ball for sphere in spheres)):
            at = names.index(name)
            of = "" if ball == "camera" else ball
            by_hand = ball != "camera" and not unknowns.columns[at].any()  # else it moves with others of its glass
            yield numbered(of, np.array([ordinary]), [at], partial(_off, name, full[at]), by_hand)
    for body, numbers in unknowns.other_bodies.bodies:
        for number in numbers:
            name = f"{body.name}.{number.name}"
            if name in held:
                size = np.array([2.0 * WALL.get(number.known, 0.5 * BALL_ORDINARY["n"])])
                at = names.index(name)
                yield numbered(body.name, size, [at], partial(_off, name, full[at]), True)
    for ball_number, place_of in unknowns.uneven.items():
        ball = unknowns.scene.spheres[ball_number].name
        every_term = list(zip(range(place_of.start, place_of.stop), DEGREES.tolist(), strict=True))
        closed = [degree for place, degree in every_term if names[place] in held]
        highest = min(min(closed, default=HIGHEST) + 1, HIGHEST)
        more = [(place, degree) for place, degree in every_term if degree <= highest and names[place] in held]
        if more:
            size = np.array([SHAPE_MM * (LOWEST / degree) ** 2 for _, degree in more])
            yield numbered(ball, size, [place for place, _ in more], partial(_more_uneven, ball, highest))
    for sphere in spheres:
        place = [f"{sphere.name}.{axis}" for axis in "xyz"]
        if set(place) <= set(held):
            say = partial(_elsewhere, sphere.name)
            yield numbered(sphere.name, np.full(3, PLACE_MM), list(map(names.index, place)), say, True)
    if spheres and not any(name.startswith("glass ") for name in unknowns.names):
        alike = [names.index(f"{sphere.name}.n") for sphere in spheres]
        columns = [rate[:, :, alike].sum(axis=2, keepdims=True) for rate in rates]
        moves = every[:, alike].sum(axis=1, keepdims=True)
        say = partial(_other_glass, full[alike[0]])
        yield _Candidate("", np.array([BALL_ORDINARY["n"]]), columns, say, moves, True)


def _moved_ways(seen: Evidence) -> Columns:
    """How a board that has moved before the frames with glass stands in each frame (N, 6, 6)."""
    moved = [frame.corners.height_number == 0 and frame.corners.glass for frame in seen.frames]
    every = np.eye(len(TARGET))
    return [np.tile(every * is_so, (len(frame), 1, 1)) for is_so, frame in zip(moved, seen.frames, strict=True)]


def _bent_ways(seen: Evidence) -> Columns:
    """How corners (N, 6, 3) move by a, b, c of a board at z = (a x^2 + b x y + c y^2) / reach^2."""
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


def _off(name: str, was: float, value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    unit, factor = unit_of(name)
    text = f"{name} was held at {was * factor:.6g}{f' {unit}' if unit else ''} and seems to be off by"
    cure = "free it in the fit section" if name.startswith("camera.") else "free it, or measure it"
    return f"{text} {float(value[0]) * factor:+.2g} +- {float(sigma[0]) * factor:.1g}; {cure}"


def _lens(terms: Sequence[str], value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    far = np.abs(value) / sigma
    named = [
        f"{name} {v:+.2g} +- {s:.1g}"
        for name, v, s, many in zip(terms, value, sigma, far, strict=True)
        if many > CLEAR or many == far.max()
    ]
    return f"a lens term is missing: the lens seems to have {', '.join(named)}; free it in fit.camera"


def _elsewhere(ball: str, value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    by = ", ".join(f"{axis} {v:+.3f}" for axis, v in zip("xyz", value, strict=True))
    return f"the ball `{ball}` does not stand where it was held: it seems to be off by {by} mm"


def _other_glass(was: float, value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    return (
        f"the glass was held at n = {was:.5f} and seems to have {was + value[0]:.5f} +- {sigma[0]:.1g}; check the"
        " glass, and the light of the target frames"
    )


def _not_round(ball: str, value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    radii = np.linalg.eigvalsh(np.tensordot(value, np.array(SHAPES), axes=1))
    differ = f"its radii seem to differ by {1e3 * (radii[-1] - radii[0]):.0f} um"
    cure = "give its fit.named.out_of_round_um, and the fit finds its shape"
    return f"the ball `{ball}` is not the sphere of the file: {differ}; {cure}"


def _more_uneven(ball: str, degree: int, value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    height = f"{1e3 * float(np.linalg.norm(value)):.1f} um rms in harmonics up to degree {degree}"
    return (
        f"the ball `{ball}` is out of round by {height} that were held; raise its out_of_round_degree to {degree}"
    )


def _moved(value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    by = ", ".join(f"{axis} {v:+.3f}" for axis, v in zip("xyz", value[:3], strict=True))
    return f"board or camera seem to have moved between the bare frames and those with glass, by {by} mm"


def _bent(value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 21), np.linspace(-1.0, 1.0, 21))
    z = value[0] * x * x + value[1] * x * y + value[2] * y * y
    return f"the board is not flat: over what is seen of it, it seems to bend by {1e3 * np.ptp(z):.0f} um"
