"""Response of an evaluation to waves and to noise: the linear theory of its passes.

Where places find their windows, strong waves are seen by the finest and weak ones by the usual.

A pass adds to the predictor what its windows see of the rest. With the response R of the windows to the flow, K to
what is interpolated between nodes, and S the smoothing before the next pass, a field and the noise n of one
correlation come out of P passes as

    gain:  g = R + (1 - K) S g,         noise:  n (1 + (1 - K) S (1 + (1 - K) S (...))),

since the same windows see the same noise again in every pass and take back K of what they had added. A last
filter (`piv.correlation.denoise`) multiplies both. R is the transform of the window's weights w(x), K that of
their averages of the spline around each node. The noise of windows that share pixels correlates as their weights
do.

Astarita, Exp. Fluids 43, 859 (2007), on the response; in the limit of dense windows the noise of any such
evaluation is the integral of gain^2 over all waves: who wants more of the short ones pays for it.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piv.correlation.denoise import LEVELS, ORDER
from piv.correlation.refine import window_weights
from piv.correlation.settings import PivSettings
from piv.correlation.windows import spline_weights

FOUND = 2  # smoothings between the passes with windows that places have found
COARSE = 2  # passes after which the predictor is smoothed more
SMOOTH_COARSE, SMOOTH_FINE = 0.35, 0.25  # of the window's side: standard deviation of the predictor's smoothing

Floats = NDArray[np.float64]
Transfer = Callable[[Floats], Floats]  # of wave numbers [rad a step], (..., 2)
WAVES = 64  # a side of the plane of wave numbers


def smoothing_after(number: int, window_px: int, step_px: int, settings: PivSettings) -> tuple[float, int]:
    """Smoothing of the predictor after a pass: standard deviation in grid steps, and order."""
    if number < COARSE:
        return SMOOTH_COARSE * window_px / step_px, 1
    asked = settings.smoothing_px
    return (SMOOTH_FINE * window_px if asked is None else asked) / step_px, ORDER


def transfers_between(windows_px: Sequence[int], step_px: int, settings: PivSettings) -> list[Transfer]:
    """Smoothings between those passes whose windows are the last ones; `step_px` is their spacing."""
    last = len(windows_px) - 1
    first = next(n for n, size in enumerate(windows_px) if n == last or (n and size == windows_px[-1]))
    return [
        smoothing_transfer(*smoothing_after(number, windows_px[-1], step_px, settings))
        for number in range(first, last)
    ]


def smoothings_of(settings: PivSettings, side_px: int, step_px: int, added_passes: int = 0) -> list[Transfer]:
    """Smoothings between the passes of the last windows of a side, `step_px` apart.

    `added_passes` are those of the very field (`VectorField.added_passes`).
    """
    if not settings.finds_windows:
        return transfers_between((*settings.windows_px, *(side_px,) * added_passes), step_px, settings)
    return [smoothing_transfer(*smoothing_after(COARSE, side_px, step_px, settings))] * (FOUND + added_passes)


def total_response(wave: Floats) -> Floats:
    """Transfer of no filter at all."""
    return np.ones(wave.shape[:-1])


def parts_of(levels_steps: Sequence[float]) -> list[Transfer]:
    """Transfers of the parts that the last filter splits a field into, from the finest to the smoothest.

    The last one is what is left where there is nothing but noise.
    """
    smooth = [smoothing_transfer(level, ORDER) for level in levels_steps]
    between = [_difference(upper, lower) for upper, lower in pairwise([total_response, *smooth])]
    return [*between, smooth[-1]]


def levels_of(settings: PivSettings, step_px: int) -> list[float]:
    """Smoothings of the last filter [grid steps]: large windows at near nodes leave noise over more than one."""
    levels = LEVELS if settings.finds_windows else LEVELS[:1]
    return [level * settings.windows_px[-1] / step_px for level in levels]


def _difference(upper: Transfer, lower: Transfer) -> Transfer:
    """Transfer of one filter without that of another."""
    return lambda wave: upper(wave) - lower(wave)


def response_of(settings: PivSettings, wavelength_px: Floats) -> tuple[Floats, Floats]:
    """Gain of an evaluation at wavelengths [px] along one axis: of strong waves, and of waves below the noise."""
    wave = 2.0 * np.pi / np.asarray(wavelength_px, float)
    return response_at(settings, np.stack((wave, np.zeros_like(wave)), axis=-1))


def response_at(settings: PivSettings, wave_rad_px: Floats, added_passes: int = 0) -> tuple[Floats, Floats]:
    """Gain of an evaluation at plane waves of wave numbers (..., 2) [rad/px]: of strong ones, and of weak ones.

    `added_passes` are those of the very field (`VectorField.added_passes`).
    """
    usual, finest = settings.windows_px[-1], settings.finest
    step = max(1, round(finest * (1.0 - settings.overlap)))

    def response_at(side: int, last: Transfer | None = None) -> Floats:
        between = smoothings_of(settings, side, step, added_passes)
        return gain(window_weights(side, settings.window_sigma), step, between, wave_rad_px, last)

    strong = response_at(finest)
    return strong, response_at(
        usual, parts_of(levels_of(settings, step))[-1]
    ) if settings.denoise else response_at(usual)


def smoothing_transfer(sigma_steps: float, order: int) -> Transfer:
    """Transfer of `order` repeated smoothings of what is left, 1 - (1 - Gaussian)^order."""

    def transfer(wave: Floats) -> Floats:
        passed: Floats = 1.0 - (1.0 - np.exp(-0.5 * sigma_steps**2 * (wave**2).sum(axis=-1))) ** order
        return passed

    return transfer


def noise_growth(
    weights: Floats, step_px: int, between: Sequence[Transfer], last: Transfer | None = None
) -> float:
    """Random error of the result over that of one correlation.

    Parameters
    ----------
    weights : ndarray of float64, shape (w,)
        Of the products of a window along one axis.
    step_px : int
        Spacing of the windows.
    between : sequence of callable
        Transfers of the smoothings between passes on this grid, one fewer than passes.
    last : callable, optional
        Transfer of the last filter.
    """
    wave = _waves()
    size = len(weights)
    shared = np.correlate(weights, weights, "full")[size - 1 :: step_px] / np.square(weights).sum()
    lags = np.arange(1, len(shared))
    line = 1.0 + 2.0 * (shared[1:, None] * np.cos(lags[:, None] * wave[0, :, 0])).sum(axis=0)
    kept = 1.0 - _node_response(weights, step_px)
    growth = np.ones_like(kept)
    for transfer in between:
        growth = 1.0 + kept * transfer(wave) * growth
    if last is not None:
        growth = growth * last(wave)
    return float(np.sqrt((np.outer(line, line) * growth**2).mean()))


def gain(
    weights: Floats, step_px: int, between: Sequence[Transfer], wave_rad_px: Floats, last: Transfer | None = None
) -> Floats:
    """Share of each plane wave (..., 2) [rad/px] that the result shows."""
    x = np.arange(len(weights)) - (len(weights) - 1) / 2
    seen, at_nodes = np.ones(wave_rad_px.shape[:-1]), np.ones(wave_rad_px.shape[:-1])
    for axis in range(2):
        k = wave_rad_px[..., axis]
        seen = seen * ((weights * np.cos(np.multiply.outer(k, x))).sum(axis=-1) / weights.sum())
        at_nodes = at_nodes * _node_line(weights, step_px, k * step_px)
    wave = wave_rad_px * step_px
    result: Floats = seen
    for transfer in between:
        result = seen + (1.0 - at_nodes) * transfer(wave) * result
    return result * last(wave) if last is not None else result


def _waves() -> Floats:
    """Wave numbers (WAVES, WAVES, 2) [rad a step]."""
    line = 2.0 * np.pi * np.fft.fftfreq(WAVES)
    return np.stack(np.meshgrid(line, line), axis=-1)


def _node_response(weights: Floats, step_px: int) -> Floats:
    """Response of windows to a field given at their nodes, for each wave of `_waves`."""
    line = _node_line(weights, step_px, _waves()[0, :, 0])
    return np.outer(line, line)


def _node_line(weights: Floats, step_px: int, wave: Floats) -> Floats:
    """The same along one axis, for waves (...) [rad a step]."""
    x = (np.arange(len(weights)) - (len(weights) - 1) / 2) / step_px
    first, shares = spline_weights(x)
    node = (first[:, None] + np.arange(4)).ravel()
    share = (weights[:, None] * shares).ravel() / weights.sum()
    seen: Floats = np.tensordot(share, np.cos(np.multiply.outer(node, wave)), 1)
    return seen / ((4.0 + 2.0 * np.cos(wave)) / 6.0)  # coefficients over nodes
