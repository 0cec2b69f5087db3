"""Mean of vectors against ensemble correlation, on the known jet behind glass.

    python -m benchmarks.ensemble two --pairs 100 --size 1008 [--steady] [-o ensemble.json]

Frames are those of `benchmarks.flow`. Errors of both routes are rms in pixels of the plane, against the mean
of the flow as it was at the times of the pairs (so that neither pays for the other's luck), at points, not
averaged over windows; sheets average over their thickness.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.flow import DT_S, RATE_HZ, RIM_FROM, Case, _correction, clean_pair
from benchmarks.options import keep, options
from correction.evaluate.regions import Region, regions_of
from correction.grid import PlaneGrid
from piv.correlation.pair import evaluate_pair
from piv.correlation.prepare import prepare_pair
from piv.correlation.vector_field import VectorField, VectorFlag
from piv.correlation.windows import WindowGrid, window_grid
from piv.statistics.ensemble import EnsembleSums
from piv.statistics.ensemble_field import ensemble_field, next_sweep
from piv.statistics.moments import Moments
from piv.statistics.sweep import sweep_with

Array = NDArray[Any]
WINDOWS_PX = (32, 16, 8)


def true_mean(case: Case, grid: PlaneGrid, windows: WindowGrid, pairs: int) -> tuple[Array, Array]:
    """Mean displacement (ny, nx, 2) [px, v down] and stresses (ny, nx, 3) of the flow when pairs were taken."""
    plane = grid.to_mm(np.stack(np.meshgrid(windows.x_px, windows.y_px), axis=-1).reshape(-1, 2))
    points = np.column_stack((plane, np.full(len(plane), case.camera.sheet.offset_mm)))
    total: Moments | None = None
    for number in range(pairs):
        velocity = case.camera.flow.velocity(points, number / RATE_HZ + 0.5 * DT_S)[:, :2]
        shift = (velocity * [1.0, -1.0] * DT_S * grid.px_per_mm).reshape(*windows.shape, 2)
        total = Moments.of(shift) if total is None else total.add(shift)
    assert total is not None
    return total.mean_uv, total.covariance


def judged(
    case: Case, windows: WindowGrid, mean: Array, stresses: Array, sigma: Array, pairs: int
) -> dict[str, Any]:
    """Errors by region."""
    prepared_map = _correction(case).corrector.map
    wanted, fluctuation = true_mean(case, prepared_map.grid, windows, pairs)
    known = np.isfinite(mean).all(axis=-1)
    nothing = np.full(windows.shape, np.nan)
    flags = np.where(known, VectorFlag.VALID, VectorFlag.MASKED).astype(np.uint8)
    field = VectorField(
        windows.x_px, windows.y_px, mean[..., 0], mean[..., 1], flags, nothing, nothing, sigma[..., 0],
        sigma[..., 1], nothing, windows.size_px, windows.step_px, 0,
    )  # fmt: skip
    regions = regions_of(field, prepared_map, case.camera.scene)
    jet = np.linalg.norm(wanted, axis=-1) > 1.0
    parts = {
        "beside": (regions.region == Region.DIRECT) & jet,
        "centre": (regions.region == Region.GLASS) & (regions.radius < RIM_FROM) & jet,
        "rim": (regions.region == Region.GLASS) & (regions.radius >= RIM_FROM) & jet,
    }
    found: dict[str, Any] = {}
    for name, where in parts.items():
        here = where & known
        if not here.any():
            continue
        error = (mean - wanted)[here]
        squares = np.square(fluctuation[here]).sum(axis=0)
        found[name] = {
            "vectors": int(here.sum()),
            "of": int(where.sum()),
            "rms_px": round(float(np.sqrt(np.mean(error**2))), 4),
            "median_px": round(float(np.median(np.abs(error))), 4),
            "within_sigma": round(float(np.mean(np.abs(error) < sigma[here])), 2),
            "stress_ratio": np.round((stresses[here] * fluctuation[here]).sum(axis=0) / squares, 3).tolist()
            if (squares > 0).all()
            else None,
        }
    return found


def compared(case: Case, pairs: int) -> dict[str, Any]:
    """Both routes on the same pairs."""
    corrector = _correction(case).corrector
    windows = window_grid(corrector.map.grid.shape, case.window_px, case.settings.overlap)
    moments = Moments.nothing(windows.shape)
    frames, vectors = [], []
    for number in range(pairs):
        a, b = clean_pair(case, number)
        field = evaluate_pair(a, b, corrector.recovered, case.settings)
        uv = np.stack((field.u_px, field.v_px), axis=-1)
        sigma = np.stack((field.sigma_u_px, field.sigma_v_px), axis=-1)
        moments = moments.add(uv, field.valid, sigma)
        frames.append((a.astype(np.float16), b.astype(np.float16)))
        vectors.append((uv, sigma, field.valid))
        print(f"{number + 1} of {pairs} pairs", flush=True)
    noise = np.sqrt(moments.noise / np.maximum(moments.count, 1)[..., None])
    result: dict[str, Any] = {"case": case.name, "size_px": case.size_px, "pairs": pairs, "steady": case.is_steady}
    result["vectors 32"] = judged(case, windows, moments.mean_uv, moments.reynolds_stresses, noise, pairs)
    known = np.where(moments.count[..., None] > 0.25 * pairs, moments.mean_uv, np.nan)
    first = [np.asarray(frame, np.float32) for frame in frames[0]]
    spread = prepare_pair(first[0], first[1], corrector.recovered, 32).spread_px2
    sweep = sweep_with(corrector.map.grid.shape, known, moments.reynolds_stresses, windows, spread)
    for number, own in ((1, False), (2, False), (3, True)):
        sums = EnsembleSums(sweep)
        for (a, b), (uv, sigma, good) in zip(frames, vectors, strict=True):
            of_pair = sweep.of_pair(uv, sigma, good, windows) if own else None
            sums.add(a.astype(np.float32), b.astype(np.float32), corrector.recovered, of_pair)
        for side in WINDOWS_PX:
            found = ensemble_field(sums, side)
            name = f"ensemble {side}, sweep {number}{', fields of pairs' if own else ''}"
            result[name] = judged(case, found.grid, found.mean_px, found.stress_px2, found.sigma_px, pairs)
        print(f"sweep {number}", flush=True)
        sweep = next_sweep(ensemble_field(sums, 16), sweep)
    return result


def main() -> None:
    """Run from the command line."""
    given = options(__doc__, case=("two", "three"), pairs=100, size=1008, steady=False, pinhole=False)
    keep(compared(Case(given.case, given.size, given.steady, given.pinhole), given.pairs), given.out)


if __name__ == "__main__":
    main()
