"""What windows of one size and those that places find make of flows that bend and of light that is poor.

    python -m benchmarks.piv_windows [--seeds 1] [--windows found] [--case 'turb*'] [-o FILE]

Every case is a flow photographed in one way by the generator of the evaluator's tests, which shares nothing with
it. Of each: median length of the error at vectors, mean over all pixels of that of a spline between them, share of
vectors that are wrong by a pixel, rms of error over sigma and share within one (valid vectors that are not wrong),
share over 5 sigma and 0.3 px, share that is valid, and seconds of processor time. Strangers are two pictures of
different particles, in three seedings: of those the share that is called valid.
"""

import argparse
import json
import time
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import RectBivariateSpline

from benchmarks.piv_cases import Truth, generator, of_the_tests
from benchmarks.piv_sigma import MARGIN, SIDE, Errors, judged
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorField
from piv.errors import PairError

WINDOWS = {
    "32 px": PivSettings(),
    "24 px": PivSettings(windows_px=(64, 32, 24, 24)),
    "16 px": PivSettings(windows_px=(64, 32, 16, 16)),
    "found": PivSettings(finest_px=16),
}
FIRST_SEED, STRANGERS_SEED = 500, 7000
SEEDINGS = 0.005, 0.02, 0.05  # particles a pixel
KINDS = "median_px", "dense_px", "wrong", "over_sigma", "within", "far", "valid", "cpu_s"


def cases() -> dict[str, tuple[Truth, dict[str, float]]]:
    """Flow and image by name."""
    flows = of_the_tests("correlation/flows.py")
    many, thin, middle = {"ppp": 0.05}, {"ppp": 0.005}, SIDE / 2
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


def dense_px(field: VectorField, truth: Truth) -> float:
    """Mean length over all pixels of the error of a spline through the vectors, guesses among them."""
    inner = np.arange(MARGIN, SIDE - MARGIN)
    square = np.zeros((inner.size, inner.size))
    for seen, true in zip((field.u_px, field.v_px), truth(*np.meshgrid(inner, inner)), strict=True):
        known = np.where(np.isfinite(seen), seen, np.nanmedian(seen))
        square += np.square(RectBivariateSpline(field.y_px, field.x_px, known)(inner, inner) - true)
    return float(np.sqrt(square).mean())


def measured(name: str, settings: PivSettings, seeds: int) -> tuple[Errors, float]:
    """Errors of a case, and the dense one."""
    make_pair, known = generator(), cases()
    (truth, image), number = known[name], list(known).index(name)
    whole, dense = None, []
    for count in range(seeds):
        frame_a, frame_b = make_pair(truth, (SIDE, SIDE), seed=FIRST_SEED + number + 100 * count, **image)
        start = time.process_time()
        field = evaluate_pair(frame_a, frame_b, settings=settings, threads=1)
        errors = judged(field, truth, time.process_time() - start)
        whole = errors if whole is None else whole.with_more(errors)
        dense.append(dense_px(field, truth))
    if whole is None:
        raise ValueError("a case needs a seed at least")
    return whole, float(np.mean(dense))


def strangers(settings: PivSettings, seeds: int) -> dict[str, float]:
    """Valid share of the vectors of two pictures of different particles, by seeding."""
    make_pair, truth = generator(), of_the_tests("correlation/flows.py").uniform(2.0, 1.0)
    found = {}
    for ppp in SEEDINGS:
        shares = []
        for first in range(STRANGERS_SEED, STRANGERS_SEED + 40 * seeds, 10):
            one, other = (make_pair(truth, (SIDE, SIDE), seed=first + k, ppp=ppp) for k in range(2))
            try:
                shares.append(float(evaluate_pair(one[0], other[1], settings=settings, threads=1).valid.mean()))
            except PairError:
                shares.append(0.0)
        found[f"strangers, {ppp:g} a px"] = float(np.mean(shares))
    return found


def main() -> None:
    """Measure, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--windows", default="*", metavar="PATTERN", help="as in '* px'")
    parser.add_argument("--case", default="*", metavar="PATTERN", help="as in 'turb*'")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="keep all figures as JSON")
    told = parser.parse_args()
    table: dict[str, Any] = {}
    print(" " * 44 + "".join(f"{kind:>11}" for kind in KINDS))
    for windows, settings in WINDOWS.items():
        if not fnmatch(windows, told.windows):
            continue
        whole, rows = None, {}
        for name in cases():
            if fnmatch(name, told.case):
                errors, dense = measured(name, settings, told.seeds)
                rows[name] = errors.figures() | {"dense_px": dense}
                whole = errors if whole is None else whole.with_more(errors)
        if whole is not None:
            rows["all"] = whole.figures() | {
                "dense_px": float(np.mean([row["dense_px"] for row in rows.values()]))
            }
        for name, row in rows.items():
            print(f"{windows:<8}{name:<36}" + "".join(f"{row[kind]:11.4f}" for kind in KINDS), flush=True)
        apart = strangers(settings, told.seeds) if fnmatch("strangers", told.case) else {}
        print(*(f"{windows:<8}{name:<36}{share:.3f}" for name, share in apart.items()), sep="\n")
        table[windows] = {"cases": rows, "strangers_valid": apart}
    if told.output:
        told.output.write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main()
