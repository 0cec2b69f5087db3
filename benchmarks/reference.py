"""A slow tracer to judge the fast one: 50 digits, textbook optics, nothing shared with the kernels.

A ray is a point and a unit direction.  Each sphere is met at the smaller root of |o + t d - c|^2 = R^2, the
ray refracted there and again at the larger root of the same quadratic, both times by Snell's law in vector
form at the surface normal; the same at every core inside, where what is totally reflected goes on as a mirror
sends it.  (The kernels know neither roots nor points on surfaces nor normals.)
Inputs are the float64 numbers of the scene, taken as exact.  `errors_um` is a ray map against it, by region of the
sphere.
"""

from dataclasses import dataclass

import mpmath
import numpy as np
from mpmath import mpf
from numpy.typing import NDArray

from benchmarks.scenes import aimed_pixels
from tracer.camera import Camera
from tracer.media import Medium
from tracer.scene.scene import Scene

mpmath.mp.dps = 50

Vector = tuple[mpf, mpf, mpf]
TOUCHES = mpf("1e-6")  # [mm]: less than that through the plane is contact


@dataclass(frozen=True)
class Glass:
    """A sphere in exact numbers, with (radius, n) of each core inwards."""

    name: str
    centre: Vector
    radius: mpf
    n: mpf
    cores: tuple[tuple[mpf, mpf], ...] = ()


@dataclass(frozen=True)
class Seen:
    """What became of a ray.

    Parameters
    ----------
    status : str
        "recovered", "tir", "missed", or "glass" for what comes to the plane in a sphere.
    x, y : mpf
        Plane point [mm].
    branch : tuple of str
        Names of the spheres crossed, and of the ways through their cores.
    worst : mpf
        Largest sine of an angle to the normal met, without those of refraction in solid spheres.
    path : mpf
        Optical path [mm].
    passed : mpf
        Fresnel transmittance, unpolarised.
    direction : Vector
        Last direction.
    """

    status: str
    x: mpf
    y: mpf
    branch: tuple[str, ...]
    worst: mpf
    path: mpf
    passed: mpf
    direction: Vector


def dot(a: Vector, b: Vector) -> mpf:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def along(o: Vector, t: mpf, d: Vector) -> Vector:
    """Return the point o + t d."""
    return (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])


def glasses(scene: Scene) -> list[Glass]:
    """Spheres of a scene, all transparent."""

    def relative(medium: Medium) -> mpf:
        return mpf(medium.n(scene.wavelength_nm)) / mpf(scene.n_ambient)

    return [
        Glass(
            ball.name,
            tuple(mpf(x) for x in ball.centre_mm),
            mpf(ball.radius_mm),
            relative(ball.medium),
            tuple((mpf(core.radius_mm), relative(core.medium)) for core in ball.cores),
        )
        for ball in scene.spheres
    ]


def pixel_direction(camera: Camera, u: float, v: float) -> Vector:
    """Unit direction of the ray of an acquired pixel."""
    x = (mpf(u) - mpf(camera.principal_px[0])) / mpf(camera.focal_px)
    y = (mpf(v) - mpf(camera.principal_px[1])) / mpf(camera.focal_px)
    k1, k2, k3, p1, p2 = (
        mpf(t) for t in (camera.lens.k1, camera.lens.k2, camera.lens.k3, camera.lens.p1, camera.lens.p2)
    )
    s = x**2 + y**2
    factor = 1 + k1 * s + k2 * s**2 + k3 * s**3
    xi = x * factor + 2 * p1 * x * y + p2 * (3 * x**2 + y**2)
    yi = y * factor + p1 * (x**2 + 3 * y**2) + 2 * p2 * x * y
    rows = [[mpf(e) for e in row] for row in camera.rotation]
    world = tuple(xi * rows[0][k] + yi * rows[1][k] + rows[2][k] for k in range(3))
    length = mpmath.sqrt(dot(world, world))
    return tuple(w / length for w in world)


def roots(o: Vector, d: Vector, ball: Glass) -> tuple[mpf, mpf] | None:
    """Where a line meets a sphere; None if it does not."""
    w = tuple(o[k] - ball.centre[k] for k in range(3))
    half = dot(w, d)
    square = half**2 - (dot(w, w) - ball.radius**2)
    if square <= 0:
        return None
    root = mpmath.sqrt(square)
    return -half - root, -half + root


def snell(d: Vector, normal: Vector, ratio: mpf) -> tuple[Vector, mpf] | None:
    """Refract at a normal that points against the ray, ratio = n before / n after; None = total reflection."""
    cos_in = -dot(normal, d)
    sin2_out = ratio**2 * (1 - cos_in**2)
    if sin2_out >= 1:
        return None
    cos_out = mpmath.sqrt(1 - sin2_out)
    scale = ratio * cos_in - cos_out
    bent = tuple(ratio * d[k] + scale * normal[k] for k in range(3))
    r_s = (ratio * cos_in - cos_out) / (ratio * cos_in + cos_out)
    r_p = (cos_in - ratio * cos_out) / (cos_in + ratio * cos_out)
    return bent, 1 - (r_s**2 + r_p**2) / 2


@dataclass(frozen=True)
class Crossed:
    """What a ray does in a sphere: where it leaves and how, by which way, and what that costs."""

    o: Vector
    d: Vector
    name: str
    worst: mpf
    path: mpf
    passed: mpf


def cross(o: Vector, d: Vector, ball: Glass) -> Crossed | None:
    """Follow a ray from its point of entry `o` through a sphere, surface by surface; None = reflected outside."""
    radii = [ball.radius, *(radius for radius, _ in ball.cores)]
    indices = [mpf(1), ball.n, *(n for _, n in ball.cores)]
    name, worst, path, passed = ball.name, mpf(0), mpf(0), mpf(1)
    level, at, inward = 0, 0, True  # surfaces around the ray; the surface it is at
    while True:
        side = 1 if inward else -1
        normal = tuple(side * (o[k] - ball.centre[k]) / radii[at] for k in range(3))
        other = level + side
        refracted = snell(d, normal, indices[level] / indices[other])
        if at > 0 or inward:
            worst = max(worst, mpmath.sqrt(max(mpf(0), 1 - dot(d, normal) ** 2)))
        if refracted is None:
            if at == 0:
                return None
            turn = 2 * dot(d, normal)
            d = tuple(d[k] - turn * normal[k] for k in range(3))
            name = f"{ball.name} off core{'' if at == 1 else f' {at}'}"
        else:
            d, share = refracted
            passed *= share
            level = other
            if at > 0:
                worst = max(worst, mpmath.sqrt(max(mpf(0), 1 - dot(d, normal) ** 2)))
            if at > 0 and inward:
                name = f"{ball.name} core{'' if at == 1 else f' {at}'}"
        if level == 0:
            return Crossed(o, d, name, worst, path, passed)
        falls = dot(tuple(o[k] - ball.centre[k] for k in range(3)), d) < 0
        inner = None
        if falls and level < len(radii):
            inner = roots(o, d, Glass("", ball.centre, radii[level], mpf(1)))
        if inner:
            at, inward, t = level, True, inner[0]
        else:
            outer = roots(o, d, Glass("", ball.centre, radii[level - 1], mpf(1)))
            assert outer is not None
            at, inward, t = level - 1, False, outer[1]
        o = along(o, t, d)
        path += indices[level] * t


def follow(scene: Scene, o: Vector, d: Vector) -> Seen:
    """Trace a ray from a point outside all spheres to the plane z = 0, which spheres may reach through.

    The direction is taken as given but for its length, which in float64 is 1 only to rounding.
    """
    length = mpmath.sqrt(dot(d, d))
    d = tuple(x / length for x in d)
    balls = glasses(scene)
    branch: list[str] = []
    worst, path, passed = mpf(0), mpf(0), mpf(1)
    left: Glass | None = None
    while True:
        ahead = []
        for ball in balls:
            if ball is not left and (hit := roots(o, d, ball)) and hit[1] > 0:
                ahead.append((hit[0], ball))
        if not ahead:
            break
        t, ball = min(ahead, key=lambda pair: pair[0])
        reaches_through = ball.centre[2] - ball.radius < -TOUCHES
        if reaches_through and d[2] < 0 and along(o, t, d)[2] < 0:
            break
        o = along(o, t, d)
        path += t
        inside = cross(o, d, ball)
        if inside is None:
            sine = mpmath.sqrt(1 - (dot(tuple(o[k] - ball.centre[k] for k in range(3)), d) / ball.radius) ** 2)
            return Seen("tir", mpmath.nan, mpmath.nan, (*branch, ball.name), max(worst, sine), path, mpf(0), d)
        branch.append(inside.name)
        o, d = inside.o, inside.d
        worst, path, passed = max(worst, inside.worst), path + inside.path, passed * inside.passed
        left = ball
        if reaches_through and o[2] < 0:
            return Seen("glass", mpmath.nan, mpmath.nan, tuple(branch), worst, path, mpf(0), d)
    if not d[2] < 0:
        return Seen("missed", mpmath.nan, mpmath.nan, tuple(branch), worst, path, passed, d)
    t = -o[2] / d[2]
    end = along(o, t, d)
    return Seen("recovered", end[0], end[1], tuple(branch), worst, (path + t) * mpf(scene.n_ambient), passed, d)


def follow_pixel(scene: Scene, u: float, v: float) -> Seen:
    """Trace the ray of an acquired pixel."""
    return follow(scene, tuple(mpf(x) for x in scene.camera.position_mm), pixel_direction(scene.camera, u, v))


REGIONS = {"clear": 0.0, "centre": 0.9, "rim": 0.99, "last 1 %": 1.0}
LEVEL = 0.05  # a ray within 3 degrees of level lands anywhere: its conditioning, not the tracer, decides


def reference_pixels(scene: Scene, count: int, seed: int = 4) -> list[tuple[int, int, Seen]]:
    """Pixels u, v, half of them aimed at spheres, and what 50 digits say about them."""
    height, width = scene.camera.shape
    pixels = np.rint(aimed_pixels(scene, np.random.default_rng(seed), count)).astype(int)
    pixels = np.clip(pixels, 0, (width - 1, height - 1))
    return [(u, v, follow_pixel(scene, float(u), float(v))) for u, v in pixels.tolist()]


def errors_um(plane_mm: NDArray[np.float64], known: list[tuple[int, int, Seen]]) -> dict[str, dict[str, float]]:
    """Largest and rms error [um] of a map (H, W, 2) in each region, and how many rays that is."""
    found: dict[str, list[float]] = {name: [] for name in REGIONS}
    for u, v, seen in known:
        if seen.status != "recovered" or abs(seen.direction[2]) < LEVEL:
            continue
        place = next(name for name, limit in REGIONS.items() if seen.worst <= limit)
        x, y = (mpf(float(value)) for value in plane_mm[v, u])
        found[place].append(1e3 * float(mpmath.hypot(x - seen.x, y - seen.y)))
    return {
        name: {
            "rays": len(values),
            "max_um": float(np.max(values)),
            "rms_um": float(np.sqrt(np.mean(np.square(values)))),
        }
        for name, values in found.items()
        if values
    }
