"""Where ensemble correlation beats the mean of vectors at a rim: by seeding and by what is lost there.

    python -m benchmarks.rim [--pairs 60] [--per-px 0.004 0.008 0.015 0.03] [--lost 0 0.5 0.8] [-o rim.json]

A disc of 244 px shows a jet whose shear layers are 14 px wide, without turbulence; of the particles a tenth finds
no partner in the middle, and up to `--lost` more towards the rim. Both routes see the same frames: the mean of
vectors with windows of 32 px, and ensemble correlation with 16 px, which begins with it. Errors are rms in px at
points, at r > 0.75 R and in the shear layer inside that.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.options import keep, options
from benchmarks.piv_cases import of_the_tests
from piv.correlation.pair import evaluate_pair
from piv.correlation.prepare import prepare_pair
from piv.correlation.settings import PivSettings
from piv.correlation.windows import window_grid
from piv.statistics.ensemble import EnsembleSums
from piv.statistics.ensemble_field import ensemble_field
from piv.statistics.moments import Moments
from piv.statistics.sweep import sweep_with

Array = NDArray[Any]
SIDE, RADIUS, MIDDLE, LAYER_PX, FROM = 256, 122.0, 127.5, 14.0, 0.75


def thin_jet(u: Array, v: Array) -> tuple[Array, Array]:
    """Displacement at pixels."""
    return 0.3 + 0 * u, -1.0 - 8.0 * np.exp(-((u - MIDDLE) ** 2) / (4 * LAYER_PX**2))


def compared(pairs: int, per_px: float, lost: float) -> dict[str, float]:
    """Errors of both routes on the same pairs."""

    def loss(u: Array, v: Array) -> Array:
        outwards = np.hypot(u - MIDDLE, v - MIDDLE) / RADIUS
        return np.asarray(0.1 + lost * np.clip((outwards - 0.6) / 0.4, 0.0, 1.0))

    drawn = of_the_tests("statistics/test_ensemble.py").frames
    columns, rows = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    valid = np.hypot(columns - MIDDLE, rows - MIDDLE) < RADIUS
    grid = window_grid((SIDE, SIDE), 32, 0.5)
    moments, frames = Moments.nothing(grid.shape), []
    for seed in range(pairs):
        frames.append(drawn(thin_jet, seed, (SIDE, SIDE), ppp=per_px, loss=loss))
        found = evaluate_pair(*frames[-1], valid, PivSettings())
        sigma = np.stack((found.sigma_u_px, found.sigma_v_px), axis=-1)
        moments = moments.add(np.stack((found.u_px, found.v_px), axis=-1), found.valid, sigma)
    mean = np.where(moments.count[..., None] > pairs / 4, moments.mean_uv, np.nan)
    spread = prepare_pair(*frames[0], valid, 32).spread_px2
    sums = EnsembleSums(sweep_with((SIDE, SIDE), mean, moments.reynolds_stresses, grid, spread))
    for a, b in frames:
        sums.add(a, b, valid)
    field = ensemble_field(sums, 16)
    result: dict[str, float] = {"per_px": per_px, "lost": lost, "pairs": pairs}
    for name, where, mean_px in (
        ("vectors_32", grid, moments.mean_uv),
        ("ensemble_16", field.grid, field.mean_px),
    ):
        x, y = np.meshgrid(where.x_px, where.y_px)
        off = mean_px - np.stack(thin_jet(x, y), axis=-1)
        r, layer = np.hypot(x - MIDDLE, y - MIDDLE) / RADIUS, np.abs(x - MIDDLE) / LAYER_PX
        for place, here in (
            ("rim", (r > FROM) & (r < 1.0)),
            ("layer", (r < FROM) & (layer > 0.7) & (layer < 2.5)),
        ):
            result[f"{name}_{place}"] = round(float(np.sqrt(np.nanmean(np.square(off[here])))), 4)
    result["rim_ratio"] = round(result["ensemble_16_rim"] / result["vectors_32_rim"], 3)
    return result


def main() -> None:
    """Run from the command line."""
    given = options(__doc__, pairs=60, per_px=[0.004, 0.008, 0.015, 0.03], lost=[0.0, 0.5, 0.8])
    found = []
    for per_px in given.per_px:
        for lost in given.lost:
            found.append(compared(given.pairs, per_px, lost))
    keep(found, given.out)


if __name__ == "__main__":
    main()
