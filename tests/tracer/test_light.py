"""Spectra of lamps, filters and cameras: what index a glass shows in them."""

import numpy as np
import pytest
from pydantic import ValidationError

from tests.loops import loop_over
from tracer.errors import SceneError
from tracer.light import band, gaussian, light_of, line, white_led
from tracer.light_table import LAMPS_DIFFER_NM, ONE_FIGURE_NM, LightTable
from tracer.media import MEDIA

GLASS = MEDIA["N-BK7"]
TYPICAL_NM = {2733.0: 592.5, 2998.0: 586.8, 4103.0: 564.6, 5109.0: 553.9, 6598.0: 541.4}  # CIE LED-B1 to LED-B5


def mean_index(low_nm: float, high_nm: float, density) -> float:
    """Mean index by a plain sum over picometres of Sellmeier's equation, written out here."""
    nm = np.arange(low_nm, high_nm, 0.01) + 0.005
    square = (nm * 1e-3) ** 2
    b, c = (1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)
    n = np.sqrt(1.0 + sum(bi * square / (square - ci) for bi, ci in zip(b, c, strict=True)))
    return float(np.average(n, weights=density(nm)))


@pytest.mark.parametrize(
    ("told", "low", "high", "density"),
    [
        ({"band_nm": [450.0, 650.0]}, 450.0, 650.0, np.ones_like),
        (
            {"mean_nm": 530.0, "width_nm": 33.0},
            450.0,
            610.0,
            lambda nm: 2.0 ** -((2.0 * (nm - 530.0) / 33.0) ** 2),
        ),
        ({"mean_nm": 530.0, "sigma_nm": 20.0}, 450.0, 610.0, lambda nm: np.exp(-0.5 * ((nm - 530.0) / 20.0) ** 2)),
        ({"points": [[420.0, 0.0], [460.0, 3.0], [500.0, 0.0]]}, 420.0, 500.0, lambda nm: 40.0 - abs(nm - 460.0)),
        (
            {
                "band_nm": [450.0, 650.0],
                "filters": [{"band_nm": [500.0, 700.0]}],
                "response": [[400.0, 0.0], [800.0, 4.0]],
            },
            500.0,
            650.0,
            lambda nm: nm - 400.0,
        ),
        (
            {"band_nm": [450.0, 650.0], "quantum_efficiency": [[400.0, 0.5], [700.0, 0.5]]},
            450.0,
            650.0,
            lambda nm: nm,
        ),
    ],
    ids=["band", "width", "sigma", "points", "filter and response", "quantum efficiency"],
)
def test_a_glass_shows_the_mean_index_of_what_the_camera_counts(told, low, high, density):
    assert LightTable(**told).light().index(GLASS) == pytest.approx(mean_index(low, high, density), abs=1e-6)


def test_lines_weigh_by_their_power():
    light = LightTable(lines=[[546.1, 3.0], [577.0, 1.0]]).light()
    assert light.index(GLASS) == pytest.approx(0.75 * GLASS.n(546.1) + 0.25 * GLASS.n(577.0), abs=1e-15)
    assert line(532.0).index(GLASS) == GLASS.n(532.0)


def test_a_flat_band_is_no_gaussian_of_its_width():
    """`width_nm: 200` for 450-650 nm, as was advised once, is wrong by as much as nothing said."""
    flat, told, alike = band(450.0, 650.0), gaussian(550.0, 200.0 / 2.3548), gaussian(550.0, 200.0 / np.sqrt(12.0))
    assert told.index(GLASS) - flat.index(GLASS) > 4e-4
    assert abs(alike.index(GLASS) - flat.index(GLASS)) < 2e-5


@pytest.mark.parametrize(("temperature_k", "mean_nm"), TYPICAL_NM.items())
def test_a_white_led_has_the_mean_wavelength_of_typical_lamps(temperature_k, mean_nm):
    light = white_led(temperature_k)
    assert light.mean_nm == pytest.approx(mean_nm, abs=0.6 * light.unsure_nm)
    assert 65.0 < light.spread_nm < 80.0


def test_colours_have_the_mean_and_nearly_the_spread_of_the_light():
    for light in (white_led(4000.0), band(450.0, 650.0), gaussian(530.0, 15.0)):
        nm, weight = light.colours(12)
        assert weight @ nm == pytest.approx(light.mean_nm, abs=0.01)
        assert np.sqrt(weight @ (nm - light.mean_nm) ** 2) == pytest.approx(light.spread_nm, rel=0.03)
    few = light_of([546.1, 577.0], [3.0, 1.0]).colours(12)
    np.testing.assert_allclose(few, [[546.1, 577.0], [0.75, 0.25]])


@loop_over(
    "told, words",
    [
        ({}, "exactly one of"),
        ({"source": "lamp"}, "exactly one of"),
        ({"source": "laser", "band_nm": [450.0, 650.0]}, "stands alone"),
        ({"source": "laser", "unsure_nm": 3.0}, "stands alone"),
        ({"source": "laser", "filters": [{"band_nm": [600.0, 700.0]}]}, "needs some power"),
        ({"mean_nm": 550.0, "band_nm": [450.0, 650.0]}, "exactly one of"),
        ({"band_nm": [650.0, 450.0]}, "shorter to a longer"),
        ({"band_nm": [450.0, 650.0], "width_nm": 20.0}, "belong to mean_nm"),
        ({"mean_nm": 550.0, "width_nm": 20.0, "sigma_nm": 9.0}, "either width_nm"),
        ({"points": [[500.0, 1.0], [450.0, 1.0]]}, "ascending"),
        ({"points": [[0.5, 1.0], [0.6, 1.0]]}, "in nm"),
        ({"points": [[450.0, 0.0], [650.0, 0.0]]}, "zero everywhere"),
        ({"mean_nm": 532.0, "filters": [{"band_nm": [600.0, 700.0]}]}, "needs some power"),
        ({"mean_nm": 532.0, "filters": [{"mean_nm": 532.0}]}, "needs a width"),
        ({"band_nm": [450.0, 650.0], "response": [[500.0, 1.0], [700.0, 1.0]]}, "25 % of the light"),
        ({"colour_temperature_k": 1800.0}, "2500"),
        ({"mean_nm": 532.0, "width_nm": 20.0, "source": "laser"}, "beside mean_nm alone"),
        ({"mean_nm": 532.0, "unsure_nm": 3.0, "source": "laser"}, "beside mean_nm alone"),
    ],
)
def test_what_is_no_light_is_refused(told, words):
    with pytest.raises(ValidationError, match=words):
        LightTable(**told)


def test_a_light_without_power_is_none():
    for power in ([0.0, 0.0], [1.0, -1.0], [1.0, np.nan]):
        with pytest.raises(SceneError, match="needs some power"):
            light_of([500.0, 600.0], power)


def test_a_width_may_mean_a_band_or_a_gaussian_as_wide_or_of_the_same_variance():
    table = LightTable(mean_nm=550.0, sigma_nm=30.0)
    as_wide, as_spread = (light.spread_nm for light in table.rivals())
    assert as_wide == pytest.approx(30.0 * np.sqrt(8.0 * np.log(2.0) / 12.0), rel=1e-3)
    assert as_spread == pytest.approx(30.0, rel=1e-3)
    as_wide, as_spread = (light.spread_nm for light in LightTable(band_nm=[500.0, 600.0]).rivals())
    assert as_wide == pytest.approx(100.0 / np.sqrt(8.0 * np.log(2.0)), rel=3e-3)
    assert as_spread == pytest.approx(100.0 / np.sqrt(12.0), rel=3e-3)
    assert not LightTable(mean_nm=532.0).rivals()
    assert not LightTable(colour_temperature_k=4000.0).rivals()
    cut = LightTable(mean_nm=550.0, width_nm=100.0, filters=[{"band_nm": [540.0, 560.0]}])
    assert max(light.spread_nm for light in cut.rivals()) < 6.0


@loop_over(
    "told, unsure_nm",
    [
        ({"mean_nm": 550.0}, ONE_FIGURE_NM),
        ({"mean_nm": 532.0}, ONE_FIGURE_NM),  # the particles' own, and nobody says that it is their laser
        ({"mean_nm": 532.0, "source": "laser"}, 0.0),
        ({"mean_nm": 550.0, "source": "laser"}, 0.0),
        ({"source": "laser"}, 0.0),
        ({"mean_nm": 550.0, "unsure_nm": 0.0}, 0.0),
        ({"mean_nm": 532.0, "source": "lamp"}, LAMPS_DIFFER_NM),
        ({"mean_nm": 532.0, "source": "lamp", "unsure_nm": 2.0}, 2.0),
        ({"mean_nm": 530.0, "width_nm": 30.0}, LAMPS_DIFFER_NM),
        ({"lines": [[546.1, 1.0]]}, 0.0),
    ],
)
def test_one_colour_is_a_lamp_unless_it_is_said_to_be_a_laser(told, unsure_nm):
    assert LightTable(**told).light(532.0).unsure_nm == unsure_nm


def test_a_laser_alone_is_the_one_that_lights_the_particles():
    assert LightTable(source="laser").light(488.0) == LightTable(mean_nm=488.0, source="laser").light(488.0)
