"""Plates with two levels fit scenes, say from where a frame was taken, and are refused if told wrong."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy

from correction.errors import FitFailed
from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.fit.solve.solver import Corners, land_corners, residuals
from correction.fit.solve.unknowns import unknowns_of
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.patterns import DotGrid, Plate
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.target import photographed_plates
from tests.slow_cases import slow
from tracer.board import LARGE_DOTS, Dots
from tracer.camera import Camera, Lens, look_at
from tracer.scene.fit_section import FitCameraTable, FitTable
from tracer.scene.scene import Scene

PITCH_MM, STEP_MM = 5.0, 1.2
SIGMA = {"scale_sigma": (1e-4, 1e-4), "step_sigma_mm": 0.01}


@dataclass(frozen=True)
class PlateAside(Plate):
    """A plate whose grooves stand aside of their places [mm], as well as its maker knows."""

    aside_mm: tuple[float, float] = (0.0, 0.0)

    def shade(self, face_mm, ground_mm):
        return super().shade(face_mm, ground_mm - self.aside_mm)


def plate(levels, step_mm=STEP_MM, pitch_mm=PITCH_MM, bright=True):
    """A board that is described, and the real thing; a grid on one level for no levels."""
    words = {"discs": LARGE_DOTS, "dots": Dots(0.4 * pitch_mm, bright, levels, step_mm if levels else 0.0)}
    board = Chessboard(pitch_mm, 0.65 * pitch_mm, **words, **SIGMA if levels else {})
    return board, (Plate if levels else DotGrid)(pitch_mm, 0.65 * pitch_mm, **words)


def bare(paper, size_px=360):
    """A nominal camera, and a frame of the bare target by one that stands a little elsewhere."""
    nominal = at_size(demo_scene("two_spheres_500"), size_px)
    scene = misalign(nominal, 3).with_bodies(())
    return nominal.with_bodies(()), [
        TargetFrame("clear", render(scene, paper, Sensor(), samples=4, seed=1), False)
    ]


@pytest.mark.parametrize("levels", ["rows", "alternating"])
def test_marks_of_a_level_land_where_its_plane_is(levels):
    """By a ray from the pixel through the world, without any plane but that of its own level."""
    board, _ = plate(levels, 2.0)
    scene = misalign(at_size(demo_scene("two_spheres_500"), 504), 4).with_bodies(())
    bench = unknowns_of(scene, [0.0], FitTable(), print_sigma=board.print_sigma)
    index = np.stack(np.meshgrid(np.arange(-4, 5), np.arange(-4, 5)), axis=-1).reshape(-1, 2)
    pixel = scene.camera.project(board.place_mm(index))
    full = bench.start.copy()
    corners = Corners(0, True, pixel, board.corner_mm(index), 1.0, board.depth_mm(index))
    assert np.abs(land_corners(bench, full, corners).point_mm - board.corner_mm(index)).max() < 1e-9
    full[bench.full_names.index("print.step")] = 0.1
    deeper = scene.camera.project(board.stretch((1.0, 1.0, 1.1)).place_mm(index))
    moved = replace(corners, pixel=deeper)
    assert np.abs(land_corners(bench, full, moved).point_mm - board.corner_mm(index)).max() < 1e-9


@pytest.mark.parametrize("step_mm", [2.0, -2.0])  # the lower level is the other one, or that of the origin
def test_marks_of_the_lower_level_are_expected_aside_as_far_as_they_stand_and_residuals_follow(step_mm):
    board, _ = plate("rows", step_mm)
    scene = misalign(at_size(demo_scene("two_spheres_500"), 504), 4).with_bodies(())
    known = (*board.print_sigma, 0.02, 0.02, 1e-3)
    bench = unknowns_of(scene, [0.0], FitTable(), print_sigma=known).only(("print.",))
    bench = replace(bench, origin_is_deep=step_mm < 0.0)
    index = np.stack(np.meshgrid(np.arange(-4, 5), np.arange(-4, 5)), axis=-1).reshape(-1, 2)
    deep, aside = (board.depth_mm(index) != 0.0) == (step_mm > 0.0), np.array((0.03, -0.05, 0.0))
    place = board.place_mm(index)
    pixel = scene.camera.project(place + deep[:, None] * (aside + 5e-4 * place * (1.0, 1.0, 0.0)))
    corners = Corners(0, True, pixel, board.corner_mm(index), np.eye(2)[None].repeat(81, 0), board.depth_mm(index))
    x = np.array((0.0, 0.0, 0.0, 1.5, -2.5, 0.5))
    part = residuals(bench, x, corners)
    assert np.abs(part.value).max() < 1e-9
    before = residuals(bench, 0.0 * x, corners).value
    assert np.abs(before + part.rate @ x).max() < 1e-3 * np.abs(before).max()
    assert np.abs(before[~deep]).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shown", "told", "words"),
    [
        (("rows", 1.2), ("rows", 1.0), "by rows, .* 1.20. mm behind .* step_mm: 1; say"),
        slow(("rows", 1.2), ("columns", 1.2), "by rows, .* levels: columns"),
        slow(("alternating", 1.2), ("rows", 1.2), "by alternating, .* levels: rows"),
        slow(("columns", -0.8), ("columns", 0.8), "by columns, .* -0.(80|79[5-9])\\d* mm behind"),
        slow(("rows", 1.2), ("", 0.0), "by rows, .* nothing of levels"),
        slow(("", 0.0), ("rows", 1.2), "all dots on one level"),
    ],
)
def test_levels_that_are_told_wrong_are_refused_and_named(shown, told, words):
    nominal, frames = bare(plate(*shown)[1])
    with pytest.raises(FitFailed, match=words):
        fit_scene(nominal, frames, plate(*told)[0])


def test_a_plate_told_right_fits_and_says_its_step():
    board, paper = plate("rows")
    nominal, frames = bare(paper)
    fit = fit_scene(nominal, frames, replace(board, dots=replace(board.dots, step_mm=1.19)))
    step = fit.board.dots.step_mm
    sigma = 1.19 * fit.sigmas[fit.names.index("print.step")]
    assert sigma < 0.005  # told to 0.01
    assert abs(step - STEP_MM) < 4.0 * sigma


FREE = FitCameraTable(position_mm=20.0, rotation_deg=3.0, focal_px=100.0, principal_px=30.0)
SENSOR_PX, FOCAL_PX, AWAY_MM = (640, 512), 3200.0, 300.0
NUMBERS = ("x", "y", "z", "focal_px", "cu", "cv")


def camera_at(position, rotation, focal_px, principal_px):
    return Camera(focal_px, principal_px, SENSOR_PX, position, rotation, Lens())


def of_one_frame(degrees, levels, seed, step_sigma_mm=SIGMA["step_sigma_mm"]):
    """Errors (6,) of a camera found from one bare frame, by a lens that nobody knows, and their sigmas (6,)."""
    rng, middle = np.random.default_rng((seed, 9)), tuple(0.5 * (side - 1) for side in SENSOR_PX)
    slant = np.deg2rad(degrees)
    told = AWAY_MM * np.array((0.8 * np.sin(slant), 0.6 * np.sin(slant), np.cos(slant)))
    nominal = camera_at(tuple(told.tolist()), look_at(tuple(told), (0.0, 0.0, 0.0), 0.05), FOCAL_PX, middle)
    place = told + rng.normal(0.0, 4.0, 3)
    aim = (*rng.normal(0.0, 2.0, 2).tolist(), 0.0)
    focal, principal = FOCAL_PX + rng.normal(0.0, 40.0), np.array(middle) + rng.normal(0.0, 12.0, 2)
    rotation = look_at(tuple(place.tolist()), aim, 0.05 + 0.02 * rng.normal())
    true = camera_at(tuple(place.tolist()), rotation, float(focal), tuple(principal.tolist()))
    board, paper = plate(levels, 1.0, 3.5)
    scale = tuple((1.0 + SIGMA["scale_sigma"][0] * rng.normal(size=2)).tolist())
    dots = paper.dots
    if levels:
        dots = replace(dots, step_mm=dots.step_mm + step_sigma_mm * rng.normal())
        paper = PlateAside(**vars(paper), aside_mm=tuple((step_sigma_mm * rng.normal(size=2)).tolist()))
    image = render(Scene(true, ()), replace(paper, dots=dots, scale=scale), Sensor(), samples=4, seed=seed)
    board = replace(board, scale_sigma=SIGMA["scale_sigma"], step_sigma_mm=step_sigma_mm if levels else 0.0)
    fit = fit_scene(Scene(nominal, ()), [TargetFrame("clear", image, False)], board, FitTable(camera=FREE))
    found, rows = fit.scene.camera, [fit.unknowns.full_names.index(f"camera.{name}") for name in NUMBERS]
    sigma = np.sqrt(np.sum(fit.root[rows] ** 2, axis=1))
    error = [*np.subtract(found.position_mm, place), found.focal_px - focal]
    return np.array((*error, *np.subtract(found.principal_px, principal))), sigma


@pytest.mark.slow
def test_one_frame_of_a_plate_says_from_where_it_was_taken_as_well_as_its_sigma_says():
    for degrees in (25.0, 0.0):
        error, sigma = np.swapaxes([of_one_frame(degrees, "rows", seed) for seed in range(10, 30)], 0, 1)
        assert 0.6 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.5
        assert np.abs(error / sigma).max() < 4.0


@pytest.mark.slow
def test_a_plate_seen_straight_on_says_what_a_flat_board_leaves_to_the_lens():
    """Distance and principal axis: with one level they move with focal length and turn, and no frame tells."""
    _, flat = of_one_frame(0.0, "", 0)
    _, levels = of_one_frame(0.0, "rows", 0)
    _, exact = of_one_frame(0.0, "rows", 0, step_sigma_mm=5e-4)  # 0.01 mm aside look like a turn of 0.6 degrees
    names = {name: n for n, name in enumerate(NUMBERS)}
    for name, sigma in (("z", levels), ("focal_px", levels), ("cu", exact), ("cv", exact)):
        assert sigma[names[name]] < 0.5 * flat[names[name]], name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "aside_mm", "step_sigma_mm"),
    [
        (402, 0.144, 0.01),
        (402, 0.144, 0.3),
        (406, 0.009, 0.01),
        (408, 0.044, 0.3),
        (412, 0.064, 0.01),
        (444, 0.0, 0.3),
    ],
)
def test_shadows_that_shift_a_whole_level_leave_the_camera_where_it_is(seed, aside_mm, step_sigma_mm, monkeypatch):
    view_at = photographed_plates.view_at
    monkeypatch.setattr(photographed_plates, "STYLES", ("plain",) * 7)
    monkeypatch.setattr(photographed_plates, "view_at", lambda *words: view_at(*words[:-1], 0.0))  # no lens
    image, made, view, _ = photographed_plates.photograph(seed, bright_dots=False)
    rng, size = np.random.default_rng(seed), image.shape[::-1]
    turn = scipy.spatial.transform.Rotation.from_rotvec(rng.normal(0.0, 0.005, 3)).as_matrix()
    place = tuple((view.place_mm + rng.normal(0.0, 4.0, 3)).tolist())
    rotation, middle = tuple(map(tuple, (view.axes @ turn).tolist())), tuple(view.middle_px.tolist())
    nominal = Camera(view.focal_px, middle, size, place, rotation, Lens())
    known = FitTable(camera=FitCameraTable(position_mm=20.0, rotation_deg=3.0))
    board = replace(made.board, step_sigma_mm=step_sigma_mm)
    fit = fit_scene(Scene(nominal, ()), [TargetFrame("clear", image, False)], board, known)
    numbers = ("camera.x", "camera.y", "camera.z", "print.step", "print.aside_y")
    rows = [fit.unknowns.full_names.index(name) for name in numbers]
    found, sigma = fit.unknowns.full(fit.x)[rows], np.sqrt(np.sum(fit.root[rows] ** 2, axis=1))
    assert np.abs((found[:4] - (*view.place_mm, 0.0)) / sigma[:4]).max() < 4.0
    assert found[4] == pytest.approx(aside_mm, abs=0.01)  # of the shadow
