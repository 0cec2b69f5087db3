"""Labs photographed by the independent renderer: the named benches, and strangers, right ones and wrong ones.

What is wrong with a lab stands in no scene file: the frames alone can show it, or nothing can.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from correction.fit.judge.result import SceneFit
from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.fitted.map_sigma import sigma_at
from correction.grid import PlaneGrid, grid_of
from correction.maps.correction_map import build_correction_map
from correction.target import Chessboard
from sim.demo.scenes import BARREL_35MM, at_size, demo_scene, misalign
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import render_irradiance
from sim.renderer.sensor import Sensor
from tests.correction.fit.benches import map_error_px
from tests.correction.fit.strangers import stranger
from tracer.bodies import Sphere
from tracer.errors import SceneError
from tracer.media import ConstantMedium, Medium
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map

SENSORS = {
    "clean": Sensor(white_counts=53000.0, electrons_per_count=float("inf"), read_noise_counts=0.0, bits=16),
    "camera": Sensor(),
    "8 bit": Sensor(
        white_counts=200.0, electrons_per_count=40.0, read_noise_counts=0.7, offset_counts=4.0, bits=8
    ),
}
BENCHES = {  # name: width of the sensor [px], square [mm]
    "one_sphere_500": (1008, 3.5),
    "one_sphere_250": (1008, 3.5),
    "two_spheres_500": (1008, 3.5),
    "three_spheres_500": (1008, 2.5),
    "pair_off_axis": (1008, 3.5),
    "pyramid_500": (1008, 2.5),
    "tilted": (1008, 2.5),
}
# Rays a pixel each way.  With 3 a corner behind glass is off by 0.015 px for want of rays, of which no real pixel
# is short, and the best corners err more than they say; with 6 and 8 they do not.
RAYS = 6
NODES, APART = 3000, 4  # nodes of the map that are compared, of every so many each way
OFF_PX = 0.5


@dataclass(frozen=True)
class Photographed:
    """A lab before its fit."""

    nominal: Scene
    truth: Scene
    board: Chessboard
    frames: tuple[TargetFrame, ...]
    priors: FitTable = field(default_factory=FitTable)


@dataclass(frozen=True)
class Compared:
    """A fitted lab beside the truth: error and sigma of the map (N, 2) [corrected px] behind glass and beside it.

    `off` is the share of nodes that the map says it knows and that show another place altogether.
    """

    fit: SceneFit
    behind: tuple[NDArray[np.float64], NDArray[np.float64]]
    beside: tuple[NDArray[np.float64], NDArray[np.float64]]
    off: float


def photographed(kind: str, seed: int, fault: str = "") -> Photographed:
    """Draw and photograph a lab: a name of BENCHES, or "stranger"; "stray": with a body that no file lists."""
    rng = np.random.default_rng((33, seed))
    sensor = SENSORS[("clean", "camera", "8 bit")[seed % 3]]
    if kind == "stranger":
        nominal, truth, board = stranger(rng, seed)
    else:
        size_px, square_mm = BENCHES[kind]
        nominal = at_size(demo_scene(kind), size_px)
        truth = misalign(nominal, seed, barrel=BARREL_35MM if kind == "one_sphere_250" else 0.0)
        board = Chessboard(square_mm, 0.4 * square_mm)
    if fault == "stray":
        truth = _with_stray(truth, rng)
    print_ = Print(board.square_mm, 0.4 * board.square_mm)
    frames = []
    for number, scene in enumerate((truth.with_bodies(()), truth)):
        light = render_irradiance(scene, print_, samples=RAYS, seed=2 * seed + number)
        image = sensor.expose(light, seed=2 * seed + number)
        frames.append(TargetFrame(("bare", "glass")[number], image, bool(number)))
    return Photographed(nominal, truth, board, tuple(frames))


def compared(lab: Photographed) -> Compared:
    """Fit a lab and hold the map against the truth.

    Raises
    ------
    FitError, TargetNotFound
        As the fit does.
    """
    fit = fit_scene(lab.nominal, lab.frames, lab.board, lab.priors)
    grid = grid_of(lab.truth.camera)
    coarse = PlaneGrid(grid.origin_mm, APART * grid.pitch_mm, (grid.shape[0] // APART, grid.shape[1] // APART))
    scene = fit.measured_scene
    given = build_correction_map(
        scene, build_ray_map(scene), coarse, min_magnification=2.0, max_magnification=64.0
    )
    rng = np.random.default_rng(0)
    parts, handed, off = [], 0, 0
    for behind in (True, False):
        pixels = given.pixel[0][given.behind_glass if behind else given.recovered & ~given.behind_glass]
        pixels = pixels[rng.permutation(len(pixels))[:NODES]].astype(np.float64)
        error = map_error_px(scene, lab.truth, pixels, grid)
        sigma = sigma_at(fit, pixels, behind) / grid.pitch_mm
        known = 3.0 * sigma.max(axis=1, initial=0.0) < OFF_PX
        near = np.linalg.norm(error, axis=1) < OFF_PX
        handed, off = handed + int(np.count_nonzero(known)), off + int(np.count_nonzero(known & ~near))
        parts.append((error[near], sigma[near]))
    return Compared(fit, parts[0], parts[1], off / max(handed, 1))


def _with_stray(truth: Scene, rng: np.random.Generator) -> Scene:
    """A bead, a drop or a speck that no file lists, before a ball."""
    camera, sensor = np.array(truth.camera.position_mm), np.array(truth.camera.sensor_px)
    for _ in range(1000):
        ball = truth.spheres[rng.integers(len(truth.spheres))]
        at = np.array(ball.centre_mm)
        towards = (camera - at) / np.linalg.norm(camera - at)
        radius = ball.radius_mm * float(rng.uniform(0.12, 0.3))
        aside = rng.normal(size=3)
        aside -= towards * (aside @ towards)
        aside *= 0.6 * ball.radius_mm * np.sqrt(rng.uniform()) / np.linalg.norm(aside)
        centre = at + (1.02 * ball.radius_mm + radius + 2.0) * towards + aside
        pixel = truth.camera.project(centre[None])[0]
        if (pixel < 0.1 * sensor).any() or (pixel > 0.9 * sensor).any():
            continue
        medium: Medium | None = ConstantMedium(float(rng.uniform(1.3, 1.6))) if rng.random() < 0.7 else None
        try:
            return truth.with_bodies([*truth.bodies, Sphere("stray", tuple(centre.tolist()), radius, medium)])
        except SceneError:
            continue
    raise SceneError("no place for a stray body")
