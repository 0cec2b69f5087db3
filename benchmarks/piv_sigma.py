"""Errors and the sigma that is said of them, on flows made anew: one set to choose on, and one to judge on.

    python -m benchmarks.piv_sigma choose [--seeds 2] [--flow 'turb*'] [--image clean] [-o FILE]
    python -m benchmarks.piv_sigma judge
    python -m benchmarks.piv_sigma windows [--seeds 1] [--flow 'turb*'] [--evaluator found]

Every flow of a set is photographed in every way, by the generator of the evaluator's tests, which moves images of
particles and shares nothing with it; and evaluated at 0, 50 and 75 % overlap by fixed windows (`PivSettings()`)
and by those that places find. The two sets have the same families, but no length, no strength and no seed in
common. What stands in the evaluator may be chosen by the first; the second is looked at when nothing is chosen any
more.  The set `windows` are flows that bend and light that is poor, each photographed in one way, evaluated at
50 % overlap by windows of one size and by those that places find; strangers there are drawn in three seedings.

Of each case and of all together: median length of the error, mean over all pixels of that of a spline between
vectors, share of vectors that are wrong (1 px or more, of all
that are not masked), rms of error over sigma and share within one sigma of valid vectors that are not wrong (a
component each), and the share of valid vectors whose error is over 5 sigma and over 0.3 px. Strangers are two
pictures of different particles: of those the share that is called valid.
"""

import time
from collections.abc import Callable, Iterator
from fnmatch import fnmatch
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from benchmarks.options import keep, options
from benchmarks.piv_cases import Truth, generator, of_the_tests
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorField
from piv.errors import PairError

SIDE, MARGIN = 384, 40  # of the frames, and what is not judged of them [px]
OVERLAPS = (0.0, 0.5, 0.75)
WRONG_PX, FAR_PX, FAR_SIGMAS = 1.0, 0.3, 5.0
IMAGES: dict[str, dict[str, float]] = {
    "clean": {"ppp": 0.05},
    "noisy": {"ppp": 0.05, "noise": 0.1},
    "dim": {"ppp": 0.02, "noise": 0.05, "diameter_px": 2.0},
    "lossy": {"ppp": 0.04, "loss": 0.2},
}
FIRST_SEED = {"choose": 100, "judge": 9000}
FIRST_OF_WINDOWS, STRANGERS_OF_WINDOWS = 500, 7000  # seeds
SEEDINGS = 0.005, 0.02, 0.05  # particles a pixel
WINDOWS = {
    "32 px": PivSettings(),
    "24 px": PivSettings(windows_px=(64, 32, 24, 24)),
    "16 px": PivSettings(windows_px=(64, 32, 16, 16)),
    "found": PivSettings(finest_px=16),
}
Floats = NDArray[np.float64]


def flows_of(which: str) -> dict[str, Callable[[int], Truth]]:
    """Flows of a set by name; each is made from a seed."""
    flows = of_the_tests("correlation/flows.py")

    def drawn(*told: Any, **named: Any) -> Callable[[int], Truth]:  # noqa: ANN401
        return lambda seed: flows.turbulence(seed, *told, **named)

    def same(truth: Truth) -> Callable[[int], Truth]:
        return lambda _: truth

    if which == "choose":
        return {
            "turbulence -5/3, 30 px": drawn(2.0, 200, 30),
            "turbulence -5/3, 45 px": drawn(2.5, 300, 45),
            "turbulence -3, 30 px": drawn(3.0, 250, 30, slope=-3.0),
            "endless turbulence, -5 below 50 px": lambda seed: flows.endless(seed, 1.3, 50.0, -5.0),
            "band 50 to 70 px": drawn(1.0, 70, 50),
            "fronts of 12 px": lambda seed: flows.fronts(seed, 2.0, 12.0),
            "vortices of 20 to 60 px": lambda seed: flows.vortices(seed, (20.0, 60.0)),
            "shear layer of 12 px": same(flows.shear_layer(4.0, 12.0, 0.3)),
            "step of 2 px": same(flows.shear_layer(2.0, 0.0, 0.4)),
            "wave of 64 px": same(flows.wave(64)),
            "wave of 128 px": same(flows.wave(128, 2.0)),
            "shear of 0.03": same(lambda u, v: (0.03 * (v - 192), 0 * u)),
            "uniform": same(flows.uniform(3.3, -1.6)),
        }
    return {
        "turbulence -5/3, 35 px": drawn(2.2, 240, 35),
        "turbulence -5/3, 60 px": drawn(3.0, 350, 60),
        "turbulence -2.5, 25 px": drawn(2.5, 220, 25, slope=-2.5),
        "endless turbulence, -4 below 40 px": lambda seed: flows.endless(seed, 1.0, 40.0, -4.0),
        "band 40 to 56 px": drawn(0.8, 56, 40),
        "fronts of 9 px": lambda seed: flows.fronts(seed, 1.7, 9.0),
        "vortices of 25 to 45 px": lambda seed: flows.vortices(seed, (25.0, 45.0), 14, 0.17),
        "shear layer of 9 px": same(flows.shear_layer(3.0, 9.0, 1.1)),
        "step of 3 px": same(flows.shear_layer(3.0, 0.0, 0.8)),
        "wave of 56 px": same(flows.wave(56, 0.8)),
        "wave of 110 px": same(flows.wave(110, 1.7)),
        "shear of 0.04": same(lambda u, v: (0.04 * (v - 192), 0.01 * (u - 192))),
        "uniform": same(flows.uniform(-2.7, 5.4)),
    }


def windows_cases() -> dict[str, tuple[Truth, dict[str, float]]]:
    """Flow and image of each case of the set `windows`."""
    flows, many, thin, middle = of_the_tests("correlation/flows.py"), {"ppp": 0.05}, {"ppp": 0.005}, SIDE / 2
    dim = {"ppp": 0.02, "noise": 0.05, "diameter_px": 2.0}
    return {
        "turbulence -5/3, 35 px": (flows.turbulence(11, 2.2, 240, 35), many),
        "turbulence -2.5, 25 px": (flows.turbulence(12, 2.5, 220, 25, slope=-2.5), many),
        "turbulence -5/3, 60 px": (flows.turbulence(13, 3.0, 350, 60), {}),
        "turbulence -5/3, 30 px, noise 20 %": (flows.turbulence(14, 2.0, 200, 30), {"noise": 0.2}),
        "turbulence -5/3, 30 px, loss 40 %": (flows.turbulence(15, 2.0, 200, 30), {"loss": 0.4, "ppp": 0.04}),
        "turbulence -5/3, 40 px, thin": (flows.turbulence(16, 2.0, 200, 40), thin),
        "turbulence -3, 30 px, dim": (flows.turbulence(17, 2.0, 200, 30, slope=-3.0), dim),
        "flat jet of 31 px": (flows.plane_jet(centre_px=middle), {}),
        "Gaussian jet of 31 px": (flows.gaussian_jet(centre_px=middle), many),
        "jet that sways": (flows.shaken_jet(5, centre_px=middle), many),
        "step of 3 px": (flows.shear_layer(3.0, 0.0, 0.8), many),
        "vortices": (flows.vortices(3, (25.0, 45.0), 14, 0.17), many),
        "wave of 56 px": (flows.wave(56, 0.8), many),
        "wave of 200 px": (flows.wave(200, 2.0), {}),
        "uniform": (flows.uniform(-2.7, 5.4), many),
        "uniform, 0.02 a px": (flows.uniform(3.3, -1.6), {}),
        "mix, thin": (flows.mix, thin),
        "mix, noise 20 %": (flows.mix, {"noise": 0.2}),
        "mix, loss 40 %": (flows.mix, {"loss": 0.4}),
        "mix, hard": (flows.mix, {"diameter_px": 2.0, "ppp": 0.015, "loss": 0.2, "noise": 0.08}),
        "mix, dim": (flows.mix, dim),
    }


class Errors(NamedTuple):
    """What an evaluation has made of a pair, away from the edge of the frames.

    `off` and `sigma` (n, 2) of vectors that are not masked, `valid` (n,), `seconds` of processor time, and the
    mean error between vectors [px] of each pair.
    """

    off: Floats
    sigma: Floats
    valid: NDArray[np.bool_]
    seconds: float
    dense_px: tuple[float, ...] = ()

    def with_more(self, other: "Errors") -> "Errors":
        """Both together."""
        parts = [np.concatenate(both) for both in zip(self[:3], other[:3], strict=True)]
        return Errors(*parts, self.seconds + other.seconds, self.dense_px + other.dense_px)

    def figures(self) -> dict[str, float]:
        """What stands in the table."""
        size = np.linalg.norm(self.off, axis=-1)
        near = ~(size >= WRONG_PX) & np.isfinite(size)
        known = self.valid & np.isfinite(self.sigma).all(axis=-1)
        told = known & near
        over = np.where(known[:, None], np.abs(self.off) / self.sigma, 0.0)
        far = known & (size > FAR_PX) & (over.max(axis=-1) > FAR_SIGMAS)
        return {
            "median_px": float(np.median(size[near])) if near.any() else float("nan"),
            "dense_px": float(np.mean(self.dense_px)) if self.dense_px else float("nan"),
            "rms_px": float(np.sqrt(np.mean(self.off[near] ** 2))) if near.any() else float("nan"),
            "wrong": float(np.mean(~near)),
            "valid": float(np.mean(self.valid)),
            "over_sigma": float(np.sqrt(np.mean(over[told] ** 2))) if told.any() else float("nan"),
            "rms_over_rms": float(np.sqrt(np.mean(self.off[told] ** 2) / np.mean(self.sigma[told] ** 2))),
            "within": float(np.mean(over[told] < 1.0)) if told.any() else float("nan"),
            "far": float(far.sum() / max(known.sum(), 1)),
            "cpu_s": self.seconds,
        }


def dense_px(field: VectorField, truth: Truth) -> float:
    """Mean length over all pixels of the error of a spline through the vectors, guesses among them."""
    inner = np.arange(MARGIN, SIDE - MARGIN)
    square = np.zeros((inner.size, inner.size))
    for seen, true in zip((field.u_px, field.v_px), truth(*np.meshgrid(inner, inner)), strict=True):
        known = np.where(np.isfinite(seen), seen, np.nanmedian(seen))
        square += np.square(RectBivariateSpline(field.y_px, field.x_px, known)(inner, inner) - true)
    return float(np.sqrt(square).mean())


def judged(field: VectorField, truth: Truth, seconds: float, side: int = SIDE) -> Errors:
    """Errors of a field."""
    x, y = np.meshgrid(field.x_px, field.y_px)
    inner = (np.minimum(x, y) > MARGIN) & (np.maximum(x, y) < side - MARGIN) & (field.flags != 1)
    off = np.stack([field.u_px, field.v_px], -1) - np.stack(np.broadcast_arrays(*truth(x, y)), -1)
    return Errors(off[inner], field.total_sigma_px[inner], field.valid[inner], seconds, (dense_px(field, truth),))


def evaluators(which: str, finest_px: int) -> dict[str, PivSettings]:
    """Settings by name: fixed windows and found ones, each at every overlap, or those of the set `windows`."""
    if which == "windows":
        return WINDOWS
    return {
        f"{name} {100 * overlap:g} %": PivSettings(finest_px=finest, overlap=overlap)
        for name, finest in (("fixed", None), ("found", finest_px))
        for overlap in OVERLAPS
    }


def pairs_of(which: str, seeds: int, flow: str, image: str) -> Iterator[tuple[str, Truth, list[Any]]]:
    """Name, truth and frames of each case of a set whose flow and image match, once a seed."""
    make_pair = generator()
    if which == "windows":
        for number, (name, (truth, told)) in enumerate(windows_cases().items()):
            for count in range(seeds if fnmatch(name, flow) else 0):
                seed = FIRST_OF_WINDOWS + number + 100 * count
                yield name, truth, make_pair(truth, (SIDE, SIDE), seed=seed, **told)
        return
    for number, (name, of_seed) in enumerate(flows_of(which).items()):
        for way, told in IMAGES.items():
            for count in range(seeds if fnmatch(name, flow) and fnmatch(way, image) else 0):
                seed = FIRST_SEED[which] + 1000 * count + 10 * number + list(IMAGES).index(way)
                truth = of_seed(seed)
                yield f"{name}, {way}", truth, make_pair(truth, (SIDE, SIDE), seed=seed, **told)


def strangers(which: str, seeds: int, settings: PivSettings) -> dict[str, float]:
    """Share of the vectors of two pictures of different particles that are valid, by seeding."""
    make_pair, truth = generator(), of_the_tests("correlation/flows.py").uniform(2.0, 1.0)
    cases = {
        "strangers": ({}, range(FIRST_SEED.get(which, 0) + 7000, FIRST_SEED.get(which, 0) + 7000 + 4 * seeds, 2))
    }
    if which == "windows":
        firsts = range(STRANGERS_OF_WINDOWS, STRANGERS_OF_WINDOWS + 40 * seeds, 10)
        cases = {f"strangers, {ppp:g} a px": ({"ppp": ppp}, firsts) for ppp in SEEDINGS}
    found = {}
    for name, (image, firsts) in cases.items():
        shares = []
        for first in firsts:
            one, other = (make_pair(truth, (SIDE, SIDE), seed=first + k, **image) for k in range(2))
            try:
                shares.append(float(np.mean(evaluate_pair(one[0], other[1], settings=settings, threads=1).valid)))
            except PairError:
                shares.append(0.0)
        found[name] = float(np.mean(shares))
    return found


def measured(which: str, seeds: int, flow: str, image: str, settings: dict[str, PivSettings]) -> dict[str, Any]:
    """Figures of every evaluator: of all cases together, of strangers, and of each case."""
    found: dict[str, dict[str, Errors]] = {name: {} for name in settings}
    for case, truth, pair in pairs_of(which, seeds, flow, image):
        for name, told in settings.items():
            start = time.process_time()
            field = evaluate_pair(*pair, settings=told, threads=1)
            errors = judged(field, truth, time.process_time() - start)
            before = found[name].get(case)
            found[name][case] = errors if before is None else before.with_more(errors)
    table: dict[str, Any] = {}
    for name, cases in found.items():
        whole = None
        for errors in cases.values():
            whole = errors if whole is None else whole.with_more(errors)
        if whole is not None:
            table[name] = {
                "all": whole.figures(),
                "strangers_valid": strangers(which, seeds, settings[name]),
                "cases": {case: errors.figures() for case, errors in cases.items()},
            }
    return table


def show(table: dict[str, Any], details: bool) -> None:
    """Print it, a line an evaluator, and a line a case."""
    kinds = (
        "median_px",
        "dense_px",
        "rms_px",
        "wrong",
        "over_sigma",
        "rms_over_rms",
        "within",
        "far",
        "valid",
        "cpu_s",
    )
    print(" " * 40 + "".join(f"{kind:>13}" for kind in kinds))
    for name, part in table.items():
        strange = "".join(f"  {kind} {share:.3f}" for kind, share in part["strangers_valid"].items())
        rows = {name: part["all"]} | (part["cases"] if details else {})
        for case, figures in rows.items():
            numbers = "".join(f"{figures[kind]:13.4f}" for kind in kinds)
            print(f"{'' if case == name else '    '}{case:<40}"[:40] + numbers + (strange if case == name else ""))


def main() -> None:
    """Measure one set, print it and keep it."""
    asked = options(
        __doc__, set=(*FIRST_SEED, "windows"), seeds=2, flow="*", image="*", evaluator="*", finest_window=16,
        cases=False,
    )  # fmt: skip
    chosen = {
        name: one
        for name, one in evaluators(asked.set, asked.finest_window).items()
        if fnmatch(name, asked.evaluator)
    }
    table = measured(asked.set, asked.seeds, asked.flow, asked.image, chosen)
    show(table, asked.cases)
    if asked.out is not None:
        keep(table, asked.out)


if __name__ == "__main__":
    main()
