"""Apparent positions behind windows: straight rays must come near there if bent ones are to meet the bodies.

The faces are parallel, N is their unit normal towards the camera, P the pinhole.  A ray leaves P at an angle theta
to N.  In a layer of thickness d and index n (of the medium before the first window: 1) it moves sideways by

    d g tan theta,   g = 1/sqrt(n^2 + (n^2 - 1) tan^2 theta),

so at every depth it is where a straight ray would be at the distance A = sum d g, the apparent one: for small
angles sum d/n.  g is monotone; for the rays of a row it lies between its values at theta = 0 and at the largest
angle, which one of the row's corners has, as rays within a cone make a convex part of the image.  With the middle
g0 of both and their half difference e, A0 = sum d g0 serves all of them: at the true depth a ray is not further
than slack = (sum d e) tan theta from where the straight one is at A0.

A sphere seems to be an ellipsoid within a sphere of radius R max(1, g0) around the apparent place of its centre.
Widened by the slack at its far end, no ray meets the sphere unless the straight one meets that: silhouettes
(``tracer.kernels.chain.glass_span``) are those of apparent spheres.  The opening of a face narrowed by its slack
is convex: where the straight rays through the corners of a block pass it, all rays of the block do.
"""

import math

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.camera import EYE_Z, axes_of, eye_of
from tracer.kernels.chain import image_ray
from tracer.kernels.vectors import Vector, divide, dot, move, scale, subtract, vector_at
from tracer.kernels.window import BEHIND, GLASS, OPENING, THICKNESS

ROUNDED = 1e-11  # of a distance: more than what rounding does
LEVEL, SEEMING, BESIDE_X, BESIDE_Y, BESIDE_Z, FREE, SLACK = range(7)
# Distance of a face from P, the apparent one, its middle as seen from P across N, free radius, slack
FACE = 7


@kernel
def image_box(x: Array, y: Array, box: Array) -> None:
    """Box (4,) around ideal image coordinates x, y: least and largest x, least and largest y."""
    left = top = math.inf
    right = bottom = -math.inf
    for i in range(x.shape[0]):
        left, right = min(left, x[i]), max(right, x[i])
    for i in range(y.shape[0]):
        top, bottom = min(top, y[i]), max(bottom, y[i])
    box[0], box[1], box[2], box[3] = left, right, top, bottom


@kernel_inlined
def corner_ray(corner: int, box: Array, camera: Array, normal: Vector) -> tuple[float, Vector]:
    """Share m towards the window of the ray through a corner of a box of the image, and its share across."""
    d = image_ray(box[corner & 1], box[2 + (corner >> 1)], axes_of(camera))
    m = -dot(d, normal)
    return m, move(d, m, normal)


@kernel
def shortening(n: float, tan2: float) -> tuple[float, float]:
    """Middle of g at theta = 0 and at the largest tan^2 theta, and half their difference; NaN: reflected."""
    square = n * n + (n - 1.0) * (n + 1.0) * tan2
    straight, oblique = 1.0 / n, 1.0 / math.sqrt(square) if square > 0.0 else math.nan
    return 0.5 * (straight + oblique), 0.5 * abs(straight - oblique)


@kernel
def apparent_positions(
    box: Array, camera: Array, windows: Array, balls: Array, faces: Array, discs: Array
) -> bool:
    """Faces (2 K, FACE) of windows (K, 10) and apparent spheres (N, 4) x, y, z, R^2 for the rays of a box.

    Returns whether they are good bounds: windows that are not parallel, or a ray that is reflected, have none.
    """
    eye, normal = eye_of(camera), vector_at(windows[0], 3)
    tan2 = 0.0
    for corner in range(4):
        m, s = corner_ray(corner, box, camera, normal)
        if not m > 0.0:
            return False
        tan2 = max(tan2, dot(s, s) / (m * m))
    tangent = math.sqrt(tan2)
    level = seeming = error = 0.0
    n = 1.0
    g, e = 1.0, 0.0
    for k in range(windows.shape[0]):
        row = windows[k]
        if row[3] != normal[0] or row[4] != normal[1] or row[5] != normal[2]:
            return False
        w = subtract(eye, vector_at(row, 0))
        away = dot(w, normal)
        if not away > level:
            return False
        for face in range(2):
            depth = away - level if face == 0 else row[THICKNESS]
            seeming, error, level = seeming + depth * g, error + depth * e, level + depth
            slack = error * tangent + ROUNDED * level
            f = faces[2 * k + face]
            f[LEVEL], f[SEEMING], f[FREE], f[SLACK] = level, seeming, max(row[OPENING] - slack, 0.0), slack
            f[BESIDE_X], f[BESIDE_Y], f[BESIDE_Z] = subtract(scale(away, normal), w)
            g, e = shortening(n * row[GLASS] if face == 0 else n * row[BEHIND], tan2)
            if not g < math.inf:
                return False
        n *= row[BEHIND]
    for k in range(balls.shape[0]):
        centre, radius = vector_at(balls[k], 0), math.sqrt(balls[k, 3])
        away = -dot(subtract(centre, eye), normal)
        depth = away - level
        if not depth >= 0.0:
            return False
        moved = away - seeming - depth * g  # towards the camera
        slack = (error + (depth + radius) * e) * tangent + ROUNDED * (away + radius)
        wide = radius * max(1.0, g) + slack
        discs[k, 0], discs[k, 1], discs[k, 2] = move(centre, moved, normal)
        discs[k, 3] = wide * wide
    return True


@kernel
def all_open(box: Array, camera: Array, windows: Array, faces: Array) -> bool:
    """Return whether all rays of a box pass the openings of all faces, above the investigation plane."""
    normal = vector_at(windows[0], 3)
    for corner in range(4):
        m, s = corner_ray(corner, box, camera, normal)
        s = divide(s, m)
        for k in range(faces.shape[0]):
            f = faces[k]
            a = subtract(scale(f[SEEMING], s), vector_at(f, BESIDE_X))
            height = camera[EYE_Z] - f[LEVEL] * normal[2] + f[SEEMING] * s[2]
            if not (dot(a, a) < f[FREE] * f[FREE] and height > f[SLACK]):
                return False
    return True
