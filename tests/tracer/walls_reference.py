"""A slow tracer for scenes with walls: 50 digits, and no idea of rooms, ways or what comes next.

Every surface of every body is one equation.  A ray goes to the nearest root of any of them, looks which medium
is a hair beyond it, and is bent there by Snell's law if that is another one.  Which medium is where is asked of
the point alone: the innermost thing around it.  (The kernels know which surface comes next from where the ray
is, have tables relative to rooms, and never look a hair ahead.)
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import mpmath
from mpmath import mpf

from benchmarks.reference import Vector, along, dot, snell
from tracer.bodies import Body, Dome, Sphere, Tube, Window
from tracer.scene.scene import Scene

HAIR = mpf(10) ** -25
Where = Callable[[Vector], bool]


@dataclass(frozen=True)
class Region:
    """A medium, where it is, and what it is: 'ball', 'wall' or 'room'."""

    body: Body
    n: mpf
    holds: Where
    what: str


@dataclass(frozen=True)
class End:
    """What became of a ray: 'recovered', 'tir', 'missed' or 'blocked'; where, path and light."""

    status: str
    point: Vector
    direction: Vector
    path: mpf
    passed: mpf
    branch: tuple[str, ...]
    steepest: mpf


@cache  # the same walls are asked about at every step of a ray
def vector(values: tuple[float, ...]) -> Vector:
    """Three exact numbers."""
    return tuple(mpf(value) for value in values)


@cache
def unit(values: tuple[float, ...]) -> Vector:
    """A direction of length 1 in all digits: points on a surface are told by a hair from those beside it."""
    v = vector(values)
    length = mpmath.sqrt(dot(v, v))
    return tuple(x / length for x in v)


def minus(a: Vector, b: Vector) -> Vector:
    """Difference."""
    return tuple(x - y for x, y in zip(a, b, strict=True))


class Walls:
    """The scene as surfaces and regions."""

    def __init__(self, scene: Scene) -> None:
        nm = scene.wavelength_nm
        self.ambient = mpf(scene.ambient.n(nm))
        self.regions: list[Region] = []
        self.balls: list[tuple[Sphere, Vector, mpf, mpf]] = []
        self.windows = [body for body in scene.bodies if isinstance(body, Window)]
        self.tubes = [body for body in scene.bodies if isinstance(body, Tube)]
        self.domes = [body for body in scene.bodies if isinstance(body, Dome)]
        for ball in scene.spheres:
            assert ball.medium is not None
            c, inner = vector(ball.centre_mm), [(mpf(ball.radius_mm), ball.medium)]
            inner += [(mpf(core.radius_mm), core.medium) for core in ball.cores]
            for radius, medium in inner:
                self.balls.append((ball, c, radius, mpf(medium.n(nm))))

        def n_of(wall: Tube | Window | Dome) -> mpf:
            medium = wall.behind if isinstance(wall, Window) else wall.filled
            if medium is not None:
                return mpf(medium.n(nm))
            return self.at(vector(wall.start_mm if isinstance(wall, Tube) else wall.centre_mm))[0]

        for window in self.windows:
            self.regions.append(Region(window, n_of(window), self._behind(window), "room"))
            self.regions.append(Region(window, mpf(window.medium.n(nm)), self._in_plate(window), "wall"))
        for wall in sorted((*self.tubes, *self.domes), key=lambda wall: -wall.outer_radius_mm):
            around = n_of(wall)  # what stands in another one is the smaller of the two
            if isinstance(wall, Tube):
                whole, inner = self._in_pipe(wall, wall.outer_radius_mm), self._in_pipe(wall, wall.inner_radius_mm)
            else:
                whole, inner = (self._in_ball(*shell) for shell in shells(wall))
            self.regions.append(Region(wall, mpf(wall.medium.n(nm)), whole, "wall"))
            self.regions.append(Region(wall, around, inner, "room"))
        self.regions += [Region(b, n, self._in_ball(c, r), "ball") for b, c, r, n in self.balls]

    @staticmethod
    def _behind(window: Window) -> Where:
        o, k, depth = vector(window.centre_mm), unit(window.normal), mpf(window.thickness_mm)
        return lambda p: dot(minus(p, o), k) < -depth

    @staticmethod
    def _in_plate(window: Window) -> Where:
        o, k, depth = vector(window.centre_mm), unit(window.normal), mpf(window.thickness_mm)
        return lambda p: -depth < dot(minus(p, o), k) < 0

    @staticmethod
    def _in_pipe(tube: Tube, radius: float) -> Where:
        o, k, length, square = vector(tube.start_mm), unit(tube.axis), mpf(tube.length_mm), mpf(radius) ** 2

        def holds(p: Vector) -> bool:
            w = minus(p, o)
            at = dot(w, k)
            return bool(0 < at < length and dot(w, w) - at * at < square)

        return holds

    @staticmethod
    def _in_ball(centre: Vector, radius: mpf) -> Where:
        return lambda p: dot(minus(p, centre), minus(p, centre)) < radius**2

    def at(self, p: Vector) -> tuple[mpf, Region | None]:
        """Medium of a point: that of the last region around it, for they are listed from the outside in."""
        found: Region | None = None
        for region in self.regions:
            if region.holds(p):
                found = region
        return (self.ambient, None) if found is None else (found.n, found)

    def surfaces(self, p: Vector, d: Vector) -> Iterator[tuple[mpf, Vector, str, Body | None]]:
        """Distance, normal (either way), kind and body of every surface on the line."""
        if d[2] != 0:
            yield -p[2] / d[2], (mpf(0), mpf(0), mpf(1)), "plane", None
        for ball, centre, radius, _ in self.balls:
            for t in _roots(minus(p, centre), d, radius):
                q = along(p, t, d)
                yield t, tuple(x / radius for x in minus(q, centre)), "ball", ball
        for dome in self.domes:
            for centre, radius in shells(dome):
                for t in _roots(minus(p, centre), d, radius):
                    q = along(p, t, d)
                    yield t, tuple(x / radius for x in minus(q, centre)), "side", dome
        for window in self.windows:
            o, k = vector(window.centre_mm), unit(window.normal)
            slope = dot(d, k)
            for depth in (mpf(0), mpf(window.thickness_mm)):
                if slope != 0:
                    yield -(dot(minus(p, o), k) + depth) / slope, k, "plate", window
        for tube in self.tubes:
            o, k = vector(tube.start_mm), unit(tube.axis)
            w = minus(p, o)
            flat_w = minus(w, tuple(dot(w, k) * x for x in k))
            flat_d = minus(d, tuple(dot(d, k) * x for x in k))
            for radius in (mpf(tube.outer_radius_mm), mpf(tube.inner_radius_mm)):
                for t in _roots(flat_w, flat_d, radius):
                    q = along(flat_w, t, flat_d)
                    at = dot(w, k) + t * dot(d, k)
                    if 0 < at < mpf(tube.length_mm):
                        yield t, tuple(x / radius for x in q), "side", tube
            if dot(d, k) != 0:
                for at in (mpf(0), mpf(tube.length_mm)):
                    t = (at - dot(w, k)) / dot(d, k)
                    q = along(flat_w, t, flat_d)
                    if dot(q, q) < mpf(tube.outer_radius_mm) ** 2:
                        yield t, k, "end", tube


def shells(dome: Dome) -> list[tuple[Vector, mpf]]:
    """Centre and radius of both spheres."""
    outer = vector(dome.centre_mm), mpf(dome.outer_radius_mm)
    return [outer, (vector(dome.inside_mm), mpf(dome.inner_radius_mm))]


def is_mount(dome: Dome, p: Vector) -> bool:
    """Return whether a point of a dome is beyond its opening."""
    w, axis = minus(p, vector(dome.centre_mm)), vector(dome.axis)
    limit = mpf(float(dome.table_of([dome], lambda *_: 1.0).rows[0, -1]))
    return bool(dot(w, axis) < limit * mpmath.sqrt(dot(w, w)))


def _roots(w: Vector, d: Vector, radius: mpf) -> list[mpf]:
    a, half, c = dot(d, d), dot(w, d), dot(w, w) - radius**2
    square = half**2 - a * c
    if a == 0 or square <= 0:
        return []
    root = mpmath.sqrt(square)
    return [(-half - root) / a, (-half + root) / a]


def follow_walls(walls: Walls, p: Vector, d: Vector, most: int = 400) -> End:
    """Follow a ray to the investigation plane."""
    path, passed, steepest, branch = mpf(0), mpf(1), mpf(0), []
    n, region = walls.at(p)
    for _ in range(most):
        ahead = sorted((hit for hit in walls.surfaces(p, d) if hit[0] > HAIR), key=lambda hit: hit[0])
        if not ahead:
            return End("missed", p, d, path, passed, tuple(branch), steepest)
        t, normal, kind, body = ahead[0]
        p, path = along(p, t, d), path + n * t
        if kind == "plane":
            status = "missed" if d[2] > 0 or (region is not None and region.what != "room") else "recovered"
            if d[2] < 0:
                return End(status, p, d, path, passed, tuple(branch), steepest)
            continue
        beyond, into = walls.at(along(p, HAIR, d))
        if kind == "plate":
            assert isinstance(body, Window)
            w = minus(p, vector(body.centre_mm))
            at = dot(w, unit(body.normal))
            if dot(w, w) - at * at >= mpf(body.radius_mm) ** 2 and dot(d, unit(body.normal)) < 0:
                return End("blocked", p, d, path, passed, tuple(branch), steepest)
            if dot(d, unit(body.normal)) > 0:
                return End("missed", p, d, path, passed, tuple(branch), steepest)
        if kind == "end":
            if n != beyond or (region is not None and region.what == "wall") or (into and into.what == "wall"):
                return End("blocked", p, d, path, passed, tuple(branch), steepest)
            region = into
            continue
        if isinstance(body, Dome) and is_mount(body, p):
            return End("blocked", p, d, path, passed, tuple(branch), steepest)
        if kind == "side" and region is not None and region.body is body and region.what == "wall":
            out = into is None or into.body is not body
            was_off = bool(branch) and branch[-1] == f"{body.name} off inside"
            if out and not was_off and not walls_from_inside(walls, p, d, body):
                branch.append(body.name)
        if n == beyond and kind != "ball":
            region = into
            continue
        if dot(normal, d) > 0:
            normal = tuple(-x for x in normal)
        steepest = max(steepest, mpmath.sqrt(max(mpf(0), 1 - dot(normal, d) ** 2)))
        bent = snell(d, normal, n / beyond)
        inside_of_pipe = kind == "side" and region and region.what == "wall" and into
        if bent is None:
            at_core = kind == "ball" and region is not None and into is not None and region.body is into.body
            if not (at_core or (inside_of_pipe and into.body is body and into.what == "room")):
                return End("tir", p, d, path, passed, tuple(branch), steepest)
            cosine = dot(normal, d)
            d = tuple(x - 2 * cosine * y for x, y in zip(d, normal, strict=True))
            if not at_core:
                branch.append(f"{body.name} off inside")
            continue
        if (
            kind == "ball"
            and into is not None
            and into.body is body
            and (region is None or region.body is not body)
        ):
            branch.append(body.name)
        d, share = bent
        steepest = max(steepest, mpmath.sqrt(max(mpf(0), 1 - dot(normal, d) ** 2)))
        passed, n, region = passed * share, beyond, into
    raise RuntimeError("a ray that never ends")


def walls_from_inside(walls: Walls, p: Vector, d: Vector, tube: Body) -> bool:
    """Return whether a ray that leaves a tube's or dome's wall outwards at p came from its inside."""
    if isinstance(tube, Dome):
        centre, radius = shells(tube)[1]
        return any(t > HAIR for t in _roots(minus(p, centre), tuple(-x for x in d), radius))
    assert isinstance(tube, Tube)
    o, k = vector(tube.start_mm), unit(tube.axis)
    w, back = minus(p, o), tuple(-x for x in d)
    flat_w = minus(w, tuple(dot(w, k) * x for x in k))
    flat_d = minus(back, tuple(dot(back, k) * x for x in k))
    return any(t > HAIR for t in _roots(flat_w, flat_d, mpf(tube.inner_radius_mm)))
