"""Products of two views of the same places, one of them moved by lags."""

import math

from ground.jit import Array, kernel


@kernel
def spline_weights(t: float) -> tuple[float, float, float, float]:
    """Cubic B-spline at -1 - t, -t, 1 - t, 2 - t for 0 <= t < 1; they sum to 1."""
    s = 1.0 - t
    return (
        s * s * s / 6.0,
        (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0,
        t * t * t / 6.0,
    )


@kernel
def smooth_at(image: Array, u: float, v: float) -> float:
    """Image (H, W) under a cubic B-spline about the pixel position (u, v), which lies two pixels inside.

    Pixels are not turned into coefficients first, so this is the image smoothed by a bell of variance 1/3 px^2,
    the same wherever it is asked: no position is favoured.
    """
    i, j = int(u), int(v)
    a0, a1, a2, a3 = spline_weights(u - i)
    b0, b1, b2, b3 = spline_weights(v - j)
    total = 0.0
    for k in range(4):
        row = j - 1 + k
        across = a0 * image[row, i - 1] + a1 * image[row, i] + a2 * image[row, i + 1] + a3 * image[row, i + 2]
        total += (b0 if k == 0 else b1 if k == 1 else b2 if k == 2 else b3) * across
    return total


@kernel
def add_products(
    image: Array,
    weight: Array,
    first: Array,
    second: Array,
    along: Array,
    across: Array,
    cell: Array,
    out: Array,
) -> None:
    """Add first view times moved second view to the planes of cells.

    image (H, W) float32; weight (N,) of places; first, second (N, 2) pixels u, v of the two views; along, across
    (N, 2) by how much the pixel of the second moves for a lag of one; cell (N,); out (C, 2 a + 1, 2 b + 1) for
    lags -a ... a along and -b ... b across.  All pixels lie two inside the image.
    """
    rows, columns = out.shape[1], out.shape[2]
    a, b = rows // 2, columns // 2
    for n in range(first.shape[0]):
        here = weight[n] * smooth_at(image, first[n, 0], first[n, 1])
        for i in range(rows):
            for j in range(columns):
                u = second[n, 0] + (i - a) * along[n, 0] + (j - b) * across[n, 0]
                v = second[n, 1] + (i - a) * along[n, 1] + (j - b) * across[n, 1]
                out[cell[n], i, j] += here * smooth_at(image, u, v)


@kernel
def add_bells(
    offset: Array, spread: Array, light: Array, along: Array, across: Array, cell: Array, out: Array
) -> None:
    """Add what layers of particles make of the planes of cells.

    offset (N, L, 2) middle of a bell from the second pixel; spread (N, L, 3) its variances along u and v and their
    covariance; light (N, L); along, across (N, 2) as in `add_products`; cell (N,); out (C, L, 2 a + 1, 2 b + 1).
    """
    rows, columns = out.shape[2], out.shape[3]
    a, b = rows // 2, columns // 2
    for n in range(offset.shape[0]):
        for k in range(offset.shape[1]):
            uu, vv, uv = spread[n, k, 0], spread[n, k, 1], spread[n, k, 2]
            det = uu * vv - uv * uv
            if light[n, k] == 0.0 or det <= 0.0:
                continue
            high = light[n, k] / (2.0 * math.pi * math.sqrt(det))
            for i in range(rows):
                for j in range(columns):
                    u = (i - a) * along[n, 0] + (j - b) * across[n, 0] - offset[n, k, 0]
                    v = (i - a) * along[n, 1] + (j - b) * across[n, 1] - offset[n, k, 1]
                    far = (vv * u * u - 2.0 * uv * u * v + uu * v * v) / det
                    if far < 50.0:
                        out[cell[n], k, i, j] += high * math.exp(-0.5 * far)
