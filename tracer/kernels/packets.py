"""One ray of a packet at one sphere and at the plane: shared by blocks and bundles.

Both go over their rays in loops without a branch (``tracer.kernels.chain``, ``tracer.kernels.bundle``): whatever a
ray does not do is computed as well and not selected.  Columns of a packet are STEP apart in one array, and begin
with position and direction.
"""

import math

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.vectors import Vector, combine, dot, move

LANES = 256  # rays of a packet: 21 kB, what the first-level cache holds
VECTOR = 8  # rays of the widest vector instruction
STEP = LANES + 40  # columns a power of two apart would fight for the same lines of that cache
PX, PY, PZ, DX, DY, DZ = (k * STEP for k in range(6))


@kernel
def whole_vectors(count: int) -> int:
    """Smallest multiple of VECTOR that is not below `count`."""
    return (count + VECTOR - 1) // VECTOR * VECTOR


@kernel_inlined
def foot_of(w: Vector, d: Vector, inverse: float) -> tuple[float, Vector, float]:
    """Distance m to the foot point [|D|], the foot point a and b^2 of a ray from w relative to a centre."""
    m = -dot(w, d) * inverse
    a = move(w, m, d)
    return m, a, dot(a, a)


@kernel_inlined
def refract(
    centre: Vector,
    a: Vector,
    b2: float,
    d: Vector,
    lengths: tuple[float, float],
    glass: tuple[float, ...],
    bent: bool,
) -> tuple[Vector, Vector]:
    """Foot point in the world and direction of a ray behind a sphere; those before it unless it is `bent`.

    `lengths`: Q = |D|^2 and its inverse, both 1.0 for unit vectors; `glass`: R^2, 1/R^2, 1/(n R)^2, 1/n,
    (n^2 - 1)/n^2 and 1/R.  Formulas: ``tracer.kernels.chain``.
    """
    (square, inverse), (r2, ir2, kt, nu, gk, ir) = lengths, glass
    chi = b2 * ir2
    cos_i = math.sqrt(max((r2 - b2) * ir2, 0.0) * square)
    cos_t = math.sqrt(max(1.0 - b2 * kt, 0.0) * square)
    g = gk * square / (cos_t + cos_i * nu)
    gi = g * inverse
    cosine = 1.0 - 2.0 * chi * g * gi
    q = 2.0 * gi * (cos_i * cos_t + chi * nu * square) * ir
    cosine, q = cosine if bent else 1.0, q if bent else 0.0
    return move(move(centre, cosine, a), b2 * q * inverse, d), combine(cosine, d, -q, a)


@kernel
def hit_plane(count: int, rays: Array) -> None:
    """Take `count` rays to the plane; their points, NaN for those that do not go down, replace PX and PY."""
    for i in range(count):
        dz = rays[DZ + i]
        t = -rays[PZ + i] / dz
        x, y = rays[PX + i] + t * rays[DX + i], rays[PY + i] + t * rays[DY + i]
        down = dz < 0.0
        rays[PX + i], rays[PY + i] = x if down else math.nan, y if down else math.nan
