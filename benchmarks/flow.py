"""The paper's third test without a bench: pairs of a known jet behind glass, evaluated as they are made.

    python -m benchmarks.flow two --pairs 1000 [--workers 2] [--window 32 | --found] [--steady] [-o jet.json]
    python -m benchmarks.flow three --pairs 100 --frames FOLDER

`two` and `three` are the stacks of 50 mm spheres 4 mm off a sheet of 1 mm, seen by 60 mm at f/22, focused between
the plane and its image behind the balls; a jet of a 5 mm pipe, turbulent, 0.03 particles per pixel, 12 bit, at
most 320 counts.  Each pair is a function of its number and the seed: workers and order change no bit.  Nothing is
kept but moments; with `--frames` pairs are written as .npy files instead and not evaluated.

The map is that of the true scene: what is judged are frames, correlation and statistics.  Errors of the mean are
in pixels of the plane, against the truths of `benchmarks.flow_truth`: the jet averaged over the window, the jet as
the evaluator's own response shows it, and the jet itself.  Stresses are measured over true, after noise
correction, against the same, and against what the response shows along slanted rays.  Their truths are moments of
the flow at the times of the pairs and of the vectors that counted, so that neither pays for the other's luck.

What a person wants to know is the jet itself, and rays that meet the sheet aslant show u - w dX/dz instead of u.
So single vectors and means are held to the jet itself as well, with all parts of sigma: `vectors_within`, the
share of single vectors within one sigma, `vectors_within_no_slant`, the same without the part of the slant, and
`mean_within`, of the means of chunks.  What flows through the sheet is assumed unless `--sigma-w` tells it; the
mean flow of the jet lies in the sheet, which is told.  `stress_ratio_slant_off` are stresses less what the slant
is said to add, over the jet's own.

`--found`: each place finds its window, as in `rtpiv evaluate`; `--chunk`: pairs whose mean is judged by itself;
`--pinhole`: without the lens's blur, three times as fast; `--frames FOLDER`: write frames, evaluate nothing.

Coverage is the share of vectors whose error against the own response is below sigma of the mean.  Vectors within
an eddy err together and a region behind glass holds few eddies, so each chunk of pairs is a mean of its own as
well: `covered_in_chunks` is the share over all of them, and `expected_in_chunks` what Student's t says of so few
pairs.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter
from scipy.special import stdtr

from benchmarks.flow_truth import Judge, Seen
from benchmarks.options import keep, options
from correction.evaluate.regions import regions_of
from correction.fitted.prepared import PreparedCorrection, PreparedCorrections
from correction.maps.slant import vector_slopes
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorField
from piv.statistics.moments import Moments
from piv.statistics.out_of_plane import OutOfPlane
from piv.statistics.unresolved import Unresolved
from rtpiv.analysis.pairs.slanted import perspective_error
from rtpiv.analysis.series.workers import worker_processes
from sim.demo.scenes import at_size, demo_scene
from sim.flow.fields import Flow
from sim.flow.images import FlowCamera
from sim.flow.jet import Jet
from sim.flow.modes import RandomModes
from sim.renderer.render import Aperture
from tracer.bodies import translate_by

Array = NDArray[Any]

GAP_MM = 4.0
DT_S = 500e-6
RATE_HZ = 10.0
LENS = Aperture(60.0, 22.0, 440.0)
BLURRED_COUNTS = 300.0  # f/22 blurs images to five pixels: the light of a sharp particle that peaks with so much
SEED = 14
CHUNK_PAIRS = 10
FIRST_STILL = 1_000_000  # numbers of pairs without seeding
RIM_FROM = 0.75
FOUND_PX = 16  # the smallest window that a place finds, as `rtpiv evaluate` has it


@dataclass(frozen=True)
class Case:
    """What is made and how it is evaluated; plain data for workers."""

    name: str
    size_px: int = 2016
    is_steady: bool = False
    is_pinhole: bool = False
    window_px: int = 32
    seed: int = SEED
    sigma_w_m_s: float | None = None
    finest_px: int | None = None

    @property
    def camera(self) -> FlowCamera:
        """The camera that sees the jet."""
        return _camera(self)

    @property
    def settings(self) -> PivSettings:
        """Windows down to the one asked for, or to those that places find."""
        return PivSettings(windows_px=(64, 32, *(self.window_px,) * 2), finest_px=self.finest_px)

    @property
    def known(self) -> OutOfPlane:
        """What is told of the flow through the sheet: the mean jet has none."""
        return OutOfPlane(self.sigma_w_m_s, 0.0)


@cache
def _camera(case: Case) -> FlowCamera:
    stack = at_size(demo_scene(f"{case.name}_spheres_500"), case.size_px)
    scene = stack.with_bodies([body.moved(translate_by((0.0, 0.0, GAP_MM))) for body in stack.bodies])
    flow = Flow(Jet(), None if case.is_steady else RandomModes(8.0, seed=case.seed))
    if case.is_pinhole:
        return FlowCamera(scene, flow, seed=case.seed)
    return FlowCamera(scene, flow, aperture=LENS, particle_counts=BLURRED_COUNTS, seed=case.seed)


@cache
def _correction(case: Case) -> PreparedCorrection:
    return PreparedCorrections().of(case.camera.scene)


@cache
def _background(case: Case) -> tuple[Array, Array]:
    """What stands still, of each pulse: the mean of eight pairs without seeding."""
    frames = [case.camera.pair(FIRST_STILL + k, DT_S, 0.0, is_seeded=False) for k in range(8)]
    first, second = (np.asarray(np.mean([pair[pulse] for pair in frames], axis=0), np.float32) for pulse in (0, 1))
    return first, second


def clean_pair(case: Case, number: int) -> list[Array]:
    """Make a pair, take off what stands still, correct."""
    made, corrector = case.camera.pair(number, DT_S, number / RATE_HZ), _correction(case).corrector
    return [
        corrector(np.asarray(frame - background, np.float32))
        for frame, background in zip(made, _background(case), strict=True)
    ]


def vectors(case: Case, number: int) -> VectorField:
    """Make a pair, clean and correlate it."""
    return evaluate_pair(*clean_pair(case, number), _correction(case).corrector.recovered, case.settings)


class Sums(NamedTuple):
    """Moments of the same vectors [px], as measured and as they could be seen; then whether sigma held them."""

    found: Moments
    itself: Moments
    window: Moments
    response: Moments
    seen: Moments
    error: Moments  # of what was measured less what could be seen along the rays
    within: Moments  # one sigma of the flow itself
    within_no_slant: Moments
    unresolved: Unresolved

    def merge_with(self, other: "Sums") -> "Sums":
        """Of both."""
        parts: list[Any] = [one.merge_with(two) for one, two in zip(self, other, strict=True)]
        return Sums(*parts)


@cache
def _judge(case: Case, is_mean: bool = False) -> Judge:
    """Of the flow, or of its mean."""
    camera, plane = case.camera, _correction(case).corrector.map.grid
    windows = case.settings.result_grid(plane.shape)
    flow = Flow(camera.flow.base) if is_mean else camera.flow
    nodes = np.ix_(np.rint(windows.y_px).astype(int), np.rint(windows.x_px).astype(int))
    pixels = _correction(case).corrector.map.pixel[0][nodes]
    slopes = camera.slopes(pixels.reshape(-1, 2)).reshape(pixels.shape)
    return Judge(flow, camera.sheet, plane, windows, case.settings, DT_S, slopes)


def moments(case: Case, numbers: range) -> Sums:
    """Moments of the displacements [px] of pairs, in their order."""
    total: Sums | None = None
    for number in numbers:
        field = vectors(case, number)
        uv = np.stack((field.u_px, field.v_px), axis=-1)
        sigma = np.stack((field.sigma_u_px, field.sigma_v_px), axis=-1)
        seen = _judge(case).at(number / RATE_HZ, field.added_passes)
        prepared, plain = _correction(case), field.total_sigma_px
        slant = perspective_error(field, prepared.corrector.map, prepared.scene, case.settings, case.known, DT_S)
        inside = [
            np.where(np.isnan(part), np.nan, np.abs(uv - seen.itself) < part)
            for part in (np.hypot(plain, slant.sigma_px), plain)
        ]
        assert field.steady_px is not None
        apart = max(1, round(0.5 * field.window_px / field.step_px))
        one = Sums(
            Moments.of(uv, field.valid, sigma),
            *(Moments.of(true, field.valid) for true in seen),
            Moments.of(uv - seen.seen, field.valid, sigma),
            *(Moments.of(share, field.valid) for share in inside),
            Unresolved.of(uv, field.valid, field.steady_px, apart),
        )
        total = one if total is None else total.merge_with(one)
    assert total is not None
    return total


def chunks(pairs: int, chunk: int) -> Iterator[range]:
    """Fixed chunks, so that bits do not depend on workers."""
    for first in range(0, pairs, chunk):
        yield range(first, min(first + chunk, pairs))


def measured(case: Case, pairs: int, workers: int, chunk: int = CHUNK_PAIRS) -> list[Sums]:
    """Moments of each chunk of pairs, on so many processes."""
    parts: list[Sums] = []
    with worker_processes(workers) as pool:
        futures = [pool.submit(moments, case, numbers) for numbers in chunks(pairs, chunk)]
        for count, future in enumerate(futures, start=1):
            parts.append(future.result())
            print(f"{min(count * chunk, pairs)} of {pairs} pairs", flush=True)
    return parts


def judged(case: Case, parts: Sequence[Sums]) -> dict[str, Any]:
    """Errors of mean and stresses by region, in pixels."""
    total = parts[0]
    for part in parts[1:]:
        total = total.merge_with(part)
    found = total.found
    prepared, camera = _correction(case), case.camera
    first = vectors(case, 0)
    regions = regions_of(first, prepared.corrector.map, camera.scene)
    true = _judge(case, is_mean=True).at(0.0, first.added_passes)
    enough = found.count >= max(2, 0.5 * found.count.max())
    inside = minimum_filter(enough, 3, mode="constant") if case.window_px >= 32 else enough
    places = {
        "beside": regions.region == 1,
        "centre": (regions.region == 2) & (regions.radius < RIM_FROM),
        "rim": (regions.region == 2) & (regions.radius >= RIM_FROM),
    }
    slope = vector_slopes(
        prepared.corrector.map, camera.scene, case.settings.result_grid(prepared.corrector.map.grid.shape),
        case.settings.window_sigma,
    ) * (1.0, -1.0)  # v down  # fmt: skip
    px_per_m_s = 1e3 * DT_S * prepared.corrector.map.grid.px_per_mm
    too_much = case.known.of_stresses(found.reynolds_stresses / px_per_m_s**2, slope).bias * px_per_m_s**2
    stated: dict[str, Any] = {"case": case.name, "pairs": int(found.count.max()), "window_px": case.window_px}
    for name, here in places.items():
        use = here & inside
        if not use.any():
            continue
        random = _sigma(found)[use]
        error = {truth: found.mean_uv[use] - getattr(true, truth)[use] for truth in Seen._fields}
        stresses = found.reynolds_stresses[use]
        stated[name] = {
            "vectors": int(use.sum()),
            "bias_px": error["window"].mean(axis=0).round(4).tolist(),
            "rms_px": _rms(error["window"]),
            "sampling_px": _rms(random),
            "against_response_rms_px": _rms(error["response"]),
            "against_jet_rms_px": _rms(error["itself"]),
            "covered_share": float(np.mean(np.abs(error["response"]) < random)),
            **_covered([part.found for part in parts], true.response, use),
            "vectors_within": float(np.nanmean(total.within.mean_uv[use])),
            "vectors_within_no_slant": float(np.nanmean(total.within_no_slant.mean_uv[use])),
            "mean_within": _mean_within(parts, true.itself, use),
            "stress_ratio": _slope(stresses, total.window.covariance[use]),
            "stress_ratio_response": _slope(stresses, total.response.covariance[use]),
            "stress_ratio_seen": _slope(stresses, total.seen.covariance[use]),
            "stress_ratio_itself": _slope(stresses, total.itself.covariance[use]),
            "stress_ratio_slant_off": _slope(stresses - too_much[use], total.itself.covariance[use]),
            "stress_ratio_seen_noise_included": _slope(found.covariance[use], total.seen.covariance[use]),
            "pair_error_px": _rms(np.sqrt(total.error.covariance[use][:, :2])),
            "pair_sigma_px": _rms(np.sqrt(found.noise[use])),
        }
    return stated


def _covered(parts: Sequence[Moments], true: Array, use: Array) -> dict[str, float]:
    """Share of vectors of whole chunks within sigma of their own mean, and what independent pairs would give."""
    full = max(int(part.count.max()) for part in parts)
    if full < 3:
        return {}
    told = [part for part in parts if int(part.count.max()) == full]
    inside = [np.abs(part.mean_uv - true)[use] < _sigma(part)[use] for part in told]
    return {
        "covered_in_chunks": float(np.mean(inside)),
        "chunks": len(told),
        "expected_in_chunks": round(float(2.0 * stdtr(full - 1, 1.0) - 1.0), 3),
    }


def _mean_within(parts: Sequence[Sums], true: Array, use: Array) -> float:
    """Share of vectors of the means of all chunks within one sigma of the flow's own mean, with all its parts."""
    inside = []
    for part in parts:
        mean, random = part.found.mean_uv, _sigma(part.found)
        unsure = np.nan_to_num(part.unresolved.share_of_mean(mean))[..., None]
        inside.append(np.abs(mean - true)[use] < np.hypot(random, unsure)[use])
    return float(np.mean(inside))


def _sigma(found: Moments) -> Array:
    """Of the mean of pairs that know nothing of each other."""
    return np.sqrt(np.maximum(found.covariance[..., :2], 0.0) / np.maximum(found.count[..., None], 1))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def _slope(found: Array, wanted: Array) -> list[float]:
    """Measured over true R_uu, R_vv, R_uv: the slope through zero, so that signs do not cancel."""
    known = np.isfinite(found).all(axis=-1) & np.isfinite(wanted).all(axis=-1)
    squares = np.maximum(np.square(wanted[known]).sum(axis=0), 1e-30)
    return np.asarray((found[known] * wanted[known]).sum(axis=0) / squares).round(3).tolist()


def write_frames(case: Case, numbers: range, folder: Path) -> None:
    """Write pairs as FOLDER/pair_00000_a.npy and _b.npy."""
    for number in numbers:
        for letter, frame in zip("ab", case.camera.pair(number, DT_S, number / RATE_HZ), strict=True):
            np.save(folder / f"pair_{number:05d}_{letter}.npy", frame)


def main() -> None:
    """Make and judge."""
    asked = options(
        __doc__, name=("two", "three"), pairs=20, workers=2, size=2016, window=32, found=False, chunk=CHUNK_PAIRS,
        steady=False, pinhole=False, sigma_w=float, frames=Path,
    )  # fmt: skip
    finest = FOUND_PX if asked.found else None
    case = Case(asked.name, asked.size, asked.steady, asked.pinhole, asked.window, SEED, asked.sigma_w, finest)
    if asked.frames is not None:
        asked.frames.mkdir(parents=True, exist_ok=True)
        with worker_processes(asked.workers) as pool:
            for future in [pool.submit(write_frames, case, part, asked.frames) for part in chunks(asked.pairs, 5)]:
                future.result()
        return
    keep(judged(case, measured(case, asked.pairs, asked.workers, asked.chunk)), asked.out)


if __name__ == "__main__":
    main()
