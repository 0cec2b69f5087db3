"""Sample a frame at every recovered node, over the node's whole footprint on the sensor."""

import math

import numpy as np

from correction.kernels.bspline import INDEX, bilinear_at, quintic_at, weight_inner, weight_middle, weight_outer
from tracer.kernels._jit import Array, kernel, kernel_inlined

MAX_SAMPLES = 16  # a side; the largest magnification that a correction map keeps
ONE_SAMPLE_PX2 = np.float32(1.25 * 1.25)  # square of the longest side for which `samples_along` is 1
_ONE = np.float32(1.0)

bilinear_inlined = kernel_inlined(bilinear_at.py_func)  # type: ignore[attr-defined]
outer_inlined = kernel_inlined(weight_outer.py_func)  # type: ignore[attr-defined]
middle_inlined = kernel_inlined(weight_middle.py_func)  # type: ignore[attr-defined]
inner_inlined = kernel_inlined(weight_inner.py_func)  # type: ignore[attr-defined]


@kernel
def samples_along(du: float, dv: float) -> int:
    """Samples needed along a footprint side (du, dv) [px]: one a pixel; a quarter too much is no reason."""
    return int(min(MAX_SAMPLES, max(1.0, math.ceil(math.sqrt(du * du + dv * dv) - 0.25))))


@kernel_inlined
def quintic_inside(flat: Array, width: int, i: int, j: int, s: np.float32, t: np.float32) -> np.float32:
    """`quintic_at` (i + s, j + t) at least three pixels inside the frame, from the flat coefficients (H W,)."""
    s1, t1 = _ONE - s, _ONE - t
    y0, y1, y2 = outer_inlined(t), middle_inlined(t), inner_inlined(t)
    y3, y4, y5 = inner_inlined(t1), middle_inlined(t1), outer_inlined(t1)
    x0, x1, x2 = outer_inlined(s), middle_inlined(s), inner_inlined(s)
    x3, x4, x5 = inner_inlined(s1), middle_inlined(s1), outer_inlined(s1)
    c = flat
    p = ((j - 2) * width + i - 2) & INDEX
    value = y0 * (x0 * c[p] + x1 * c[p + 1] + x2 * c[p + 2] + x3 * c[p + 3] + x4 * c[p + 4] + x5 * c[p + 5])
    p += width
    value += y1 * (x0 * c[p] + x1 * c[p + 1] + x2 * c[p + 2] + x3 * c[p + 3] + x4 * c[p + 4] + x5 * c[p + 5])
    p += width
    value += y2 * (x0 * c[p] + x1 * c[p + 1] + x2 * c[p + 2] + x3 * c[p + 3] + x4 * c[p + 4] + x5 * c[p + 5])
    p += width
    value += y3 * (x0 * c[p] + x1 * c[p + 1] + x2 * c[p + 2] + x3 * c[p + 3] + x4 * c[p + 4] + x5 * c[p + 5])
    p += width
    value += y4 * (x0 * c[p] + x1 * c[p + 1] + x2 * c[p + 2] + x3 * c[p + 3] + x4 * c[p + 4] + x5 * c[p + 5])
    p += width
    value += y5 * (x0 * c[p] + x1 * c[p + 1] + x2 * c[p + 2] + x3 * c[p + 3] + x4 * c[p + 4] + x5 * c[p + 5])
    return value  # type: ignore[no-any-return]


@kernel
def mean_over(
    image: Array,
    quintic: bool,
    u: float,
    v: float,
    uc: float,
    ur: float,
    vc: float,
    vr: float,
) -> float:
    """Mean of the image over the footprint of a node."""
    right, bottom = image.shape[1] - 1.0, image.shape[0] - 1.0
    n_c, n_r = samples_along(uc, vc), samples_along(ur, vr)
    total = 0.0
    for i in range(n_r):
        r = (i + 0.5) / n_r - 0.5
        for j in range(n_c):
            c = (j + 0.5) / n_c - 0.5
            a = min(max(u + uc * c + ur * r, 0.0), right)
            b = min(max(v + vc * c + vr * r, 0.0), bottom)
            total += float(quintic_at(image, a, b) if quintic else bilinear_at(image, a, b))
    return total / (n_c * n_r)


@kernel
def correct_rows(
    image: Array,
    quintic: bool,
    position: Array,
    jacobian: Array,
    weight: Array,
    status: Array,
    fill: float,
    first: int,
    last: int,
    out: Array,
) -> None:
    """Correct rows first..last-1 into out (h, w) float32; nodes that are not recovered get `fill`.

    ``image`` holds B-spline coefficients if `quintic`, else the frame.  ``position`` (K, h, w, 2) and
    ``jacobian`` (K, h, w, 4) say where each layer of a node lies on the sensor and how its square is
    stretched there; ``weight`` (K, h, w) joins the layers.

    Nearly all nodes have one view that is not magnified and lies inside the frame: one sample, no footprint.
    """
    flat = image.reshape(image.size)
    height, width = image.shape
    layers = position.shape[0]
    for row in range(first, last):
        place, slope, state, line = position[0, row], jacobian[0, row], status[row], out[row]
        for column in range(out.shape[1]):
            if state[column] != 0:
                line[column] = fill
                continue
            u, v = place[column, 0], place[column, 1]
            uc, ur, vc, vr = slope[column, 0], slope[column, 1], slope[column, 2], slope[column, 3]
            i, j = int(u), int(v)
            small = uc * uc + vc * vc <= ONE_SAMPLE_PX2 and ur * ur + vr * vr <= ONE_SAMPLE_PX2
            alone = layers == 1 or not weight[1, row, column] > 0.0
            if small and alone and i >= 2 and j >= 2 and i < width - 3 and j < height - 3:
                if quintic:
                    s, t = u - np.float32(i), v - np.float32(j)
                    line[column] = quintic_inside(flat, width, i, j, s, t)
                else:
                    line[column] = bilinear_inlined(image, u, v)
                continue
            value = 0.0
            for layer in range(layers):
                share = weight[layer, row, column]
                if share > 0.0:
                    u, v = position[layer, row, column, 0], position[layer, row, column, 1]
                    uc, ur = jacobian[layer, row, column, 0], jacobian[layer, row, column, 1]
                    vc, vr = jacobian[layer, row, column, 2], jacobian[layer, row, column, 3]
                    value += share * mean_over(image, quintic, u, v, uc, ur, vc, vr)
            line[column] = value
