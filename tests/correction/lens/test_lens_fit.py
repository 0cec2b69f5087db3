"""Lens and focal length from boards held by hand: cameras drawn by OpenCV's own projection, and photographs."""

import json

import cv2
import numpy as np
import pytest

from correction.errors import ViewsMissing
from correction.lens.lens_fit import SHARED, SeenBoard, fit_lens
from rtpiv.verbs.calibrate import calibrate
from tests.correction.target.photographs import FOLDER
from tracer.scene.scene_file import load_priors, load_scene

SENSOR = (1280, 1024)
PLACES = np.stack(np.meshgrid(np.arange(11) * 10.0 - 50.0, np.arange(8) * 10.0 - 35.0), axis=-1).reshape(-1, 2)


def matrix_of(focal, middle=(0.0, 0.0), high=1.0):
    return np.array(((focal, 0.0, 640.0 + middle[0]), (0.0, focal / high, 512.0 + middle[1]), (0.0, 0.0, 1.0)))


def boards(rng, matrix, terms, count=10, tilt_deg=22.0, noise_px=0.05, bent_mm=0.0, step_mm=0.0, aside_mm=0.0):
    """Boards as OpenCV projects them, bent, or every second mark deeper and put aside by shadows of that frame."""
    deep = np.arange(len(PLACES))[:, None] % 2
    places = np.column_stack((PLACES, step_mm * deep))
    out = []
    focal = matrix[0, 0]
    while len(out) < count:
        far = focal * 100.0 / (SENSOR[0] * rng.uniform(0.4, 0.9))
        shift = far * np.array((*(rng.uniform(-0.3, 0.3, 2) * SENSOR / focal), 1.0))
        x, y = PLACES.T / 50.0
        aside = rng.normal(0.0, aside_mm, 2) if aside_mm else np.zeros(2)
        depth = bent_mm * (rng.normal() * x * x + rng.normal() * y * y + rng.normal() * x * y)
        space = places + np.column_stack((deep * aside, depth))
        pixel = cv2.projectPoints(space, rng.normal(0.0, np.radians(tilt_deg), 3), shift, matrix, terms)[0][:, 0]
        inside = ((pixel > 5.0) & (pixel < np.array(SENSOR) - 5.0)).all(axis=1)
        if inside.sum() > 30:
            seen = pixel[inside] + rng.normal(0.0, noise_px, (inside.sum(), 2))
            known = np.full_like(seen, noise_px), max(aside_mm, 0.01)
            out.append(SeenBoard(f"{len(out)}.png", places[inside], seen, *known))
    return out


@pytest.mark.slow
def test_numbers_lie_where_their_sigma_says():
    rng = np.random.default_rng(3)
    pulls = []
    for bent_mm, step_mm, aside_mm in ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 2.0, 0.1)) * 4:
        focal, middle = rng.uniform(1200.0, 3000.0), rng.normal(0.0, 15.0, 2)
        terms = np.r_[rng.normal(0.0, 0.1, 2), rng.normal(0.0, 0.0007, 2), 0.0]
        kind = {"bent_mm": bent_mm, "step_mm": step_mm, "aside_mm": aside_mm}
        found = fit_lens(boards(rng, matrix_of(focal, middle), terms, **kind), SENSOR)
        true = np.array((focal, 640.0 + middle[0], 512.0 + middle[1]))
        pulls.append((found.numbers[:3] - true) / found.sigma[:3])
        assert found.sigma[0] < 0.01 * focal
        assert (found.board_sigma_px > 0.05) == (bent_mm > 0.0)
    spread = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert (spread > 0.5).all()
    assert (spread < 1.6).all()
    assert np.abs(pulls).max() < 4.5


def test_shadows_that_put_a_lower_level_aside_in_every_frame_leave_the_lens_as_it_is():
    rng = np.random.default_rng(9)
    found = fit_lens(boards(rng, matrix_of(2000.0), np.zeros(5), step_mm=2.0, aside_mm=0.1), SENSOR)
    assert not found.refused
    assert found.rms_px < 0.08  # 0.05 px of noise in u and v
    assert np.std([pose[6:] for pose in found.poses.values()]) > 0.05
    assert found.sigma[0] < 3.0
    assert abs(found.camera.focal_px - 2000.0) < 4.0 * found.sigma[0]


def test_the_lens_takes_acquired_pixels_to_those_of_a_pinhole():
    rng = np.random.default_rng(4)
    matrix, terms = matrix_of(1500.0), np.array((-0.2, 0.05, 0.001, -0.0005, 0.0))
    found = fit_lens(boards(rng, matrix, terms, 16, noise_px=0.01), SENSOR)
    across, down = np.meshgrid(np.linspace(100.0, 1180.0, 9), np.linspace(100.0, 924.0, 9))
    at = np.stack((across, down), axis=-1).reshape(-1, 1, 2)
    straight = cv2.undistortPoints(at, matrix, terms)[:, 0]
    seen = (found.camera.ideal(at[:, 0]) - found.camera.principal_px) / found.camera.focal_px
    assert np.abs(seen - straight).max() * 1500.0 < 1.0  # a shift of the axis and a turn look alike
    turn = np.linalg.lstsq(np.column_stack((straight, np.ones(81))), seen, rcond=None)[0]
    assert np.abs(np.column_stack((straight, np.ones(81))) @ turn - seen).max() * 1500.0 < 0.1


def test_boards_that_all_face_the_camera_are_refused_and_tilted_ones_beside_them_help():
    rng = np.random.default_rng(5)
    facing = boards(rng, matrix_of(2000.0), np.zeros(5), 6, tilt_deg=0.3)
    with pytest.raises(ViewsMissing, match="tilted by 20 to 40 degrees"):
        fit_lens(facing, SENSOR)
    tilted = boards(rng, matrix_of(2000.0), np.zeros(5), 4, tilt_deg=30.0)
    assert abs(fit_lens(facing + tilted, SENSOR).camera.focal_px - 2000.0) < 10.0
    weak = boards(np.random.default_rng(20), matrix_of(2000.0), np.zeros(5), 9, 2.0, noise_px=0.1)
    one = fit_lens([*weak, tilted[0]._replace(tag="tilted")], SENSOR)
    assert abs(one.camera.focal_px - 2000.0) < 3.0 * one.sigma[0]
    assert "without tilted alone it is" in one.warnings[0]


def test_a_board_of_another_size_or_out_of_flat_is_named_and_left_out():
    rng = np.random.default_rng(6)
    right = boards(rng, matrix_of(2000.0), np.zeros(5))
    bent = boards(rng, matrix_of(2000.0), np.zeros(5), 1, bent_mm=6.0)[0]._replace(tag="bent.png")
    found = fit_lens([*right, bent], SENSOR)
    assert list(found.refused) == ["bent.png"]
    assert abs(found.camera.focal_px - 2000.0) < 4.0 * found.sigma[0]


def test_pixels_that_are_not_square_are_found_and_free_where_frames_show_them():
    rng = np.random.default_rng(7)
    terms = np.array((-0.2, 0.05, 0.001, -0.0005, 0.0))
    pulls = []
    for high in (1.01, 0.97, 1.2):
        found = fit_lens(boards(rng, matrix_of(2000.0, high=high), terms), SENSOR)
        assert not found.has_square_pixels
        assert "times as high as wide" in found.warnings[0]
        assert found.rms_px < 0.1
        pulls.append((found.numbers[[0, 8]] - (2000.0, high)) / found.sigma[[0, 8]])
    assert np.abs(pulls).max() < 4.0


def test_square_pixels_stay_square_unless_they_are_freed():
    rng = np.random.default_rng(8)
    seen = boards(rng, matrix_of(2000.0), np.zeros(5), noise_px=0.2)
    square, free = fit_lens(seen, SENSOR), fit_lens(seen, SENSOR, aspect_sigma=0.1)
    assert square.has_square_pixels
    assert abs(square.numbers[8] - 1.0) < 1e-4
    assert square.sigma[8] <= 1e-4
    assert free.sigma[8] > 1.2e-4
    assert free.sigma[8] == pytest.approx(free.seen_aspect[1], rel=0.01)
    assert abs(free.numbers[8] - 1.0) < 4.0 * free.sigma[8]


def test_photographs_agree_with_opencv_and_become_the_prior_of_a_scene(tmp_path, capsys):
    if not FOLDER.is_dir():
        pytest.skip("photographs of boards are not beside this checkout")
    taken = tmp_path / "taken by hand"
    taken.mkdir()
    places, pixels = [], []
    for path in sorted((FOLDER / "opencv").glob("left*.jpg")):
        (taken / path.name).write_bytes(path.read_bytes())
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        there, corners = cv2.findChessboardCorners(image, (9, 6))
        assert there
        pixels.append(cv2.cornerSubPix(image, corners, (5, 5), (-1, -1), (3, 40, 0.001)))
        places.append(np.pad(np.mgrid[:9, :6].T.reshape(-1, 2) * 25.0, ((0, 0), (0, 1))).astype(np.float32))
    rms, matrix, _, _, _, sigma, *_ = cv2.calibrateCameraExtended(places, pixels, (640, 480), None, None)
    scene = tmp_path / "scene.yaml"
    scene.write_text("camera: {f_mm: 8.0, L_mm: 400.0, pixel_pitch_um: 14.0, sensor_px: [640, 480]}\nbodies: []\n")
    found = calibrate(taken, scene=scene, square_mm=25.0, out=tmp_path / "lens", pictures=False)
    assert found.rms_px < rms
    assert abs(found.camera.focal_px - matrix[0, 0]) < 3.0 * np.hypot(sigma[0, 0], found.sigma[0])
    kept = load_scene(tmp_path / "lens" / "scene.yaml").camera
    assert kept.focal_px == found.camera.focal_px
    assert kept.lens == found.camera.lens
    assert load_priors(tmp_path / "lens" / "scene.yaml").camera.focal_px == pytest.approx(found.sigma[0])
    facts = json.loads((tmp_path / "lens" / "lens.json").read_text())
    assert list(facts["numbers"]) == list(SHARED)
    assert "13 boards" in capsys.readouterr().out
    assert not any("describes glass" in warning for warning in facts["warnings"])
    for path in sorted(taken.iterdir())[4:]:
        path.unlink()
    ball = "{name: ball, kind: sphere, centre_mm: [0, 0, 30], radius_mm: 10.0, material: acrylic}"
    scene.write_text(scene.read_text().replace("[]", f"[{ball}]"))
    calibrate(taken, scene=scene, square_mm=25.0, out=tmp_path / "glass", pictures=False)
    warnings = json.loads((tmp_path / "glass" / "lens.json").read_text())["warnings"]
    assert "describes glass" in warnings[0]
    assert "target_glass_pose1.tif" in warnings[0]


def test_frames_of_a_stage_with_other_names_are_told_how_to_be_named(tmp_path):
    for name in ("bare", "glass", "glass +10"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((64, 64), 90, np.uint8))
    with pytest.raises(
        ViewsMissing,
        match=r"no frame shows the board; .* by --board; or, of a board on a stage, name the frames target_clear",
    ):
        calibrate(tmp_path, square_mm=2.5, out=tmp_path / "lens", pictures=False)


def test_a_frame_that_shows_the_layout_shows_it_for_frames_that_show_too_little(tmp_path, capsys):
    drawn = cv2.aruco.CharucoBoard((9, 6), 1.0, 0.75, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    drawn.setLegacyPattern(True)
    paper = cv2.GaussianBlur(drawn.generateImage((900, 600), marginSize=30), (0, 0), 0.8)
    tilts = [(0.0, 0.0), (0.5, 0.0), (-0.4, 0.3), (0.1, -0.5)]  # the first so near that no edge is in view
    for number, tilt in enumerate(tilts):
        turn, _ = cv2.Rodrigues(np.array((*tilt, 0.1 * number)))
        lens, away = matrix_of(1500.0), np.array((0.0, 0.0, 1500.0 if number else 750.0))
        shift = np.array(((1.0, 0.0, -450.0), (0.0, 1.0, -300.0), (0.0, 0.0, 1.0)))
        to_frame = lens @ np.column_stack((turn[:, :2], away)) @ shift
        frame = cv2.warpPerspective(paper, to_frame, SENSOR, borderValue=255)
        cv2.imwrite(str(tmp_path / f"{number}.png"), frame)
    board = tmp_path / "board.yaml"
    words = "kind: charuco, square_mm: 9.0, marker_mm: 6.75, squares: [9, 6], dictionary: DICT_4X4_50"
    board.write_text(f"{{{words}, origin_corner: [4, 3]}}")
    found = calibrate(tmp_path, board=board, out=tmp_path / "lens", pictures=False)
    assert sorted(found.poses) == ["0.png", "1.png", "2.png", "3.png"]
    assert abs(found.camera.focal_px - 1500.0) < 4.0 * found.sigma[0]
    assert "5 of 5" in capsys.readouterr().err
