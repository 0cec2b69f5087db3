"""Which spheres of a world are out of round: asked of the TYPE of its ``shapes``.

`shapes` is the empty tuple where every sphere is one, and nothing of this is left in the machine code; else it
holds one table (N, 50), a row for each sphere (``tracer.kernels.ball``), whose radius is 0 for those that are
round. The row of such a ball in the table of spheres is the sphere around it.
"""

import math
from typing import Any

from ground.jit import OVERLOADED, Array, kernel, overload
from tracer.kernels.ball import BESIDE, MEAN, back_through_ball, ball_rates, cross_ball, meets_ball
from tracer.kernels.branches import NOTHING
from tracer.kernels.sphere import CENTRE_X, CENTRE_Y, CENTRE_Z, RADIUS


@kernel
def next_of_shaped(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, last: int, spheres: Array, shapes: Array,
    room: int, home: Array,
) -> tuple[int, float]:  # fmt: skip
    """Number of the sphere or ball in a room met next, or NOTHING, and the distance to a point in it."""
    best, nearest = NOTHING, math.inf
    for i in range(spheres.shape[0]):
        if i != last and (home.shape[0] == 0 or home[i] == room):
            wx, wy, wz = px - spheres[i, CENTRE_X], py - spheres[i, CENTRE_Y], pz - spheres[i, CENTRE_Z]
            m = -(wx * dx + wy * dy + wz * dz)
            radius = spheres[i, RADIUS]
            if m + radius > 0.0 and m - radius < nearest:
                ax, ay, az = wx + m * dx, wy + m * dy, wz + m * dz
                if ax * ax + ay * ay + az * az < radius * radius:
                    if shapes[i, MEAN] > 0.0:
                        m = meets_ball(px, py, pz, dx, dy, dz, spheres[i], shapes[i])
                    if 0.0 < m < nearest:
                        best, nearest = i, m
    return best, nearest


def is_shaped(shapes: tuple[Any, ...], body: int) -> bool:
    """Whether a sphere is out of round."""
    return len(shapes) > 0 and bool(shapes[0][body, MEAN] > 0.0)


def next_shaped(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, last: int,
    spheres: Array, shapes: tuple[Any, ...], room: int, home: Array,
) -> tuple[int, float]:  # fmt: skip
    """`next_of_shaped` where there are shapes."""
    if not len(shapes):
        return NOTHING, math.inf
    return next_of_shaped(px, py, pz, dx, dy, dz, last, spheres, shapes[0], room, home)


def cross_shaped(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    body: int, spheres: Array, shapes: tuple[Any, ...],
) -> tuple[int, float, float, float, float, float, float, float, float]:  # fmt: skip
    """`cross_ball` where there are shapes."""
    if not len(shapes):
        return BESIDE, px, py, pz, dx, dy, dz, 0.0, 1.0
    return cross_ball(px, py, pz, dx, dy, dz, spheres[body], shapes[0][body])


def shaped_rates(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float,
    body: int, spheres: Array, shapes: tuple[Any, ...],
) -> tuple[float, ...]:  # fmt: skip
    """`ball_rates` where there are shapes."""
    if not len(shapes):
        return fx, fy, fz, ux, uy, uz
    return ball_rates(px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, spheres[body], shapes[0][body])


def back_through_shaped(
    fx: float, fy: float, fz: float, gx: float, gy: float, gz: float, state: Array,
    body: int, spheres: Array, shapes: tuple[Any, ...], out: Array, by_shape: Array,
) -> tuple[float, ...]:  # fmt: skip
    """`back_through_ball` where there are shapes, from a state as ``tracer.kernels.adjoint`` keeps it."""
    if not len(shapes):
        return fx, fy, fz, gx, gy, gz
    px, py, pz = (
        state[0] + spheres[body, CENTRE_X],
        state[1] + spheres[body, CENTRE_Y],
        state[2] + spheres[body, 2],
    )
    return back_through_ball(
        fx, fy, fz, gx, gy, gz, px, py, pz, state[3], state[4], state[5], spheres[body], shapes[0][body],
        out, by_shape,
    )  # fmt: skip


@overload(is_shaped, jit_options=OVERLOADED)
def _is_shaped(shapes, body):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda shapes, body: False
    return lambda shapes, body: shapes[0][body, MEAN] > 0.0


@overload(next_shaped, jit_options=OVERLOADED)
def _next_shaped(px, py, pz, dx, dy, dz, last, spheres, shapes, room, home):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda px, py, pz, dx, dy, dz, last, spheres, shapes, room, home: (NOTHING, math.inf)
    return lambda px, py, pz, dx, dy, dz, last, spheres, shapes, room, home: next_of_shaped(
        px, py, pz, dx, dy, dz, last, spheres, shapes[0], room, home
    )


@overload(cross_shaped, jit_options=OVERLOADED)
def _cross_shaped(px, py, pz, dx, dy, dz, body, spheres, shapes):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda px, py, pz, dx, dy, dz, body, spheres, shapes: (BESIDE, px, py, pz, dx, dy, dz, 0.0, 1.0)
    return lambda px, py, pz, dx, dy, dz, body, spheres, shapes: cross_ball(
        px, py, pz, dx, dy, dz, spheres[body], shapes[0][body]
    )


@overload(shaped_rates, jit_options=OVERLOADED)
def _shaped_rates(px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, body, spheres, shapes):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, body, spheres, shapes: (
            fx, fy, fz, ux, uy, uz,
        )  # fmt: skip
    return lambda px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, body, spheres, shapes: ball_rates(
        px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, spheres[body], shapes[0][body]
    )


@overload(back_through_shaped, jit_options=OVERLOADED)
def _back_through_shaped(fx, fy, fz, gx, gy, gz, state, body, spheres, shapes, out, by_shape):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda fx, fy, fz, gx, gy, gz, state, body, spheres, shapes, out, by_shape: (
            fx, fy, fz, gx, gy, gz,
        )  # fmt: skip

    def back(fx, fy, fz, gx, gy, gz, state, body, spheres, shapes, out, by_shape):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        ball = spheres[body]
        return back_through_ball(
            fx, fy, fz, gx, gy, gz, state[0] + ball[0], state[1] + ball[1], state[2] + ball[2],
            state[3], state[4], state[5], ball, shapes[0][body], out, by_shape,
        )  # fmt: skip

    return back
