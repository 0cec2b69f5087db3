"""Boards, light, lenses and sensors of other labs: the map is right, its sigma honest, or the fit says why not."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.fit.seen.prediction import in_target_frame
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.patterns import Pose
from sim.renderer.render import render_irradiance
from sim.renderer.sensor import Sensor
from tests.correction.fit.benches import errors_behind
from tracer.bodies import Rod
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose

HOME = Sensor()


@dataclass(frozen=True)
class Lab:
    """What differs from the bench at home."""

    scene: str = "two_spheres_500"
    seed: int = 6
    square_mm: float = 3.5
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sensor: Sensor = HOME
    dark: float = 0.08
    bright: float = 0.92
    falls_to: float = 1.0  # light at the left border, of that at the right
    vignette: float = 0.0
    byte: bool = False
    glints: int = 0
    rod: bool = False
    heights_mm: tuple[float, ...] = ()
    crop_rows: int = 0  # of each of both borders: a sensor that is no square


LABS = {
    "board turned by 20 deg, glass off the axis": Lab("pair_off_axis", 4, turn_deg=(0.0, 0.0, 20.0)),
    "board leaning by 3 deg, with a stack": Lab(turn_deg=(3.0, -1.5, 0.0), heights_mm=(-15.0,)),
    "blur of 2 px": Lab(sensor=Sensor(blur_px=2.0)),
    "a fifth of the light, vignetted, falling to a fourth, 8 bit": Lab(
        sensor=Sensor(white_counts=660.0), falls_to=0.25, vignette=0.4, byte=True
    ),
    "grey on grey": Lab(dark=0.4, bright=0.5),
    "glints at full scale": Lab(glints=20),
    "a stem that no scene names, wide sensor": Lab(rod=True, crop_rows=150),
    "f = 35 mm, 8 mm squares": Lab("one_sphere_250", 7, 8.0),
    "f = 105 mm": Lab("one_sphere_1000", 7, 5.0),
}


def scenes(lab: Lab) -> tuple[Scene, Scene]:
    """Nominal scene, and the true one before the board upright."""
    nominal = at_size(demo_scene(lab.scene), 1008)
    if lab.crop_rows:
        camera, cut = nominal.camera, lab.crop_rows
        (width, height), (cu, cv) = camera.sensor_px, camera.principal_px
        camera = replace(camera, sensor_px=(width, height - 2 * cut), principal_px=(cu, cv - cut))
        nominal = nominal.with_camera(camera)
    return nominal, misalign(nominal, lab.seed)


def photographs(lab: Lab, truth: Scene) -> list[TargetFrame]:
    rng, turn = np.random.default_rng(lab.seed), np.deg2rad(lab.turn_deg)
    if lab.rod:
        truth = truth.with_bodies([*truth.bodies, Rod("stem", (-120.0, 25.0, 45.0), (-29.0, 3.0, 30.0), 2.0)])
    height, width = truth.camera.shape
    v, u = np.mgrid[0:height, 0:width]
    light = lab.falls_to + (1.0 - lab.falls_to) * u / width
    light *= 1.0 - lab.vignette * ((u / width - 0.5) ** 2 + (v / height - 0.5) ** 2) / 0.5
    frames = []
    for glass in (False, True):
        for height_mm in (0.0, *lab.heights_mm):
            pose = Pose((0.0, 0.0, height_mm), tuple(turn.tolist()))
            printed = Print(lab.square_mm, 0.4 * lab.square_mm, lab.dark, lab.bright, pose)
            scene = truth if glass else truth.with_bodies(())
            seen = render_irradiance(scene, printed, samples=3, seed=len(frames))
            image = lab.sensor.expose((seen * light).astype(np.float32), seed=len(frames))
            for x, y in rng.integers(height // 3, height - height // 3, (lab.glints if glass else 0, 2)):
                image[(u - x) ** 2 + (v - y) ** 2 < rng.integers(16, 150)] = 4095
            image = (image >> 4).astype(np.uint8) if lab.byte else image
            frames.append(TargetFrame(f"target_{glass}_{height_mm:g}", image, glass, height_mm))
    return frames


@pytest.mark.slow  # the fast suite has the lab at home in test_rendered.py, and turned scenes in test_supports.py
@pytest.mark.parametrize("name", LABS)
def test_the_map_is_true_and_its_sigma_honest(name):
    lab = LABS[name]
    nominal, bench = scenes(lab)
    fit = fit_scene(nominal, photographs(lab, bench), Chessboard(lab.square_mm, 0.4 * lab.square_mm))
    axes = Pose(turn_rad=tuple(np.deg2rad(lab.turn_deg).tolist())).axes()[1:]
    truth = in_target_frame(bench, TargetPose(axes=tuple(map(tuple, axes.tolist()))))
    error, sigma, compared = errors_behind(fit, truth)
    known = sigma < 0.1
    assert compared > 0.98
    assert known.mean() > 0.9
    assert np.sqrt(np.mean(error[known] ** 2)) <= 0.05
    assert np.mean(error < 5.0 * sigma + 0.01) > 0.99
