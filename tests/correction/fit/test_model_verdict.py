"""Does the fit know when its model is wrong?  A few drawn labs; hundreds of them behind `make labs`."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import FitFailed
from correction.fit.adjustment import Adjustment
from correction.fit.judge.model_test import MODEL_FALSE_ALARMS, Remainder, ways_tested
from correction.fit.judge.prior_pulls import prior_pulls
from correction.fit.judge.result import check
from correction.fit.judge.verdict import Verdict
from correction.fit.seen.hidden_patches import Hidden
from correction.fit.seen.measurement import TargetFrame, glass_frame
from correction.fit.seen.smear_test import ColourSmear
from correction.fit.seen.unconfirmed_ways import Unconfirmed
from correction.fit.solve.ball_shape import SHAPES, shape_rates
from correction.fit.solve.correlation import FURTHEST, Lattice, correlation_of, with_correlation
from correction.fit.solve.unknowns import unknowns_of
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene, misalign
from tests.correction.fit.drawn_labs import BOARD, drawn_lab, photographed
from tests.correction.fit.drawn_optics import Ball, Lab, shown_mm
from tests.slow_cases import slow
from tracer.masked import UNCONFIRMED, UNLISTED, MaskedPart
from tracer.scene.fit_section import FitSphereTable, FitTable
from tracer.strategies.sensitivity import TargetPose

LATTICE = np.stack(np.meshgrid(np.arange(20), np.arange(12)), axis=-1).reshape(-1, 2)
PIXEL = 40.0 + 22.0 * LATTICE


def remainder(
    residual_px: np.ndarray, way: str = "ball", sigma: float = 0.02, known_smooth_px: float = 0.0
) -> Remainder:
    count = len(residual_px)
    return Remainder(
        np.full(count, way),
        PIXEL,
        residual_px,
        np.full((count, 2), sigma),
        np.tile(np.eye(2), (count, 1, 1)),
        np.full(count, known_smooth_px),
    )


def bent(size_px: float) -> np.ndarray:
    """A smooth field: cubic along u."""
    x = (PIXEL[:, 0] - PIXEL[:, 0].mean()) / np.ptp(PIXEL[:, 0])
    return size_px * np.stack((x**3 - 0.15 * x, x**2 - 0.08), axis=1)


def test_right_models_raise_no_more_alarms_than_said_whatever_the_sigmas_are():
    rng = np.random.default_rng(1)
    alarms = 0
    for _ in range(150):
        factor = np.exp(rng.normal())  # sigmas that are all wrong by one factor
        tests = ways_tested([remainder(0.02 * factor * rng.normal(size=PIXEL.shape), way) for way in ("", "ball")])
        alarms += any(test.alarm for test in tests)
    assert alarms <= 150 * MODEL_FALSE_ALARMS


def test_a_field_that_bends_is_found_and_measured_below_the_noise():
    rng = np.random.default_rng(2)
    noise = 0.02 * rng.normal(size=PIXEL.shape)
    field = bent(0.3)
    (test,) = ways_tested([remainder(noise + field)])
    size = float(np.sqrt(np.mean(field**2)))
    assert size < 0.02
    assert test.alarm
    assert test.smooth_px == pytest.approx(size, rel=0.2)
    assert test.rough_px == pytest.approx(0.02, rel=0.1)
    assert test.map_px == pytest.approx(np.sqrt(2.0) * size, rel=0.2)


def test_a_field_as_large_as_what_is_known_to_be_smooth_is_no_alarm():
    field, noise = bent(0.3), 0.02 * np.random.default_rng(2).normal(size=PIXEL.shape)
    size = float(np.sqrt(np.mean(np.sum(field**2, axis=1))))
    (known,) = ways_tested([remainder(noise + field, known_smooth_px=size)])
    (larger,) = ways_tested([remainder(noise + 3.0 * field, known_smooth_px=size)])
    assert not known.alarm
    assert larger.alarm


def test_a_few_wrong_corners_are_no_wrong_model():
    rng = np.random.default_rng(3)
    residual = 0.02 * rng.normal(size=PIXEL.shape)
    residual[rng.choice(len(residual), 6)] += 3.0
    (test,) = ways_tested([remainder(residual)])
    assert not test.alarm


def lattice(value: np.ndarray) -> Lattice:
    rate = np.stack((np.ones_like(value), value * 0.0 + PIXEL / 100.0), axis=2)
    return Lattice(LATTICE, np.full(len(value), "ball"), value, rate)


def test_independent_corners_count_in_full_and_alike_ones_for_few():
    rng = np.random.default_rng(4)
    noise = rng.normal(size=PIXEL.shape)
    alone = correlation_of([lattice(noise)], True)
    assert alone.independent == alone.corners == len(PIXEL)
    alike = correlation_of([lattice(0.3 * noise + bent(10.0))], True)
    assert alike.independent < 0.2 * len(PIXEL)
    assert len(alike.by_distance) <= FURTHEST


def test_the_covariance_holds_the_scatter_of_means_of_corners_that_err_alike():
    """The mean of a field of patches scatters by what the sandwich says, not by 1 / sqrt(N)."""
    rng = np.random.default_rng(5)
    patch = LATTICE // 3
    means, said = [], []
    for _ in range(60):
        field = rng.normal(size=(8, 8, 2))
        value = 0.7 * field[patch[:, 0], patch[:, 1]] + 0.7 * rng.normal(size=PIXEL.shape)
        seen = lattice(value)
        seen = Lattice(seen.index, seen.branch_name, value, np.ones((*value.shape, 1)))
        found = {True: correlation_of([seen], True)}
        means.append(value.mean())
        said.append(with_correlation(np.array([[1.0 / value.size]]), [seen], found)[0, 0])
    assert np.std(means) > 1.5 / np.sqrt(2 * len(PIXEL))
    assert np.std(means) == pytest.approx(np.sqrt(np.mean(said)), rel=0.35)


def test_the_covariance_is_the_sandwich_summed_pair_by_pair():
    rng = np.random.default_rng(6)
    frames = [replace(lattice(bent(10.0) + rng.normal(size=PIXEL.shape)), rate=rng.normal(size=(len(PIXEL), 2, 5)))
              for _ in range(2)]  # fmt: skip
    found = {True: correlation_of(frames, True)}
    rho, middle = found[True].by_distance, np.zeros((5, 5))
    assert len(rho) > 1
    for frame in frames:
        for distance, first, second in frame.pairs(True):
            for one, other in zip(first, second, strict=True):
                if distance <= len(rho):
                    both = frame.rate[one].T @ frame.rate[other]
                    middle += rho[distance - 1] * (both + both.T)
    values, vectors = np.linalg.eigh(middle)
    inverse = np.linalg.inv(sum(np.einsum("nkp,nkq->pq", frame.rate, frame.rate) for frame in frames))
    wanted = inverse + inverse @ (vectors * np.maximum(values, 0.0)) @ vectors.T @ inverse
    np.testing.assert_allclose(with_correlation(inverse, frames, found), wanted, rtol=1e-11)


def test_landing_points_move_with_a_balls_shape_as_optics_of_another_hand_say():
    scene = at_size(demo_scene("two_spheres_500"), 700)
    pixels = np.random.default_rng(7).uniform(250.0, 450.0, (200, 2))
    table = scene.sphere_table()
    order = [int(row) for row in np.argsort(-table[:, 2])]
    step = 1e-3
    truth = tuple(
        Ball(s.centre_mm, s.radius_mm, float(row[4])) for s, row in zip(scene.spheres, table, strict=True)
    )
    _, through = shown_mm(Lab(scene.camera, truth), pixels)
    pixels = pixels[through == 3 * 5 + 1]  # the second ball, then the first
    assert len(pixels) > 50
    both = shape_rates(scene.camera, table, np.tile(order, (len(pixels), 1)), pixels, TargetPose())
    for ball in range(2):
        here, rates = both.by(ball)
        assert here.all()
        for number, shape in enumerate(SHAPES):
            ends = []
            for sign in (1.0, -1.0):
                balls = tuple(
                    Ball(s.centre_mm, s.radius_mm, float(table[i, 4]), sign * step * shape * (i == ball))
                    for i, s in enumerate(scene.spheres)
                )
                ends.append(shown_mm(Lab(scene.camera, balls), pixels)[0])
            np.testing.assert_allclose(
                rates[:, :, number], (ends[0] - ends[1]) / (2.0 * step), rtol=1e-3, atol=1e-5
            )


def test_a_corner_whose_window_leaves_the_frame_is_not_one_that_something_hides():
    scene = at_size(demo_scene("two_spheres_500"), 504)
    blank = TargetFrame("blank", np.full((504, 504), 1000, np.uint16), True)
    lost = glass_frame(blank, Chessboard(3.5, 1.4), scene, TargetPose(), 0, only_behind=False).lost
    assert len(lost.index) > 500
    to_border = np.minimum(lost.pixel, 503.0 - lost.pixel).min(axis=1)
    assert to_border.min() > 2.0


HIDDEN = Hidden("glass", "ball", 6, (9.0, 9.0), MaskedPart(UNLISTED, ((0.0, 0.0), (9.0, 0.0), (9.0, 9.0))))
BALL = Unconfirmed("ball", 1, 9, True, (MaskedPart(UNCONFIRMED, through=("ball",)),))
WAY = Unconfirmed("ball", 1, 9, False, (MaskedPart(UNCONFIRMED, through=("ball",)),))
WHITE = ColourSmear(1.0, 0.01, 0.4)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ({}, "the model is right within the accuracy of the corners: residuals bend smoothly by no more than 0.0"),
        ({"unconfirmed": (WAY,)}, "the model is right within the accuracy of the corners: residuals bend"),
        ({"hidden": (HIDDEN,)}, "outside what is masked, residuals bend smoothly by no more than 0.0"),
        ({"unconfirmed": (BALL,)}, "outside what is masked, residuals bend smoothly by no more than 0.0"),
        ({"smear": WHITE}, "apart from that, residuals bend smoothly by no more than 0.0"),
    ],
)
def test_what_residuals_say_agrees_with_the_verdict_on_the_whole_model(found, words):
    """A part that is masked, or smeared corners, are no model that is right, however little residuals bend."""
    noise = 0.02 * np.random.default_rng(2).normal(size=PIXEL.shape)
    verdict = Verdict(ways_tested([remainder(noise)]), {}, (), noise, **found)
    said = verdict.sentences
    assert verdict.is_right == any("the model is right" in one for one in said)
    assert sum(one.startswith(words) for one in said) == 1
    assert said[0].startswith("the model is right") == verdict.is_right
    assert len(said) == 1 + bool(found)


@pytest.mark.parametrize(
    ("seed", "fault", "words"),
    [
        slow(205, "", "the model is right"),
        (205, "ellipsoid", "not the sphere"),
        slow(205, "support", "side by side"),
    ],
)
def test_drawn_labs_are_judged_and_the_cause_is_named(seed, fault, words):
    lab = drawn_lab(seed, fault)
    verdict = lab.fit.verdict
    assert words in " ".join(verdict.sentences)
    assert verdict.is_right == (not fault)
    if fault == "ellipsoid":
        assert f"`{lab.ball}`" in verdict.sentences[0]
        assert verdict.cause.ball == lab.ball
        assert verdict.to_dict()["right"] is False
    inside = np.mean(np.abs(lab.error_px) < 2.0 * lab.sigma_px)
    assert inside > 0.8


# Priors that hold one by one and fail together, and labs whose priors are right.


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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_labs_drawn_from_their_priors_raise_no_alarm_more_often_than_stated():
    alarms = sum(map(bool, linear_labs([0.0, -10.0, 10.0], 1000, 1)))
    assert alarms <= 5  # 1 in 1000 expected at most


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
