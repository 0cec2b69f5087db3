"""The paper's third test without a bench: pairs of a known jet behind glass, evaluated as they are made.

    python -m benchmarks.flow two --pairs 1000 [--workers 2] [--window 32] [--steady] [-o jet.json]
    python -m benchmarks.flow three --pairs 100 --frames FOLDER

`two` and `three` are the stacks of 50 mm spheres 4 mm off a sheet of 1 mm, seen by 60 mm at f/22, focused between
the plane and its image behind the balls; a jet of a 5 mm pipe, turbulent, 0.03 particles per pixel, 12 bit, at
most 320 counts.  Each pair is a function of its number and the seed: workers and order change no bit.  Nothing is
kept but moments; with `--frames` pairs are written as .npy files instead and not evaluated.

The map is that of the true scene: what is judged are frames, correlation and statistics.  Errors are in pixels of
the plane: against the jet averaged over the window (`sim.flow.truth`), and against the jet itself.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from correction.evaluate.regions import regions_of
from correction.flow.moments import Moments
from correction.piv.pair import evaluate_pair
from correction.piv.settings import PivSettings
from correction.piv.vector_field import VectorField
from correction.prepared import PreparedCorrection, PreparedCorrections
from daq.analysis.series.workers import worker_processes
from sim.demo.scenes import at_size, named_scene
from sim.flow.fields import Flow
from sim.flow.images import FlowCamera
from sim.flow.jet import Jet
from sim.flow.modes import RandomModes
from sim.flow.particles import LightSheet
from sim.flow.truth import window_places, windowed_mean, windowed_stresses
from sim.renderer.render import Aperture
from tracer.bodies import shifted_by

Array = NDArray[Any]

GAP_MM = 4.0
DT_S = 500e-6
RATE_HZ = 10.0
LENS = Aperture(60.0, 22.0, 440.0)
BLURRED_COUNTS = 300.0  # f/22 blurs images to five pixels: the light of a sharp particle that peaks with so much
SEED = 14
FIRST_STILL = 1_000_000  # numbers of pairs without seeding
RIM_FROM = 0.75


@dataclass(frozen=True)
class Case:
    """What is made and how it is evaluated; plain data for workers."""

    name: str
    size_px: int = 2016
    is_steady: bool = False
    is_pinhole: bool = False
    window_px: int = 32
    seed: int = SEED

    @property
    def camera(self) -> FlowCamera:
        """The camera that sees the jet."""
        return _camera(self)

    @property
    def settings(self) -> PivSettings:
        """Windows down to the one asked for."""
        return PivSettings(windows_px=(64, 32, *(self.window_px,) * 2))


@cache
def _camera(case: Case) -> FlowCamera:
    stack = at_size(named_scene(f"{case.name}_spheres_500"), case.size_px)
    scene = stack.with_bodies([body.moved(shifted_by((0.0, 0.0, GAP_MM))) for body in stack.bodies])
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


def vectors(case: Case, number: int) -> VectorField:
    """Make a pair, take off what stands still, correct, correlate."""
    corrector = _correction(case).corrector
    clean = [
        corrector(np.asarray(frame - background, np.float32))
        for frame, background in zip(
            case.camera.pair(number, DT_S, number / RATE_HZ), _background(case), strict=True
        )
    ]
    return evaluate_pair(clean[0], clean[1], corrector.recovered, case.settings)


def moments(case: Case, numbers: range) -> Moments:
    """Moments of the displacements [px] of pairs, in their order."""
    total: Moments | None = None
    for number in numbers:
        field = vectors(case, number)
        uv = np.stack((field.u_px, field.v_px), axis=-1)
        sigma = np.stack((field.sigma_u_px, field.sigma_v_px), axis=-1)
        total = Moments.of(uv, field.valid, sigma) if total is None else total.add(uv, field.valid, sigma)
    assert total is not None
    return total


def chunks(pairs: int, chunk: int) -> Iterator[range]:
    """Fixed chunks, so that bits do not depend on workers."""
    for first in range(0, pairs, chunk):
        yield range(first, min(first + chunk, pairs))


def measured(case: Case, pairs: int, workers: int, chunk: int = 10) -> Moments:
    """Moments of all pairs, on so many processes."""
    with worker_processes(workers) as pool:
        futures = [pool.submit(moments, case, numbers) for numbers in chunks(pairs, chunk)]
        total = futures[0].result()
        for count, future in enumerate(futures[1:], start=2):
            total = total.merged(future.result())
            print(f"{min(count * chunk, pairs)} of {pairs} pairs", flush=True)
    return total


def judged(case: Case, found: Moments) -> dict[str, Any]:
    """Errors of mean and stresses by region, in pixels."""
    prepared, camera = _correction(case), case.camera
    grid = prepared.corrector.map.grid
    field = vectors(case, 0)
    regions = regions_of(field, prepared.corrector.map, camera.scene)
    columns, rows = np.meshgrid(field.x_px, field.y_px)
    plane = grid.to_mm(np.stack((columns, rows), axis=-1).reshape(-1, 2))
    points = np.column_stack((plane, np.full(len(plane), camera.sheet.offset_mm)))
    px = DT_S * grid.px_per_mm
    window_mm = case.window_px / grid.px_per_mm
    weight_mm = case.settings.window_sigma * window_mm / np.sqrt(2.0)  # both frames carry the weight
    places, weights = window_places(window_mm, LightSheet(), weight_mm)
    shape = (*columns.shape, 2)
    flip = np.array([1.0, -1.0])
    truth = (windowed_mean(camera.flow, points, places, weights)[:, :2] * flip * px).reshape(shape)
    jet = (camera.flow.mean(points)[:, :2] * flip * px).reshape(shape)
    stresses = windowed_stresses(camera.flow, points, places, weights) * px * px
    wanted = np.stack((stresses[:, 0, 0], stresses[:, 1, 1], -stresses[:, 0, 1]), axis=-1).reshape(*shape[:2], 3)
    point = camera.flow.stresses(points) * px * px
    unfiltered = np.stack((point[:, 0, 0], point[:, 1, 1], -point[:, 0, 1]), axis=-1).reshape(*shape[:2], 3)
    enough = found.count >= max(2, 0.5 * found.count.max())
    inside = minimum_filter(enough, 3, mode="constant") if case.window_px >= 32 else enough
    parts = {
        "beside": regions.region == 1,
        "centre": (regions.region == 2) & (regions.radius < RIM_FROM),
        "rim": (regions.region == 2) & (regions.radius >= RIM_FROM),
    }
    noise = np.sqrt(np.maximum(found.covariance[..., :2], 0.0) / np.maximum(found.count[..., None], 1))
    out: dict[str, Any] = {"case": case.name, "pairs": int(found.count.max()), "window_px": case.window_px}
    for name, here in parts.items():
        use = here & inside
        if not use.any():
            continue
        error = found.mean_uv[use] - truth[use]
        out[name] = {
            "vectors": int(use.sum()),
            "bias_px": error.mean(axis=0).round(4).tolist(),
            "rms_px": float(np.sqrt(np.mean(np.square(error)))),
            "sampling_px": float(np.sqrt(np.mean(np.square(noise[use])))),
            "against_jet_rms_px": float(np.sqrt(np.mean(np.square(found.mean_uv[use] - jet[use])))),
            "covered_share": float(np.mean(np.abs(error) < noise[use])),
            "stress_ratio": _slope(found.reynolds_stresses[use], wanted[use]),
            "stress_ratio_unfiltered": _slope(found.reynolds_stresses[use], unfiltered[use]),
        }
    return out


def _slope(found: Array, wanted: Array) -> list[float]:
    """Measured over true R_uu, R_vv, R_uv: the slope through zero, so that signs do not cancel."""
    known = np.isfinite(found).all(axis=-1)
    squares = np.maximum(np.square(wanted[known]).sum(axis=0), 1e-30)
    return np.asarray((found[known] * wanted[known]).sum(axis=0) / squares).round(3).tolist()


def write_frames(case: Case, numbers: range, folder: Path) -> None:
    """Write pairs as FOLDER/pair_00000_a.npy and _b.npy."""
    for number in numbers:
        for letter, frame in zip("ab", case.camera.pair(number, DT_S, number / RATE_HZ), strict=True):
            np.save(folder / f"pair_{number:05d}_{letter}.npy", frame)


def main() -> None:
    """Make and judge."""
    parser = argparse.ArgumentParser(description="A known jet behind glass: pairs, vectors, mean, stresses.")
    parser.add_argument("name", choices=("two", "three"))
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--size", type=int, default=2016, help="pixels across; 2016 is the paper's")
    parser.add_argument("--window", type=int, default=32)
    parser.add_argument("--steady", action="store_true", help="without turbulence")
    parser.add_argument("--pinhole", action="store_true", help="without the lens's blur; three times as fast")
    parser.add_argument("--frames", type=Path, help="write frames here, evaluate nothing")
    parser.add_argument("-o", "--out", type=Path, help="write the figures as JSON")
    asked = parser.parse_args()
    case = Case(asked.name, asked.size, asked.steady, asked.pinhole, asked.window)
    if asked.frames is not None:
        asked.frames.mkdir(parents=True, exist_ok=True)
        with worker_processes(asked.workers) as pool:
            for future in [pool.submit(write_frames, case, part, asked.frames) for part in chunks(asked.pairs, 5)]:
                future.result()
        return
    figures = judged(case, measured(case, asked.pairs, asked.workers))
    text = json.dumps(figures, indent=1)
    print(text)
    if asked.out is not None:
        asked.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
