"""Bodies that the scene does not list, seen in the frame of the target pixel by pixel."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from correction.fit.scene_fit import fit_scene
from correction.fit.seen.unlisted_parts import Compared, View, compare_views
from correction.fit.seen.view_agreement import Shown
from correction.maps.correction_map import build_correction_map
from correction.node_status import NodeStatus
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import Aperture, render
from sim.renderer.sensor import Sensor
from tests.correction.fit.benches import map_error_px, photograph
from tests.correction.fit.rendered_labs import compared, photographed
from tests.slow_cases import slow_but
from tracer.bodies import Body, Rod, Sphere, Tube, Window
from tracer.masked import MaskedPart
from tracer.media import MEDIA, ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.sensitivity import TargetPose

SQUARE_MM = 5.0
BOARD = Chessboard(SQUARE_MM, 0.4 * SQUARE_MM)
LATTICE = [np.array([[-17, -17], [17, 17]])]  # of corners: the board fills the view
BODIES: dict[str, Body] = {
    "bead": Sphere("stray", (6.0, 5.0, 130.0), 2.5, ConstantMedium(1.5)),
    "drop": Sphere("stray", (-8.0, 9.0, 112.0), 2.4, ConstantMedium(1.33)),
    "wire": Rod("stray", (9.0, -70.0, 150.0), (9.0, 70.0, 150.0), 0.8),
    "beside": Sphere("stray", (50.0, -35.0, 60.0), 3.5, ConstantMedium(1.52)),
}


@cache
def lab() -> Scene:
    return misalign(at_size(demo_scene("two_spheres_500"), 504), 6)


@cache
def frame(stray: str) -> np.ndarray:
    bodies = [BODIES[stray]] if stray else []
    return photograph(lab().with_bodies([*lab().bodies, *bodies]), True, 0.0, 17, SQUARE_MM).image


def test_squares_are_as_wide_as_derivatives_of_the_whole_map_say():
    """Rows are computed some at a time: no width differs at their borders."""
    reach = np.full(2, 17 * SQUARE_MM)
    shown = Shown.of(lab(), TargetPose(), BOARD, (-reach, reach))
    plane = shown.rays.plane_mm
    moved = np.stack([np.asarray(np.gradient(plane, axis=axis)) for axis in (0, 1)], axis=-1)
    known = np.isfinite(moved).all(axis=(2, 3))
    widest = np.linalg.svd(moved[known], compute_uv=False)[:, 0]
    np.testing.assert_allclose(shown.width_px[known], SQUARE_MM / widest, rtol=1e-9)
    assert not shown.width_px[~known].any()
    assert (shown.bright == (BOARD.shade(np.nan_to_num(plane)) > 0.5)).all()


def masked_parts(found: Compared) -> tuple[MaskedPart, ...]:
    bodies = [part for one in found.unlisted for part in one.masked]
    return (*bodies, *(one.masked for one in found.misfits))


def masked_by(image: np.ndarray) -> Scene:
    """The scene, which lists no stray body, as it comes out of a fit."""
    parts = compare_views(lab(), [View("glass", image, TargetPose())], BOARD, LATTICE)
    return replace(lab(), masked=masked_parts(parts))


def are_wrong(*given) -> bool:
    found = compare_views(*given)
    return bool(found.unlisted or found.misfits or found.rims)


def nodes_off(scene: Scene, stray: str) -> int:
    """Recovered nodes whose pixel shows another place than the map says, or none."""
    truth = lab().with_bodies([*lab().bodies, BODIES[stray]])
    found = build_correction_map(scene, build_ray_map(scene))
    error = np.linalg.norm(map_error_px(scene, truth, found.pixel[0][found.recovered], found.grid), axis=1)
    return int(np.count_nonzero(~(error < 0.5)))


@pytest.mark.parametrize("stray", slow_but(BODIES, "wire"))
@pytest.mark.slow
def test_a_stray_body_is_masked_and_little_else(stray):
    scene = masked_by(frame(stray))
    assert scene.masked
    assert nodes_off(lab(), stray) > 100
    assert nodes_off(scene, stray) <= 0.03 * nodes_off(lab(), stray)
    left_out = build_correction_map(scene, build_ray_map(scene)).status == NodeStatus.UNLISTED
    assert np.count_nonzero(left_out) < 8 * nodes_off(lab(), stray) + 200


@pytest.mark.parametrize("change", ["none", "blurred", "shaded", "dim and noisy"])
def test_frames_that_show_what_they_should_mask_nothing(change):
    import cv2

    image = frame("").astype(np.float32)
    if change == "blurred":
        image = cv2.GaussianBlur(image, (0, 0), 1.5)
    if change == "shaded":
        v, u = np.mgrid[0:504, 0:504] / 504.0
        image = image * (0.3 + 0.7 * np.cos(1.2 * (u - 0.5)) * (0.4 + 0.6 * v)).astype(np.float32)
    if change == "dim and noisy":
        image = 0.1 * image + np.random.default_rng(3).normal(0.0, 10.0, image.shape).astype(np.float32)
    assert not masked_by(image).masked


def test_what_lies_beyond_the_board_is_not_asked():
    image = frame("").copy()
    image[:, 460:] = image.max()
    assert not are_wrong(lab(), [View("glass", image, TargetPose())], BOARD, [np.array([[-17, -17], [9, 17]])])
    assert masked_by(image).masked


def test_a_board_at_another_height_is_compared_there():
    pose = TargetPose((0.0, 0.0, -10.0))
    image = photograph(lab(), True, -10.0, 5, SQUARE_MM).image
    assert not are_wrong(lab(), [View("glass", image, pose)], BOARD, LATTICE)


def test_squares_of_which_the_fit_does_not_know_which_they_are_say_nothing():
    """A ball 8 mm off in depth shows other squares; whoever knows its place no better cannot call them wrong."""
    image, (low, high) = frame(""), lab().spheres
    off = lab().with_bodies([low, replace(high, centre_mm=(*high.centre_mm[:2], high.centre_mm[2] + 8.0))])
    rate = 3.0  # mm on the board for a change in depth of 8 mm, more than it is anywhere

    def known_to(sigma_mm: float) -> View:
        return View("glass", image, TargetPose(), lambda pixels: np.full_like(pixels, sigma_mm))

    assert are_wrong(off, [known_to(0.01)], BOARD, LATTICE)
    assert not are_wrong(off, [known_to(rate)], BOARD, LATTICE)


def test_a_rim_whose_place_is_not_known_is_no_body_of_its_own():
    low, high = lab().spheres
    x, y, z = high.centre_mm
    off = lab().with_bodies([low, replace(high, centre_mm=(x + 1.5, y - 0.5, z))])
    near = View("glass", frame(""), TargetPose())
    for place_mm, rim_of in (({}, ""), ({high.name: 1.0}, high.name)):
        beside = [part for part in compare_views(off, [near], BOARD, LATTICE, place_mm).unlisted if not part.way]
        assert beside
        assert all(part.rim_of == rim_of for part in beside)
        assert all(part.masked for part in beside)


def right_lab(kind: str, seed: int) -> tuple[Scene, np.ndarray]:
    """A scene as a fit would have it, hundredths of a millimetre off, and the frame of the target."""
    glass, rng = MEDIA["N-BK7"], np.random.default_rng((33, seed))
    nominal = at_size(demo_scene("two_spheres_500"), 504)
    balls, walls = [replace(ball, medium=glass) for ball in nominal.spheres], list[Body]()
    if kind == "window":
        walls = [
            Window("wall", (0.0, 0.0, 170.0), (0.03, -0.02, 1.0), float(rng.uniform(4.0, 15.0)), 120.0, glass)
        ]
    elif kind == "tube":
        walls = [Tube("wall", (0.0, -150.0, 0.0), (0.0, 150.0, 0.0), 50.0, float(rng.uniform(44.0, 47.0)), glass)]
        balls = [
            Sphere(name, (float(rng.uniform(-4.0, 4.0)), y, 20.5), 19.0, glass)
            for name, y in (("low", -20.5), ("high", 20.5))
        ]
    truth = misalign(nominal.with_bodies([*walls, *balls]), seed)
    board = Print(SQUARE_MM, 0.4 * SQUARE_MM)
    frames, aperture, samples = [truth], None, 3
    if kind == "aperture":
        aperture, samples = Aperture(60.0, float(rng.choice([8.0, 11.0, 16.0])), 500.0), 8
    if kind == "coloured light":
        frames = [replace(truth, wavelength_nm=nm) for nm in (480.0, 532.0, 600.0)]
    image = sum(
        render(one, board, Sensor(), samples=samples, seed=seed, aperture=aperture).astype(float) for one in frames
    )
    x, y, z = np.add(truth.camera.position_mm, rng.normal(0.0, 0.03, 3)).tolist()
    return truth.with_camera(replace(truth.camera, position_mm=(x, y, z))), image


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("kind", ["window", "tube", "aperture", "coloured light"])
def test_right_labs_of_other_kinds_mask_nothing(kind):
    for seed in range(5):
        scene, image = right_lab(kind, seed)
        assert not are_wrong(scene, [View("glass", image, TargetPose())], BOARD, LATTICE), seed


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "stray",
    [
        Sphere("bead", (6.0, 5.0, 130.0), 2.0, ConstantMedium(1.5)),
        Sphere("drop", (6.0, 5.0, 110.0), 1.2, ConstantMedium(1.33)),
    ],
    ids=["bead of 4 mm", "drop of 1.2 mm radius"],
)
def test_a_whole_calibration_says_it_and_masks_it(stray):
    nominal = at_size(demo_scene("two_spheres_500"), 1008)
    truth = misalign(nominal, 6)
    shown = truth.with_bodies([*truth.bodies, stray])
    frames = [photograph(truth.bare(), False, 0.0, 600), photograph(shown, True, 0.0, 601)]
    fit = fit_scene(nominal, frames, Chessboard(3.5, 1.4))
    assert not fit.verdict.is_right
    assert "does not list" in fit.verdict.sentences[0]
    scene = fit.measured_scene
    found = build_correction_map(scene, build_ray_map(scene))
    error = np.linalg.norm(map_error_px(scene, shown, found.pixel[0][found.recovered], found.grid), axis=1)
    assert np.count_nonzero(~(error < 0.5)) < 20


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", [71004, 71010, 71012])
def test_strangers_right_labs_mask_nothing_where_a_ball_shows_squares_many_times_as_large(seed):
    lab = compared(photographed("stranger", seed))
    assert not lab.fit.verdict.unlisted
    assert lab.off < 0.003
