"""Mean and Reynolds stresses over a wall that shines, against a flow whose every pair is known.

    python -m benchmarks.wall_statistics [--pairs 300] [--told] [--background sliding-minimum] [-o FILE]

`--told`: the wall is given as a mask; `--background`: none, mean, minimum or sliding-minimum; `--vectors`: windows
of single pairs, 0 where each place finds its own; `--alone`: each pair finds the wall for itself, not the series;
`--steady`: the ensemble without fields of pairs as well.

A turbulent boundary layer over a solid wall: a mean profile, and waves of random direction whose lengths lie
partly above and partly below the windows, with a covariance that falls to zero at the wall. Frames have uneven
light, camera noise, 15 % of the particles without a partner, and a wall with a grain of its own, brighter than
particles, that stands still, flickers from pulse to pulse and glares into the fluid. Particles are drawn here,
the flow is a sum of cosines: nothing is shared with what is judged.

Both routes to a mean (vectors of single pairs, and the ensemble of all, its frames deformed by fields of pairs
as the verb does) are judged by distance from the wall, with windows of 32 and of 16 px, against

* the mean over the part of the window that is fluid, and the covariance of that mean from pair to pair ("window");
* the covariance at points, averaged over that part ("points"): what the displacements of its particles scatter by.

Distances are of window middles from the wall in sides of the window; "inside" are windows whose middle is in
solid.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from benchmarks.options import keep, options
from piv.correlation.pair import evaluate_pair
from piv.correlation.prepare import prepare_pair
from piv.correlation.settings import PivSettings
from piv.correlation.windows import WindowGrid, window_grid
from piv.preprocessing.series_light import series_mean, series_minimum, without_light
from piv.preprocessing.sliding_minimum import without_sliding_minimum
from piv.preprocessing.still_light import across_pairs, still_light
from piv.statistics.ensemble import EnsembleSums
from piv.statistics.ensemble_field import ensemble_field, next_sweep
from piv.statistics.moments import Moments
from piv.statistics.sweep import sweep_with
from piv.statistics.unresolved import Unresolved, is_measured_often, selection_sigma

Array = NDArray[Any]
SHAPE, WALL = (224, 256), 160  # rows and columns of a frame; first row that is solid
LATTICE_PX, EDGE_PX = 4, 24  # of the truth; and what is not judged at the other three edges
PARTICLES_PX, SPREAD_PX, PEAK, NOISE, LOSS = 0.03, 0.8, 600.0, 12.0, 0.15
ZONES = {"open": (2.0, 9.0), "1-2 windows": (1.0, 2.0), "0.5-1 window": (0.5, 1.0), "0-0.5 window": (0.0, 0.5),
         "inside": (-9.0, 0.0)}  # fmt: skip
LONG, SHORT = ((60.0, 220.0), (14.0, 40.0)), ((0.075, 0.05, -0.03), (0.012, 0.009, -0.004))


@dataclass(frozen=True)
class Flow:
    """The displacement of one pair."""

    wave: Array
    phase: Array
    strength: Array

    @classmethod
    def of(cls, rng: np.random.Generator, waves: int = 16) -> "Flow":
        """A sample; covariances of both ranges of wave length are those of SHORT[1]."""
        parts = []
        for (low, high), (uu, vv, uv) in zip(LONG, SHORT, strict=True):
            length, way = np.exp(rng.uniform(np.log(low), np.log(high), waves)), rng.uniform(0, 2 * np.pi, waves)
            turn = np.linalg.cholesky(np.array([[uu, uv], [uv, vv]]))
            strength = rng.normal(size=(waves, 2)) @ turn.T * np.sqrt(2.0 / waves)
            parts.append((2 * np.pi / length[:, None] * np.stack((np.cos(way), np.sin(way)), -1), strength))
        return cls(
            np.concatenate([wave for wave, _ in parts]),
            rng.uniform(0, 2 * np.pi, 2 * waves),
            np.concatenate([strength for _, strength in parts]),
        )

    def at(self, x: Array, y: Array) -> Array:
        """Displacement (..., 2) at pixels; zero in solid."""
        high = np.maximum(WALL - 0.5 - y, 0.0)
        phase = x[..., None] * self.wave[:, 0] + y[..., None] * self.wave[:, 1] + self.phase
        shift = np.cos(phase) @ self.strength * (1.0 - np.exp(-high / 12.0))[..., None]
        shift[..., 0] += 5.0 * (1.0 - np.exp(-high / 20.0))
        shift[..., 1] += 0.4 * (1.0 - np.exp(-high / 20.0)) ** 2
        return shift


def spots(x: Array, y: Array, light: Array) -> Array:
    """Image (H, W) of Gaussian particles, integrated over pixels."""
    image = np.zeros(SHAPE)
    row, column = np.floor(y).astype(int), np.floor(x).astype(int)
    reach = np.arange(-4, 6)
    down, along = (
        np.diff(ndtr((np.append(reach, 6) - 0.5 + (whole - place)[:, None]) / SPREAD_PX), axis=1)
        for whole, place in ((row, y), (column, x))
    )
    rows, columns = row[:, None] + reach, column[:, None] + reach
    down = down * ((rows >= 0) & (rows < SHAPE[0]))
    along = along * ((columns >= 0) & (columns < SHAPE[1]))
    height = (light * 2 * np.pi * SPREAD_PX**2)[:, None, None] * down[:, :, None] * along[:, None, :]
    places = np.clip(rows, 0, SHAPE[0] - 1)[:, :, None], np.clip(columns, 0, SHAPE[1] - 1)[:, None, :]
    np.add.at(image, places, height)
    return image


def glare() -> Array:
    """The wall as the camera sees it: a bright grain of 2 to 3 px, and light that falls off into the fluid."""
    rng = np.random.default_rng(77)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    depth = rows - WALL
    grain = spots(rng.uniform(0, SHAPE[1], 900), rng.uniform(WALL, SHAPE[0], 900), rng.uniform(200, 1500, 900))
    body = np.where(depth >= 0, 400.0 + 300.0 * np.sin(columns / 17.0) ** 2, 500.0 * np.exp(depth / 4.0))
    return body + np.where(depth >= 0, grain, 0.0)


def pair_of(flow: Flow, rng: np.random.Generator, wall: Array) -> tuple[Array, Array]:
    """Frames A and B (uint16, 12 bit)."""
    margin, frames = 12, []
    n = rng.poisson(PARTICLES_PX * (SHAPE[1] + 2 * margin) * (WALL + margin))
    x, y = rng.uniform(-margin, SHAPE[1] + margin, n), rng.uniform(-margin, WALL - 0.5, n)
    light = PEAK * rng.uniform(0.2, 1.0, n)
    shift, gone = flow.at(x, y), rng.uniform(size=n) < LOSS
    end = np.column_stack((x, y)) + 0.5 * shift
    end[gone] = np.column_stack((rng.uniform(-margin, SHAPE[1] + margin, n), rng.uniform(-margin, WALL - 0.5, n)))[
        gone
    ]
    columns = np.arange(SHAPE[1])
    uneven = 0.35 + 0.65 * np.exp(-(((columns - 110.0) / 100.0) ** 2))
    for px, py in ((x - 0.5 * shift[:, 0], y - 0.5 * shift[:, 1]), end.T):
        seen = py < WALL - 0.5
        image = uneven * spots(px[seen], py[seen], light[seen]) + rng.uniform(0.75, 1.25) * wall
        image += (
            40.0 + rng.normal(0.0, NOISE, SHAPE) + rng.normal(size=SHAPE) * 0.5 * np.sqrt(np.maximum(image, 0.0))
        )
        frames.append(np.clip(np.rint(image), 0, 4095).astype(np.uint16))
    return frames[0], frames[1]


@dataclass(frozen=True)
class Series:
    """Pairs, and the displacement (N, ny, nx, 2) of each on a lattice."""

    frames: list[tuple[Array, Array]]
    truth: Array

    @classmethod
    def of(cls, pairs: int, first_seed: int = 0) -> "Series":
        """Make it."""
        y, x = (np.arange(0, side, LATTICE_PX) + 0.5 * (LATTICE_PX - 1) for side in SHAPE)
        places = np.meshgrid(x, y)
        wall, frames, truth = glare(), [], []
        for number in range(pairs):
            rng = np.random.default_rng((first_seed, number))
            flow = Flow.of(rng)
            truth.append(flow.at(*places))
            frames.append(pair_of(flow, rng, wall))
        return cls(frames, np.stack(truth))

    def cleaned(self, background: str) -> list[tuple[Array, Array]]:
        """Frames without their background."""
        both = []
        for pulse in (0, 1):
            series = [pair[pulse] for pair in self.frames]
            if background == "sliding-minimum":
                both.append(list(without_sliding_minimum(series)))
            elif background in ("mean", "minimum"):
                light = (series_mean if background == "mean" else series_minimum)(series)
                both.append([without_light(frame, light) for frame in series])
            else:
                both.append(series)
        return list(zip(*both, strict=True))

    def over(self, grid: WindowGrid) -> dict[str, Array]:
        """Truth over the fluid part of windows: mean, and both covariances; NaN without any fluid."""
        ny, nx = grid.shape
        at = np.full((ny, nx, 2), np.nan)
        mean, window, points = (np.full((ny, nx, k), np.nan) for k in (2, 3, 3))
        y = np.arange(self.truth.shape[1]) * LATTICE_PX + 0.5 * (LATTICE_PX - 1)
        x = np.arange(self.truth.shape[2]) * LATTICE_PX + 0.5 * (LATTICE_PX - 1)
        off = self.truth - self.truth.mean(axis=0)
        of_points = np.stack([(off[..., a] * off[..., b]).sum(axis=0) for a, b in ((0, 0), (1, 1), (0, 1))], -1)
        of_points /= len(off) - 1
        for j in range(ny):
            rows = (y > grid.row[j] - 0.5) & (y < grid.row[j] + grid.size_px - 0.5) & (y < WALL - 0.5)
            for i in range(nx):
                columns = (x > grid.column[i] - 0.5) & (x < grid.column[i] + grid.size_px - 0.5)
                if not rows.any():
                    continue
                if grid.y_px[j] < WALL - 0.5:
                    down, along = (
                        np.abs(axis - centre) < LATTICE_PX * 0.9
                        for axis, centre in ((y, grid.y_px[j]), (x, grid.x_px[i]))
                    )
                    at[j, i] = self.truth.mean(axis=0)[down][:, along].mean(axis=(0, 1))
                here = self.truth[:, rows][:, :, columns].mean(axis=(1, 2))
                mean[j, i] = here.mean(axis=0)
                cov = np.cov(here.T)
                window[j, i] = cov[0, 0], cov[1, 1], cov[0, 1]
                points[j, i] = of_points[rows][:, columns].mean(axis=(0, 1))
        return {"at": at, "mean": mean, "window": window, "points": points}


@dataclass(frozen=True)
class Found:
    """What a route says: mean, its sigma and stresses, with theirs; NaN where it says nothing."""

    grid: WindowGrid
    mean: Array
    sigma: Array
    stress: Array
    stress_sigma: Array
    share: Array


def by_vectors(
    frames: list[tuple[Array, Array]], valid: Array | None, side: int, still: Array | None = None
) -> tuple[Found, list[Any]]:
    """Statistics of vectors, as `mean` makes them (independent pairs); a side of 0: each place finds its own."""
    settings = PivSettings(finest_px=16)
    if side:
        settings = PivSettings(windows_px=(64, 32, 32) if side == 32 else (64, 32, side, side))
    grid = settings.result_grid(SHAPE)
    moments, looked, vectors = Moments.nothing(grid.shape), np.zeros(grid.shape, np.int64), []
    missing = Unresolved.nothing(grid.shape, 1)
    for a, b in frames:
        field = evaluate_pair(a, b, valid, settings, still=still)
        uv, sigma = (np.stack(p, -1) for p in ((field.u_px, field.v_px), (field.sigma_u_px, field.sigma_v_px)))
        moments = moments.add(uv, field.valid, sigma)
        missing = missing.merge_with(Unresolved.of(uv, field.valid, field.steady_px, 1))
        looked += field.asked
        vectors.append((uv, sigma, field.valid))
    often = is_measured_often(moments, looked)
    total = moments.only(often)
    n = np.maximum(total.count, 2)[..., None]
    shared = missing.share_of_mean(total.mean_uv)
    unsure = np.hypot(np.nan_to_num(shared), np.nan_to_num(selection_sigma(total, looked)))[..., None]
    stresses, cov = total.reynolds_stresses, total.covariance
    products = np.stack(
        (cov[..., 0] ** 2 * 2, cov[..., 1] ** 2 * 2, cov[..., 0] * cov[..., 1] + cov[..., 2] ** 2), -1
    )
    spread = np.hypot(np.sqrt(products / (n - 1)), np.nan_to_num(missing.of_stresses(shared, stresses)))
    sigma = np.hypot(np.sqrt(cov[..., :2] / n), unsure)
    found = Found(grid, total.mean_uv, sigma, stresses, spread, total.count / len(frames))
    return found, [moments, vectors]


def by_ensemble(
    frames: list[tuple[Array, Array]], valid: Array | None, begun: list[Any], own: bool, still: Array | None = None
) -> dict[int, Found]:
    """Both sweeps of the verb; `own`: frames deformed by the fields of their pairs."""
    moments, vectors = begun
    grid = window_grid(SHAPE, 32, 0.5)
    known = np.where(moments.count[..., None] > 0.25 * len(frames), moments.mean_uv, np.nan)
    spread = prepare_pair(*frames[len(frames) // 2], valid, 32).spread_px2
    sweep = sweep_with(SHAPE, known, moments.reynolds_stresses, grid, spread)
    found: dict[int, Found] = {}
    if still is not None:
        valid = ~still if valid is None else valid & ~still
    for number in (1, 2):
        sums = EnsembleSums(sweep)
        for (a, b), (uv, sigma, good) in zip(frames, vectors, strict=True):
            good = good & np.isfinite(uv).all(-1) & np.isfinite(sigma).all(-1)
            told = np.where(good[..., None], uv, 0.0), np.where(good[..., None], sigma, 1.0)
            sums.add(a, b, valid, sweep.of_pair(*told, good, grid) if own else None)
        for side in (32, 16):
            field = ensemble_field(sums, side)
            sigma = np.hypot(field.sigma_px, field.resolution_px[..., None])
            moments_found = field.mean_px, sigma, field.stress_px2, field.stress_sigma_px2
            found[side] = Found(field.grid, *moments_found, field.correlation)
        if number == 1:
            sweep = next_sweep(ensemble_field(sums, 16), sweep)
    return found


def judged(found: Found, series: Series) -> dict[str, dict[str, Any]]:
    """Errors by distance from the wall."""
    grid, truth, table = found.grid, series.over(found.grid), {}
    x, y = np.meshgrid(grid.x_px, grid.y_px)
    away = (WALL - 0.5 - y) / grid.size_px
    judge = (x > EDGE_PX) & (x < SHAPE[1] - EDGE_PX) & (y > EDGE_PX)
    known = np.isfinite(found.mean).all(-1)
    for name, (low, high) in ZONES.items():
        zone = judge & (away >= low) & (away < high)
        here = zone & known
        row: dict[str, Any] = {"means": f"{int(here.sum())} of {int(zone.sum())}"}
        if here.any():
            true = np.nan_to_num(truth["mean"][here])
            error = found.mean[here] - true
            row["mean"] = error.mean(axis=0)
            at = np.nan_to_num(truth["at"][here])
            row["mean at"] = (found.mean[here] - at).mean(axis=0)
            row["at in 1, 2 sigma"] = [
                float(np.mean(np.abs(found.mean[here] - at) < k * found.sigma[here])) for k in (1, 2)
            ]
            row["rms"] = np.sqrt(np.square(error).mean(axis=0))
            row["sigma"] = np.sqrt(np.square(found.sigma[here]).mean(axis=0))
            row["in 1, 2 sigma"] = [float(np.mean(np.abs(error) < k * found.sigma[here])) for k in (1, 2)]
            for what in ("window", "points"):
                row[what] = np.nan_to_num(truth[what][here]).mean(axis=0)
                row[f"- {what}"] = found.stress[here].mean(axis=0) - row[what]
                off = found.stress[here] - np.nan_to_num(truth[what][here])
                row[f"{what} in sigma"] = float(np.mean(np.abs(off) < found.stress_sigma[here]))
            row["stress sigma"] = found.stress_sigma[here].mean(axis=0)
        table[name] = row
    return table


def shown(name: str, table: dict[str, dict[str, Any]]) -> None:
    """Print it."""
    print(f"\n{name}")
    for zone, row in table.items():
        parts = [f"{zone:13s} {row['means']:>11s}"]
        for key, value in row.items():
            if key != "means":
                values = " ".join(
                    f"{v:+.4f}" if "in" not in key.split() else f"{v:.2f}" for v in np.atleast_1d(value)
                )
                parts.append(f"{key} {values}")
        print(" | ".join(parts), flush=True)


def main() -> None:
    """Run from the command line."""
    given = options(
        __doc__, pairs=300, seed=0, told=False, background="none", vectors=[32, 16, 0], alone=False,
        no_ensemble=False, steady=False,
    )  # fmt: skip
    series = Series.of(given.pairs, given.seed)
    frames = series.cleaned(given.background)
    valid = (np.arange(SHAPE[0])[:, None] < WALL) & np.ones(SHAPE, bool) if given.told else None
    still = None
    if not given.alone:  # as the verb does, in frames as they are
        found_still = still_light(across_pairs(series.frames), np.ones(SHAPE, bool))
        still = np.zeros(SHAPE, bool) if found_still is None or given.told else found_still
    tables: dict[str, Any] = {}
    for side in given.vectors:
        found, begun = by_vectors(frames, valid, side, still)
        name = f"vectors {side or 'found'}"
        tables[name] = judged(found, series)
        shown(name, tables[name])
        if side != 32 or given.no_ensemble:
            continue
        for own in (True, False) if given.steady else (True,):
            for size, one in by_ensemble(frames, valid, begun, own, still).items():
                name = f"ensemble {size}{'' if own else ', one field for all'}"
                tables[name] = judged(one, series)
                shown(name, tables[name])
    keep(tables, given.out)


if __name__ == "__main__":
    main()
