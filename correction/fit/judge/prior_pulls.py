"""Joint test of the priors: numbers that are each within their gate, and together are not.

With C0 = (N + 1)^-1 the gain of the fit in units of the prior's sigmas, N its normal matrix, the estimate of a
right lab is x = C0 N x_true + C0 J^T noise.  If C is the covariance of its error,

    V = cov(x) = 1 - 2 C0 + C,        T = (A x)^T (A V A^T)^-1 (A x)  ~  chi-square

for any rows A: a number that the frames do not show has neither pull nor variance.  Tested are the numbers of one
kind (radii, indices, heights of the target, scale of the print), distances between balls, which a common shift of
all balls does not change, and their common direction: radii that are each 4 sigmas too small are one error of a
scale, not two of a radius.  Last of all one number for all lengths, as a print of another size would move them.

What is found enters the uncertainty: priors of the kind are widened by Birge's ratio, the root of T over its
degrees of freedom, and the step that the fit would then make is an error of the scene.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.fit.solve.unknowns import Unknowns, unit_of

PULL_FALSE_ALARMS = 1e-3  # chance that a right lab fails any of the tests
LEAST_VARIANCE = 1e-3  # of a combination in prior variances; less is not shown by the frames
AS_LIKELY = 0.5  # sigmas by which one scale may explain less than a number for each length
NAMED = 1.0  # sigmas from which a number is named
KINDS = {
    "radii": r".+radius",
    "refractive indices": r"glass .+\.n",
    "heights of the target": r"target[+-]\S+mm\.z",
    "scale of the print": r"print\.stretch_.",
}
LENGTHS = "all lengths"
LENGTH_CURE = "measure the squares of the board and give square_mm, or check the radii and heights"


@dataclass(frozen=True)
class PriorPull:
    """A joint deviation from the priors that chance does not explain.

    Parameters
    ----------
    kind : str
        What is tested.
    names : tuple of str
        Free numbers concerned.
    pulls : tuple of float
        Their distances from the priors, in sigmas.
    sigmas : float
        Joint distance: as unlikely as so many sigmas of one number.
    ratio : float
        Birge's ratio.
    scale : float
        Relative error of all lengths that would pull them, 0 of other kinds.
    """

    kind: str
    names: tuple[str, ...]
    pulls: tuple[float, ...]
    sigmas: float
    ratio: float
    scale: float = 0.0

    @property
    def reason(self) -> str:
        """Describe the pulls and what to check."""
        both, least = zip(self.names, self.pulls, strict=True), min(NAMED, max(map(abs, self.pulls)))
        each = ", ".join(f"{name} {pull:+.1f}" for name, pull in both if abs(pull) >= least)
        if self.kind == LENGTHS:
            return (
                f"lengths are pulled alike ({each} sigmas), as by a print {100.0 * abs(self.scale):.2g} %"
                f" {'larger' if self.scale < 0.0 else 'smaller'} than given; {LENGTH_CURE}"
            )
        return f"the {self.kind} moved from their values by {each} sigmas; check these values and their sigmas"

    def __str__(self) -> str:
        """Return one sentence."""
        return f"priors fail their joint test by {self.sigmas:.1f} sigmas: {self.reason}"


def prior_pulls(
    unknowns: Unknowns, x: NDArray[np.float64], normal: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[PriorPull, ...]:
    """Test the priors jointly.

    Parameters
    ----------
    unknowns : Unknowns
        P free numbers.
    x : (P,) float64
        The fitted free vector.
    normal, covariance : (Q, Q) float64
        N and C of these and, after them, of further numbers.

    Returns
    -------
    tuple of PriorPull
        Failed tests, the least likely first.
    """
    free = len(x)
    gain = np.linalg.inv(normal + np.eye(len(normal)))[:free, :free]
    spread = np.eye(free) - 2.0 * gain + covariance[:free, :free]
    tests, found = list(_tests(unknowns, unknowns.full(x), spread, np.eye(free) - gain)), []
    scales = [float(rows[0] @ x * per) for kind, rows, per in tests if kind == LENGTHS]
    for kind, rows, _ in tests:
        combined, values, vectors = rows @ x, *np.linalg.eigh(rows @ spread @ rows.T)
        shown = values > LEAST_VARIANCE
        square = float(np.sum((vectors[:, shown].T @ combined) ** 2 / values[shown]))
        freedom = max(int(np.count_nonzero(shown)), 1)
        tail = float(scipy.special.chdtrc(freedom, square))
        if tail < PULL_FALSE_ALARMS / len(tests):
            sigmas = float(-scipy.special.ndtri(max(0.5 * tail, 1e-300)))
            at = np.flatnonzero(rows.any(axis=0))
            names, is_length = tuple(unknowns.names[one] for one in at), unit_of(unknowns.names[at[0]])[0] == "mm"
            scale = scales[0] if scales and is_length else 0.0
            ratio = float(np.sqrt(square / freedom))
            found.append(PriorPull(kind, names, tuple(x[at].tolist()), sigmas, ratio, scale))
    found.sort(key=lambda pull: -pull.sigmas)
    best = next((pull for pull in found if pull.kind == LENGTHS), None)
    if best is not None and best.sigmas > found[0].sigmas - AS_LIKELY:
        found = [best, *(pull for pull in found if not pull.scale)]
    return tuple({pull.names: pull for pull in reversed(found)}.values())[::-1]


def widen_priors(
    unknowns: Unknowns, x: NDArray[np.float64], pulls: tuple[PriorPull, ...], count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weights (count,) of the priors once those of failed tests are widened, and the gradient (count, 1 or 0)."""
    weight, step = np.ones(count), np.zeros((count, min(len(pulls), 1)))
    for pull in pulls:
        here = [unknowns.names.index(name) for name in pull.names]
        weight[here] = np.minimum(weight[here], pull.ratio**-2.0)
    step[: len(x)] = ((1.0 - weight[: len(x)]) * x)[:, None]
    return weight, step


def length_errors(unknowns: Unknowns, x: NDArray[np.float64], pulls: tuple[PriorPull, ...]) -> NDArray[np.float64]:
    """Errors (F, K) of the full vector, whose lengths are all off by the scale of each pull that has one."""
    lengths = np.array([unit_of(name)[0] == "mm" for name in unknowns.full_names])
    scales = {pull.scale for pull in pulls if pull.scale}
    return np.outer(lengths * unknowns.full(x), sorted(scales))


def _tests(
    unknowns: Unknowns, full: NDArray[np.float64], spread: NDArray[np.float64], shown: NDArray[np.float64]
) -> Iterator[tuple[str, NDArray[np.float64], float]]:
    """Kind, rows of a test (K, P), and the scale that a value of 1 stands for."""
    every, sigma = np.eye(len(unknowns.names)), unknowns.sigma
    groups = {
        kind: [at for at, name in enumerate(unknowns.names) if re.fullmatch(shape, name)]
        for kind, shape in KINDS.items()
    }
    lengths = [every[groups["radii"]], every[groups["heights of the target"]]]
    for kind, chosen in groups.items():
        if chosen:
            yield kind, every[chosen], 0.0
        if len(chosen) > 1:
            yield kind, every[chosen].sum(axis=0, keepdims=True), 0.0
    balls = [sphere.name for sphere in unknowns.scene.spheres]
    for axis in "xyz":
        here = [unknowns.names.index(name) for ball in balls if (name := f"{ball}.{axis}") in unknowns.names]
        if len(here) > 1:
            lengths.append(every[here] - (every[here] * sigma).mean(axis=0) / sigma[here, None])
    if len(lengths) > 2:
        yield "distances between balls", np.concatenate(lengths[2:]), 0.0
    rows = np.concatenate(lengths)
    if len(rows) > 1:
        # A world that is larger than its priors by a scale pulls each number as far as the frames show it.
        length = [unit_of(name)[0] == "mm" for name in unknowns.names]
        value = full[np.argmax(unknowns.columns != 0.0, axis=0)]
        by_scale = rows @ shown @ (value * length / sigma)
        best = by_scale @ np.linalg.pinv(rows @ spread @ rows.T, rcond=LEAST_VARIANCE, hermitian=True)
        power = float(best @ by_scale)
        if power > 0.0:
            yield LENGTHS, (best @ rows)[None] / np.sqrt(power), power**-0.5
