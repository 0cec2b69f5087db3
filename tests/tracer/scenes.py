"""Scenes for the tracer's tests: the paper's, one where nothing is aligned, and random ones."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import bench_scene
from tracer.bodies import Body, Core, Sphere
from tracer.camera import Camera, Lens, look_at
from tracer.kernels.rays import trace_to_plane
from tracer.kernels.world import World
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.trace import NO_CELLS, NO_RODS

NO_TRAIL = NO_CELLS[2]  # keeps no event
TILTED = "tilted"
HOLLOW = "hollow"


def ball(
    name: str,
    x: float,
    y: float,
    z: float,
    radius_mm: float,
    n: float | None = 1.53,
    *cores: tuple[float, float],
) -> Sphere:
    """A sphere; of each core radius [mm] and n, inwards."""
    inside = tuple(Core(radius, ConstantMedium(index)) for radius, index in cores)
    return Sphere(name, (x, y, z), radius_mm, None if n is None else ConstantMedium(n), inside)


def camera_at(
    position_mm: tuple[float, float, float] = (0.0, 0.0, 500.0),
    target_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    focal_px: float = 6200.0,
    sensor_px: tuple[int, int] = (2016, 2016),
    roll_rad: float = 0.0,
    lens: Lens | None = None,
) -> Camera:
    principal = ((sensor_px[0] - 1) / 2.0, (sensor_px[1] - 1) / 2.0)
    rotation = look_at(position_mm, target_mm, roll_rad)
    return Camera(focal_px, principal, sensor_px, position_mm, rotation, lens or Lens())


def shrunk(camera: Camera, factor: float) -> Camera:
    """The same view on a sensor with `factor` times fewer pixels each way."""
    return camera.with_width(int(camera.sensor_px[0] / factor))


@cache
def scene(name: str) -> Scene:
    """A scene by name: those of the paper; nothing aligned; the same hollow, filled, a ball in a ball."""
    if name == HOLLOW:
        bodies = (
            ball("gas", 3.0, -4.0, 31.0, 30.0, 1.53, (24.0, 1.0003)),
            ball("thin", -25.0, 12.0, 77.5, 11.25, 1.4607, (11.1, 1.0)),
            ball("drop", 34.0, 31.0, 26.0, 14.0, 1.333, (6.0, 1.6)),
            ball("bubble", 32.0, -36.0, 20.0, 7.5, 1.1),
            ball("nested", 28.0, -14.0, 118.0, 18.0, 1.517, (15.0, 1.0003), (9.0, 1.517), (4.0, 1.0003)),
        )
        return scene(TILTED).with_bodies(bodies)
    if name != TILTED:
        return bench_scene(name)
    return Scene(
        camera=camera_at(
            (120.0, -60.0, 420.0),
            (5.0, 3.0, 10.0),
            6200.0,
            (2016, 1800),
            roll_rad=0.3,
            lens=Lens(k1=0.04, k2=-0.3, k3=0.5, p1=0.002, p2=-0.003),
        ),
        bodies=(
            ball("large", 3.0, -4.0, 31.0, 30.0, 1.53),
            ball("small", -25.0, 12.0, 77.5, 11.25, 1.4607),
            ball("dense", 34.0, 31.0, 26.0, 14.0, 1.923),
            ball("bubble", 32.0, -36.0, 20.0, 7.5, 1.1),
            ball("high", 28.0, -14.0, 118.0, 18.0, 1.517),
        ),
        ambient=ConstantMedium(1.0003),
    )


def random_bodies(rng: np.random.Generator, count: int, bubbles: bool = False) -> list[Body]:
    """Spheres that do not overlap, some of them in contact with each other or with the plane."""
    bodies: list[Sphere] = []
    while len(bodies) < count:
        radius = float(10.0 ** rng.uniform(0.3, 1.5))
        n = float(rng.choice([1.0, 1.0 + 1e-6, 1.023, 1.33, 1.53, 1.9, 2.6]))
        if bubbles:
            n = float(rng.choice([1.0, 1.1, 1.33, 1.53]))
        kind = rng.integers(4)
        centre = np.array([*rng.uniform(-45.0, 45.0, 2), radius + rng.uniform(0.0, 60.0)])
        if kind == 0:
            centre[2] = radius
        elif kind == 1 and bodies:
            other = bodies[rng.integers(len(bodies))]
            way = rng.normal(size=3)
            centre = np.array(other.centre_mm) + (other.radius_mm + radius) * way / np.linalg.norm(way)
        gaps = [np.linalg.norm(centre - np.array(b.centre_mm)) - b.radius_mm - radius for b in bodies]
        if centre[2] >= radius and all(gap > -1e-9 for gap in gaps):
            bodies.append(Sphere(f"b{len(bodies)}", tuple(map(float, centre)), radius, ConstantMedium(n)))
    return list(bodies)


def random_camera(rng: np.random.Generator, bodies: list[Body]) -> Camera:
    """A camera above all bodies, looking somewhere among them."""
    top = max((body.highest_mm for body in bodies), default=0.0)
    height = float(top + 10.0 ** rng.uniform(0.0, 3.0))
    position = (*(float(x) for x in rng.uniform(-0.5, 0.5, 2) * height), height)
    target = tuple(float(x) for x in rng.uniform(-20.0, 20.0, 3))
    focal = float(10.0 ** rng.uniform(2.0, 4.0))
    lens = Lens(*(float(x) for x in rng.normal(size=5) * (0.05, 0.05, 0.05, 0.002, 0.002)))
    return camera_at(position, target, focal, (640, 480), float(rng.uniform(-3.0, 3.0)), lens)


def hollowed(rng: np.random.Generator, bodies: list[Body]) -> list[Body]:
    """The same spheres, most of them with one to three cores: thin shells, thick ones, small drops."""
    made: list[Body] = []
    for body in bodies:
        cores, radius = [], body.radius_mm
        for _ in range(rng.choice([0, 1, 1, 1, 2, 3])):
            radius *= float(rng.choice([1.0 - 1e-6, 0.999, rng.uniform(0.1, 1.0), rng.uniform(0.6, 1.0)]))
            n = float(rng.choice([1.0, 1.0 + 1e-6, 1.333, 1.53, 2.6, body.medium.n(532.0)]))
            cores.append(Core(radius, ConstantMedium(n)))
        made.append(replace(body, cores=tuple(cores)))
    return made


def random_scene(rng: np.random.Generator, most: int = 8, cores: bool = False) -> Scene:
    bubbles = bool(rng.random() < 0.25)
    bodies = random_bodies(rng, int(rng.integers(0, most + 1)), bubbles)
    if cores:
        bodies = hollowed(rng, bodies)
    ambient = ConstantMedium(1.333 if bubbles else 1.0)
    return Scene(random_camera(rng, bodies), tuple(bodies), ambient=ambient)


def one_ray(
    *numbers: float, table: NDArray[np.float64], trail: NDArray[np.int32] | None = None
) -> tuple[float, ...]:
    """`trace_to_plane` from a point along a direction past the spheres of a table; its events in `trail` (64,)."""
    kept = NO_TRAIL if trail is None else trail
    return flat(trace_to_plane(numbers[:3], numbers[3:], World(table, *NO_CELLS, NO_RODS), kept))


def flat(result: Any) -> tuple[float, ...]:
    """The numbers of what a kernel returns, vectors taken apart."""
    return tuple(number for part in result for number in (part if isinstance(part, tuple) else (part,)))


def halves(numbers: NDArray[np.float64]) -> tuple[Any, Any]:
    """Two vectors of six numbers, as kernels take them."""
    return tuple(numbers[:3].tolist()), tuple(numbers[3:].tolist())
