"""Errors over the sigma that is stated, by flow and size of particle image: vectors, means and ensembles.

    python -m tests.piv.sigma_table [--kind vectors|means|ensembles] [--flow 'turb*'] [--image clear] [--seeds 2]

Frames are drawn here: uneven particles in a sheet of Gaussian profile, integrated over pixels, shot noise and read
noise, 10 bit; a few particles leave the sheet. Of each case: rms of the error [px], rms of the error over rms of
sigma, share of components within one sigma, share of valid vectors off by more than 5 sigma and 0.3 px. Seeds of
the default are not those by which anything was chosen (`--first-seed`).
"""

import argparse
from fnmatch import fnmatch

import numpy as np

from piv.correlation.finer_waves import Evaluated
from piv.correlation.pair import evaluate_pair
from piv.correlation.prepare import prepare_pair
from piv.correlation.settings import FOUND_WINDOWS
from piv.correlation.windows import WindowGrid
from piv.statistics.denoised_components import NoiseFilter
from piv.statistics.denoised_mean import DenoisedMean
from piv.statistics.effective_samples import EffectiveSamples
from piv.statistics.ensemble import EnsembleSums
from piv.statistics.ensemble_field import ensemble_field, next_sweep
from piv.statistics.moments import Moments
from piv.statistics.short_waves import ShortWaves
from piv.statistics.sweep import sweep_with
from piv.statistics.unresolved import Unresolved, selection_sigma
from tests.piv.conftest import draw
from tests.piv.correlation import flows

SIDE, EDGE, MARGIN = 256, 32, 24  # of frames; what is not judged; particles beyond the frame [px]
DIAMETERS = 1.2, 1.6, 2.4, 4.0, 8.0, 12.0
IMAGES = {"clear": (4.0, 0.02), "noisy": (40.0, 0.15)}  # read noise [counts of 1023], share that leaves the sheet
PAIRS = 12  # of a mean


def flows_of(seed):
    """Displacement fields by name."""
    rng = np.random.default_rng(seed)
    return {
        "uniform": flows.uniform(*rng.uniform(-4.0, 4.0, 2)),
        "shear": lambda u, v: (2.0 + 0.027 * (v - 120), 0.011 * (u - 130)),
        "turbulence k^-5/3": flows.turbulence(seed, 1.8, 260, 42),
        "turbulence k^-5/3, fine": flows.turbulence(seed, 1.6, 220, 26),
        "turbulence k^-4": flows.endless(seed, 1.2, 44.0, -4.0),
        "vortices": flows.vortices(seed, (22.0, 50.0), 8, 0.16, SIDE),
        "shear layer": flows.shear_layer(3.4, 11.0, 0.45, SIDE / 2),
        "weak waves": _added(flows.uniform(1.3, -0.7), flows.turbulence(seed, 0.06, 90, 45)),
    }


def _added(one, other):
    """Sum of two fields: a uniform flow behind glass has detail that is weaker than the noise of a vector."""
    return lambda u, v: [a + b for a, b in zip(one(u, v), other(u, v), strict=True)]


def pair_of(flow, seed, diameter_px, image):
    """Frames A and B (uint16) of a flow."""
    rng = np.random.default_rng(seed)
    read, leave = IMAGES[image]
    width = SIDE + 2 * MARGIN
    count = rng.poisson(0.04 * min(1.0, (3.0 / diameter_px) ** 1.3) * width**2)
    place = rng.uniform(-MARGIN, SIDE + MARGIN, (2, count))
    depth = rng.normal(0.0, 0.6, count)
    bright = 500.0 * rng.uniform(0.5, 1.2, count)
    shift = np.stack(np.broadcast_arrays(*flow(*place)))
    gone = rng.uniform(size=count) < leave
    other = np.where(gone, rng.uniform(-MARGIN, SIDE + MARGIN, (2, count)), place)
    frames = []
    for at, sign in ((place, -0.5), (other, 0.5)):
        light = 40.0 + draw((SIDE, SIDE), *(at + sign * shift), diameter_px, bright * np.exp(-(depth**2)))
        light = rng.normal(light, np.sqrt(read**2 + 0.5 * light))
        frames.append(np.clip(np.rint(light), 0, 1023).astype(np.uint16))
    return frames


def inner(x_px, y_px):
    """Places that are judged."""
    x, y = np.meshgrid(x_px, y_px)
    return (np.minimum(x, y) > EDGE) & (np.maximum(x, y) < SIDE - EDGE), x, y


def of_vectors(flow, seed, diameter_px, image):
    """Errors and sigma (n, 2) of single vectors."""
    field = evaluate_pair(*pair_of(flow(seed), seed, diameter_px, image), threads=1)
    here, x, y = inner(field.x_px, field.y_px)
    off = np.stack((field.u_px, field.v_px), -1) - np.stack(np.broadcast_arrays(*flow(seed)(x, y)), -1)
    here &= field.valid
    return off[here], field.total_sigma_px[here]


def series(flow, seed, diameter_px, image):
    """Pairs of a flow that is the same in all of them."""
    return [pair_of(flow(seed), 1000 * seed + k, diameter_px, image) for k in range(PAIRS)]


def mean_of(pairs):
    """The last field of pairs, moments of their vectors, their mean, and its sigma."""
    moments = before = looked = missing = short = None
    for pair in pairs:
        field = evaluate_pair(*pair, threads=1)
        vectors = np.stack((field.u_px, field.v_px), -1)
        sigma = np.stack((field.sigma_u_px, field.sigma_v_px), -1)
        apart = max(1, round(0.5 * field.window_px / field.step_px))
        one = Moments.of(vectors, field.valid, sigma)
        rough = Moments.of(
            field.unfiltered_px, field.valid, np.repeat(field.unfiltered_sigma_px[..., None], 2, axis=-1)
        )
        part = Unresolved.of(vectors, field.valid, field.unfiltered_steady_px, apart)
        usual = field.side_px == field.window_px
        how = Evaluated.usual(FOUND_WINDOWS, field.step_px)
        waves = ShortWaves.of(field.unfiltered_px, field.valid, field.resolution_px, usual, how)
        short = waves if short is None else short.merge_with(waves)
        before = rough if before is None else before.merge_with(rough)
        moments = one if moments is None else moments.merge_with(one)
        missing = part if missing is None else missing.merge_with(part)
        looked = field.asked.astype(int) + (0 if looked is None else looked)
    how = NoiseFilter.of(FOUND_WINDOWS, field.step_px, FOUND_WINDOWS.denoise)
    mean = DenoisedMean.of(before, moments, how)
    independent = EffectiveSamples(np.maximum(moments.count, 1)[..., None], "", converged=True)
    lost = np.hypot(np.nan_to_num(selection_sigma(moments, looked)), mean.taken)
    unresolved = np.maximum(missing.share_of_mean(mean.mean), short.short_wave_sigma(before.mean_uv))
    unsure = np.hypot(unresolved, lost)
    return field, moments, mean.mean, np.hypot(mean.sigma(moments, independent), unsure[..., None])


def of_means(flow, seed, diameter_px, image):
    """Errors and sigma (n, 2) of means."""
    field, moments, mean, sigma = mean_of(series(flow, seed, diameter_px, image))
    here, x, y = inner(field.x_px, field.y_px)
    off = mean - np.stack(np.broadcast_arrays(*flow(seed)(x, y)), -1)
    here &= moments.count > PAIRS // 2
    return off[here], sigma[here]


def of_ensembles(flow, seed, diameter_px, image, window_px=16):
    """Errors and sigma (n, 2) of ensemble correlation."""
    pairs = series(flow, seed, diameter_px, image)
    field, moments, mean, _ = mean_of(pairs)
    grid = WindowGrid(*(np.rint(at - (field.window_px - 1) / 2).astype(int) for at in (field.y_px, field.x_px)),
                      field.window_px, field.step_px)  # fmt: skip
    sweep = sweep_with(
        (SIDE, SIDE),
        mean,
        moments.reynolds_stresses,
        grid,
        prepare_pair(*pairs[0], None, 32).spread_px2,
    )
    for number in range(3):
        sums = EnsembleSums(sweep)
        for pair in pairs:
            sums.add(*pair, threads=1)
        found = ensemble_field(sums, window_px, threads=1)
        sweep = next_sweep(found, sweep) if number < 2 else sweep
    here, x, y = inner(found.grid.x_px, found.grid.y_px)
    off = found.mean_px - np.stack(np.broadcast_arrays(*flow(seed)(x, y)), -1)
    here &= found.valid
    return off[here], np.hypot(found.sigma_px, found.resolution_px[..., None])[here]


KINDS = {"vectors": of_vectors, "means": of_means, "ensembles": of_ensembles}


def figures(off, sigma):
    """Rms error, ratio, share within one sigma, share far off, sigmas known."""
    known = np.isfinite(off).all(axis=-1) & np.isfinite(sigma).all(axis=-1)
    off, sigma = off[known], sigma[known]
    rms = np.sqrt(np.mean(off**2))
    far = (np.linalg.norm(off, axis=-1) > 0.3) & ((np.abs(off) / sigma).max(axis=-1) > 5.0)
    return rms, rms / np.sqrt(np.mean(sigma**2)), np.mean(np.abs(off) < sigma), np.mean(far)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", default="vectors", choices=KINDS)
    parser.add_argument("--flow", default="*")
    parser.add_argument("--image", default="*")
    parser.add_argument("--diameter", type=float, nargs="*", default=DIAMETERS)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=71000)
    told = parser.parse_args()
    print(f"{told.kind:28}" + "".join(f"{f'{d:g} px':^22}" for d in told.diameter))
    total = good = 0
    whole = {}
    for image in (name for name in IMAGES if fnmatch(name, told.image)):
        for name in (name for name in flows_of(0) if fnmatch(name, told.flow)):
            line = f"{name + ', ' + image:28}"
            for diameter in told.diameter:
                seeds = [told.first_seed + 17 * k + 3 * round(10 * diameter) for k in range(told.seeds)]
                parts = [KINDS[told.kind](lambda s, n=name: flows_of(s)[n], s, diameter, image) for s in seeds]
                off, sigma = (np.concatenate(part) for part in zip(*parts, strict=True))
                whole.setdefault(diameter, []).append((off, sigma))
                rms, ratio, within, far = figures(off, sigma)
                is_good = bool(0.85 <= ratio <= 1.15 and 0.62 <= within <= 0.73)
                total, good = total + 1, good + is_good
                line += f" {rms:.3f} {ratio:.2f} {100 * within:2.0f}%{100 * far:4.1f}{' *'[is_good]}"
            print(line, flush=True)
    line = f"{'all':28}"
    for cases in whole.values():
        rms, ratio, within, far = figures(*(np.concatenate(part) for part in zip(*cases, strict=True)))
        line += f" {rms:.3f} {ratio:.2f} {100 * within:2.0f}%{100 * far:4.1f} "
    print(line)
    print(f"{good} of {total} within 0.85 to 1.15 and 62 to 73 %")


if __name__ == "__main__":
    main()
