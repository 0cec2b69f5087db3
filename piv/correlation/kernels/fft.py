"""Periodic cross-correlation of square windows whose side is a power of two, 32 pairs at once.

Two real windows are one complex array z = a + i b.  With Z its transform and W the conjugate of Z at the
negative frequency, the spectra are A = (Z + W)/2 and B = (Z - W)/2i, so one complex transform serves a pair:

    R = conj(A) B = -i/4 conj(Z + W) (Z - W).

Correlation planes are real again, so R1 + i R2 brings back the planes of two pairs in one inverse transform.

Windows lie side by side: element (row, column) of 16 windows is a block of 16 real parts followed by 16
imaginary parts.  Every butterfly is then a handful of vector instructions, nothing is shuffled within a
register, and a radix of 2 is enough: the data stay in the second-level cache and its bandwidth is the limit.
Transforms run along the rows of blocks; for the other axis the blocks are transposed.  The forward transform
leaves frequencies in bit-reversed order and the inverse takes them so, without sorting.
"""

import numpy as np

from ground.jit import Array, kernel, kernel_inlined

LANES = 16
BLOCK = 2 * LANES  # floats: real and imaginary parts of one element of 16 windows
PAIRS = 2 * LANES  # pairs of windows that go through together
STRIP = 16  # pixels of a window moved at a time


@kernel
def butterfly_forward(a: Array, b: Array, cosine: np.float32, sine: np.float32) -> None:
    """Butterfly of the forward transform: a, b <- a + b, (a - b) w with w = cosine + i sine."""
    for n in range(a.size // BLOCK):
        at = n * BLOCK
        for k in range(at, at + LANES):
            a_real, a_imaginary, b_real, b_imaginary = a[k], a[k + LANES], b[k], b[k + LANES]
            real, imaginary = a_real - b_real, a_imaginary - b_imaginary
            a[k] = a_real + b_real
            a[k + LANES] = a_imaginary + b_imaginary
            b[k] = real * cosine - imaginary * sine
            b[k + LANES] = real * sine + imaginary * cosine


@kernel
def butterfly_inverse(a: Array, b: Array, cosine: np.float32, sine: np.float32) -> None:
    """Butterfly of the inverse transform: a, b <- a + b conj(w), a - b conj(w)."""
    for n in range(a.size // BLOCK):
        at = n * BLOCK
        for k in range(at, at + LANES):
            real = b[k] * cosine + b[k + LANES] * sine
            imaginary = b[k + LANES] * cosine - b[k] * sine
            b[k] = a[k] - real
            b[k + LANES] = a[k + LANES] - imaginary
            a[k] += real
            a[k + LANES] += imaginary


@kernel
def forward(size: int, turn: Array, z: Array) -> None:
    """Transform z, size rows of size blocks, along its rows; frequencies come out bit-reversed.

    turn (2, size/2) float32 holds cos and sin of -2 pi k/size.
    """
    row = size * BLOCK
    span = size
    while span > 1:
        half = span // 2
        for block in range(0, size, span):
            for p in range(half):
                a = (block + p) * row
                b = a + half * row
                k = p * (size // span)
                butterfly_forward(z[a : a + row], z[b : b + row], turn[0, k], turn[1, k])
        span = half


@kernel
def backward(size: int, turn: Array, z: Array) -> None:
    """Undo `forward`, but for the factor `size`."""
    row = size * BLOCK
    span = 2
    while span <= size:
        half = span // 2
        for block in range(0, size, span):
            for p in range(half):
                a = (block + p) * row
                b = a + half * row
                k = p * (size // span)
                butterfly_inverse(z[a : a + row], z[b : b + row], turn[0, k], turn[1, k])
        span *= 2


@kernel
def transpose(size: int, z: Array, out: Array) -> None:
    """Exchange rows and columns of blocks."""
    for j in range(size):
        for i in range(size):
            a, b = (j * size + i) * BLOCK, (i * size + j) * BLOCK
            for k in range(BLOCK):
                out[b + k] = z[a + k]


@kernel_inlined
def combine(p: Array, p_negative: Array, q: Array, q_negative: Array, scale: np.float32) -> None:
    """Spectra of 16 + 16 pairs at a frequency and its negative -> R1 + i R2 there, put into p, p_negative.

    Part of its caller, as it works on so little that a call would take a fifth of the whole correlation.
    """
    for k in range(LANES):
        i = k + LANES
        sum_real, sum_imaginary = p[k] + p_negative[k], p[i] - p_negative[i]
        gap_real, gap_imaginary = p[k] - p_negative[k], p[i] + p_negative[i]
        real_1 = scale * (sum_real * gap_imaginary - sum_imaginary * gap_real)
        imaginary_1 = -scale * (sum_real * gap_real + sum_imaginary * gap_imaginary)
        sum_real, sum_imaginary = q[k] + q_negative[k], q[i] - q_negative[i]
        gap_real, gap_imaginary = q[k] - q_negative[k], q[i] + q_negative[i]
        real_2 = scale * (sum_real * gap_imaginary - sum_imaginary * gap_real)
        imaginary_2 = -scale * (sum_real * gap_real + sum_imaginary * gap_imaginary)
        p[k] = real_1 - imaginary_2
        p[i] = imaginary_1 + real_2
        p_negative[k] = real_1 + imaginary_2
        p_negative[i] = real_2 - imaginary_1


@kernel
def load(a: Array, b: Array, first: int, z: Array) -> None:
    """Put windows first.. of a, b (N, w, w) into the lanes of z; lanes without a window become 0.

    A few pixels of all windows at a time: what is written stays in the first-level cache.
    """
    count, pixels = a.shape[0], a.shape[1] * a.shape[2]
    flat_a, flat_b = a.reshape(count, pixels), b.reshape(count, pixels)
    used = min(LANES, count - first)
    if used < LANES:
        for k in range(z.size):
            z[k] = np.float32(0.0)
    for start in range(0, pixels, STRIP):
        for lane in range(used):
            line_a, line_b = (
                flat_a[first + lane, start : start + STRIP],
                flat_b[first + lane, start : start + STRIP],
            )
            at = start * BLOCK + lane
            for k in range(line_a.size):
                z[at + k * BLOCK] = line_a[k]
                z[at + k * BLOCK + LANES] = line_b[k]


@kernel
def unload(z: Array, planes: Array) -> None:
    """Put the lanes of z into planes (N, w, w), N <= PAIRS."""
    count, pixels = planes.shape[0], planes.shape[1] * planes.shape[2]
    flat = planes.reshape(count, pixels)
    for start in range(0, pixels, STRIP):
        for lane in range(count):
            line = flat[lane, start : start + STRIP]
            at = start * BLOCK + lane
            for k in range(line.size):
                line[k] = z[at + k * BLOCK]


@kernel
def correlate_pairs(a: Array, b: Array, turn: Array, negative: Array, z: Array, planes: Array) -> None:
    """planes[n](s) = sum_x a[n](x) b[n](x + s), periodic, for at most PAIRS windows a, b (N, w, w) float32.

    w is a power of two; turn as in `forward`; negative (w,) is the index of the negative frequency in
    bit-reversed order; z (3, w * w * BLOCK) float32 is scratch.
    """
    size = a.shape[1]
    first, second, spare = z[0], z[1], z[2]
    for part in range(2):
        target = first if part == 0 else second
        load(a, b, part * LANES, spare)
        forward(size, turn, spare)
        transpose(size, spare, target)
        forward(size, turn, target)
    scale = np.float32(0.25 / (size * size))
    for j in range(size):
        for i in range(size):
            here, there = j * size + i, negative[j] * size + negative[i]
            if here <= there:
                u, v = here * BLOCK, there * BLOCK
                combine(
                    first[u : u + BLOCK], first[v : v + BLOCK], second[u : u + BLOCK], second[v : v + BLOCK], scale
                )
    backward(size, turn, first)
    transpose(size, first, spare)
    backward(size, turn, spare)
    unload(spare, planes)
