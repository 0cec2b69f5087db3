"""What glass that is called by its name says of the light of the target frames."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from correction.fit.judge.light_of_glass import light_of_glass
from tests.correction.fit.lamps import PLASTICS, lab_scene
from tracer.light import line
from tracer.media import MEDIA, MELTS, ConstantMedium, shifted

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
