"""Test for a sphere that has moved, with its displacement and uncertainty, at a stated rate of false alarms.

For each sphere by itself, its move d (three numbers) and the light sheet (height, two tilts; known as the scene
says) are fitted to what particles seen twice are apart (`seen_twice`), by weighted least squares in which outliers
lose their weight. How much d scatters, the frames say: with u_k the share of pair k of K in the answer,

    C = K / (K - 1) sum_k u_k u_k^T + (what was unsure before),        T2 = d^T (C + FLOOR^2)^-1 d,

and if no sphere has moved, T2 (K - 3) / (3 (K - 1)) is at most distributed as F(3, K - 3) (Hotelling); particles
of one pair may depend on each other as they like. FLOOR is what calibration leaves unsure of a place: with a
thousand particles a pair, chance is below a micrometre and the map's own error is not. An alarm is a probability
below MOVE_FALSE_ALARMS divided by the number of spheres (Bonferroni), for any of them; and what the move explains
must be as improbable (likelihood ratio, chi-squared with three degrees of freedom), so that neither few pairs nor
particles that depend on each other raise one.

The sphere that moved is the one that explains most of what is apart. One that moves spoils the views through it,
and another sphere's move can repair a part of that; where the next best sphere explains nearly as much, both are
named.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.light_sheet.disparities import Light
from correction.self_check.seen_twice import Finder, SeenTwice, join_pairs
from ground.rows import run_parts
from tracer.light_sheet import LightSheet
from tracer.scene.scene import Scene

MOVE_FALSE_ALARMS = 5e-4  # in a check of a scene whose spheres stand still
FLOOR_MM = np.array((0.0015, 0.0015, 0.012))  # sideways, and along the view, where the sheet's height looks alike
MOVE_PRIOR_MM = 0.3  # standard deviation of a move that is looked for
FEWEST_PAIRS = 10
MIN_PARTICLES = 200  # particles seen twice
MAX_REPORTED_SIGMA = 0.3  # of MOVE_PRIOR_MM; a move that is less sure than this is not reported
PARTICLE_ROUNDS = 6
PARTICLE_BIWEIGHT = 4.0
AS_GOOD = 0.9  # of what the best sphere explains: another one may be meant
CHI2_2 = 1.386  # median of chi-squared with two degrees of freedom
SHEET = 3  # numbers of the light sheet


@dataclass(frozen=True)
class Move:
    """A move of one sphere that is looked for.

    Parameters
    ----------
    name : str
        Of the sphere.
    move_mm, sigma_mm : (3,) float64
        Its move, and what is unsure of it.
    probability : float
        Of as large a move by chance.
    explains : float
        How much less is apart, weighted, for it.
    """

    name: str
    move_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float64]
    probability: float
    explains: float

    @property
    def is_told(self) -> bool:
        """True if particles determine it."""
        return bool((self.sigma_mm[:2] < MAX_REPORTED_SIGMA * MOVE_PRIOR_MM).all())


@dataclass(frozen=True)
class SelfCheck:
    """Result of the self-check by particles seen twice.

    Parameters
    ----------
    moves : tuple of Move
        One a sphere, the one that explains most first.
    pairs, particles : int
        Frames pairs looked at, and particles seen twice in them.
    false_alarms : float
        Probability that spheres which stand still are said to have moved.
    """

    moves: tuple[Move, ...]
    pairs: int
    particles: int
    false_alarms: float = MOVE_FALSE_ALARMS

    @property
    def likely_moves(self) -> tuple[Move, ...]:
        """The sphere that has moved, and those that explain it nearly as well; none if nothing has."""
        if not self.moves or min(m.probability for m in self.moves) >= self.false_alarms / len(self.moves):
            return ()
        return tuple(m for m in self.moves if m.explains >= AS_GOOD * self.moves[0].explains)

    @property
    def attributes(self) -> dict[str, str]:
        """Attributes of a file of results; `spheres_moved` only where one has."""
        names = " or ".join(one.name for one in self.likely_moves)
        return {"self_check": self.sentence} | ({"spheres_moved": names} if names else {})

    @property
    def sentence(self) -> str:
        """In words."""
        seen = f"{self.particles} particles seen twice in {self.pairs} pairs"
        if not self.moves:
            return f"{seen}: too few to tell whether a sphere has moved"
        if not self.likely_moves:
            reported = [m for m in self.moves if m.is_told]
            untold = ", ".join(m.name for m in self.moves if not m.is_told)
            said = f"{seen} agree: no sphere has moved by more than chance"
            said += "".join(f", {m.name} +- {1e3 * float(m.sigma_mm[:2].max()):.0f} um" for m in reported)
            return said + (f"; they tell nothing of {untold}" if untold else "")
        x, y, z = (1e3 * self.likely_moves[0].move_mm).tolist()
        names = " or ".join(m.name for m in self.likely_moves)
        return (
            f"{seen} do not agree: {names} has moved, by about ({x:+.0f}, {y:+.0f}, {z:+.0f}) um; calibrate again"
            f" (false alarms: fewer than {self.false_alarms:g} a check)"
        )


Pairs = Callable[[], Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]]


def check_spheres(scene: Scene, pairs: Pairs) -> SelfCheck:
    """Ask particles whether the spheres of a scene stand where it says.

    Parameters
    ----------
    scene : Scene
        Fitted; with its light sheet, if that is known.
    pairs : callable
        Gives the raw pairs of frames of a flow, the same ones at each call.

    Raises
    ------
    SheetError
        There are too few pairs.
    """
    finder = Finder(scene.in_light_sheet())
    light, count = Light.of(pairs, FEWEST_PAIRS, "whether a sphere has moved")
    frames = ((number, pulse, frame) for number, pair in enumerate(pairs()) for pulse, frame in enumerate(pair))
    found: dict[tuple[int, int], SeenTwice] = {}

    def search(part: tuple[int, int, NDArray[np.float32]]) -> None:
        number, pulse, frame = part
        found[number, pulse] = finder.find(frame - light.mean[pulse], number)

    run_parts(search, frames)
    return judge_pairs(finder.spheres, join_pairs([found[key] for key in sorted(found)]), count, scene.lit)


class RunningCheck:
    """The same for frames as they come, over the last pairs: what a live page can show.

    Parameters
    ----------
    scene : Scene
        As for `check_spheres`.
    most_pairs : int
        How many of the last pairs count.
    """

    def __init__(self, scene: Scene, most_pairs: int = 50) -> None:
        self._finder = Finder(scene.in_light_sheet())
        self._known = scene.lit
        self._seen: deque[SeenTwice] = deque(maxlen=most_pairs)
        self._mean: list[NDArray[np.float32]] = []
        self._count = 0

    def add(self, *given: NDArray[np.float32]) -> None:
        """Look at a raw pair, or at its frame of one pulse, always the same; what stands still is their mean."""
        frames = [np.asarray(frame, np.float32) for frame in given]
        self._count += 1
        if not self._mean:
            self._mean = [frame.copy() for frame in frames]
            return
        for mean, frame in zip(self._mean, frames, strict=True):
            mean += (frame - mean) / np.float32(self._count)
        free = [frame - mean for frame, mean in zip(frames, self._mean, strict=True)]
        self._seen.append(join_pairs([self._finder.find(frame, 0) for frame in free]))

    @property
    def found(self) -> SelfCheck:
        """Result from the last pairs."""
        parts = [replace(seen, frame_pair=np.full(len(seen), n)) for n, seen in enumerate(self._seen)]
        if not parts:
            return SelfCheck((), 0, 0)
        return judge_pairs(self._finder.spheres, join_pairs(parts), len(parts), self._known)


def judge_pairs(spheres: tuple[str, ...], seen: SeenTwice, pairs: int, known: LightSheet) -> SelfCheck:
    """Judge particles seen twice in some pairs of frames.

    Parameters
    ----------
    spheres : tuple of str
        Names, in the order of `SeenTwice.by_sphere`.
    seen : SeenTwice
        Of all frames; `frame_pair` from 0 to `pairs` - 1.
    pairs : int
        How many.
    known : LightSheet
        How well the sheet is known.
    """
    if len(seen) < MIN_PARTICLES or pairs < FEWEST_PAIRS:
        return SelfCheck((), pairs, len(seen))
    x, y = seen.place_mm.T
    sheet = seen.by_height[:, :, None] * np.stack((np.ones_like(x), x, y), axis=-1)[:, None, :]
    root = np.linalg.cholesky(np.linalg.inv(_covariance(known)))
    still = _Fit(seen, sheet, root @ root.T, pairs)
    moves = []
    for number, name in enumerate(spheres):
        design = np.concatenate((sheet, seen.by_sphere[:, :, 3 * number : 3 * number + 3]), axis=2)
        prior = np.zeros((SHEET + 3, SHEET + 3))
        prior[:SHEET, :SHEET] = root @ root.T
        prior[SHEET:, SHEET:] = np.eye(3) / MOVE_PRIOR_MM**2
        fit = _Fit(seen, design, prior, pairs, still.spread2)
        move, covariance = fit.answer[SHEET:], fit.covariance[SHEET:, SHEET:] + np.diag(FLOOR_MM**2)
        t2 = float(move @ np.linalg.solve(covariance, move))
        by_scatter = float(scipy.special.fdtrc(3, pairs - 3, t2 * (pairs - 3) / (3.0 * (pairs - 1))))
        by_fit = float(scipy.special.chdtrc(3, 2.0 * (still.cost - fit.cost)))
        probability = max(by_scatter, by_fit)
        moves.append(Move(name, move, np.sqrt(np.diag(covariance)), probability, still.cost - fit.cost))
    return SelfCheck(tuple(sorted(moves, key=lambda one: -one.explains)), pairs, len(seen))


class _Fit:
    """Robust weighted least squares, with the scatter of its answer between pairs of frames."""

    def __init__(
        self,
        seen: SeenTwice,
        design: NDArray[np.float64],
        prior: NDArray[np.float64],
        pairs: int,
        spread2: float | None = None,
    ) -> None:
        answer, trust = np.zeros(design.shape[2]), np.ones(len(seen))
        weighted = np.einsum("nij,njk->nik", seen.weight, design)
        ratio, left = np.zeros(len(seen)), seen.apart_mm
        self.spread2 = 1.0
        for _ in range(PARTICLE_ROUNDS):
            normal = np.einsum("nik,nil,n->kl", design, weighted, trust) + prior
            right = np.einsum("nik,ni,n->k", weighted, seen.apart_mm, trust)
            answer = np.linalg.solve(normal, right)
            left = seen.apart_mm - design @ answer
            far = np.einsum("ni,nij,nj->n", left, seen.weight, left)
            self.spread2 = max(float(np.median(far)) / CHI2_2, 1e-12) if spread2 is None else spread2
            ratio = far / (PARTICLE_BIWEIGHT**2 * self.spread2)
            trust = np.where(ratio < 1.0, (1.0 - ratio) ** 2, 0.0)
        self.answer = answer
        self.cost = PARTICLE_BIWEIGHT**2 / 6.0 * float(np.sum(1.0 - (1.0 - np.minimum(ratio, 1.0)) ** 3))
        pulls = np.einsum("nik,ni->nk", weighted, left)
        # a pull weighs less the farther it is: what the answer gives way by is less than the weights say
        less = 4.0 * np.maximum(1.0 - ratio, 0.0) / (PARTICLE_BIWEIGHT**2 * self.spread2)
        normal = np.einsum("nik,nil,n->kl", design, weighted, trust) - (pulls * less[:, None]).T @ pulls + prior
        share = np.zeros((pairs, len(answer)))
        np.add.at(share, seen.frame_pair, pulls * trust[:, None])
        share = np.linalg.solve(normal, (share - share.mean(axis=0)).T).T
        unknown = np.linalg.inv(normal)  # what nothing tells is as unsure as it was
        self.covariance = np.asarray(pairs / (pairs - 1.0) * share.T @ share + unknown @ prior @ unknown)


def _covariance(known: LightSheet) -> NDArray[np.float64]:
    """Of height and slopes of the sheet; never singular."""
    root = known.root()
    return np.asarray(root @ root.T + np.diag([1e-6**2, 1e-8**2, 1e-8**2]))
