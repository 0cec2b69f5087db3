"""The light of the target frames in a file: spectrum, filters and camera response.

One of these says what the lamp sends:

    {source: laser}                             # the laser that lights the particles, a line at wavelength_nm
    {mean_nm: 532.0, source: laser}             # a line: any other laser
    {mean_nm: 530.0, source: lamp}              # one colour, of whatever width
    {mean_nm: 530.0, width_nm: 33.0}            # a Gaussian by its full width at half height: a coloured LED
    {mean_nm: 530.0, sigma_nm: 14.0}            # the same by its standard deviation
    {band_nm: [450.0, 650.0]}                   # equally strong between two wavelengths
    {colour_temperature_k: 4000.0}              # a white LED of which nothing else is known
    {points: [[430.0, 0.0], [452.0, 1.0], ...]} # nm, power; straight lines between them: best, from a data sheet
    {lines: [[546.1, 1.0], [577.0, 0.4]]}       # nm, power of single lines

Beside it stand ``filters`` (a list of the same shapes, read as transmittance) and how the camera counts:
``response`` (points of signal per watt) or ``quantum_efficiency`` (points of electrons per photon).  Without
either the spectrum is taken as what the camera counts.  ``unsure_nm`` is the standard deviation of the mean
wavelength: 0 for a laser and for lines, 5 for lamps, of which no two of one data sheet are alike, 8 where a colour
temperature or one colour is all that is said.  A file that gives no more than a wavelength, be it the one in which
particles are seen, has not said that it is a laser's; and of a lamp three are sold as "the" wavelength: the peak
of the spectrum, the dominant wavelength, which is the colour that eyes see, and the mean.  They are some 5 nm
apart, beside the 5 nm by which lamps differ.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ground.config import Table
from tracer.errors import SceneError
from tracer.light import (
    COLDEST_K,
    FULL_WIDTH,
    WARMEST_K,
    Light,
    Numbers,
    band,
    continuous,
    gaussian,
    light_of,
    line,
    white_led,
)
from tracer.media import VISIBLE_NM

Wavelength = Annotated[float, Field(ge=VISIBLE_NM[0], le=VISIBLE_NM[1])]
Width = Annotated[float, Field(ge=0.0, le=500.0)]
Point = Annotated[list[Annotated[float, Field(ge=0.0, le=1e9)]], Field(min_length=2, max_length=2)]
Points = Annotated[list[Point], Field(min_length=2, max_length=10_000)]
# Where a laser is tried that has the scene's wavelength, which this table does not know
MIDDLE_NM = 532.0
VARIANCE_WIDTH = float(np.sqrt(12.0))  # width of a band in its standard deviations
LAMPS_DIFFER_NM = 5.0  # in mean wavelength, between lamps of one data sheet
# Of a wavelength that is all that is said, whatever it is and of whatever source
ONE_FIGURE_NM = 8.0
UNCOVERED = 0.01  # of the light may lie where a response or filter says nothing


def _ascending(points: Sequence[Sequence[float]], what: str) -> None:
    """Refuse points out of order, beyond the known wavelengths, or without any height."""
    lengths = [point[0] for point in points]
    if any(after <= before for before, after in pairwise(lengths)):
        raise ValueError(f"{what} must come in ascending order of wavelength, each once")
    if lengths[0] < VISIBLE_NM[0] or lengths[-1] > VISIBLE_NM[1]:
        raise ValueError(f"{what} must lie within {VISIBLE_NM[0]:g}-{VISIBLE_NM[1]:g} nm; give wavelengths in nm")
    if not any(point[1] > 0.0 for point in points):
        raise ValueError(f"{what} are zero everywhere")


class ShapeTable(Table):
    """A spectrum, or the transmittance of a filter."""

    mean_nm: Wavelength | None = None
    width_nm: Width | None = None
    sigma_nm: Width | None = None
    band_nm: Annotated[list[Wavelength], Field(min_length=2, max_length=2)] | None = None
    points: Points | None = None

    @model_validator(mode="after")
    def _of_one_shape(self) -> "ShapeTable":
        if (self.width_nm is not None or self.sigma_nm is not None) and self.mean_nm is None:
            raise ValueError("width_nm and sigma_nm belong to mean_nm; a band is band_nm: [from, to]")
        if self.width_nm is not None and self.sigma_nm is not None:
            raise ValueError("give either width_nm (full, at half height) or sigma_nm (standard deviation)")
        if self.band_nm is not None and self.band_nm[0] >= self.band_nm[1]:
            raise ValueError("band_nm goes from a shorter to a longer wavelength")
        if self.points is not None:
            _ascending(self.points, "points")
        return self

    @property
    def spread_nm(self) -> float:
        """Standard deviation of the Gaussian; 0 for a line."""
        return self.sigma_nm if self.sigma_nm is not None else (self.width_nm or 0.0) / FULL_WIDTH


class FilterTable(ShapeTable):
    """Transmittance of a filter: a Gaussian of height 1, a band, or points."""

    @model_validator(mode="after")
    def _one(self) -> "FilterTable":
        if sum(given is not None for given in (self.mean_nm, self.band_nm, self.points)) != 1:
            raise ValueError("a filter is one of mean_nm with width_nm, band_nm and points")
        if self.mean_nm is not None and self.spread_nm == 0.0:
            raise ValueError("a filter needs a width: width_nm (full, at half height) or sigma_nm")
        return self

    def passed(self, nm: Numbers) -> Numbers:
        """Transmittance at wavelengths."""
        if self.points is not None:
            return _interpolate(nm, self.points)
        if self.band_nm is not None:
            return ((nm >= self.band_nm[0]) & (nm <= self.band_nm[1])).astype(np.float64)
        return np.asarray(np.exp(-0.5 * ((nm - (self.mean_nm or 0.0)) / self.spread_nm) ** 2))


class LightTable(ShapeTable):
    """The light of the target frames."""

    colour_temperature_k: Annotated[float, Field(ge=WARMEST_K, le=COLDEST_K)] | None = None
    lines: Annotated[list[Point], Field(min_length=1, max_length=1000)] | None = None
    filters: Annotated[list[FilterTable], Field(max_length=20)] = Field(default_factory=list)
    response: Points | None = None
    quantum_efficiency: Points | None = None
    unsure_nm: Annotated[float, Field(ge=0.0, le=200.0)] | None = None
    source: Literal["laser", "lamp"] | None = None

    @model_validator(mode="after")
    def _one(self) -> "LightTable":
        shapes = (self.mean_nm, self.band_nm, self.points, self.colour_temperature_k, self.lines)
        given = sum(shape is not None for shape in shapes)
        if given > 1 or (given == 0 and self.source != "laser"):
            raise ValueError(
                "give exactly one of mean_nm, band_nm, points, lines and colour_temperature_k for the lamp"
            )
        if self.response is not None and self.quantum_efficiency is not None:
            raise ValueError("give either response (per watt) or quantum_efficiency (per photon)")
        if self.source == "laser" and ((given and self.mean_nm is None) or self.spread_nm > 0.0 or self.unsure_nm):
            raise ValueError(
                "a laser is one line, known exactly: source: laser stands alone, or beside mean_nm alone"
            )
        for what in ("response", "quantum_efficiency", "lines"):
            if getattr(self, what) is not None:
                _ascending(getattr(self, what), what)
        try:
            self.light(self.mean_nm or MIDDLE_NM)
        except SceneError as error:
            raise ValueError(str(error)) from None
        return self

    def light(self, particles_nm: float | None = None) -> Light:
        """Return the light as the camera counts it.

        Parameters
        ----------
        particles_nm : float, optional
            What particles are seen in: the line of a laser without a wavelength of its own.

        Raises
        ------
        SceneError
            Nothing is left behind the filters, or a response says nothing about a part of the light.
        """
        return self._light_at_camera(self._lamp_light(particles_nm))

    @property
    def is_believed(self) -> bool:
        """Return whether the file says how well the mean wavelength is known."""
        return self.unsure_nm is not None or self.source == "laser"

    def rivals(self) -> tuple[Light, ...]:
        """Lights that the same width could mean: a band for a Gaussian, a Gaussian for a band.

        One is as wide at half height, one has the same variance; none where the spectrum is given point by point.

        Raises
        ------
        SceneError
            As of `light`.
        """
        if self.band_nm is not None:
            middle, width = 0.5 * sum(self.band_nm), self.band_nm[1] - self.band_nm[0]
            shapes = [gaussian(middle, width / times) for times in (FULL_WIDTH, VARIANCE_WIDTH)]
        elif self.mean_nm is not None and self.spread_nm > 0.0:
            low, high = VISIBLE_NM
            halves = [0.5 * times * self.spread_nm for times in (FULL_WIDTH, VARIANCE_WIDTH)]
            shapes = [band(max(self.mean_nm - half, low), min(self.mean_nm + half, high)) for half in halves]
        else:
            shapes = []
        return tuple(self._light_at_camera(shape) for shape in shapes)

    def _light_at_camera(self, light: Light) -> Light:
        """Light behind the filters as the camera counts it."""
        for number, one in enumerate(self.filters, start=1):
            if one.points is not None:
                _covering(light, one.points, f"filter {number}")
            light = light.through(one.passed)
        counts = self.response or self.quantum_efficiency
        if counts is not None:
            photons = self.quantum_efficiency is not None  # of a watt, as many as the wavelength is long
            _covering(light, counts, "quantum_efficiency" if photons else "response")
            light = light.through(lambda nm: _interpolate(nm, counts) * (nm if photons else 1.0))
        if self.unsure_nm is not None:
            return replace(light, unsure_nm=self.unsure_nm)
        if light.unsure_nm or self.lines is not None or self.source == "laser":
            return light
        one_figure = self.mean_nm is not None and self.spread_nm == 0.0 and self.source is None
        return replace(light, unsure_nm=ONE_FIGURE_NM if one_figure else LAMPS_DIFFER_NM)

    def _lamp_light(self, particles_nm: float | None) -> Light:
        """Light of the lamp."""
        if self.colour_temperature_k is not None:
            return white_led(self.colour_temperature_k)
        if self.lines is not None:
            lengths, power = np.array(self.lines).T
            return light_of(lengths, power)
        if self.points is not None:
            points = self.points
            return continuous(points[0][0], points[-1][0], lambda nm: _interpolate(nm, points))
        if self.band_nm is not None:
            return band(*self.band_nm)
        mean_nm = self.mean_nm or particles_nm
        assert mean_nm is not None
        return gaussian(mean_nm, self.spread_nm) if self.spread_nm > 0.0 else line(mean_nm)


def _interpolate(nm: Numbers, points: Sequence[Sequence[float]]) -> Numbers:
    """Straight lines between points, nothing beyond them."""
    table = np.array(points)
    return np.asarray(np.interp(nm, table[:, 0], table[:, 1], left=0.0, right=0.0))


def _covering(light: Light, points: Sequence[Sequence[float]], what: str) -> None:
    """Refuse a curve that does not reach over the light: what it leaves out is not known to be zero."""
    nm, weight = np.array(light.wavelength_nm), np.array(light.weight)
    beyond = float(weight[(nm < points[0][0]) | (nm > points[-1][0])].sum())
    if beyond > UNCOVERED:
        raise SceneError(
            f"{what} is given from {points[0][0]:g} to {points[-1][0]:g} nm, and {100.0 * beyond:.0f} % of the"
            " light lies beyond; give points over all of it, zeros included"
        )
