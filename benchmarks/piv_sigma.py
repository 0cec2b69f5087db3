"""Errors and the sigma that is said of them, on flows made anew: one set to choose on, and one to judge on.

    python -m benchmarks.piv_sigma choose [--seeds 2] [--flow 'turb*'] [--image clean] [-o FILE]
    python -m benchmarks.piv_sigma judge

Every flow of a set is photographed in every way, by the generator of the evaluator's tests, which moves images of
particles and shares nothing with it; and evaluated at 0, 50 and 75 % overlap by fixed windows (`PivSettings()`)
and by those that places find. The two sets have the same families, but no length, no strength and no seed in
common. What stands in the evaluator may be chosen by the first; the second is looked at when nothing is chosen any
more.

Of each case and of all together: median length of the error, share of vectors that are wrong (1 px or more, of all
that are not masked), rms of error over sigma and share within one sigma of valid vectors that are not wrong (a
component each), and the share of valid vectors whose error is over 5 sigma and over 0.3 px. Strangers are two
pictures of different particles: of those the share that is called valid.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

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


class Errors(NamedTuple):
    """What an evaluation has made of a pair, away from the edge of the frames.

    `off` and `sigma` (n, 2) of vectors that are not masked, `valid` (n,), `seconds` of processor time.
    """

    off: Floats
    sigma: Floats
    valid: NDArray[np.bool_]
    seconds: float

    def with_more(self, other: "Errors") -> "Errors":
        """Both together."""
        parts = [np.concatenate(both) for both in zip(self[:3], other[:3], strict=True)]
        return Errors(parts[0], parts[1], parts[2], self.seconds + other.seconds)

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
            "rms_px": float(np.sqrt(np.mean(self.off[near] ** 2))) if near.any() else float("nan"),
            "wrong": float(np.mean(~near)),
            "valid": float(np.mean(self.valid)),
            "over_sigma": float(np.sqrt(np.mean(over[told] ** 2))) if told.any() else float("nan"),
            "rms_over_rms": float(np.sqrt(np.mean(self.off[told] ** 2) / np.mean(self.sigma[told] ** 2))),
            "within": float(np.mean(over[told] < 1.0)) if told.any() else float("nan"),
            "far": float(far.sum() / max(known.sum(), 1)),
            "cpu_s": self.seconds,
        }


def judged(field: VectorField, truth: Truth, seconds: float, side: int = SIDE) -> Errors:
    """Errors of a field."""
    x, y = np.meshgrid(field.x_px, field.y_px)
    inner = (np.minimum(x, y) > MARGIN) & (np.maximum(x, y) < side - MARGIN) & (field.flags != 1)
    off = np.stack([field.u_px, field.v_px], -1) - np.stack(np.broadcast_arrays(*truth(x, y)), -1)
    return Errors(off[inner], field.total_sigma_px[inner], field.valid[inner], seconds)


def evaluators(finest_px: int) -> dict[str, PivSettings]:
    """Settings by name: fixed windows and found ones, each at every overlap."""
    return {
        f"{name} {100 * overlap:g} %": PivSettings(finest_px=finest, overlap=overlap)
        for name, finest in (("fixed", None), ("found", finest_px))
        for overlap in OVERLAPS
    }


def pairs_of(which: str, seeds: int, flow: str, image: str) -> Iterator[tuple[str, str, Truth, list[Any]]]:
    """Flow, image, truth and frames of each case of a set whose names match, once a seed."""
    make_pair = generator()
    for number, (name, of_seed) in enumerate(flows_of(which).items()):
        for way, told in IMAGES.items():
            for count in range(seeds if fnmatch(name, flow) and fnmatch(way, image) else 0):
                seed = FIRST_SEED[which] + 1000 * count + 10 * number + list(IMAGES).index(way)
                truth = of_seed(seed)
                yield name, way, truth, make_pair(truth, (SIDE, SIDE), seed=seed, **told)


def strangers(which: str, seeds: int, settings: PivSettings) -> float:
    """Share of the vectors of two pictures of different particles that are valid."""
    make_pair, flows = generator(), of_the_tests("correlation/flows.py")
    shares = []
    for count in range(2 * seeds):
        one, other = (
            make_pair(flows.uniform(2.0, 1.0), (SIDE, SIDE), seed=FIRST_SEED[which] + 7000 + 2 * count + k)
            for k in range(2)
        )
        try:
            shares.append(float(np.mean(evaluate_pair(one[0], other[1], settings=settings, threads=1).valid)))
        except PairError:
            shares.append(0.0)
    return float(np.mean(shares))


def measured(which: str, seeds: int, flow: str, image: str, settings: dict[str, PivSettings]) -> dict[str, Any]:
    """Figures of every evaluator: of all cases together, of strangers, and of each case."""
    found: dict[str, dict[str, Errors]] = {name: {} for name in settings}
    for case, way, truth, pair in pairs_of(which, seeds, flow, image):
        for name, told in settings.items():
            start = time.process_time()
            field = evaluate_pair(*pair, settings=told, threads=1)
            errors = judged(field, truth, time.process_time() - start)
            before = found[name].get(f"{case}, {way}")
            found[name][f"{case}, {way}"] = errors if before is None else before.with_more(errors)
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
    kinds = ("median_px", "rms_px", "wrong", "over_sigma", "rms_over_rms", "within", "far", "valid", "cpu_s")
    print(" " * 40 + "".join(f"{kind:>13}" for kind in kinds))
    for name, part in table.items():
        strange = f"  strangers {part['strangers_valid']:.3f}"
        rows = {name: part["all"]} | (part["cases"] if details else {})
        for case, figures in rows.items():
            numbers = "".join(f"{figures[kind]:13.4f}" for kind in kinds)
            print(f"{'' if case == name else '    '}{case:<40}"[:40] + numbers + (strange if case == name else ""))


def main() -> None:
    """Measure one set, print it and keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", choices=["choose", "judge"])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--flow", default="*", metavar="PATTERN")
    parser.add_argument("--image", default="*", metavar="PATTERN")
    parser.add_argument("--evaluator", default="*", metavar="PATTERN", help="as in 'found *'")
    parser.add_argument("--finest-window", type=int, default=16, metavar="PX")
    parser.add_argument("--cases", action="store_true", help="print each case")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="keep all figures as JSON")
    told = parser.parse_args()
    chosen = {name: one for name, one in evaluators(told.finest_window).items() if fnmatch(name, told.evaluator)}
    table = measured(told.set, told.seeds, told.flow, told.image, chosen)
    show(table, told.cases)
    if told.output:
        told.output.write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main()
