"""The jet at many points, from its tables by cubic convolution; the formulas stand in `sim.flow.jet`."""

import numpy as np

from ground.jit import Array, kernel, kernel_inlined


@kernel_inlined
def keys(t: float, k: int) -> float:
    """Weight of node k = -1, 0, 1, 2 at t in 0..1 of cubic convolution (Keys 1981); C1 from cell to cell."""
    if k == -1:
        return t * (-0.5 + t * (1.0 - 0.5 * t))
    if k == 0:
        return 1.0 + t * t * (-2.5 + 1.5 * t)
    if k == 1:
        return t * (0.5 + t * (2.0 - 1.5 * t))
    return t * t * (-0.5 + 0.5 * t)


@kernel_inlined
def keys_slope(t: float, k: int) -> float:
    """Derivative of `keys`."""
    if k == -1:
        return -0.5 + t * (2.0 - 1.5 * t)
    if k == 0:
        return t * (-5.0 + 4.5 * t)
    if k == 1:
        return 0.5 + t * (4.0 - 4.5 * t)
    return t * (-1.0 + 1.5 * t)


@kernel_inlined
def interpolate_table(
    first: float, second: float, table: Array, start: Array, step: Array
) -> tuple[float, float, float]:
    """Value and both slopes of `table` (rows, columns) at (first, second).

    Row i lies at start[0] + i step[0], column j at start[1] + j step[1]; beyond the ends the last cell goes on.
    """
    rows, columns = table.shape
    p, q = (first - start[0]) / step[0], (second - start[1]) / step[1]
    i, j = min(max(int(np.floor(p)), 1), rows - 3), min(max(int(np.floor(q)), 1), columns - 3)
    a, b = min(max(p - i, -1.0), 2.0), min(max(q - j, -1.0), 2.0)
    value = by_first = by_second = 0.0
    for k in range(-1, 3):
        along = slope = 0.0
        for m in range(-1, 3):
            node = table[i + k, j + m]
            along += keys(b, m) * node
            slope += keys_slope(b, m) * node
        value += keys(a, k) * along
        by_first += keys_slope(a, k) * along
        by_second += keys(a, k) * slope
    return value, by_first / step[0], by_second / step[1]


@kernel
def jet_at(
    points: Array,
    pipe: Array,
    disc: Array,
    speed: Array,
    start: Array,
    step: Array,
    mean: Array,
    amplitude: Array,
) -> None:
    """Mean (N, 3) and amplitude (N, 3, 3; or empty) of the jet of `sim.flow.jet` at points (N, 3).

    `pipe`: x, y, z of its end, radius, exit speed, growth at the exit and behind it, both intensities.  `disc` and
    `speed` are H/U_0 and U/U_0 over (log sigma/R, log(1 + r/R)).
    """
    radius, exit_speed = pipe[3], pipe[4]
    for n in range(points.shape[0]):
        x, s, z = points[n, 0] - pipe[0], points[n, 1] - pipe[1], points[n, 2] - pipe[2]
        r = np.sqrt(x * x + z * z)
        ex, ez = (x / r, z / r) if r > 0.0 else (1.0, 0.0)
        behind = max(s, 0.0)
        sigma2 = (pipe[5] * radius) ** 2 + (pipe[6] * behind) ** 2
        width, place = 0.5 * np.log(sigma2) - np.log(radius), np.log1p(r / radius)
        h, by_width, by_place = interpolate_table(width, place, disc, start, step)
        along = exit_speed * (h + 0.5 * r * by_place / (radius + r))
        outwards = -0.5 * exit_speed * r * by_width * pipe[6] * pipe[6] * behind / sigma2
        mean[n, 0], mean[n, 1], mean[n, 2] = outwards * ex, along, outwards * ez
        if amplitude.shape[0] == 0:
            continue
        centre, _, _ = interpolate_table(width, 0.0, disc, start, step)
        _, _, slope = interpolate_table(width, place, speed, start, step)
        growth = -np.expm1(-behind / (8.0 * radius))
        wide = pipe[7] * exit_speed * centre * growth * np.exp(-r * r / (6.0 * sigma2))
        layer = pipe[8] * np.sqrt(sigma2) * exit_speed * slope / (radius + r)
        e = np.sqrt(wide * wide + layer * layer)
        t = 0.5 * r / np.sqrt(sigma2)
        rho = 0.8 * t / (1.0 + t * t)
        one, other = 0.8 * e * rho, 0.8 * e * np.sqrt(1.0 - rho * rho)
        # Columns: what each unit turbulence does. The second and third are turned with the outward direction, or a
        # fluctuation would change its sign on the axis; around is the axis cross the outward direction.
        amplitude[n, 0, 0], amplitude[n, 1, 0], amplitude[n, 2, 0] = one * ex, e, one * ez
        around = 0.8 * e
        mixed = (other - around) * ex * ez
        amplitude[n, 0, 1], amplitude[n, 1, 1] = other * ex * ex + around * ez * ez, 0.0
        amplitude[n, 2, 2], amplitude[n, 1, 2] = other * ez * ez + around * ex * ex, 0.0
        amplitude[n, 2, 1] = amplitude[n, 0, 2] = mixed
