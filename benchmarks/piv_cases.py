"""Flows and images that are hard, each in its own way, with known truth; and what is counted about an evaluation.

Generator and flows are those of the evaluator's tests, which share nothing with it.
"""

import importlib.util
from collections.abc import Callable, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.piv_contenders import TO_16, Array, Contenders, Field, Pair, run

Truth = Callable[[Array, Array], tuple[Array, Array]]
Table = dict[str, Any]
ROOT = Path(__file__).resolve().parents[1]


def of_the_tests(file: str) -> Any:  # noqa: ANN401
    """Return a module of the evaluator's tests: its generator of pairs and its flows share nothing with it."""
    path = ROOT / "tests" / "piv" / file
    spec = importlib.util.spec_from_file_location(f"evaluator_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise FileNotFoundError(path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def generator() -> Callable[..., Pair]:
    """Return the pair generator of the tests."""
    return of_the_tests("conftest.py").make_pair  # type: ignore[no-any-return]


WAVES_PX = (24, 32, 48, 64, 96, 128, 192, 256)
SIDE = 512  # of the frames of the cases below


def cases() -> dict[str, tuple[Truth, dict[str, float]]]:
    """Flow and image of each case: what is hard about it stands in its name."""
    flows = of_the_tests("correlation/flows.py")
    found: dict[str, tuple[Truth, dict[str, float]]] = {"all fractions": (flows.mix, {})}
    for diameter in (1.0, 1.2, 1.5, 2.0, 5.0, 8.0):
        found[f"particles of {diameter:g} px"] = (flows.mix, {"diameter_px": diameter})
    for noise in (0.0, 0.05, 0.1, 0.2):
        found[f"noise {100 * noise:g} %"] = (flows.mix, {"noise": noise})
    for loss in (0.05, 0.2, 0.4):
        found[f"loss {100 * loss:g} %"] = (flows.mix, {"loss": loss})
    for ppp in (0.005, 0.05, 0.1):
        found[f"{ppp:g} particles per px"] = (flows.mix, {"ppp": ppp})
    for dead in (0.05, 0.2, 0.3):
        found[f"dead pixels {100 * dead:g} %"] = (flows.mix, {"dead": dead})
    found["hard"] = (flows.mix, {"diameter_px": 2.0, "ppp": 0.015, "loss": 0.2, "noise": 0.08})
    found["shot noise"] = (flows.mix, {"noise": 0.0, "shot": 0.01})
    found["static stripes"] = (flows.mix, {"stripes": 0.15})
    found["vortex"] = (flows.vortex(), {})
    for length in WAVES_PX:
        found[f"wave {length} px"] = (flows.wave(length), {"ppp": 0.05})
    for number, (rms, largest, smallest) in enumerate(
        ((2, 300, 50), (2.5, 300, 40), (2, 200, 30), (3, 250, 40)), 1
    ):
        found[f"turbulence {number}"] = (flows.turbulence(number, rms, largest, smallest), {"ppp": 0.05})
    return found


def drawn(make_pair: Callable[..., Pair], truth: Truth, image: dict[str, float]) -> Pair:
    """Pair of a case; shot noise, stripes and dead pixels (NaN) come on top of what the generator knows."""
    plain = {name: value for name, value in image.items() if name not in ("shot", "stripes", "dead")}
    pair = make_pair(truth, (SIDE, SIDE), seed=7, **plain)
    rng = np.random.default_rng(5)
    if "shot" in image:
        pair = [f + rng.normal(size=f.shape) * image["shot"] * np.sqrt(4095.0 * f) for f in pair]
    if "stripes" in image:
        stripe = image["stripes"] * 4095.0 * (np.sin(2 * np.pi * np.arange(SIDE) / 12) > 0)
        pair = [f + stripe for f in pair]
    pair = [np.clip(np.rint(f), 0, 4095).astype(np.uint16) for f in pair]
    if "dead" in image:
        gaps = rng.uniform(size=(SIDE, SIDE)) < image["dead"]
        pair = [np.where(gaps, np.float32(np.nan), f.astype(np.float32)) for f in pair]
    return pair


def judged(field: Field, truth: Truth, name: str, margin: int = 48) -> dict[str, float]:
    """Rms of what is within 1 px, median error, share of what is not, gain of a wave, and how honest sigma is."""
    du, dv = truth(field["x"], field["y"])
    inner = (np.minimum(field["x"], field["y"]) > margin) & (np.maximum(field["x"], field["y"]) < SIDE - margin)
    off = np.stack([field["u"] - du, field["v"] - dv])[:, inner]
    size = np.hypot(*off)
    near = size < 1.0
    found = {
        "rms_px": float(np.sqrt(np.mean(off[:, near] ** 2))) if near.any() else float("nan"),
        "median_px": float(np.nanmedian(size)),
        "wrong": float(np.mean(~near)),
    }
    if name.startswith("wave"):
        seen, true = np.stack([field["u"], field["v"]])[:, inner], np.stack([du, dv])[:, inner]
        known = np.isfinite(seen) & (np.sum(true**2) > 1.0)
        found["gain"] = float((seen * true)[known].sum() / max((true**2)[known].sum(), 1e-9))
    if "sigma_u" in field:
        sigma = np.stack([field["sigma_u"], field["sigma_v"]])[:, inner]
        known = np.isfinite(sigma) & near
        if known.any():
            found["error_over_sigma"] = float(np.sqrt(np.mean(off[known] ** 2) / np.mean(sigma[known] ** 2)))
            found["within_sigma"] = float(np.mean(np.abs(off[known]) < sigma[known]))
    return found


def hard_cases(
    contenders: Contenders, folder: Path, make_pair: Callable[..., Pair], wanted: Sequence[str] = ("*",)
) -> Table:
    """All of `cases` whose name matches, and turbulence once more down to 16 px where a contender can."""
    table: Table = {name: {} for name in contenders}
    for case, (truth, image) in cases().items():
        if not any(fnmatch(case, pattern) for pattern in wanted):
            continue
        pair = drawn(make_pair, truth, image)
        for name, (python, script, mode) in contenders.items():
            if "dead" in image and name != "rtpiv":
                continue  # no peer takes a mask of single pixels
            table[name][case] = _tried(python, script, pair, folder, mode, truth, case)
            if case.startswith(("turbulence", "wave")) and (name == "rtpiv" or name in TO_16):
                fine = (python, script, "16") if name == "rtpiv" else (python, TO_16[name], "")
                table[name][case + ", 16 px windows"] = _tried(*fine[:2], pair, folder, fine[2], truth, case)
    return table


def _tried(
    python: str, script: str, pair: Pair, folder: Path, mode: str, truth: Truth, case: str
) -> dict[str, float] | str:
    """Figures of a contender, or what it said when it failed."""
    try:
        return judged(run(python, script, pair, folder, 1, mode)[1], truth, case)
    except RuntimeError as error:
        return str(error)
