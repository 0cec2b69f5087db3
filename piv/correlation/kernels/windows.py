"""Interrogation windows: cut out, freed of their mean, correlated, and their peaks found.

A window is compared over its valid pixels only: the mean is taken over them and masked pixels are 0 after it,
so that neither a mask edge nor what shines behind it correlates.  Sums run along columns first, which keeps
them exact to float32 and lets them share vector registers.
"""

import numpy as np

from ground.jit import Array, kernel

INF = np.float32(np.inf)
NAN = np.float32(np.nan)


@kernel
def total_of(sums: Array) -> float:
    """Sum of sums (w,) float32 in float64."""
    total = 0.0
    for k in range(sums.size):
        total += sums[k]
    return total


@kernel
def count_valid(valid: Array, row: int, column: int, sums: Array) -> int:
    """Number of valid pixels (uint8, 0 or 1) in a window; sums is (w,) float32 scratch."""
    size = sums.size
    for k in range(size):
        sums[k] = np.float32(0.0)
    for j in range(row, row + size):
        line = valid[j, column : column + size]
        for k in range(size):
            sums[k] += np.float32(line[k])
    return int(total_of(sums))


@kernel
def cut_whole(frame: Array, row: int, column: int, level: np.float32, sums: Array, out: Array) -> float:
    """Copy one window of frame (H, W) to out (w, w) and remove its mean; returns the sum of squares.

    `level` is near the mean, which keeps the sum of squares exact; sums is (2, w) float32 scratch.
    """
    size = out.shape[0]
    plain, square = sums[0], sums[1]
    for k in range(size):
        plain[k] = np.float32(0.0)
        square[k] = np.float32(0.0)
    for j in range(size):
        line, target = frame[row + j, column : column + size], out[j]
        for k in range(size):
            value = line[k] - level
            target[k] = value
            plain[k] += value
            square[k] += value * value
    total = total_of(plain)
    mean = np.float32(total / (size * size))
    flat = out.reshape(size * size)
    for k in range(flat.size):
        flat[k] -= mean
    return total_of(square) - total * total / (size * size)  # type: ignore[no-any-return]


@kernel
def cut_masked(frame: Array, valid: Array, count: int, row: int, column: int, sums: Array, out: Array) -> float:
    """Copy one window of frame (H, W) to out (w, w), mean over `count` valid pixels removed, the others 0.

    sums is (2, w) float32 scratch.  Returns the sum of squares.
    """
    size = out.shape[0]
    zero = np.float32(0.0)
    plain, square = sums[0], sums[1]
    for k in range(size):
        plain[k] = zero
        square[k] = zero
    for j in range(size):
        line, mask = frame[row + j, column : column + size], valid[row + j, column : column + size]
        for k in range(size):
            plain[k] += line[k] if mask[k] else zero
    mean = np.float32(total_of(plain) / count)
    for j in range(size):
        line, mask = frame[row + j, column : column + size], valid[row + j, column : column + size]
        target = out[j]
        for k in range(size):
            value = line[k] - mean if mask[k] else zero
            target[k] = value
            square[k] += value * value
    return total_of(square)


@kernel
def cut_windows(
    frame_a: Array,
    frame_b: Array,
    valid: Array,
    rows: Array,
    columns: Array,
    least: int,
    floor: float,
    sums: Array,
    count: Array,
    energy: Array,
    a: Array,
    b: Array,
) -> None:
    """Cut windows n = 0..N-1 at (rows[n], columns[n]) out of two frames into a, b (N, w, w) float32.

    count[n] becomes the number of valid pixels and energy[n] the root of both sums of squares multiplied;
    windows with fewer than `least` valid pixels become 0 with energy 0.  So does the energy of a window whose
    mean square is not above `floor` in both frames: it shows no texture.  sums is (2, w) float32 scratch.
    """
    size = a.shape[1]
    for n in range(rows.size):
        row, column = rows[n], columns[n]
        count[n] = count_valid(valid, row, column, sums[0])
        energy[n] = 0.0
        if count[n] < least:
            a[n] = np.float32(0.0)
            b[n] = np.float32(0.0)
            continue
        if count[n] == size * size:
            middle_a = frame_a[row + size // 2, column + size // 2]
            energy_a = cut_whole(frame_a, row, column, middle_a, sums, a[n])
            middle_b = frame_b[row + size // 2, column + size // 2]
            energy_b = cut_whole(frame_b, row, column, middle_b, sums, b[n])
        else:
            energy_a = cut_masked(frame_a, valid, count[n], row, column, sums, a[n])
            energy_b = cut_masked(frame_b, valid, count[n], row, column, sums, b[n])
        # Resampling leaves rounding noise where a frame is constant; it must not pass for texture.
        energy[n] = np.sqrt(energy_a * energy_b) if min(energy_a, energy_b) > floor * count[n] else 0.0


@kernel
def multiply_conjugate(a: Array, b: Array) -> None:
    """Spectra a <- conj(a) b, flattened complex64."""
    for k in range(a.size):
        a[k] = np.conj(a[k]) * b[k]


@kernel
def three_points(low: float, middle: float, high: float) -> float:
    """Position of a peak between three samples: Gaussian, or parabola where a logarithm does not exist."""
    if low > 0.0 and high > 0.0 and middle > 0.0:
        low, middle, high = np.log(low), np.log(middle), np.log(high)
    curvature = low - 2.0 * middle + high
    return min(1.0, max(-1.0, 0.5 * (low - high) / curvature)) if curvature < 0.0 else 0.0


@kernel
def highest(plane: Array, best: Array) -> None:
    """Highest value of plane (w, w) per column and its row: best is (2, w) float32, compared in registers."""
    size = plane.shape[0]
    value, row = best[0], best[1]
    for k in range(size):
        value[k] = -INF
        row[k] = np.float32(0.0)
    for j in range(size):
        line, number = plane[j], np.float32(j)
        for k in range(size):
            better = line[k] > value[k]
            row[k] = number if better else row[k]
            value[k] = line[k] if better else value[k]


@kernel
def second_peak(plane: Array, peak_j: int, peak_i: int) -> float:
    """Highest local maximum of the periodic plane (w, w) other than the one at (peak_j, peak_i); 0 if none."""
    size = plane.shape[0]
    second = np.float32(0.0)
    for j in range(size):
        line = plane[j]
        up, down = plane[(j - 1) % size], plane[(j + 1) % size]
        for i in range(size):
            value = line[i]
            if value <= second or (i == peak_i and j == peak_j):
                continue
            left, right = (i - 1) % size, (i + 1) % size
            if (
                value >= line[left]
                and value >= line[right]
                and value >= up[i]
                and value >= down[i]
                and value >= up[left]
                and value >= up[right]
                and value >= down[left]
                and value >= down[right]
            ):
                second = value
    return second  # type: ignore[return-value]


@kernel
def lag_mean(a: Array, b: Array, dx: int, dy: int, sums: Array) -> float:
    """Mean of a(x) b(x + d) over the pixels that windows a, b (w, w) share at the displacement d."""
    size = a.shape[0]
    first, width = max(0, -dx), size - abs(dx)
    for k in range(width):
        sums[k] = np.float32(0.0)
    for j in range(max(0, -dy), size - max(0, dy)):
        here = a[j, first : first + width]
        there = b[j + dy, first + dx : first + dx + width]
        for k in range(width):
            sums[k] += here[k] * there[k]
    return total_of(sums[:width]) / (width * (size - abs(dy)))  # type: ignore[no-any-return]


@kernel
def find_peaks(
    planes: Array, a: Array, b: Array, energy: Array, with_ratio: bool, best: Array, out: Array
) -> None:
    """Displacement from periodic correlation planes (N, w, w) float32, displacement 0 at [0, 0].

    The plane says which pixel; the fraction comes from the correlation of windows a, b (N, w, w) themselves at
    that pixel and its four neighbours, without what the periodic continuation folds in from the other side.
    out (N, 4) float64 becomes du, dv [px], correlation coefficient, and peak ratio (NaN unless asked for).
    A window without texture (energy 0) gives NaN.  best is (2, w) float32 scratch.
    """
    size = planes.shape[1]
    half = (size - 1) // 2
    for n in range(planes.shape[0]):
        if not energy[n] > 0.0:
            out[n] = np.nan
            continue
        plane = planes[n]
        highest(plane, best)
        i = 0
        for k in range(1, size):
            if best[0, k] > best[0, i]:
                i = k
        j = int(best[1, i])
        top = plane[j, i]
        out[n, 2] = top / energy[n]
        out[n, 3] = np.nan
        if with_ratio:
            second = second_peak(plane, j, i)
            out[n, 3] = top / second if second > 0.0 else np.inf
        dx = i if i <= half else i - size
        dy = j if j <= half else j - size
        sums = best[0]
        middle = lag_mean(a[n], b[n], dx, dy, sums)
        left, right = lag_mean(a[n], b[n], dx - 1, dy, sums), lag_mean(a[n], b[n], dx + 1, dy, sums)
        above, below = lag_mean(a[n], b[n], dx, dy - 1, sums), lag_mean(a[n], b[n], dx, dy + 1, sums)
        out[n, 0] = dx + three_points(left, middle, right)
        out[n, 1] = dy + three_points(above, middle, below)
