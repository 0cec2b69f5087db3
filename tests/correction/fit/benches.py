"""Benches with hidden misalignment on a small sensor, photographed by the independent renderer, once a session."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from correction.fit.judge.result import SceneFit
from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.fitted.map_sigma import sigma_at
from correction.grid import PlaneGrid, grid_of
from correction.maps.correction_map import build_correction_map
from correction.target import Chessboard
from sim.demo.scenes import BARREL_35MM, at_size, demo_scene, misalign
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.patterns import Pose, place
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.trace import TraceResult, trace

SIZE_PX = 1008
SQUARE_MM = 3.5  # 22 px in the bare view
BOARD = Chessboard(SQUARE_MM, 0.4 * SQUARE_MM)
FINE = {"pyramid_500": 2.5, "tilted": 2.5}  # so little is seen through some spheres that corners must be dense


@dataclass(frozen=True)
class Unknowns:
    """A nominal scene, the true one, and frames of the target."""

    nominal: Scene
    truth: Scene
    frames: tuple[TargetFrame, ...]
    board: Chessboard


@cache
def bench(
    name: str,
    seed: int,
    bare_mm: tuple[float, ...] = (),
    glass_mm: tuple[float, ...] = (),
    size_px: int = SIZE_PX,
) -> Unknowns:
    """Photograph the target at z = 0 and further heights; a smaller sensor sees fewer squares, as wide in px."""
    nominal = at_size(demo_scene(name), size_px)
    truth = misalign(nominal, seed, barrel=BARREL_35MM if name == "one_sphere_250" else 0.0)
    square = FINE.get(name, SQUARE_MM) * SIZE_PX / size_px
    frames = []
    for glass, heights in ((False, (0.0, *bare_mm)), (True, (0.0, *glass_mm))):
        scene = truth if glass else truth.with_bodies(())
        for height in heights:
            frames.append(photograph(scene, glass, height, 100 * seed + len(frames), square))
    return Unknowns(nominal, truth, tuple(frames), Chessboard(square, 0.4 * square))


def photograph(
    scene: Scene, glass: bool, height_mm: float, seed: int, square_mm: float = SQUARE_MM
) -> TargetFrame:
    """One frame of the target."""
    print_ = place(Print(square_mm, 0.4 * square_mm), Pose((0.0, 0.0, height_mm)))
    image = render(scene, print_, Sensor(), samples=3, seed=seed)
    return TargetFrame(f"target_{'glass' if glass else 'clear'}_z{height_mm:+g}mm", image, glass, height_mm)


@cache
def fitted(name: str, seed: int, *more: object) -> SceneFit:
    """Fit of `bench`."""
    made = bench(name, seed, *more)  # type: ignore[arg-type]
    return fit_scene(made.nominal, made.frames, made.board)


def map_error_px(fit: Scene, truth: Scene, pixels: np.ndarray, grid: PlaneGrid) -> np.ndarray:
    """Where pixels land in the fitted scene minus where they land in truth (N, 2), in corrected px."""
    a, b = trace(fit, pixels), trace(truth, pixels)
    off = (a.plane_mm - b.plane_mm) / grid.pitch_mm
    off[(_ways(a) != _ways(b)) | ~a.recovered | ~b.recovered] = np.nan
    return off


def _ways(traced: TraceResult) -> np.ndarray:
    """The bodies that each ray went through, as one word (N,); there are few ways and many rays."""
    keys, which = np.unique(traced.rays["key"], return_inverse=True)
    return np.array([",".join(traced.branches[int(key)]) for key in keys])[which]


def errors_behind(fit: SceneFit, truth: Scene, every: int = 5) -> tuple[np.ndarray, np.ndarray, float]:
    """True error and sigma of a fitted map behind glass (N,), in corrected px; what share can be compared."""
    grid = grid_of(truth.camera)
    seen = build_correction_map(truth, build_ray_map(truth), grid)
    pixels = seen.pixel[0][seen.behind_glass][::every]
    error = np.linalg.norm(map_error_px(fit.scene, truth, pixels, grid), axis=1)
    here = np.isfinite(error)
    sigma = np.linalg.norm(sigma_at(fit, pixels[here], True), axis=1) / grid.pitch_mm
    return error[here], sigma, float(here.mean())
