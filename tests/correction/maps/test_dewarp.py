import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile

from correction.errors import DewarpError
from correction.maps.dewarp import Dewarp, coverage, fit_dewarp, fit_dewarp_pairs, powers
from correction.target import Chessboard
from piv.errors import FrameError
from sim.renderer.patterns import DotGrid, Plate
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.frame_truth import FRAMES, true_projection
from tests.correction.synthetic_board import photographed, soft_board
from tests.correction.target.drawn_boards import camera
from tests.slow_cases import slow
from tracer.board import LARGE_DOTS, Dots
from tracer.camera import Camera, Lens, look_at, thin_lens_distance_mm
from tracer.scene.scene import Scene

SENSOR = (800, 600)


def lattice(step=20.0, sensor=SENSOR):
    u, v = np.meshgrid(np.arange(2.0, sensor[0], step), np.arange(2.0, sensor[1], step))
    return np.stack((u.ravel(), v.ravel()), -1)


def bent(points, size):
    """A full polynomial of degree `size` with every term present, of a few pixels."""
    x, y = (points[..., 0] - 390) / 400, (points[..., 1] - 310) / 400
    u, v = (
        3.0 + 1.01 * points[..., 0] - 0.02 * points[..., 1],
        -2.0 + 0.015 * points[..., 0] + 0.99 * points[..., 1],
    )
    for total in range(2, size + 1):
        for m in range(total + 1):
            u = u + (1.0 + m) / total * x ** (total - m) * y**m
            v = v - (2.0 - m) / total * x ** (total - m) * y**m
    return np.stack((u, v), -1)


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_a_polynomial_of_the_order_is_reproduced(order):
    ideal = lattice()
    fitted = fit_dewarp_pairs(ideal, bent(ideal, order), SENSOR, order, spacing_px=20.0)
    probe = np.random.default_rng(1).uniform(0, 1, (7, 5, 2)) * (SENSOR[0] - 1, SENSOR[1] - 1)
    assert np.abs(fitted.apply(probe) - bent(probe, order)).max() < 1e-9
    assert fitted.residual_max_px < 1e-9
    assert fitted.condition < 200  # in pixels it would be 1e7 to 1e14
    assert fitted.left_out == 0


def test_jacobian_agrees_with_differences_and_nan_stays_nan():
    ideal = lattice()
    fitted = fit_dewarp_pairs(ideal, bent(ideal, 3), SENSOR, 3, spacing_px=20.0)
    probe = np.random.default_rng(2).uniform(0, 600, (4, 6, 2))
    for k, step in enumerate(np.eye(2) * 1e-3):
        slope = (fitted.apply(probe + step) - fitted.apply(probe - step)) / 2e-3
        assert np.abs(fitted.jacobian(probe)[..., k] - slope).max() < 1e-7
    probe[1, 2] = np.nan
    assert np.isnan(fitted.apply(probe)[1, 2]).all()
    assert np.isfinite(fitted.apply(probe)).sum() == probe.size - 2


def test_gross_errors_are_left_out_and_misfit_is_not():
    ideal = lattice()
    acquired = bent(ideal, 3) + np.random.default_rng(3).normal(0, 0.02, ideal.shape)
    wrong = np.arange(5, len(ideal), 97)
    acquired[wrong] += (20.0, -7.0)
    fitted = fit_dewarp_pairs(ideal, acquired, SENSOR, 3, spacing_px=20.0)
    assert fitted.left_out == len(wrong)
    assert np.abs(fitted.apply(ideal) - bent(ideal, 3)).max() < 0.02
    low = fit_dewarp_pairs(ideal, bent(ideal, 5), SENSOR, 2, spacing_px=20.0)
    assert low.left_out == 0
    assert low.residual_rms_px > 0.1


def test_weights_follow_sigma():
    ideal = lattice()
    rng = np.random.default_rng(4)
    sigma = np.where(rng.uniform(size=ideal.shape) < 0.5, 0.02, 0.06)
    errors = {"weighted": [], "plain": []}
    for _ in range(20):
        acquired = bent(ideal, 2) + rng.normal(size=ideal.shape) * sigma
        for name, weights in (("weighted", sigma), ("plain", None)):
            fitted = fit_dewarp_pairs(ideal, acquired, SENSOR, 2, weights, 20.0)
            errors[name].append(fitted.apply(ideal) - bent(ideal, 2))
    assert np.std(errors["weighted"]) < 0.8 * np.std(errors["plain"])


def test_coverage_counts_the_frame_between_the_points():
    square = np.array([(0, 0), (399.5, 0), (399.5, 599), (0, 599)], float)
    assert coverage(square, SENSOR) == pytest.approx(0.5, abs=0.01)
    assert coverage(square + 1e-9, (400, 600), 1.0) == pytest.approx(1.0, abs=1e-9)
    assert coverage(np.zeros((20, 2)), SENSOR) == 0.0


def test_what_cannot_be_fitted_is_refused_with_the_cure():
    ideal = lattice()
    half = ideal[ideal[:, 0] < 500]
    with pytest.raises(DewarpError, match=r"cover 6\d\.\d % .* fills the frame"):
        fit_dewarp_pairs(half, half, SENSOR, 2, spacing_px=20.0)
    with pytest.raises(DewarpError, match="at least 20 pairs"):
        fit_dewarp_pairs(ideal[:19], ideal[:19], SENSOR, 3)
    with pytest.raises(DewarpError, match="2, 3, 4 or 5"):
        fit_dewarp_pairs(ideal, ideal, SENSOR, 6)
    frame = np.array([(0, 0), (799, 0), (799, 599), (0, 599)], float)
    with pytest.raises(DewarpError, match="few spots"):
        fit_dewarp_pairs(np.repeat(frame, 9, axis=0), np.repeat(frame, 9, axis=0), SENSOR, 2)


def test_round_trip_through_json_gives_the_same_numbers():
    ideal = lattice()
    fitted = fit_dewarp_pairs(ideal, bent(ideal, 3), SENSOR, 3, spacing_px=20.0)
    assert Dewarp.from_dict(json.loads(json.dumps(fitted.to_dict()))) == fitted
    assert "order 3" in fitted.summary()


@pytest.mark.parametrize(
    "change",
    [
        {"order": 7},
        {"scale_px": 0.0},
        {"scale_px": "wide"},
        {"centre_px": [1.0]},
        {"coefficients": [[0.0, 1.0]]},
        {"coefficients": [[0.0, float("nan")]] * 6},
        {"coefficients": None},
        {"extra": 1},
    ],
)
def test_broken_stored_dewarps_are_refused(change):
    ideal = lattice()
    stored = fit_dewarp_pairs(ideal, bent(ideal, 2), SENSOR, 2, spacing_px=20.0).to_dict()
    with pytest.raises(DewarpError):
        Dewarp.from_dict(stored | change)
    with pytest.raises(DewarpError):
        Dewarp.from_dict({key: value for key, value in stored.items() if key != "order"})


def test_powers_are_complete():
    assert len(powers(2)) == 6
    assert set(powers(3)) == {(k, m) for k in range(4) for m in range(4) if k + m <= 3}


def nominal(scene):
    distance, focal = {"one_sphere": (250.0, 35.0), "two_spheres": (500.0, 60.0)}[scene]
    place = (0.0, 0.0, distance)
    scale = thin_lens_distance_mm(focal, distance) / 0.011
    return Camera(scale, (1007.5, 1007.5), (2016, 2016), place, look_at(place, (0.0, 0.0, 0.0)))


@pytest.mark.slow
def test_a_photographed_board_gives_its_warp():
    size = (420, 420)
    camera = Camera(4000.0, (209.5, 209.5), size, (0.0, 0.0, 400.0), look_at((0.0, 0.0, 400.0), (0.0, 0.0, 0.0)))
    ideal = np.stack(np.meshgrid(np.arange(420.0), np.arange(420.0)), -1)

    def warp(points):
        x, y = (points[..., 0] - 209.5) / 210, (points[..., 1] - 209.5) / 210
        return points + np.stack((1.3 + 0.8 * x * y - y, -0.6 + 1.1 * x + 0.5 * x * x), -1)

    def unwarp(points):
        guess = points
        for _ in range(30):
            guess = guess + points - warp(guess)
        return guess

    board = Chessboard()
    picture = soft_board(lambda p: (unwarp(p) - 209.5) * (0.1, -0.1), size, discs=board.discs)
    fitted = fit_dewarp(photographed(picture, 1), camera, board)
    assert np.abs(fitted.apply(ideal) - warp(ideal)).max() < 0.006
    assert fitted.residual_rms_px < 0.01
    with pytest.raises(FrameError, match="420 x 420"):
        fit_dewarp(photographed(picture, 1)[:400], camera, board)
    dark = picture.copy()
    dark[:, 300:] = 400.0
    with pytest.raises(DewarpError, match="cover"):
        fit_dewarp(photographed(dark, 1), camera, board)


@pytest.mark.slow
@pytest.mark.parametrize("levels", [slow(""), "rows"])
def test_dots_on_one_level_or_on_two_show_the_lens(levels):
    """Of a plate that is taken to be flat the lower dots would lie a third of a per cent nearer to the middle."""
    small = camera((0.0, 0.0, 300.0), (0.0, 0.0), 0.0)
    view = {"focal_px": 1.5 * small.focal_px, "principal_px": (479.5, 383.5), "sensor_px": (960, 768)}
    nominal = replace(small, **view)
    true = replace(nominal, lens=Lens(k1=0.3))
    dots = Dots(0.6, levels=levels, step_mm=1.0 if levels else 0.0)
    about = {"discs": LARGE_DOTS, "dots": dots, "squares": (80, 80)}
    paper = (Plate if levels else DotGrid)(1.5, 1.0, **about)
    image = render(Scene(true, ()), paper, Sensor(), samples=3, seed=1)
    fitted = fit_dewarp(image, nominal, Chessboard(1.5, 1.0, **about), 3)
    plane = np.column_stack((np.random.default_rng(0).uniform(-20.0, 20.0, (200, 2)), np.zeros(200)))
    bent_px = np.linalg.norm(true.project(plane) - nominal.project(plane), axis=1)
    off_px = np.linalg.norm(fitted.apply(nominal.project_ideal(plane)) - true.project(plane), axis=1)
    assert bent_px.max() > 0.5
    assert off_px.max() < 0.03


@pytest.mark.parametrize(
    ("scene", "order", "rms_px", "truth_rms_px"),
    [
        ("two_spheres", 2, 0.018, 0.002),
        pytest.param("one_sphere", 3, 0.11, 0.13, marks=pytest.mark.slow),
        pytest.param("one_sphere", 5, 0.027, 0.012, marks=pytest.mark.slow),
    ],
)
def test_supplied_frames(scene, order, rms_px, truth_rms_px):
    path = FRAMES / scene / "target_clear.tif"
    if not path.exists():
        pytest.skip(f"supplied frame {scene}/target_clear is not here")
    camera, board = nominal(scene), Chessboard()
    fitted = fit_dewarp(tifffile.imread(path), camera, board, order)
    index = board.corners_within([(-85, -85), (85, 85)])
    true = true_projection(scene)(board.corner_mm(index))
    inside = ((true >= 0) & (true <= 2015)).all(axis=1)
    plane = np.column_stack((board.corner_mm(index)[inside], np.zeros(inside.sum())))
    error = fitted.apply(camera.project_ideal(plane)) - true[inside]
    assert fitted.residual_rms_px < rms_px
    assert np.sqrt(np.mean(error**2)) < truth_rms_px
    assert fitted.coverage > 0.95
    assert fitted.left_out == 0
