"""Labs that resemble none of ours: many balls of several glasses, any sensor, turned cameras, straight boards.

A nominal scene is drawn ball by ball, so that nothing touches; the true one is a bench's `misalign`.  Half of
the true cameras look at the board exactly along its normal, their rows along its squares or turned by up to
10 mrad, and a square may be a whole number of pixels: what people align, and what leaves pixel locking one phase.
"""

from dataclasses import replace

import numpy as np

from correction.target import Chessboard
from sim.demo.scenes import misalign
from tracer.bodies import Sphere
from tracer.camera import Camera, look_at
from tracer.errors import SceneError
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene

SENSORS_PX = ((640, 480), (1024, 1024), (1008, 700), (700, 1008), (1280, 800))
VIEW_MM = (50.0, 200.0)  # width of what the camera sees of the plane
DISTANCE = (3.0, 9.0)  # from the plane, in widths
RADIUS = (0.07, 0.25)  # of a ball, in widths
BALLS = (1, 12)
GLASSES = (1.30, 1.85)  # least and largest index
TURNS_RAD = (0.0, 0.0, 5e-4, 1e-3, 3e-3, 1e-2)  # of boards that somebody has aligned
GAP_MM = 0.8  # between balls, and above the board
TRIES = 60


def stranger(rng: np.random.Generator, seed: int) -> tuple[Scene, Scene, Chessboard]:
    """Nominal scene, true scene and board of a seed."""
    while True:
        nominal = _scene(rng)
        try:
            truth = misalign(nominal, 1000 + seed)
            break
        except SceneError:
            continue
    camera = truth.camera
    if rng.random() < 0.5:  # straight: the board's normal is the camera's axis
        x, y, z = camera.position_mm
        turn = float(rng.choice(TURNS_RAD)) + 0.5 * np.pi * float(rng.integers(4))
        camera = replace(camera, rotation=look_at((x, y, z), (x, y, 0.0), turn))
        truth, nominal = truth.with_camera(camera), nominal.with_camera(_near(nominal.camera, camera, rng))
    px_per_mm = camera.focal_px / camera.position_mm[2]
    square_px = float(rng.uniform(17.0, 34.0))
    if rng.random() < 0.5:
        square_px = round(square_px)
    square_mm = square_px / px_per_mm
    return nominal, truth, Chessboard(square_mm, 0.4 * square_mm)


def _near(nominal: Camera, true: Camera, rng: np.random.Generator) -> Camera:
    """What somebody believes of a camera that truly stands straight."""
    x, y, z = (np.array(true.position_mm) + rng.normal(0.0, 0.3, 3)).tolist()
    up = -np.array(true.rotation_matrix[1])
    roll = float(np.arctan2(up[0], up[1]) + rng.uniform(-2e-3, 2e-3))
    return replace(nominal, position_mm=(x, y, z), rotation=look_at((x, y, z), (x, y, 0.0), roll))


def _scene(rng: np.random.Generator) -> Scene:
    width, height = SENSORS_PX[rng.integers(len(SENSORS_PX))]
    view_mm = float(np.exp(rng.uniform(*np.log(VIEW_MM))))
    distance_mm = view_mm * float(rng.uniform(*DISTANCE))
    aside = distance_mm * np.tan(np.deg2rad(rng.uniform(-4.0, 4.0, 2)))
    position = (float(aside[0]), float(aside[1]), distance_mm)
    roll = float(rng.choice([0.0, 0.5 * np.pi, rng.uniform(-np.pi, np.pi)]))
    middle = (0.5 * (width - 1), 0.5 * (height - 1))
    pose = look_at(position, (0.0, 0.0, 0.0), roll)
    camera = Camera(width * distance_mm / view_mm, middle, (width, height), position, pose)
    glasses = [ConstantMedium(float(n)) for n in rng.uniform(*GLASSES, rng.integers(1, 4))]
    return Scene(camera, tuple(_balls(rng, view_mm, view_mm * height / width, glasses)))


def _balls(
    rng: np.random.Generator, width_mm: float, height_mm: float, glasses: list[ConstantMedium]
) -> list[Sphere]:
    """Balls that touch neither each other nor the board, as many as find a place."""
    balls: list[Sphere] = []
    for number in range(rng.integers(*BALLS, endpoint=True)):
        for _ in range(TRIES):
            radius = float(rng.uniform(*RADIUS) * min(width_mm, height_mm))
            x, y = (rng.uniform(-0.45, 0.45, 2) * (width_mm, height_mm)).tolist()
            z = radius + GAP_MM + float(rng.exponential(0.5 * width_mm)) * float(rng.random() < 0.5)
            clear = (
                np.linalg.norm(np.subtract((x, y, z), b.centre_mm)) > radius + b.radius_mm + GAP_MM for b in balls
            )
            if z < width_mm and all(clear):
                balls.append(Sphere(f"s{number}", (x, y, z), radius, glasses[rng.integers(len(glasses))]))
                break
    return balls
