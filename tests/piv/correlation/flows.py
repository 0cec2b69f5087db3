"""Displacement fields with known truth for the judges of the evaluator: waves, vortices, turbulence.

Each is a function of pixel positions (u, v) that returns the displacement (du, dv) there [px]; all are free of
divergence but for `mix`, so they are flows that a light sheet could hold.
"""

import numpy as np


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


def turbulence(seed, rms_px=3.0, largest_px=300.0, smallest_px=40.0, modes=400):
    """Sum of random solenoidal waves with Kolmogorov's spectrum, E(k) ~ k^(-5/3) between two lengths.

    Kraichnan, Phys. Fluids 13, 22 (1970): amplitudes are drawn so that every mode carries the energy of its share
    of the logarithmic range, and each wave's velocity is normal to its wave vector.
    """
    rng = np.random.default_rng(seed)
    k = 2 * np.pi / largest_px * (largest_px / smallest_px) ** rng.uniform(size=modes)
    angle, phase = rng.uniform(0, 2 * np.pi, (2, modes))
    amplitude = k ** (-1 / 3) * rng.normal(size=modes)  # E(k) dk = k^(-5/3) k d(ln k)
    amplitude *= rms_px * np.sqrt(2.0) / np.sqrt(0.5 * (amplitude**2).sum())
    kx, ky = k * np.cos(angle), k * np.sin(angle)

    def field(u, v):
        u, v = np.asarray(u, float), np.asarray(v, float)
        du, dv = np.zeros(u.shape), np.zeros(u.shape)
        for x, y, a, p, t in zip(kx, ky, amplitude, phase, angle, strict=True):
            s = a * np.cos(x * u + y * v + p)
            du -= np.sin(t) * s
            dv += np.cos(t) * s
        return du, dv

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
