"""Spheres that reach through the investigation plane: a ray ends where it reaches z = 0, in the gas or in glass.

A ray is asked twice at each sphere.  If it would enter behind the plane, it has met the plane in the gas before:
it ends there and is RECOVERED.  If it leaves behind the plane, it has crossed z = 0 inside, and is IN_GLASS.  With
the foot point a of a straight piece relative to the centre and half the chord h = sqrt(R^2 - b^2), which is the
same before and behind (``tracer.kernels.sphere``), it enters at a - h d and leaves at a' + h d': no tolerance
decides.  One that comes up to the plane from behind is lost, as it was IN_GLASS before.

A sphere that touches the plane to CONTACT_TOL_MM does not reach through it and is never asked.
"""

import math

from ground.jit import Array, kernel_inlined
from tracer.kernels.ball import entry_of_shape, is_shaped
from tracer.kernels.sphere import RADIUS, foot
from tracer.kernels.vectors import Vector, dot, subtract, vector_at
from tracer.kernels.world import World

CONTACT_TOL_MM = 1e-6  # a nanometre of overlap is contact: coordinates come from decimal files
foot_inlined = kernel_inlined(foot.py_func)  # type: ignore[attr-defined]


@kernel_inlined
def reaches_through(z: float, radius: float) -> bool:
    """Return whether a sphere reaches through the plane from above."""
    return bool(z - radius < -CONTACT_TOL_MM)


@kernel_inlined
def enters_behind(p: Vector, d: Vector, centre: Vector, radius: float) -> bool:
    """Return whether a ray from p along d reaches the plane before it enters a sphere that it meets."""
    if not (d[2] < 0.0 and reaches_through(centre[2], radius)):
        return False
    _, a = foot_inlined(subtract(p, centre), d)
    return bool(centre[2] + a[2] - math.sqrt(max(radius * radius - dot(a, a), 0.0)) * d[2] < 0.0)


@kernel_inlined
def leaves_behind(a: Vector, d: Vector, z: float, radius: float) -> bool:
    """Return whether a ray leaves a sphere behind the plane: foot point and direction behind, z of the centre."""
    if not reaches_through(z, radius):
        return False
    return bool(z + a[2] + math.sqrt(max(radius * radius - dot(a, a), 0.0)) * d[2] < 0.0)


@kernel_inlined
def ends_before(p: Vector, d: Vector, body: int, world: World) -> bool:
    """Return whether a ray reaches the plane before the sphere or ball that it meets next."""
    ball: Array = world.spheres[body]
    if len(world.shapes) > 0 and is_shaped(world.shapes, body):
        return bool(d[2] < 0.0 and entry_of_shape(p, d, body, world.spheres, world.shapes)[2] < 0.0)
    return enters_behind(p, d, vector_at(ball, 0), ball[RADIUS])
