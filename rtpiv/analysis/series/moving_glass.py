"""Knocks and drift during a run of several cameras, and the scene of each pair: maps follow what moved.

A pair keeps the scene of its series until the places that its windows show through balls that have moved differ by
more than `FOLLOW_LIMIT_PX`; then the balls of its scene are moved, and those of the pairs after it.
So a run that stands still has one map, and one that drifts has one for each limit of its drift.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from correction.grid import grid_of
from correction.self_check.drift import CandidatePath, drifting, find_changes
from correction.self_check.knocks import Knock, least_knocks, min_pairs
from piv.errors import PairError
from rtpiv.analysis.series.series_input import SeriesInput
from rtpiv.analysis.series.sheet_of_views import BALL, candidates_of, disparities_of, position_rates
from tracer.bodies import Sphere, translate_by
from tracer.bodies.body import vector3
from tracer.scene.scene import Scene

FOLLOW_LIMIT_PX = 0.02  # change of the places that a map shows, but for rims, from which a pair gets another map
NEARLY_ALL = 0.95  # of the windows behind a ball: near its rim a pixel is anywhere
END_PAIRS = 5  # before the end of a run, for which the least knock is stated as well
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Moves:
    """Knock and drift of a run.

    Parameters
    ----------
    knock : Knock or None
        The clearest knock.
    paths : tuple of CandidatePath
        Of everything that may move.
    least_mm : dict
        For each ball, the least knock sideways that half of such runs would show in the middle of the run and
        `END_PAIRS` before its end.
    """

    knock: Knock | None
    paths: tuple[CandidatePath, ...]
    least_mm: dict[str, list[float]] = field(default_factory=dict)

    @property
    def drifting(self) -> list[CandidatePath]:
        """Things that drift, the most likely first."""
        return drifting(self.paths)

    @property
    def moving(self) -> list[CandidatePath]:
        """Balls that were knocked or drift, if nothing else explains it."""
        drift = [path.name for path in self.drifting]
        named = [names[0] for names in (self.knock.names if self.knock else (), drift) if len(names) == 1]
        return [path for path in self.paths if path.name in named and path.name.startswith(BALL)]


def find_moves(series: Sequence[SeriesInput]) -> Moves:
    """Look for knocks and drift in the disparities of views at the same time, pair by pair.

    Parameters
    ----------
    series : sequence of SeriesInput
        As for `rtpiv.analysis.series.sheet_of_views.sheet_of_views`.

    Raises
    ------
    PairError
        There are too few pairs to know how much positions scatter by chance.
    """
    candidates = candidates_of(series)
    pairs, least = min(len(each.given.pairs) for each in series), min_pairs(candidates)
    if pairs < least:
        raise PairError(f"--knocks and --follow need {least} pairs or more, not {pairs}")
    disparity = disparities_of(series, pairs)
    knock, paths = find_changes(disparity, candidates)
    balls = [one.name for one in candidates if one.name.startswith(BALL)]
    return Moves(knock, tuple(paths), least_knocks(disparity, candidates, balls, (pairs // 2, pairs - END_PAIRS)))


def follow_moves(series: Sequence[SeriesInput], moves: Moves) -> tuple[list[SeriesInput], int]:
    """Give each pair the scene of its time.

    Parameters
    ----------
    series : sequence of SeriesInput
        The views.
    moves : Moves
        What moved.

    Returns
    -------
    tuple of list of SeriesInput, int
        The views with the scenes of their pairs, and how many scenes each has.
    """
    if not moves.moving:
        return list(series), 1
    path = np.concatenate([one.position for one in moves.moving], axis=-1)
    names = [one.name.removeprefix(BALL) for one in moves.moving]
    rates = [_largest_rates(each, names) for each in series]
    at = steps_to_apply(path, np.max(rates, axis=0))
    found = [
        replace(
            each,
            given=replace(
                each.given,
                pairs=tuple(
                    pair if not step.any() else replace(pair, scene=move_balls(each.method.scene, names, step))
                    for pair, step in zip(each.given.pairs, at, strict=True)
                ),
            ),
        )
        for each in series
    ]
    return found, len(np.unique(at, axis=0))


def steps_to_apply(path: Floats, px_per_mm: Floats) -> Floats:
    """Moves (K, P) that are applied: those of the last pair at which they had changed by the limit."""
    applied, now = np.zeros_like(path), np.zeros(path.shape[1])
    for number, place in enumerate(path):
        if np.linalg.norm((place - now) * px_per_mm) > FOLLOW_LIMIT_PX:
            now = place
        applied[number] = now
    return applied


def _largest_rates(series: SeriesInput, names: Sequence[str]) -> Floats:
    """Largest change (3 a ball) of the places that windows show [px of the corrected image per mm]."""
    method = series.method
    rates = position_rates(series, [f"{name}.{axis}" for name in names for axis in "xyz"])
    lengths = np.linalg.norm(rates, axis=1)
    behind = np.where(lengths > 0.0, lengths, np.nan)
    some = np.isfinite(behind).any(axis=0)
    largest = np.nanquantile(np.where(some, behind, 0.0), NEARLY_ALL, axis=0)
    return np.asarray(largest / (method.grid or grid_of(method.scene.camera)).pitch_mm)


def move_balls(scene: Scene, names: Sequence[str], step_mm: Floats) -> Scene:
    """Return the scene with its balls moved by (3 a ball), those that touch beside each other and not into it."""
    bodies = {body.name: body for body in scene.bodies}
    for k, name in enumerate(names):
        ball = bodies[name].moved(translate_by(vector3(step_mm[3 * k : 3 * k + 3])))
        for other in bodies.values():
            if isinstance(ball, Sphere) and isinstance(other, Sphere) and other.name != name:
                away = np.subtract(ball.centre_mm, other.centre_mm)
                apart = float(np.linalg.norm(away))
                if apart < (touching := ball.radius_mm + other.radius_mm):
                    ball = ball.moved(translate_by(vector3((touching / apart - 1.0) * away)))
        bodies[name] = ball
    return scene.with_bodies(list(bodies.values()))
