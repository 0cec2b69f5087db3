"""Of all that may be wrong, what explains the frames is named, and not an innocent number that took it up."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from correction.errors import FitFailed
from correction.fit import adjustment, camera_stage
from correction.fit.adjustment import Adjustment
from correction.fit.camera_stage import cause_on_bare, find_camera, turn_scene
from correction.fit.judge.hypotheses import ErrorHypothesis, starts_of_refit
from correction.fit.judge.result import SceneFit, check
from correction.fit.judge.verdict import Verdict
from correction.fit.judge.weakness import weaknesses
from correction.fit.progress import Progress
from correction.fit.seen import prediction
from correction.fit.seen.measurement import TargetFrame
from correction.fit.solve import considered as doubts
from correction.fit.solve.considered import ORDINARY, ORDINARY_N, with_considered
from correction.fit.solve.linear_change import as_linear
from correction.fit.solve.moved_board import motion_as_board
from correction.fit.solve.solver import Corners, free_rates, land_corners, residuals
from correction.fit.solve.unknowns import unknowns_of
from correction.grid import PlaneGrid, grid_of
from correction.maps.correction_map import build_correction_map
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene, misalign
from tests.correction.fit.drawn_labs import BOARD, drawn_lab, map_error, photographed
from tests.correction.fit.drawn_optics import Ball, Lab
from tests.correction.fit.faulty_labs import right
from tests.correction.fit.strangers import stranger
from tests.slow_cases import slow
from tracer.media import ConstantMedium
from tracer.scene.fit_section import FitCameraTable, FitNamedTable, FitTable
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map

CLOSE = FitTable(camera=FitCameraTable(position_mm=0.5))  # measured, so that a camera cannot hide a lens


def lens_aside(seed: int, decentred_mm: float, turn: float = 0.0) -> tuple[Scene, Scene]:
    """Nominal scene, and the true one, whose lens is off its axis by so much, in a direction of the seed."""
    rng = np.random.default_rng((36, seed))
    nominal = at_size(demo_scene("two_spheres_500"), 504)
    truth = misalign(nominal, 600 + seed)
    way = rng.uniform(0.0, 2.0 * np.pi)
    aside = decentred_mm / 0.044 * np.array([np.cos(way), np.sin(way)])  # px of 44 um
    p1, p2 = (1e-3 * decentred_mm * rng.normal(size=2)).tolist()
    middle = (truth.camera.principal_px[0] + aside[0], truth.camera.principal_px[1] + aside[1])
    lens = replace(truth.camera.lens, k1=float(rng.uniform(-0.3, 0.3)), p1=p1, p2=p2)
    camera = replace(truth.camera, principal_px=middle, lens=lens)
    return nominal, truth.with_camera(
        turn_scene(truth.with_camera(camera), _about(turn)).camera if turn else camera
    )


def bare_stage(seed: int, decentred_mm: float, turn: float = 0.0) -> Progress:
    """A fit whose camera is to be found from drawn corners of a bare board, of a lens off its axis."""
    nominal, truth = lens_aside(seed, decentred_mm, turn)
    bare = truth.with_bodies(())
    corners = photographed(
        bare, Lab(bare.camera, ()), Chessboard(7.0, 2.8), False, 0.006, 0.0, np.random.default_rng((36, seed, 1))
    )
    image = np.arange(16, dtype=np.uint16).reshape(4, 4)
    frames = [TargetFrame("bare", image, False), TargetFrame("glass", image, True)]
    work = Progress(nominal, frames, BOARD, CLOSE, lambda text: None)
    with pytest.MonkeyPatch.context() as context:
        context.setattr(camera_stage, "bare_frame", lambda frame, board, *asked: (corners, board))
        find_camera(work)
    return work


def refusal(seed: int, decentred_mm: float) -> str:
    """What the camera's stage of a fit refuses such a lens with; empty if it passes."""
    try:
        bare_stage(seed, decentred_mm)
    except FitFailed as failed:
        return str(failed)
    return ""


def _about(turn: float) -> np.ndarray:
    return Rotation.from_rotvec([0.05, 0.0, turn]).as_matrix()


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 40))])
def test_a_lens_off_its_axis_is_named_and_not_the_camera_that_stands_where_it_was_told(seed):
    if refused := refusal(seed, 0.7):
        assert re.search(r"lens is off its axis.*principal_px", refused)
        assert "camera.cu" in refused or "camera.cv" in refused
        assert "check square_mm" not in refused
        return
    # The camera takes most of it up and stays within its tolerance; then the whole fit must name the lens.
    lab = drawn_lab(seed, noise_px=0.006, draw=lambda rng, _: (*lens_aside(seed, 0.7), BOARD))
    first = lab.fit.verdict.sentences[0]
    assert not lab.fit.verdict.is_right
    assert re.search(r"a lens term is missing|camera\.c[uv] was held", first), first
    assert np.sqrt(np.mean((lab.error_px / lab.sigma_px) ** 2)) < 2.0


def test_a_board_that_hangs_askew_is_followed_and_no_lens_is_blamed():
    work = bare_stage(9, 0.0, turn=0.3)
    assert any("leans" in str(step) for step in work.history)


def test_a_right_camera_names_nothing():
    work = bare_stage(10, 0.0)
    assert not cause_on_bare(work)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("known", "words"),
    [
        (0.0, "sphere1.n was held at 1.63 and seems to be off by -0.01 "),
        slow(2e-4, "glass sphere1.n was given as 1.63 +- 0.0002 and seems to be off by -0.0"),
    ],
)
def test_a_flint_ball_whose_index_is_held_wrong_is_named_and_not_the_radius_that_took_it_up(known, words):
    rng = np.random.default_rng((35, 1))
    named = at_size(demo_scene("two_spheres_500"), 1008)
    true, told = (
        named.with_bodies([replace(b, medium=ConstantMedium(n)) for b, n in zip(named.spheres, each, strict=True)])
        for each in ((1.62, 1.515), (1.63, 1.515))
    )
    truth = misalign(true, 501)
    balls = tuple(Ball(s.centre_mm, s.radius_mm, s.medium.n(truth.wavelength_nm)) for s in truth.spheres)
    frames = []
    for glass in (False, True):
        scene = truth if glass else truth.with_bodies(())
        frames.append(photographed(scene, Lab(truth.camera, balls * glass), BOARD, glass, 0.006, 0.01, rng))
    bench = unknowns_of(told, [0.0], FitTable(n=known))
    fit = Adjustment().estimate(bench, bench.start, frames, ())
    assert np.abs(fit.x).max() > 5.0  # the radius of an innocent ball, or the index
    assert "sphere1" in fit.verdict.cause.ball
    assert words in fit.verdict.cause.sentence
    with pytest.raises(FitFailed, match=re.escape(words)):
        check(fit)


def test_where_no_cause_is_named_all_that_may_be_reach_sigma_as_far_as_they_are_likely():
    changes = np.arange(1.0, 7.0).reshape(2, 3, 1)
    rivals = tuple(
        ErrorHypothesis("", "", 5.0, share, one) for share, one in zip((0.36, 0.25), changes, strict=True)
    )
    verdict = Verdict((), {}, (*rivals, ErrorHypothesis("s0", "", 4.0, 0.2, None)), np.zeros((0, 2)))
    assert verdict.cause is None
    np.testing.assert_allclose(verdict.changes, (0.6 * changes[0], 0.5 * changes[1]))
    alone = replace(verdict, suspects=(replace(rivals[0], share=0.9), rivals[1]))
    np.testing.assert_allclose(alone.changes, changes[:1])
    assert alone.is_right
    assert len(alone.sentences) == len(verdict.sentences) + 1  # what is counted is said


def test_a_cause_is_refitted_from_the_priors_too_where_a_fit_has_left_them():
    unknowns = unknowns_of(demo_scene("two_spheres_500"), [0.0], FitTable())
    near = np.full(len(unknowns.names), 0.5)
    assert len(starts_of_refit(unknowns, near)) == 1
    far = near.copy()
    far[unknowns.names.index("sphere1.radius")] = 17.0
    stands, anew = starts_of_refit(unknowns, far)
    of_camera = [name.startswith(("camera", "target", "print")) for name in unknowns.names]
    np.testing.assert_array_equal(stands, far)
    np.testing.assert_array_equal(anew, np.where(of_camera, 0.5, 0.0))


# Changes between bare frames and those with glass: named, and in sigma.


Chi = dict[bool, float]


def lab_of(scene: Scene) -> Lab:
    room = scene.n_ambient
    balls = [
        Ball(s.centre_mm, s.radius_mm, s.medium.n(scene.wavelength_nm) / room) for s in scene.spheres if s.medium
    ]
    return Lab(scene.camera, tuple(balls))


def fitted(seed: int, since: Scene | None = None, truth: Scene | None = None) -> tuple[SceneFit, Chi]:
    """Fit corners of a lab that was otherwise since the bare frames, and how large errors are in sigmas.

    The truth is as it has been since, unless it is given.
    """
    case, rng = right(seed), np.random.default_rng((58, seed))
    since, square = since or case.bare, case.board.square_mm
    truth = truth or since
    board, frames = Chessboard(square, 0.4 * square), []
    for glass, scene in ((False, case.bare.bare()), (True, since)):
        frames.append(photographed(scene, lab_of(scene), board, glass, 0.01, 0.01, rng))
    bench = unknowns_of(case.given, [0.0], FitTable())
    fit = Adjustment().estimate(bench, bench.start, frames, ())
    chi = {}
    for behind in (False, True):
        _, error, sigma = map_error(fit, truth, lab_of(truth), rng, behind)
        chi[behind] = float(np.sqrt(np.mean((error / sigma) ** 2)))
    return fit, chi


def test_camera_and_glass_that_move_against_a_board_are_a_board_that_moves_against_them():
    case = right(3)
    unknowns = unknowns_of(case.given, [0.0], FitTable())
    every = replace(unknowns, names=unknowns.full_names, columns=np.eye(len(unknowns.start)))
    pixels = np.random.default_rng(1).uniform(100.0, 400.0, (200, 2))
    part = residuals(every, np.zeros(len(unknowns.start)), Corners(0, True, pixels, np.zeros_like(pixels), 1.0))
    rate = part.rate[np.isfinite(part.rate).all(axis=(1, 2))]
    both = rate @ motion_as_board(unknowns, unknowns.start) + rate[:, :, unknowns.place(0)]
    assert len(rate) > 100
    np.testing.assert_allclose(both, 0.0, atol=1e-6 * float(np.abs(rate).max()))


@pytest.mark.parametrize("seed", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in range(2, 6))])
def test_a_camera_that_moved_between_frames_is_named_and_in_sigma(seed):
    camera = right(seed).bare.camera
    x, y, z = camera.position_mm
    moved = replace(camera, position_mm=(x + 0.03, y - 0.02, z))
    fit, chi = fitted(seed, right(seed).bare.with_camera(moved))
    assert "camera seem to have moved" in fit.verdict.sentences[0]
    assert 0.8 < chi[False] < 1.25
    assert chi[True] < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in range(2, 6))])
def test_a_lens_that_was_focused_between_frames_is_named_and_in_sigma(seed):
    camera = right(seed).bare.camera
    fit, chi = fitted(seed, right(seed).bare.with_camera(replace(camera, focal_px=1.001 * camera.focal_px)))
    assert "focused or zoomed" in fit.verdict.sentences[0]
    assert 0.8 < chi[False] < 1.25
    assert chi[True] < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 6))
def test_a_board_that_moved_between_frames_is_named_and_in_sigma(seed):
    """Seen from a board that moved, camera and balls have moved the other way; the world has not."""
    truth, by = right(seed).bare, np.array((-0.03, 0.02, 0.0))
    at = (np.array(truth.camera.position_mm) + by).tolist()
    balls = [replace(ball, centre_mm=tuple((np.array(ball.centre_mm) + by).tolist())) for ball in truth.spheres]
    moved = truth.with_camera(replace(truth.camera, position_mm=tuple(at))).with_bodies(balls)
    fit, chi = fitted(seed, moved, truth)
    assert "board or camera seem to have moved" in fit.verdict.sentences[0]
    assert max(chi.values()) < 1.25


def test_a_right_lab_names_nothing():
    fit, chi = fitted(1)
    assert fit.verdict.is_right
    assert max(chi.values()) < 2.0


# The difference of two scenes as one change: derivatives of the map say with it what the two maps differ by.


LIFTED_MM = 1.6
OF_A_DIFFERENCE = 0.02  # how exactly derivatives can say it, at nine nodes of ten


@pytest.mark.parametrize("name", ["pair_off_axis", "two_spheres_500", "three_spheres_500"])
@pytest.mark.parametrize("seed", [1, 2])
def test_derivatives_say_the_difference_where_the_map_shows_anything(name, seed):
    """A lifted ball: pixels at its rim, where derivatives say hundreds of px, must not have the say everywhere."""
    scene = misalign(at_size(demo_scene(name), 1008), seed)
    unknowns = unknowns_of(scene, [0.0], FitTable())
    full = unknowns.start
    other = full.copy()
    other[unknowns.full_names.index(f"{scene.spheres[-1].name}.z")] += LIFTED_MM
    grid = grid_of(scene.camera)
    coarse = PlaneGrid(grid.origin_mm, 8 * grid.pitch_mm, (grid.shape[0] // 8, grid.shape[1] // 8))
    shown = build_correction_map(scene, build_ray_map(scene), coarse, min_magnification=4.0, max_magnification=128)
    pixels = shown.pixel[0][shown.behind_glass].astype(float)
    asked = Corners(0, True, pixels, np.zeros_like(pixels), 1.0)
    before, after = land_corners(unknowns, full, asked), land_corners(unknowns, other, asked)
    same = before.recovered & after.recovered & (before.key == after.key)
    truly = (after.point_mm - before.point_mm)[same]
    every = replace(unknowns, columns=np.eye(len(full)), names=unknowns.full_names)
    added, (_, unsaid_px) = as_linear(unknowns, full, other, unknowns.columns)
    change = other - full + added
    said = free_rates(every, full, asked, before)[same] @ change
    size = np.linalg.norm(truly, axis=1)
    off = np.linalg.norm(said - truly, axis=1) / (size + np.median(size))
    print(f"\n{name}: {np.median(size) / grid.pitch_mm:.2f} px, off {np.quantile(off, [0.5, 0.9])}")
    assert np.count_nonzero(same) > 100
    assert np.quantile(off, 0.9) < OF_A_DIFFERENCE
    left = np.linalg.solve(before.pixel_rate[same], (said - truly)[:, :, None])[:, :, 0]
    assert 0.3 < np.sqrt(np.median(np.sum(left**2, axis=1)) / 1.386) / unsaid_px < 3.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "fault"), [(131016, "ball off"), pytest.param(101014, "ellipsoid", marks=pytest.mark.slow)]
)
def test_sigma_of_a_named_fault_is_the_error_at_every_node(seed, fault):
    """Sigma was 0.02 px where the map was 1.15 px off along x, and 0.001 px where it was 0.05 px off along y."""
    lab = drawn_lab(seed, fault, pulled=float(np.random.default_rng((18, seed)).normal()))
    assert fault == "ellipsoid" or "does not stand where it was held" in lab.fit.verdict.sentences[0]
    chi = np.abs(lab.error_px / lab.sigma_px)
    assert 0.7 < np.sqrt(np.mean(chi**2)) < 1.3
    assert chi.max() < 4.0


# Numbers that the fit section holds: the map's sigma counts them, and a wrong one is named.


SCENE = at_size(demo_scene("two_spheres_500"), 700)


def test_what_is_free_or_has_a_sigma_is_not_doubted_again():
    assert (
        with_considered(unknowns_of(SCENE, [0.0], FitTable())).names == unknowns_of(SCENE, [0.0], FitTable()).names
    )
    measured = unknowns_of(SCENE, [0.0], FitTable(n=1e-6))
    assert with_considered(measured).names == measured.names


def test_what_is_held_is_doubted_by_its_ordinary_size_and_one_glass_has_one_index():
    held = unknowns_of(SCENE, [0.0], FitTable(n=0.0, named={"sphere1": FitNamedTable(centre_mm=0.0)}))
    wide = with_considered(held)
    glass = next(name for name in wide.names if name.startswith("glass "))
    assert wide.names[len(held.names) :] == ("sphere1.x", "sphere1.y", "sphere1.z", glass)
    np.testing.assert_allclose(wide.sigma[len(held.names) :], [*[ORDINARY["z"]] * 3, ORDINARY_N])
    moved = wide.full_names, np.flatnonzero(wide.columns[:, -1])
    assert [moved[0][at] for at in moved[1]] == ["sphere1.n", "sphere2.n"]


@pytest.mark.slow
def test_the_sigma_of_the_map_holds_an_index_that_was_held_wrong_and_says_that_it_was_held(monkeypatch):
    def largest() -> float:
        lab = drawn_lab(20086, "index", size=1e-3)
        assert any("held, but how well known is not said" in weak.sentence for weak in weaknesses(lab.fit))
        return float(np.sqrt(np.mean((lab.error_px / lab.sigma_px) ** 2)))

    assert largest() < 1.5
    # What else is doubted would take the index over: pulled corners, and shapes.
    monkeypatch.setattr(prediction, "PULLED", 0.0)
    for module in (adjustment, doubts):
        monkeypatch.setattr(module, "shapes_to_consider", lambda unknowns: ())
    monkeypatch.setattr(adjustment, "with_considered", lambda unknowns: unknowns)
    assert largest() > 2.5


@pytest.mark.slow
def test_a_lab_known_along_one_way_and_not_at_all_along_another_is_judged_as_well():
    """Its covariance spans seventeen orders: the smallest eigenvalues are rounding, of either sign."""
    lab = drawn_lab(131009, "ball off")
    assert np.isfinite(lab.sigma_px).all()
    assert np.mean(np.abs(lab.error_px) < 2.0 * lab.sigma_px) > 0.8


@pytest.mark.slow
def test_a_held_ball_that_shows_no_corner_is_as_unsure_as_one_that_is_free():
    """It stands 1.6 mm off, and nothing in the frames says so: its map must, behind it."""
    lab = drawn_lab(57009, "ball off", draw=stranger)
    assert lab.cost_px > 1.0
    assert not any(lab.ball in way for way in lab.fit.expected)
    assert np.mean(np.abs(lab.error_px) < 2.0 * lab.sigma_px) > 0.95
    said = [weak.sentence for weak in weaknesses(lab.fit) if "no corner is seen through" in weak.sentence]
    assert lab.ball in said[0].partition(":")[0]
