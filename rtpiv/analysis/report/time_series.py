"""The page of velocities over time: what moved at each place, how fast it changes, and a line over time."""

import numpy as np
from numpy.typing import NDArray

from rtpiv.analysis.pictures.plane_axes import SOFT, Figure, log_scale
from rtpiv.analysis.report.figures import HEAT, SERIES
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.report.table import Table
from rtpiv.analysis.series.time_series import TimeSeries

MAX_PLACES_DRAWN = 8  # places drawn; the file has all
COMPONENTS = ("u", "v")
FIGURES = ("mean", "standard deviation", "random sigma")


def time_series_page(found: TimeSeries, title: str) -> Page:
    """Return the page."""
    page = Page(title, "velocity over time")
    unit = found.unit.replace("m s-1", "m/s")
    points = np.nonzero(~found.on_line)[0][:MAX_PLACES_DRAWN]
    if points.size:
        page.figure(
            "points", _points(found, points, unit), "At each place; grey: one standard uncertainty, random."
        )
        head = ("x, y [mm]", *(f"{name} u, v [{unit}]" for name in FIGURES), "measured")
        page.table(Table("", head, [_row(found, point) for point in points]))
    if found.spectrum is None:
        page.text(f"No spectrum: {found.why_none}.")
    elif points.size:
        page.heading("Spectra")
        page.figure(
            "spectra",
            _spectra(found, points, unit),
            (
                f"Power spectral density. In 95 of 100 cases the truth lies within {found.spectrum.least:.2f} and "
                f"{found.spectrum.most:.2f} times what is drawn. Dashed: what the errors of vectors make of it."
            ),
        )
    if found.on_line.any():
        page.heading("Along the line")
        page.figure(
            "line", _line(found, unit), "Over time, from the first end of the line to the second.", dense=True
        )
    return page


def _row(found: TimeSeries, point: int) -> tuple[str, ...]:
    at, sigma = found.velocity[:, point], found.sigma[:, point]
    known = np.isfinite(at).all(axis=-1)
    place = _place(found, point)
    if not known.any():
        return place, "-", "-", "-", "0"
    rms = np.sqrt(np.mean(np.square(sigma[known]), axis=0))
    pairs = ("{:.3g}, {:.3g}".format(*both) for both in (at[known].mean(axis=0), at[known].std(axis=0), rms))
    return place, *pairs, str(int(known.sum()))


def _place(found: TimeSeries, point: int) -> str:
    return "{:g}, {:g}".format(*found.place_mm[point])


def _points(found: TimeSeries, points: NDArray[np.int64], unit: str) -> Figure:
    figure = Figure(figsize=(7.2, 0.9 + 1.6 * len(points)), layout="constrained")
    for axes, point in zip(figure.subplots(len(points), sharex=True, squeeze=False)[:, 0], points, strict=True):
        for number, name in enumerate(COMPONENTS):
            at, sigma = found.velocity[:, point, number], found.sigma[:, point, number]
            axes.fill_between(found.time, at - sigma, at + sigma, color=SOFT, alpha=0.3, linewidth=0)
            axes.plot(found.time, at, color=SERIES[number], linewidth=0.8, label=name)
        axes.set_ylabel(f"({_place(found, point)}) mm\n[{unit}]")
        axes.legend(loc="upper right", frameon=False, ncols=2)
    axes.set_xlabel(f"t [{found.time_unit}]")
    return figure


def _spectra(found: TimeSeries, points: NDArray[np.int64], unit: str) -> Figure:
    assert found.spectrum is not None
    figure = Figure(figsize=(7.2, 0.9 + 2.4 * len(points)), layout="constrained")
    for axes, point in zip(figure.subplots(len(points), sharex=True, squeeze=False)[:, 0], points, strict=True):
        for number, name in enumerate(COMPONENTS):
            density = found.spectrum.density[:, point, number]
            axes.plot(found.spectrum.frequency_hz, density, color=SERIES[number], linewidth=0.9, label=name)
            axes.axhline(found.spectrum.noise[point, number], color=SERIES[number], linewidth=0.8, linestyle="--")
        log_scale(axes.xaxis)
        log_scale(axes.yaxis)
        axes.set_ylabel(f"({_place(found, point)}) mm\n[({unit})²/Hz]")
        axes.legend(loc="upper right", frameon=False, ncols=2)
    axes.set_xlabel("f [Hz]")
    return figure


def _line(found: TimeSeries, unit: str) -> Figure:
    places = found.place_mm[found.on_line]
    along = np.hypot(*(places - places[0]).T)
    figure = Figure(figsize=(7.2, 4.8), layout="constrained")
    for axes, number in zip(figure.subplots(2, sharex=True), range(2), strict=True):
        shown = axes.pcolormesh(
            found.time, along, found.velocity[:, found.on_line, number].T, cmap=HEAT, rasterized=True
        )
        figure.colorbar(shown, ax=axes, label=f"{COMPONENTS[number]} [{unit}]")
        axes.set_ylabel("along the line [mm]")
    axes.set_xlabel(f"t [{found.time_unit}]")
    return figure
