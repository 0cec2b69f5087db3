"""Velocity over time at places of a series of pairs, and its spectrum.

**Places.** Between vectors u is bilinear in the four around it, and nothing where one of them was not measured.
Windows that overlap share particles, so errors of the four are taken to be common: sigma is the sum of w_i
sigma_i, an upper limit. A line is as many places as there are vectors along it.

**Spectrum.** One-sided power spectral density S(f) [m2/s2/Hz], whose integral over all frequencies is the variance
of u: the mean of the periodograms of K segments, each without its mean and under a Hann window, every one half
over the next (Welch, IEEE Trans. Audio Electroacoust. 15, 70 (1967)). Neighbours have 1/36 of their variance in
common, so S has about

    nu = 2 K / (1 + 2 (1 - 1/K) / 36)

degrees of freedom and lies within nu / chi2(nu) of the truth.

**Noise.** Errors of vectors know nothing of those of another pair, so their spectrum is flat: 2 sigma^2 dt, dt the
time from pair to pair. What is below that line is noise; subtract it for the variance of the flow.

**Pairs that are no even sampling** have no spectrum: of no clock, taken in bursts, or with more than `MOST_FILLED`
of their vectors missing. Fewer are filled by straight lines, which takes a little from the fast part.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from daq.errors import RunUsageError
from ground.whole_file import whole_file
from piv.files.vector_file import Variable, Vectors, netcdf
from rtpiv.analysis.series.series_folder import SeriesFolder

FILE = "time_series.nc"
SEGMENTS = 7  # half over each other: a quarter of the series each
MIN_SPECTRUM_PAIRS = 64  # pairs for a spectrum
MOST_FILLED = 0.1  # of a series
EVEN = 0.1  # of the time from pair to pair that one may be off
BAND = (0.025, 0.975)
Floats = NDArray[np.float64]
Place = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Power spectral densities at P places.

    Parameters
    ----------
    frequency_hz : (F,) float64
        From that of one period a segment up.
    density : (F, P, 2) float64
        Of u and v, squares of their unit a Hz; NaN at places with too many gaps.
    noise : (P, 2) float64
        What the errors of vectors make of it at every frequency.
    least, most : float
        Times the density: where the truth lies in 95 of 100 cases.
    """

    frequency_hz: Floats
    density: Floats
    noise: Floats
    least: float
    most: float


@dataclass(frozen=True, eq=False)
class TimeSeries:
    """Velocities of T pairs at P places.

    Parameters
    ----------
    place_mm : (P, 2) float64
        On the plane, y up.
    on_line : (P,) bool
        Whether a place is one of the line.
    time : (T,) float64
        In `time_unit`, "s", or "pair" where the camera has no clock.
    velocity, sigma : (T, P, 2) float64
        u and v, and their random standard uncertainty; NaN where nothing was measured.
    unit, time_unit : str
        Theirs: "m s-1", or "mm" where the time between the frames of a pair is not known.
    spectrum : Spectrum or None
        None if there is none.
    why_none : str
        Why, in words; "" if there is one.
    run : str
        Whose pairs they are.
    """

    place_mm: Floats
    on_line: NDArray[np.bool_]
    time: Floats
    velocity: Floats
    sigma: Floats
    unit: str
    time_unit: str
    spectrum: Spectrum | None
    why_none: str
    run: str

    def write(self, path: Path) -> None:
        """Write a NetCDF file: (t, place), and (frequency, place) if there is a spectrum."""
        unit = self.unit
        found = {
            "t": Variable(("t",), self.time, self.time_unit),
            "x": Variable(("place",), self.place_mm[:, 0], "mm"),
            "y": Variable(("place",), self.place_mm[:, 1], "mm"),
            "on_line": Variable(("place",), self.on_line.astype(np.int8)),
        }
        for name, values in (("", self.velocity), ("sigma_", self.sigma)):
            for axis, component in enumerate("uv"):
                found[name + component] = Variable(("t", "place"), values[..., axis], unit)
        if self.spectrum is not None:
            density = f"({unit})2 s"
            found["frequency"] = Variable(("frequency",), self.spectrum.frequency_hz, "s-1")
            for axis, component in enumerate("uv"):
                of_both = (("frequency", "place"), self.spectrum.density), (("place",), self.spectrum.noise)
                for name, (along, values) in zip(("density_", "noise_"), of_both, strict=True):
                    found[name + component] = Variable(along, values[..., axis], density)
        about = {} if self.spectrum is None else {"least": self.spectrum.least, "most": self.spectrum.most}
        with whole_file(path) as stream:
            stream.write(netcdf(found, about))


def time_series(series: Path, places_mm: Sequence[Place], line_mm: tuple[Place, Place] | None) -> TimeSeries:
    """Read the chunks of a series once, and keep what they say at some places.

    Parameters
    ----------
    series : path
        Its folder.
    places_mm : sequence of (float, float)
        x and y on the plane, y up.
    line_mm : ((float, float), (float, float)), optional
        Ends of a line.

    Raises
    ------
    RunUsageError
        A place is not within the vectors.
    RunUnsuitable, SeriesError
        It is no series, or a chunk is missing or damaged.
    """
    folder = SeriesFolder(series)
    points, on_line = np.reshape(np.asarray(places_mm, float), (-1, 2)), np.zeros(len(places_mm), bool)
    times, velocity, sigma = list[Floats](), list[Floats](), list[Floats]()
    unit = time_unit = ""
    about = folder.about
    for number, key in enumerate(about["keys"]):
        vectors = folder.vectors(number, key)
        if not times:
            unit, time_unit = vectors.units.get("u", "1"), vectors.time_unit
            along = _along(vectors, line_mm) if line_mm is not None else np.empty((0, 2))
            points, on_line = np.concatenate((points, along)), np.repeat([False, True], [len(points), len(along)])
            _require_inside(points, vectors)
        is_valid = vectors.fields["flag"] == 0
        for name, kept in (("", velocity), ("sigma_", sigma)):
            both = [np.where(is_valid, vectors.fields[name + axis], np.nan) for axis in "uv"]
            kept.append(_between(vectors, np.stack(both, axis=-1), points))
        times.append(vectors.times)
    time, at = np.concatenate(times), np.concatenate(velocity)
    error = np.where(np.isfinite(at), np.concatenate(sigma), np.nan)
    why = _uneven(time, time_unit)
    spectrum = None
    if not why:
        spectrum = spectrum_of(at, error, float(np.ptp(time)) / (len(time) - 1))
        if not np.isfinite(spectrum.density).any():
            spectrum, why = None, f"more than {MOST_FILLED:.0%} of the vectors are missing at every place"
    return TimeSeries(points, on_line, time, at, error, unit, time_unit, spectrum, why, about["run"])


def spectrum_of(values: Floats, sigma: Floats, step_s: float) -> Spectrum:
    """Spectrum of evenly timed values.

    Parameters
    ----------
    values, sigma : (T, P, 2) float64
        NaN where nothing was measured.
    step_s : float
        Time from one to the next.
    """
    count = len(values)
    length = 2 * count // (SEGMENTS + 1)
    flat = values.reshape(count, -1)
    known = np.isfinite(flat)
    few = known.mean(axis=0) >= 1.0 - MOST_FILLED
    filled = np.zeros_like(flat)
    every = np.arange(count)
    for column in np.nonzero(few)[0]:
        here = known[:, column]
        filled[:, column] = np.interp(every, every[here], flat[here, column])
    frequency, density = scipy.signal.welch(
        filled, 1.0 / step_s, "hann", length, length // 2, detrend="constant", axis=0
    )
    density = np.where(few, density, np.nan).reshape(-1, *values.shape[1:])
    with np.errstate(invalid="ignore"):
        noise = 2.0 * step_s * np.nansum(np.square(sigma), axis=0) / np.maximum(np.isfinite(sigma).sum(axis=0), 1)
    segments = 1 + (count - length) // (length - length // 2)
    free = 2.0 * segments / (1.0 + 2.0 * (1.0 - 1.0 / segments) / 36.0)
    low, high = (free / float(scipy.special.chdtri(free, share)) for share in BAND)
    return Spectrum(frequency[1:], density[1:], noise, low, high)


def _uneven(time: Floats, unit: str) -> str:
    """Return the reason why pairs at these times have no spectrum; "" if they have one."""
    if unit != "s":
        return "the frames bear no times"
    if len(time) < MIN_SPECTRUM_PAIRS:
        return f"{len(time)} pairs are too few; {MIN_SPECTRUM_PAIRS} do"
    even = np.linspace(time[0], time[-1], len(time))
    step = even[1] - even[0]
    if step <= 0.0 or np.abs(time - even).max() > EVEN * step:
        return "the time from pair to pair is not always the same"
    return ""


def _along(vectors: Vectors, line_mm: tuple[Place, Place]) -> Floats:
    """Places (P, 2) on a line, about as far apart as vectors."""
    first, last = np.asarray(line_mm, float)
    step = min(np.diff(vectors.x_mm).min(initial=np.inf), np.diff(vectors.y_mm).min(initial=np.inf))
    count = max(2, round(float(np.hypot(*(last - first))) / step) + 1)
    return np.asarray(first + np.linspace(0.0, 1.0, count)[:, None] * (last - first))


def _require_inside(points: Floats, vectors: Vectors) -> None:
    for x, y in points:
        if not (vectors.x_mm[0] <= x <= vectors.x_mm[-1] and vectors.y_mm[0] <= y <= vectors.y_mm[-1]):
            raise RunUsageError(
                f"({x:g}, {y:g}) mm: vectors reach from ({vectors.x_mm[0]:.4g}, {vectors.y_mm[0]:.4g}) to"
                f" ({vectors.x_mm[-1]:.4g}, {vectors.y_mm[-1]:.4g}) mm; choose a place between them"
            )


def _between(vectors: Vectors, values: Floats, points: Floats) -> Floats:
    """Values (T, P, 2) at places from those (T, ny, nx, 2) of the vectors around them."""
    (i, s), (j, t) = (_cell(axis, points[:, n]) for n, axis in enumerate((vectors.x_mm, vectors.y_mm)))
    total = np.zeros((len(values), len(points), 2))
    for down, along, weight in (
        (0, 0, (1 - s) * (1 - t)),
        (0, 1, s * (1 - t)),
        (1, 0, (1 - s) * t),
        (1, 1, s * t),
    ):
        # A vector that has no weight is not asked: places on vectors need no neighbours.
        part = values[:, np.minimum(j + down, len(vectors.y_mm) - 1), np.minimum(i + along, len(vectors.x_mm) - 1)]
        total += np.where(weight[:, None] > 0.0, weight[:, None] * part, 0.0)
    return total


def _cell(axis: Floats, at: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Number of the vector before each place, and how far it is to the next, 0 to 1."""
    index = np.clip(np.searchsorted(axis, at, side="right") - 1, 0, max(len(axis) - 2, 0))
    width = axis[np.minimum(index + 1, len(axis) - 1)] - axis[index]
    return index, np.where(width > 0.0, (at - axis[index]) / np.where(width > 0.0, width, 1.0), 0.0)
