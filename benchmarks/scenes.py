"""The scenes of the benchmark: the paper's, one like a bench (nothing aligned), and packed beds."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtpiv.example_files import examples
from tracer.bodies import Sphere
from tracer.camera import Camera, Lens, look_at
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene

PAPER = (
    "one_sphere_250",
    "one_sphere_500",
    "one_sphere_1000",
    "two_spheres_500",
    "three_spheres_500",
    "pyramid_500",
)
BENCH_LIKE = "pyramid, nothing aligned"
MOVED = ", camera moved"


def bench_scene(name: str) -> Scene:
    """A scene by its name: an example, the unaligned pyramid, ``bed N``, ``empty``; any of them `MOVED`."""
    if name.endswith(MOVED):
        return moved(bench_scene(name.removesuffix(MOVED)))
    if name == "empty":
        return load_scene(examples() / "two_spheres_500.yaml").with_bodies([])
    if name.endswith(".yaml"):
        return load_scene(Path(name))
    if name.startswith("bed "):
        return bed(int(name.split()[1]))
    if name != BENCH_LIKE:
        return load_scene(examples() / f"{name}.yaml")
    scene = load_scene(examples() / "pyramid_500.yaml")
    position, camera = (31.0, -22.0, 496.0), scene.camera
    rotation = look_at(position, (2.0, 1.0, 0.0), 0.05)
    lens = Lens(k1=0.03, k2=-0.1, p1=0.001, p2=-0.002)
    bent = Camera(camera.focal_px, camera.principal_px, camera.sensor_px, position, rotation, lens)
    return scene.with_camera(bent)


def moved(scene: Scene) -> Scene:
    """The scene with its camera as a fit leaves it: 3 mm aside, tilted by some 8 mrad, turned by 3 mrad."""
    camera = scene.camera
    x, y, z = camera.position_mm
    position = (x + 2.4, y - 1.8, z)
    rotation = look_at(position, (x - 1.1, y + 0.7, 0.0), 0.003)
    return scene.with_camera(
        Camera(camera.focal_px, camera.principal_px, camera.sensor_px, position, rotation, camera.lens)
    )


def bed(count: int, width_mm: float = 100.0, packing: str = "bcc") -> Scene:
    """Up to `count` equal spheres, matched to 1.023, over the same square of the plane.

    `packing` is "bcc", body-centred cubic, or "random": a quarter smaller, at random places, none overlapping.
    """
    columns = max(1, round((count / 2.0) ** (1.0 / 3.0)))
    pitch = width_mm / columns
    radius = 0.49 * np.sqrt(0.75) * pitch
    glass, bodies = ConstantMedium(1.023), []
    for corner in (0.0, 0.5):
        for i, j, k in np.ndindex(columns, columns, columns):
            x, y, z = (np.array([i, j, k]) + corner - columns / 2.0 + 0.25) * pitch
            centre = (float(x), float(y), float(z + width_mm / 2.0 + radius + 1.0))
            bodies.append(Sphere(f"s{len(bodies)}", centre, float(radius), glass))
    bodies = bodies[:count]
    if packing == "random":
        bodies = scattered(bodies, width_mm)
    scene = load_scene(examples() / "pyramid_500.yaml")
    return scene.with_bodies(bodies)


def scattered(bodies: list[Sphere], width_mm: float) -> list[Sphere]:
    """The same spheres, a quarter smaller so that there is room, at random in the same cube."""
    rng, radius = np.random.default_rng(0), 0.75 * bodies[0].radius_mm
    low, placed = np.array([-width_mm / 2.0, -width_mm / 2.0, 1.0]) + radius, np.empty((0, 3))
    for _ in bodies:
        for _ in range(5000):
            centre = low + rng.random(3) * (width_mm - 2.0 * radius)
            if not len(placed) or ((placed - centre) ** 2).sum(axis=1).min() > (2.001 * radius) ** 2:
                placed = np.vstack((placed, centre))
                break
    return [
        Sphere(body.name, (float(x), float(y), float(z)), radius, body.medium)
        for body, (x, y, z) in zip(bodies, placed.tolist(), strict=False)
    ]


def aimed_pixels(where: Scene, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Pixels on the sensor: half anywhere, half aimed at a sphere with b/R up to 1 - 1e-6 (N, 2)."""
    height, width = where.camera.shape
    pixels = rng.uniform((-0.5, -0.5), (width - 0.5, height - 0.5), (count, 2))
    aimed = pixels[::2]
    count = len(aimed)
    eye = np.array(where.camera.position_mm)
    centres, radii = np.array([ball.centre_mm for ball in where.spheres]), [b.radius_mm for b in where.spheres]
    which = rng.integers(len(radii), size=count)
    axis = centres[which] - eye
    distance = np.linalg.norm(axis, axis=-1, keepdims=True)
    share = 1.0 - 10.0 ** rng.uniform(-6.0, 0.0, (count, 1))
    side = np.cross(axis, rng.normal(size=(count, 3)))
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    sine = share * np.array(radii)[which, None] / distance
    wanted = where.camera.project(eye + distance * (np.sqrt(1.0 - sine**2) * axis / distance + sine * side))
    seen = np.all((wanted > -0.5) & (wanted < (width - 0.5, height - 0.5)), axis=-1)
    aimed[seen] = wanted[seen]
    return pixels
