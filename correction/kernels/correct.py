"""Sample a frame at every recovered node, over the node's whole footprint on the sensor."""

import math

from correction.kernels.bspline import bilinear_at, quintic_at
from tracer.kernels._jit import Array, kernel

MAX_SAMPLES = 16  # a side; the largest magnification that a correction map keeps


@kernel
def samples_along(du: float, dv: float) -> int:
    """Samples needed along a footprint side (du, dv) [px]: one a pixel; a quarter too much is no reason."""
    return int(min(MAX_SAMPLES, max(1.0, math.ceil(math.sqrt(du * du + dv * dv) - 0.25))))


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
    """
    right, bottom = image.shape[1] - 1.0, image.shape[0] - 1.0
    for row in range(first, last):
        for column in range(out.shape[1]):
            if status[row, column] != 0:
                out[row, column] = fill
                continue
            value = 0.0
            for layer in range(position.shape[0]):
                share = weight[layer, row, column]
                if not share > 0.0:
                    continue
                u, v = position[layer, row, column, 0], position[layer, row, column, 1]
                uc, ur = jacobian[layer, row, column, 0], jacobian[layer, row, column, 1]
                vc, vr = jacobian[layer, row, column, 2], jacobian[layer, row, column, 3]
                n_c, n_r = samples_along(uc, vc), samples_along(ur, vr)
                total = 0.0
                for i in range(n_r):
                    r = (i + 0.5) / n_r - 0.5
                    for j in range(n_c):
                        c = (j + 0.5) / n_c - 0.5
                        a = min(max(u + uc * c + ur * r, 0.0), right)
                        b = min(max(v + vc * c + vr * r, 0.0), bottom)
                        total += float(quintic_at(image, a, b) if quintic else bilinear_at(image, a, b))
                value += share * total / (n_c * n_r)
            out[row, column] = value
