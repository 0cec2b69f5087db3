"""How sure a fitted corner is, from the residuals in its window.

Frames have noise of different size on edges and plains, and blur correlates neighbours, so
sigma^2 (J^T J)^-1 would be wrong.  With the pull of pixel i on p, a_i = (J^T J)^-1 J_i r_i / (1 - h_i),
where its leverage h_i = J_i^T (J^T J)^-1 J_i makes up for the part of the noise that the fit swallowed,

    cov = sum_ij k(i - j) a_i a_j,      k a triangle of base 2 BLOCK px in each direction

(White, Econometrica 48, 817 (1980); MacKinnon, White, J. Econometrics 29, 305 (1985), HC3; Conley,
J. Econometrics 92, 1 (1999)), summed as squares of block sums.  A wider block knows more correlation and
loses more to the fit, whose pulls sum to zero.  Block 2 measured: errors are 1.05 sigma in noise that is
white, as a camera's, 1.3 sigma in noise blurred by 0.5 px.
"""

from correction.target.kernels.corner_model import FREE, gradient, set_turn
from ground.jit import Array, kernel
from ground.kernels.cholesky import factorise, solve

BLOCK = 2  # block of pixels taken as correlated [px]


@kernel
def covariance(
    p: Array, pixels: Array, count: int, box: Array, turn: Array, row: Array, normal: Array, lower: Array,
    weights: Array, step: Array, pull: Array, sums: Array, out: Array,
) -> bool:  # fmt: skip
    """Variance of u, of v and their covariance [px^2] into out (3,), from the residuals in the window.

    weights (2, FREE), pull (SIDE^2, 2), sums (SIDE, 2) are scratch.
    """
    if not factorise(normal, 0.0, lower):
        return False
    for axis in range(2):
        for i in range(FREE):
            row[i] = 1.0 if i == axis else 0.0
        solve(lower, row, step)
        for i in range(FREE):
            weights[axis, i] = step[i]
    set_turn(p, turn)
    width, height = box[2], box[3]
    for k in range(width * height):
        pull[k, 0] = 0.0
        pull[k, 1] = 0.0
    for k in range(count):
        residual = pixels[k, 2] - gradient(p, turn, pixels[k, 0], pixels[k, 1], row)
        place = int(pixels[k, 3])
        leverage = 0.0
        for i in range(FREE):
            value = row[i]
            for j in range(i):
                value -= lower[i, j] * step[j]
            step[i] = value / lower[i, i]
            leverage += step[i] * step[i]
        residual /= max(1.0 - leverage, 0.1)
        for axis in range(2):
            value = 0.0
            for i in range(FREE):
                value += weights[axis, i] * row[i]
            pull[place, axis] = value * residual
    uu = vv = uv = 0.0
    for top in range(1 - BLOCK, height):
        for c in range(width):
            sums[c, 0] = 0.0
            sums[c, 1] = 0.0
            for r in range(max(top, 0), min(top + BLOCK, height)):
                sums[c, 0] += pull[r * width + c, 0]
                sums[c, 1] += pull[r * width + c, 1]
        a = b = 0.0
        for right_end in range(width + BLOCK - 1):
            if right_end < width:
                a += sums[right_end, 0]
                b += sums[right_end, 1]
            if right_end >= BLOCK:
                a -= sums[right_end - BLOCK, 0]
                b -= sums[right_end - BLOCK, 1]
            uu += a * a
            vv += b * b
            uv += a * b
    scale = 1.0 / (BLOCK * BLOCK)
    out[0], out[1], out[2] = uu * scale, vv * scale, uv * scale
    return True
