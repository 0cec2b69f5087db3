"""Priors that hold one by one and fail together, and labs whose priors are right."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import FitFailed
from correction.fit.adjustment import Adjustment
from correction.fit.judge.prior_pulls import prior_pulls
from correction.fit.judge.result import check
from correction.fit.judge.verdict import STRAINED
from correction.fit.solve.unknowns import unknowns_of
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene, misalign
from tests.correction.fit.drawn_labs import BOARD, photographed
from tests.correction.fit.drawn_optics import Ball, Lab
from tests.slow_cases import slow
from tracer.scene.fit_section import FitSphereTable, FitTable

SIZE_PX = 504


def fitted(name, print_scale=1.0, radius_scale=1.0, radius_mm=0.02, scale_sigma=0.0, seed=5):
    """Fit a lab whose print, or whose balls, are larger than the files say."""
    rng = np.random.default_rng(seed)
    nominal = at_size(demo_scene(name), SIZE_PX)
    truth = misalign(nominal, seed)
    nominal = nominal.with_bodies([replace(s, radius_mm=s.radius_mm / radius_scale) for s in nominal.spheres])
    real = Chessboard(BOARD.square_mm * print_scale, BOARD.disc_mm)
    frames = []
    for glass in (False, True):
        scene = truth if glass else truth.bare()
        index = [
            Ball(s.centre_mm, s.radius_mm, s.medium.n(truth.wavelength_nm) / truth.n_ambient)
            for s in scene.spheres
        ]
        seen = photographed(scene, Lab(truth.camera, tuple(index)), real, glass, 0.005, 0.0, rng)
        stated = replace(seen.corners, node_mm=seen.corners.node_mm / print_scale)
        frames.append(replace(seen, corners=stated))
    priors = FitTable(spheres=FitSphereTable(radius_mm=radius_mm))
    bench = unknowns_of(nominal, [0.0], priors, print_sigma=(scale_sigma, scale_sigma))
    return Adjustment().estimate(bench, bench.start, frames, ()), truth, bench


@pytest.mark.parametrize(
    ("name", "faults", "said"),
    [
        ("two_spheres_500", {"print_scale": 1.004, "radius_mm": 0.025}, "larger than given; measure the squares"),
        slow("pair_off_axis", {"print_scale": 0.9968}, "print 0.32 % smaller"),
        slow("pair_off_axis", {"radius_scale": 1.003}, "check the radii"),
    ],
)
def test_a_wrong_scale_that_no_single_prior_shows_is_named_and_is_in_sigma(name, faults, said):
    fit, truth, _ = fitted(name, **faults)
    assert np.abs(fit.x).max() < 5.0  # each gate alone lets it pass
    assert not fit.verdict.is_right
    assert said in fit.verdict.sentences[0]
    found, sigma = fit.scene.spheres[1].radius_mm, np.sqrt((fit.ball_root[1, 3] ** 2).sum())
    assert abs(found - truth.spheres[1].radius_mm) < 2.5 * sigma
    far = replace(fit.verdict, pulls=(replace(fit.verdict.pulls[0], sigmas=5.5),))
    with pytest.raises(FitFailed, match=r"joint distance from the priors.*" + said):
        check(replace(fit, verdict=far))


def test_a_print_whose_scale_is_unsure_takes_it_up_without_an_alarm():
    fit, _, bench = fitted("two_spheres_500", print_scale=1.004, scale_sigma=0.005)
    assert fit.verdict.is_right, fit.verdict.sentences
    sigma = dict(zip(fit.names, zip(fit.values, fit.sigmas, strict=True), strict=True))["print.stretch_x"]
    assert sigma[0] == pytest.approx(0.004, abs=2.5 * sigma[1])
    assert sigma[1] < 0.002
    assert bench.names == fit.names


@pytest.mark.slow
def test_a_right_lab_is_left_alone():
    for seed, name in enumerate(("two_spheres_500", "one_sphere_500", "three_spheres_500")):
        assert not fitted(name, seed=seed)[0].verdict.pulls


def linear_labs(heights_mm, count, seed):
    """Tests of labs drawn from their priors, by the linear algebra of a fit."""
    rng = np.random.default_rng(seed)
    bench = unknowns_of(demo_scene("three_spheres_500"), heights_mm, FitTable(), print_sigma=(0.005, 0.005))
    free = len(bench.names)
    root = rng.normal(size=(free, free)) * 10.0 ** rng.uniform(-1.0, 3.0, free)  # known badly, well, not at all
    root[:, ::7] = 0.0
    inner = root.T @ root + np.eye(free)
    gain = np.linalg.inv(inner)
    truth = rng.normal(size=(free, count))
    labs = np.linalg.solve(inner, root.T @ (root @ truth + rng.normal(size=(free, count)))).T
    return [prior_pulls(bench, x, root.T @ root, gain) for x in labs]


def test_labs_drawn_from_their_priors_raise_no_alarm_more_often_than_stated():
    alarms = sum(map(bool, linear_labs([0.0, -10.0, 10.0], 1000, 1)))
    assert alarms <= 5  # 1 in 1000 expected at most


@pytest.mark.slow
@pytest.mark.parametrize("name", ["one_sphere_500", "two_spheres_500", "three_spheres_500"])
def test_right_labs_drawn_from_the_linear_model_of_a_fit_raise_few_alarms(name):
    """Single numbers beyond 4 sigmas and joint tests together: less than 1 % of labs."""
    fit, _, _ = fitted(name, scale_sigma=0.005)
    normal, rng = 0.5 * (fit.normal + fit.normal.T), np.random.default_rng(1)
    free, (values, vectors) = len(normal), np.linalg.eigh(normal)
    root, inner = vectors * np.sqrt(np.maximum(values, 0.0)), normal + np.eye(len(normal))
    truth, noise = rng.normal(size=(2, free, 3000))
    # Solved, as a fit is: an inverse times normal equations of 1e11 moves a radius by up to 0.9 sigma.
    labs, gain = np.linalg.solve(inner, normal @ truth + root @ noise).T, np.linalg.inv(inner)
    alarms = sum(np.abs(x).max() > STRAINED or bool(prior_pulls(fit.unknowns, x, normal, gain)) for x in labs)
    assert 0 < alarms < 12


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        (("target-20mm.z", "target-10mm.z", "target+10mm.z"), "heights of the target"),
        (("sphere1.radius", "sphere2.radius", "sphere3.radius"), "radii"),
        (("print.stretch_x", "print.stretch_y"), "scale of the print"),
        (("sphere2.x",), "distances between balls"),
    ],
)
def test_each_kind_that_is_pulled_alike_is_named(names, kind):
    bench = unknowns_of(demo_scene("three_spheres_500"), [-20.0, -10.0, 10.0], FitTable(), print_sigma=(5e-3,) * 2)
    assert set(names) <= set(bench.names), bench.names
    x = np.zeros(len(bench.names))
    x[[bench.names.index(name) for name in names]] = 4.0 if len(names) > 1 else 6.5
    well = np.eye(len(x))
    pulls = prior_pulls(bench, x, 1e4 * well, 1e-4 * well)
    assert pulls[0].kind in (kind, "all lengths")
    assert kind in [pull.kind for pull in pulls]


def test_balls_that_all_stand_beside_their_place_by_the_same_step_are_no_fault():
    bench = unknowns_of(demo_scene("three_spheres_500"), [0.0], FitTable())
    x = np.array([4.0 if name.endswith(".x") and not name.startswith("camera") else 0.0 for name in bench.names])
    well = np.eye(len(x))
    assert not prior_pulls(bench, x, 1e4 * well, 1e-4 * well)
