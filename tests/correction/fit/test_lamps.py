"""Target frames in the light of lamps, measured in a laser's: the map is true, or its sigma says how much not.

One bench, twelve lamps (`lamps`): white LEDs, LEDs of one colour, flat bands, single lines.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from correction.fit.judge.light_of_glass import light_of_glass
from correction.fit.judge.result import SceneFit
from correction.fit.judge.weakness import _of_light, weaknesses
from correction.fit.scene_fit import fit_scene
from correction.fit.solve.light import any_lamp, light_uncertainty
from correction.fitted.map_sigma import sigma_at
from correction.grid import grid_of
from correction.maps.correction_map import build_correction_map
from sim.demo.scenes import at_size, demo_scene
from tests.correction.fit.benches import BOARD, map_error_px
from tests.correction.fit.lamps import (
    BK7,
    LAMPS,
    PLASTICS,
    TEMPERATURES,
    WAVES_NM,
    frames_in,
    lab_scene,
    true_scene,
)
from tracer.light import line
from tracer.light_table import LightTable
from tracer.media import MEDIA, MELTS, ConstantMedium, shifted
from tracer.scene.fit_section import FitTable
from tracer.strategies.ray_map import build_ray_map

TRANSFER_PX = 0.01
# The band of 500-600 nm (29 nm standard deviation) smears too little to be told from one colour; sigma holds it.
MANY_COLOURS = ("band_450_650", "white_3000", "white_4000", "white_5000", "white_6500", "mercury")
WRONG_SHAPES = (  # half width of the true band; the light of the last one is a Gaussian of 100 nm at half height
    *((100.0, {"mean_nm": 550.0, **width}) for width in ({"width_nm": 200.0}, {"sigma_nm": 57.7})),
    (50.0, {"mean_nm": 550.0, "width_nm": 100.0}),
    (50.0, {"band_nm": [500.0, 600.0]}),
)
MEASURED = {"points": [[450.0, 0.0], [550.0, 1.0], [650.0, 0.0]]}
NO_WHITE = ("red_led", "blue_led", "line_590")  # the sigma of a light that is not told is made of white lamps


def error_and_sigma(
    fit: SceneFit, glasses: tuple[str, str] = BK7, particles_nm: float = 532.0
) -> tuple[float, float]:
    """Rms error and sigma of the map in the light of the flow, corrected px, over the view behind glass."""
    truth = replace(true_scene(glasses), wavelength_nm=particles_nm)
    grid = grid_of(truth.camera)
    seen = build_correction_map(truth, build_ray_map(truth), grid)
    pixels = seen.pixel[0][seen.behind_glass][::7]
    error = np.linalg.norm(map_error_px(fit.measured_scene, truth, pixels, grid), axis=1)
    here = np.isfinite(error)
    assert here.mean() > 0.98
    sigma = np.linalg.norm(sigma_at(fit, pixels[here], True), axis=1) / grid.pitch_mm
    return float(np.sqrt(np.mean(error[here] ** 2))), float(np.sqrt(np.mean(sigma**2)))


def fitted(
    share: np.ndarray | float, told: dict | None, glasses: tuple[str, str] = BK7, particles_unsure_nm: float = 0.0
) -> SceneFit:
    priors = FitTable(light=LightTable(**told) if told else None, wavelength_nm=particles_unsure_nm)
    return fit_scene(lab_scene(glasses), frames_in(share, glasses), BOARD, priors)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", LAMPS)
def test_a_light_that_is_told_costs_nothing(name):
    lamp = LAMPS[name]
    fit = fitted(lamp.share, {**lamp.told, "unsure_nm": 0.5})  # as a spectrometer tells it
    error, sigma = error_and_sigma(fit)
    print(f"{name}: told {error:.4f} px, sigma {sigma:.4f} px")
    assert error <= TRANSFER_PX
    assert sigma <= 2.0 * TRANSFER_PX  # it is known, so nothing is added
    assert not fit.verdict.many_colours


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", LAMPS)
def test_a_light_that_is_not_told_is_in_the_sigma_and_said(name):
    fit = fitted(LAMPS[name].share, None)
    error, sigma = error_and_sigma(fit)
    print(f"{name}: unsaid {error:.4f} px, sigma {sigma:.4f} px, smear {fit.verdict.smear}")
    assert error <= (2.2 if name in NO_WHITE else 1.0) * sigma
    assert "light of the target frames is not said" in weaknesses(fit)[0].sentence
    assert fit.verdict.many_colours == (name in MANY_COLOURS)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", TEMPERATURES)
def test_a_colour_temperature_is_better_than_nothing_and_says_what_it_is_worth(name):
    fit = fitted(LAMPS[name].share, {"colour_temperature_k": TEMPERATURES[name]})
    error, sigma = error_and_sigma(fit)
    print(f"{name}: by temperature {error:.4f} px, sigma {sigma:.4f} px")
    assert error <= 2.0 * sigma
    assert sigma < 0.06
    assert "mean wavelength" in weaknesses(fit)[0].sentence


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("half_nm", "told"), WRONG_SHAPES)
def test_a_light_told_in_the_wrong_shape_is_named_or_in_the_sigma(half_nm, told):
    inside = np.clip((half_nm - np.abs(WAVES_NM - 550.0)) / 10.0 + 0.5, 0.0, 1.0)
    power = np.exp(-0.5 * ((WAVES_NM - 550.0) / 42.5) ** 2) if "band_nm" in told else inside
    fit = fitted(power / power.sum(), told)
    error, sigma = error_and_sigma(fit)
    print(f"{told}: {error:.4f} px, sigma {sigma:.4f} px, smear {fit.verdict.smear}")
    assert fit.verdict.many_colours or error <= 1.25 * sigma
    assert error <= 2.0 * sigma  # what is named is in the sigma as well


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_wavelength_alone_is_in_the_sigma_though_it_is_the_particles_own():
    """An LED sold as 532 nm, or the laser itself: nobody said which."""
    parts = []
    for true_nm in (524.0, 540.0):
        fit = fitted(true_nm, {"mean_nm": 532.0}, PLASTICS)
        error, sigma = error_and_sigma(fit, PLASTICS)
        print(f"plastics, {true_nm:g} as 532 nm: {error:.4f} px, sigma {sigma:.4f} px, {fit.light.sentence}")
        assert error > 0.05
        assert fit.verdict.is_right
        assert "source: laser" in fit.light.sentence
        parts.append(error / sigma)
    assert max(parts) < 1.25
    fit = fitted(532.0, {"mean_nm": 532.0}, PLASTICS)
    error, sigma = error_and_sigma(fit, PLASTICS)
    assert fit.verdict.is_right
    assert error < 0.3 * sigma  # the laser itself costs what nobody said


def test_a_width_that_is_told_leaves_the_shape_of_the_light_open():
    nominal = lab_scene()
    wide, narrow, points = (
        LightTable(**told, unsure_nm=0.0)
        for told in ({"mean_nm": 550.0, "width_nm": 200.0}, {"mean_nm": 530.0, "width_nm": 30.0}, MEASURED)
    )
    steps = []
    for table in (wide, narrow, points):
        light = table.light()
        doubt = light_uncertainty(nominal, light, [(rival, 1.0) for rival in table.rivals()])
        steps.append(float(np.abs(doubt.step).max(initial=0.0)))
        assert ("points" in doubt.sentence) == (table is wide)
    true, told = LightTable(band_nm=[450.0, 650.0]).light(), wide.light()
    glass = nominal.spheres[0].medium
    assert steps[0] > 0.7 * abs(true.index(glass) - told.index(glass)) > 1e-4
    assert 0.0 < steps[1] < 3e-5
    assert steps[2] == 0.0


def test_a_light_that_the_smear_contradicts_may_be_any_lamp():
    nominal, light = lab_scene(), LightTable(mean_nm=532.0).light()
    doubt = light_uncertainty(nominal, light, [(lamp, 1.0) for lamp in any_lamp(nominal.wavelength_nm)])
    assert float(np.abs(doubt.step).max()) > 1e-3


def test_what_is_not_known_of_a_light_moves_all_glass_together():
    nominal = lab_scene()
    unsaid, white = (
        light_uncertainty(nominal, None),
        light_uncertainty(nominal, LightTable(colour_temperature_k=4000.0).light()),
    )
    for doubt, least, most in ((unsaid, 2e-3, 3e-3), (white, 2e-4, 5e-4)):
        n = np.abs(doubt.step[14:].reshape(-1, 5))
        assert np.all(n[:, :4] == 0.0)
        assert least < n[0, 4] == n[1, 4] < most
    assert not light_uncertainty(nominal, LightTable(source="laser").light(532.0)).sentence


def test_a_lamp_that_lights_the_particles_is_as_unsure_as_the_one_of_the_target():
    nominal, lamp = lab_scene(), LightTable(mean_nm=532.0, source="lamp").light()
    target, both, flow, alike = (
        light_uncertainty(nominal, light, particles_unsure_nm=unsure)
        for light, unsure in ((lamp, 0.0), (lamp, 5.0), (line(590.0), 5.0), (line(532.0), 5.0))
    )
    np.testing.assert_allclose(both.step, np.sqrt(2.0) * target.step)
    np.testing.assert_allclose(flow.step, target.step)
    assert "particles' light is known to 5.0 nm" in flow.sentence
    assert not alike.sentence


def test_glass_that_is_a_number_is_said_to_hold_in_the_light_of_the_target_alone():
    nominal = at_size(demo_scene("two_spheres_500"), 300)
    unsaid = light_uncertainty(nominal, None)
    assert not unsaid.step.size
    assert "the index of sphere1, sphere2 is a number without dispersion" in unsaid.sentence
    assert not light_uncertainty(nominal, LightTable(source="laser").light(nominal.wavelength_nm)).sentence
    assert not light_uncertainty(nominal.with_bodies(()), None).sentence


# What glass that is called by its name says of the light of the target frames.


GREEN = line(532.0)


def fit_of(names, off, sigma, prior=0.005):
    """A fit that found indices so far from the told light's, each as well as its sigma says."""
    unit = np.full(len(names), prior)
    return SimpleNamespace(
        names=[f"glass {name}.n" for name in names],
        x=np.array(off) / unit,
        covariance=np.diag((np.array(sigma) / unit) ** 2),
        unknowns=SimpleNamespace(sigma=unit),
    )


def test_a_red_lamp_told_as_green_is_seen_by_the_index_of_the_glass():
    glass = MEDIA["N-BK7"]
    red = glass.n(630.0) - glass.n(532.0)
    seen = light_of_glass(fit_of(["N-BK7"], [red], [0.0009]), lab_scene(), GREEN, False)
    slope = (glass.n(533.0) - glass.n(531.0)) / 2.0
    alone = 1.0 / (0.0009**-2 - 0.005**-2)  # variance by the frames without the prior
    assert seen.off_nm == pytest.approx(red * alone / 0.0009**2 / slope)
    assert seen.sigma_nm == pytest.approx(np.hypot(np.sqrt(alone), MELTS["N-BK7"]) / -slope)
    assert seen.alarm
    assert "not 532 as fit.light tells" in str(seen)
    assert 0.75 * seen.off_nm < seen.unsure_nm < seen.off_nm


def test_two_glasses_tell_more_than_one_and_a_measured_one_counts_as_its_file_says():
    nominal = lab_scene(PLASTICS)
    off = [0.5 * (glass.n(552.0) - glass.n(512.0)) for glass in (MEDIA[name] for name in PLASTICS)]
    both = light_of_glass(fit_of(PLASTICS, off, [0.002, 0.001]), nominal, GREEN, False)
    one = light_of_glass(fit_of(PLASTICS[1:], off[1:], [0.001]), nominal, GREEN, False)
    assert both.sigma_nm < one.sigma_nm
    assert both.off_nm == pytest.approx(20.0, rel=0.25)
    assert not both.alarm
    assert both.unsure_nm == 0.0
    melts = [shifted(ball.medium, 1e-4) for ball in nominal.spheres]
    measured = nominal.with_bodies([replace(b, medium=m) for b, m in zip(nominal.spheres, melts, strict=True)])
    assert light_of_glass(fit_of(PLASTICS, off, [0.002, 0.001]), measured, GREEN, False).sigma_nm > both.sigma_nm


def test_who_says_how_well_the_light_is_known_is_believed_until_it_cannot_be():
    told = replace(GREEN, unsure_nm=1.0)
    for off, is_alarm in ((-0.0025, False), (-0.006, True)):
        believed, doubted = (
            light_of_glass(fit_of(["N-BK7"], [off], [0.001]), lab_scene(), told, word) for word in (True, False)
        )
        assert believed.alarm == doubted.alarm == is_alarm
        assert doubted.unsure_nm > 30.0
        assert believed.unsure_nm == (doubted.unsure_nm if is_alarm else 1.0)


def test_glass_that_is_a_number_or_is_not_seen_says_nothing():
    numbers = lab_scene().with_bodies([replace(b, medium=ConstantMedium(1.5)) for b in lab_scene().spheres])
    assert light_of_glass(fit_of(["sphere1+sphere2"], [-0.006], [0.001]), numbers, GREEN, False) is None
    assert light_of_glass(fit_of([], [], []), lab_scene(), GREEN, False) is None
    assert light_of_glass(fit_of(["N-BK7"], [0.0], [0.005]), lab_scene(), GREEN, False) is None


# What a calibration says of the light of its target frames: once, and in digits that mean something.


def doubt(unsure_nm):
    scene = demo_scene("two_spheres_500")
    scene = scene.with_bodies([replace(ball, medium=MEDIA["N-BK7"]) for ball in scene.bodies])
    return light_uncertainty(scene, replace(line(625.0), unsure_nm=unsure_nm))


def test_how_well_a_wavelength_is_known_has_no_digits_beyond():
    assert "is known to 117 nm, n to" in doubt(116.591).sentence
    assert "is known to 4.6 nm, n to" in doubt(4.591).sentence


def test_a_light_that_cannot_be_the_told_one_is_not_also_said_to_be_known():
    fit = SimpleNamespace(light=doubt(116.591), verdict=SimpleNamespace(wrong_light=""))
    assert len(_of_light(fit)) == 1
    fit.verdict.wrong_light = "the light of the target frames seems to have a mean wavelength of 507 +- 14 nm"
    assert _of_light(fit) == []
