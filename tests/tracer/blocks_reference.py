"""A slow tracer for blocks and balls: 50 digits, and no idea of chords, rooms, or which face comes next.

A ray goes to the nearest root of any surface of any body, and what lies a hair beyond it says whether it has met
anything there at all: the planes of faces go on beyond the body.  Planes are taken from the corners of a block, by
cross products.
"""

from dataclasses import dataclass

import mpmath
from mpmath import mpf

from benchmarks.reference import Vector, along, dot, snell
from tests.tracer.walls_reference import HAIR, minus, vector
from tracer.bodies import Block
from tracer.kernels.block import MOST_SURFACES
from tracer.scene.scene import Scene


@dataclass(frozen=True)
class Face:
    """A plane of a block's outside or inside: a point of it and its unit normal outwards."""

    block: Block
    name: str
    at: Vector
    normal: Vector
    is_inner: bool


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def faces_of(block: Block) -> list[Face]:
    """All faces from the corners; those of the inside a wall further in."""
    corners = [vector(tuple(point)) for point in block.corners_mm.tolist()]
    count = len(corners) // 2
    middle = tuple(sum(corner[k] for corner in corners) / (2 * count) for k in range(3))
    rings = [(k, (k + 1) % count, k + count) for k in range(count)] + [(0, 1, 2), (count, count + 1, count + 2)]
    faces = []
    for name, (a, b, c) in zip(block.face_names, rings, strict=True):
        normal = cross(minus(corners[b], corners[a]), minus(corners[c], corners[a]))
        length = mpmath.sqrt(dot(normal, normal))
        sign = 1 if dot(normal, minus(corners[a], middle)) > 0 else -1
        normal = tuple(sign * x / length for x in normal)
        faces.append(Face(block, name, corners[a], normal, False))
        if block.wall_mm:
            faces.append(Face(block, name, along(corners[a], -mpf(block.wall_mm), normal), normal, True))
    return faces


class Reference:
    """A scene of blocks and balls, none of them in another one but in a hollow block."""

    def __init__(self, scene: Scene) -> None:
        nm = scene.wavelength_nm
        self.n = {None: mpf(scene.ambient.n(nm))}
        self.faces = [face for body in scene.bodies if isinstance(body, Block) for face in faces_of(body)]
        self.balls = [(ball, vector(ball.centre_mm), mpf(ball.radius_mm)) for ball in scene.spheres]
        for block in {face.block.name: face.block for face in self.faces}.values():
            self.n[block.name, "glass"] = mpf(block.medium.n(nm))
            self.n[block.name, "inside"] = mpf((block.filled or scene.ambient).n(nm))
        for ball in scene.spheres:
            assert ball.medium is not None
            self.n[ball.name] = mpf(ball.medium.n(nm))

    def at(self, p: Vector) -> object:
        """Where a point is: a ball's name, a block's with "glass" or "inside", or None."""
        for ball, centre, radius in self.balls:
            if dot(minus(p, centre), minus(p, centre)) < radius**2:
                return ball.name
        for block in {face.block.name: face.block for face in self.faces}.values():
            own = [face for face in self.faces if face.block is block]
            if all(dot(minus(p, face.at), face.normal) < 0 for face in own if not face.is_inner):
                inner = [face for face in own if face.is_inner]
                hollow = bool(inner) and all(dot(minus(p, face.at), face.normal) < 0 for face in inner)
                return block.name, "inside" if hollow else "glass"
        return None

    def is_at_edge(self, p: Vector, met: Face) -> bool:
        """Return whether a point of a face is within the edge's width of another face's plane."""
        others = (f for f in self.faces if f.block is met.block and f.is_inner == met.is_inner and f is not met)
        return any(dot(minus(f.at, p), f.normal) < met.block.edge_mm for f in others)

    def surfaces(self, p: Vector, d: Vector) -> list[tuple[mpf, Vector, Face | None]]:
        """Distance ahead, normal and face of every surface on the line, nearest first."""
        hits = []
        for face in self.faces:
            if dot(d, face.normal) != 0:
                hits.append((dot(minus(face.at, p), face.normal) / dot(d, face.normal), face.normal, face))
        for _, centre, radius in self.balls:
            w, a = minus(p, centre), dot(d, d)  # 1 to 16 digits only
            square = dot(w, d) ** 2 - a * (dot(w, w) - radius**2)
            for sign in (-1, 1) if square > 0 else ():
                t = (-dot(w, d) + sign * mpmath.sqrt(square)) / a
                hits.append((t, tuple(x / radius for x in minus(along(p, t, d), centre)), None))
        return sorted((hit for hit in hits if hit[0] > HAIR), key=lambda hit: hit[0])


def follow(world: Reference, p: Vector, d: Vector) -> tuple[str, Vector, mpf, mpf, tuple[str, ...]]:
    """Follow a ray to the plane: status, point, path, light, and the branch by names of bodies and faces."""
    path, light, branch, faces = mpf(0), mpf(1), [], []
    here, came_out, was_inner = world.at(p), False, False
    for _ in range(200):
        to_plane = -p[2] / d[2] if d[2] < 0 else mpf("inf")
        t, normal, face = next(
            (hit for hit in world.surfaces(p, d) if world.at(along(p, hit[0] + HAIR, d)) != here),
            (mpf("inf"), None, None),
        )
        in_glass = isinstance(here, str) or (isinstance(here, tuple) and here[1] == "glass")
        if t >= to_plane < mpf("inf"):
            if in_glass:
                return "in glass", p, path, light, tuple(branch)
            return "recovered", along(p, to_plane, d), path + to_plane * world.n[here], light, tuple(branch)
        if normal is None:
            return "missed", p, path, light, tuple(branch)
        p, path = along(p, t, d), path + t * world.n[here]
        beyond = world.at(along(p, HAIR, d))
        if face is not None:
            if not faces:
                came_out, was_inner = face.is_inner, False
            if world.is_at_edge(p, face):
                return "edge", p, path, light, tuple(branch)
            faces.append(face.name)
        normal = normal if dot(normal, d) < 0 else tuple(-x for x in normal)
        bent = snell(d, normal, world.n[here] / world.n[beyond])
        if bent is None:
            if face is None or not in_glass or (came_out and face.is_inner) or len(faces) == MOST_SURFACES:
                return "tir", p, path, light, tuple(branch)
            was_inner = was_inner or face.is_inner
            cosine = dot(normal, d)
            d = tuple(x - 2 * cosine * y for x, y in zip(d, normal, strict=True))
            continue
        if face is not None and in_glass:
            into = face.is_inner
            if into and came_out:
                return "tir", p, path, light, tuple(branch)
            way = " out" if came_out else " in" if into else " off inside" if was_inner else ""
            branch.append(f"{face.block.name}{way} {'-'.join(faces)}")
            faces = []
        elif face is None and isinstance(beyond, str):
            branch.append(beyond)
        d, share = bent
        light, here = light * share, beyond
    raise RuntimeError("a ray that never ends")
