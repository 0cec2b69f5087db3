"""Derivatives of landing points by every number of a scene, against differences of the 50-digit tracer."""

from dataclasses import replace
from types import SimpleNamespace

import mpmath
import numpy as np
from mpmath import mpf
from scipy.spatial.transform import Rotation

from benchmarks.reference import dot, follow_pixel
from sim.demo.scenes import demo_scene
from tests.loops import loop_over
from tracer.bodies import Core
from tracer.camera import Lens
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import (
    CAMERA,
    SPHERE,
    TARGET,
    TargetPose,
    landings,
    parameter_names,
)

STEP = mpf(10) ** -16  # of 50 digits: truncation and rounding both below 1e-30
POSE = TargetPose(
    (0.3, -0.2, -5.0), tuple(map(tuple, Rotation.from_rotvec((0.02, -0.03, 0.1)).as_matrix().tolist()))
)
AIR = 1.0003


def exact_scene(name: str) -> Scene:
    """A scene in which no number is zero by chance."""
    scene = demo_scene("two_spheres_500" if name == "hollow" else name)
    if name == "hollow":
        near, far = scene.spheres
        inside = (
            Core(0.7 * near.radius_mm, ConstantMedium(1.0004)),
            Core(0.3 * near.radius_mm, ConstantMedium(1.6)),
        )
        scene = scene.with_bodies([replace(near, cores=inside[1:]), replace(far, cores=inside)])
    turn = Rotation.from_rotvec((0.004, -0.006, 0.05)).as_matrix() @ scene.camera.rotation_matrix
    camera = replace(
        scene.camera,
        principal_px=(1000.0, 1015.0),
        position_mm=(3.0, -2.0, 500.0),
        rotation=tuple(map(tuple, turn.tolist())),
        lens=Lens(0.3, -2.0, 5.0, 0.002, -0.003),
    )
    return replace(scene, camera=camera, ambient=ConstantMedium(AIR))


def turned(vector, turn):
    """Rodrigues, in many digits."""
    angle = mpmath.sqrt(dot(turn, turn))
    if angle == 0:
        return vector
    axis = tuple(part / angle for part in turn)
    across = tuple(
        axis[(k + 1) % 3] * vector[(k + 2) % 3] - axis[(k + 2) % 3] * vector[(k + 1) % 3] for k in range(3)
    )
    c, s, along = mpmath.cos(angle), mpmath.sin(angle), dot(axis, vector)
    return tuple(c * vector[k] + s * across[k] + (1 - c) * along * axis[k] for k in range(3))


def exact_landing(scene: Scene, pixel, name: str, step: mpf):
    """Landing point in target coordinates with one number moved by `step`."""
    camera, move = scene.camera, dict.fromkeys(parameter_names(scene), mpf(0))
    move[name] = step
    by = {part: move[f"camera.{part}"] for part in CAMERA}
    aim = tuple(by[f"r{axis}"] for axis in "xyz")
    rows = [turned(tuple(map(mpf, row)), aim) for row in camera.rotation]
    eye = tuple(mpf(p) + by[axis] for p, axis in zip(camera.position_mm, "xyz", strict=True))
    lean = tuple(move[f"target.r{axis}"] for axis in "xyz")
    axes = [turned(tuple(map(mpf, row)), lean) for row in POSE.axes]
    origin = tuple(mpf(p) + move[f"target.{axis}"] for p, axis in zip(POSE.origin_mm, "xyz", strict=True))

    def seen_from_target(point):
        return tuple(dot(axis, tuple(p - o for p, o in zip(point, origin, strict=True))) for axis in axes)

    balls = []
    for ball in scene.spheres:
        own = {part: move[f"{ball.name}.{part}"] for part in SPHERE}
        centre = tuple(mpf(p) + own[axis] for p, axis in zip(ball.centre_mm, "xyz", strict=True))
        n = mpf(ball.medium.n(532.0)) + own["n"]
        medium = SimpleNamespace(n=lambda _nm, n=n: n)
        radius = mpf(ball.radius_mm) + own["radius"]
        balls.append(
            SimpleNamespace(
                name=ball.name,
                centre_mm=seen_from_target(centre),
                radius_mm=radius,
                medium=medium,
                cores=ball.cores,
            )
        )
    lens = SimpleNamespace(**{term: mpf(getattr(camera.lens, term)) + by[term] for term in CAMERA[9:]})
    principal = tuple(mpf(p) + by[part] for p, part in zip(camera.principal_px, ("cu", "cv"), strict=True))
    focal = mpf(camera.focal_px) + by["focal_px"]
    rotation = [[dot(row, axis) for axis in axes] for row in rows]
    view = SimpleNamespace(
        position_mm=seen_from_target(eye), rotation=rotation, focal_px=focal, principal_px=principal, lens=lens
    )
    found = follow_pixel(
        SimpleNamespace(camera=view, spheres=balls, wavelength_nm=532.0, n_ambient=scene.n_ambient), *pixel
    )
    return np.array([found.x, found.y])


HOLLOW_PX = (11.0, 60.0, 110.0, 150.0, 190.0, 230.0)
CASES = [
    ("one_sphere_500", (1300.0, 700.0)),
    ("one_sphere_500", (60.0, 1950.0)),
    ("three_spheres_500", (1100.0, 1060.0)),
    ("pyramid_500", (1100.0, 900.0)),
    ("pyramid_500", (640.0, 1400.0)),
    *(("hollow", (1000.0 + off, 1015.0 + 0.5 * off)) for off in HOLLOW_PX),
]


@loop_over("name, pixel", CASES)
def test_every_derivative_agrees_with_fifty_digits(name, pixel):
    scene = exact_scene(name)
    found = landings(scene, [pixel], POSE)
    assert found.recovered.all()
    for number, parameter in enumerate(found.names):
        ahead, behind = (exact_landing(scene, pixel, parameter, side * STEP) for side in (1, -1))
        exact = ((ahead - behind) / (2 * STEP)).astype(float)
        error = np.abs(found.rate[0, :, number] - exact).max()
        assert error <= 1e-8 * np.abs(exact).max() + 1e-18, parameter


def test_lost_rays_are_nan():
    scene = exact_scene("two_spheres_500")
    lens = replace(scene.camera.lens, k1=0.3, k2=-20.0)  # one that folds far from its axis
    scene = replace(scene, camera=replace(scene.camera, lens=lens))
    found = landings(scene, np.random.default_rng(1).uniform(-2e4, 2e4, (400, 2)), POSE)
    assert 0 < np.count_nonzero(found.recovered) < 400
    assert np.isnan(found.rate[~found.recovered]).all()
    assert np.isfinite(found.rate[found.recovered]).all()
    assert len(found.names) == len(CAMERA) + 2 * len(SPHERE) + len(TARGET)
