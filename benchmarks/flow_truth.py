"""What a measurement could see of a known flow at one moment: the judge of `benchmarks.flow`.

Four answers at the nodes of the vectors, of the flow between the pulses, averaged across the sheet by what both
pulses light:

    itself     at the node
    window     averaged over the window with the weights that both frames give it: what one correlation sees
    response   filtered by what the passes of the evaluator make of waves (`piv.correlation.response`, which tests
               hold to images of waves): more than a window shows, less than the flow
    seen       the same along slanted rays: a particle that leaves the plane at w seems to move within it by w
               times the slope of its ray, 0.3 at the rim of a ball; one camera cannot tell that from a flow

The response is a property of the instrument, and is applied to the true field of every pair before any moment is
formed; the field is sampled much finer than any window, and beyond the frame as far as filters reach.
"""

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.hermite import hermgauss
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from piv.correlation.refine import window_weights
from piv.correlation.response import gain, response_at
from piv.correlation.settings import PivSettings
from piv.correlation.windows import WindowGrid
from sim.flow.fields import Flow
from sim.flow.particles import LightSheet

Array = NDArray[Any]

FINE_PX = 4.0  # samples from node to node are about as far apart
BEYOND = 3.0  # windows around the frame
DEEP = 5  # Gauss-Hermite nodes across the sheet


class Seen(NamedTuple):
    """Displacements (ny, nx, 2) [px], v down: of the flow, of windows, by the response, and that along rays."""

    itself: Array
    window: Array
    response: Array
    seen: Array


class Judge:
    """The flow at the nodes of a grid, as it could be seen.

    Parameters
    ----------
    flow : Flow
        What moves the particles.
    sheet : LightSheet
        What lights them.
    plane : PlaneGrid
        Pixels of the corrected frames on the plane.
    windows : WindowGrid
        Where the vectors lie.
    settings : PivSettings
        How they are measured.
    dt_s : float
        Between the pulses.
    slopes : ndarray, shape (ny, nx, 2)
        dx/dz and dy/dz of the rays at the nodes, y up; NaN where there is none.
    """

    def __init__(
        self,
        flow: Flow,
        sheet: LightSheet,
        plane: PlaneGrid,
        windows: WindowGrid,
        settings: PivSettings,
        dt_s: float,
        slopes: Array,
    ) -> None:
        self.flow, self.sheet, self.settings, self.windows = flow, sheet, settings, windows
        self._scale = np.array((1.0, -1.0, 1.0)) * dt_s * plane.px_per_mm
        self._slant = np.nan_to_num(slopes) * np.array((-1.0, 1.0))
        self._dt_s, self._plane = dt_s, plane
        self._fine_count = max(1, round(windows.step_px / FINE_PX))
        self._spacing = windows.step_px / self._fine_count
        self._responses: dict[int, Array] = {}
        self._margin = int(np.ceil(BEYOND * windows.size_px / self._spacing))

    def at(self, time_s: float, added_passes: int = 0) -> Seen:
        """Of a pair whose first pulse is at `time_s`, measured with so many passes more than asked for."""
        field = self._fine(time_s + 0.5 * self._dt_s)
        inner = slice(self._margin, -self._margin, self._fine_count)
        spectrum = np.fft.rfft2(field, axes=(0, 1))
        seen = [
            np.fft.irfft2(spectrum * share[..., None], s=field.shape[:2], axes=(0, 1))[inner, inner]
            for share in (self._window_share, self._response_share(added_passes))
        ]
        window, response = seen
        along = response[..., :2] + self._slant * response[..., 2:]
        return Seen(field[inner, inner, :2], window[..., :2], response[..., :2], along)

    def _fine(self, time_s: float) -> Array:
        """Displacement (Ny, Nx, 3) [px] on the fine raster: right, down, towards the camera."""
        nodes, weights = hermgauss(DEEP)
        total = np.zeros((len(self._places_mm), 3))
        for node, weight in zip(nodes, weights / weights.sum(), strict=True):
            z = self.sheet.offset_mm + node * self.sheet.thickness_mm / 4.0
            at = np.column_stack((self._places_mm, np.full(len(self._places_mm), z)))
            total += weight * self.flow.velocity(at, time_s)
        return (total * self._scale).reshape(*self._shape, 3)

    @cached_property
    def _places_mm(self) -> Array:
        x, y = (self._line(first, count) for first, count in ((self.windows.x_px, 1), (self.windows.y_px, 0)))
        return self._plane.to_mm(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))

    def _line(self, nodes: Array, axis: int) -> Array:
        return nodes[0] + self._spacing * (np.arange(self._shape[axis]) - self._margin)

    @property
    def _shape(self) -> tuple[int, int]:
        ny, nx = (self._fine_count * (count - 1) + 1 + 2 * self._margin for count in self.windows.shape)
        return ny, nx

    @cached_property
    def _waves(self) -> Array:
        """Wave numbers [rad/px] of the fine raster's half plane."""
        down, along = (2.0 * np.pi * np.fft.fftfreq(side, self._spacing) for side in self._shape)
        return np.stack(np.meshgrid(along[: self._shape[1] // 2 + 1], down), axis=-1)

    @cached_property
    def _window_share(self) -> Array:
        weights = window_weights(self.windows.size_px, self.settings.window_sigma)
        return gain(weights, self.windows.step_px, [], self._waves)

    def _response_share(self, added_passes: int) -> Array:
        if added_passes not in self._responses:
            self._responses[added_passes] = response_at(self.settings, self._waves, added_passes)[0]
        return self._responses[added_passes]
