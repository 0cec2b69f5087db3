"""Displacement fields with known truth for the judges of the evaluator: waves, vortices, turbulence.

Each is a function of pixel positions (u, v) that returns the displacement (du, dv) there [px]; all are free of
divergence but for `mix`, so they are flows that a light sheet could hold.
"""

import numpy as np

MARGIN = 3  # windows at the edge that `errors` leaves out


def rms(values):
    """Root mean square of all values."""
    return float(np.sqrt(np.mean(np.square(values))))


def errors(field, truth):
    """Errors (ny, nx, 2) of vectors but for those at the edge."""
    du, dv = truth(*np.moveaxis(field.grid_px, -1, 0))
    off = np.stack([field.u_px - du, field.v_px - dv], axis=-1)
    return off[MARGIN:-MARGIN, MARGIN:-MARGIN]


def uniform(du_px, dv_px):
    """The same displacement everywhere."""
    return lambda u, v: (du_px + 0 * u, dv_px + 0 * v)


def wave(length_px, amplitude_px=1.0):
    """u = a sin(2 pi v/L), v = a sin(2 pi u/L): the response to it is the transfer of an evaluator at L."""
    k = 2 * np.pi / length_px
    return lambda u, v: (amplitude_px * np.sin(k * v), amplitude_px * np.sin(k * u))


def mix(u, v):
    """Every fraction of a pixel, slight gradients."""
    return 3 + 0.004 * (v - 256), -2 + 0.004 * (u - 256)


def vortex(centre_px=256.0, core_px=40.0, turn=0.2):
    """Gaussian vortex; `turn` is the displacement gradient of its core."""

    def field(u, v):
        x, y = u - centre_px, v - centre_px
        g = turn * np.exp(-(x * x + y * y) / (2 * core_px**2))
        return -g * y, g * x

    return field


def turbulence(seed, rms_px=3.0, largest_px=300.0, smallest_px=40.0, modes=400, slope=-5 / 3):
    """Sum of random solenoidal waves with E(k) ~ k^slope between two lengths, Kolmogorov's spectrum by default.

    Kraichnan, Phys. Fluids 13, 22 (1970): amplitudes are drawn so that every mode carries the energy of its share
    of the logarithmic range, and each wave's velocity is normal to its wave vector.
    """
    rng = np.random.default_rng(seed)
    k = 2 * np.pi / largest_px * (largest_px / smallest_px) ** rng.uniform(size=modes)
    angle, phase = rng.uniform(0, 2 * np.pi, (2, modes))
    amplitude = k ** ((1 + slope) / 2) * rng.normal(size=modes)  # E(k) dk = k^slope k d(ln k)
    amplitude *= rms_px * np.sqrt(2.0) / np.sqrt(0.5 * (amplitude**2).sum())
    return _waves(k * np.cos(angle), k * np.sin(angle), amplitude, phase, angle)


def _waves(kx, ky, amplitude, phase, angle):
    """Sum of plane waves, the velocity of each normal to its wave vector."""

    def field(u, v):
        u, v = np.asarray(u, float), np.asarray(v, float)
        du, dv = np.zeros(u.shape), np.zeros(u.shape)
        for x, y, a, p, t in zip(kx, ky, amplitude, phase, angle, strict=True):
            s = a * np.cos(x * u + y * v + p)
            du -= np.sin(t) * s
            dv += np.cos(t) * s
        return du, dv

    return field


def endless(seed, rms_px=1.0, bend_px=40.0, slope=-4.0, largest_px=250.0, smallest_px=6.0, modes=500):
    """The same with a spectrum that goes on below all windows: k^-5/3, from waves of `bend_px` on k^slope.

    Below a few windows the spectrum of turbulence is steep but has no end (Pope, Turbulent Flows (2000), 6.5).
    """
    rng = np.random.default_rng(seed)
    k = 2 * np.pi / largest_px * (largest_px / smallest_px) ** rng.uniform(size=modes)
    angle, phase = rng.uniform(0, 2 * np.pi, (2, modes))
    energy = k ** (-5 / 3) * (1.0 + (k * bend_px / (2 * np.pi)) ** 2) ** (0.5 * (slope + 5 / 3))
    amplitude = np.sqrt(k * energy) * rng.normal(size=modes)
    amplitude *= rms_px * np.sqrt(2.0) / np.sqrt(0.5 * (amplitude**2).sum())
    return _waves(k * np.cos(angle), k * np.sin(angle), amplitude, phase, angle)


def vortices(seed, cores_px=(20.0, 60.0), number=12, turn=0.2, side_px=384.0):
    """Gaussian vortices of both signs, anywhere in a frame; fronts and thin necks where they meet."""
    rng = np.random.default_rng(seed)
    cores = rng.uniform(*cores_px, number)
    places, signs = rng.uniform(0.0, side_px, (2, number)), rng.choice([-1.0, 1.0], number)
    parts = [vortex(0.0, core, sign * turn) for core, sign in zip(cores, signs, strict=True)]

    def field(u, v):
        each = [part(u - x, v - y) for part, x, y in zip(parts, *places, strict=True)]
        return sum(du for du, _ in each), sum(dv for _, dv in each)

    return field


def fronts(seed, rms_px=2.0, sharp_px=15.0, number=10, side_px=384.0):
    """Currents along curved fronts of width `sharp_px`, as at the surface of quasi-geostrophic flows.

    The stream function is a sum of steps in slope across wavy lines, so the velocity is one of steps that are
    smooth over that width: its spectrum falls as k^-2 to there.
    """
    rng = np.random.default_rng(seed)
    angle, phase, bend = rng.uniform(0, 2 * np.pi, (3, number))
    offset, strength = rng.uniform(-side_px / 2, side_px / 2, number), rng.normal(size=number)
    strength *= 2.0 * rms_px / np.sqrt((strength**2).sum())

    def field(u, v):
        x, y = np.asarray(u, float) - side_px / 2, np.asarray(v, float) - side_px / 2
        du, dv = np.zeros(x.shape), np.zeros(x.shape)
        for a, p, b, o, s in zip(angle, phase, bend, offset, strength, strict=True):
            along, across = np.cos(a) * x + np.sin(a) * y, np.cos(a) * y - np.sin(a) * x
            k = 2 * np.pi / (side_px * (0.5 + b / (4 * np.pi)))
            n = across - o - 15.0 * np.sin(k * along + p)
            current = s * np.tanh(n / sharp_px)  # of the stream function s sharp ln cosh(n/sharp)
            slope = -15.0 * k * np.cos(k * along + p)  # dn/d(along); dn/d(across) is 1
            ahead, aside = current, -current * slope
            du += np.cos(a) * ahead - np.sin(a) * aside
            dv += np.sin(a) * ahead + np.cos(a) * aside
        return du, dv

    return field


def shear_layer(jump_px=4.0, width_px=12.0, angle_rad=0.3, centre_px=192.0):
    """Two streams along each other: u = jump/2 tanh(n/width); a sharp step where the width is 0."""
    along, across = np.cos(angle_rad), np.sin(angle_rad)

    def field(u, v):
        n = (np.asarray(v, float) - centre_px) * along - (np.asarray(u, float) - centre_px) * across
        half = 0.5 * jump_px * (np.tanh(n / width_px) if width_px else np.sign(n))
        return half * along, half * across

    return field


def plane_jet(peak_px=12.0, width_px=31.0, edge_px=4.0, angle_rad=0.0, centre_px=256.0):
    """Core of full width `width_px` that moves along itself over a fluid at rest; edges as tanh(n/edge)."""
    along, across = np.cos(angle_rad), np.sin(angle_rad)

    def field(u, v):
        n = (np.asarray(v, float) - centre_px) * along - (np.asarray(u, float) - centre_px) * across
        core = 0.5 * peak_px * (np.tanh((n + width_px / 2) / edge_px) - np.tanh((n - width_px / 2) / edge_px))
        return core * along, core * across

    return field


def gaussian_jet(peak_px=12.0, width_px=31.0, angle_rad=0.0, centre_px=256.0):
    """The same with a Gaussian profile of this full width at half its height."""
    along, across = np.cos(angle_rad), np.sin(angle_rad)

    def field(u, v):
        n = (np.asarray(v, float) - centre_px) * along - (np.asarray(u, float) - centre_px) * across
        core = peak_px * np.exp(-4.0 * np.log(2.0) * (n / width_px) ** 2)
        return core * along, core * across

    return field


def shaken_jet(seed, peak_px=12.0, width_px=31.0, centre_px=128.0):
    """A jet along u out of a pipe 60 px before the frame: it widens, pulses by 10 %, sways and is turbulent."""
    rng = np.random.default_rng(seed)
    strength, sway, phase = 1.0 + 0.1 * rng.normal(), 3.0 * rng.normal(), rng.uniform(0.0, 2.0 * np.pi)
    swirls = turbulence(seed, 0.5, 100, 25, 80)

    def field(u, v):
        from_pipe = np.maximum(np.asarray(u, float) + 60.0, 0.0)
        n = v - centre_px - sway * np.sin(2.0 * np.pi * u / 180.0 + phase) * np.minimum(from_pipe / 200.0, 1.0)
        edge = np.hypot(3.0, 0.068 * from_pipe)
        core = 0.5 * (np.tanh((n + width_px / 2) / edge) - np.tanh((n - width_px / 2) / edge))
        du, dv = swirls(u, v)
        return peak_px * strength * core + (0.15 + core) * du, (0.15 + core) * dv

    return field
