"""Boards held by hand at any pose, through flat walls and beside balls: frames of rays of the tests' own."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from correction.errors import ViewsMissing
from correction.fit.judge.weakness import weaknesses
from correction.fit.pose_stage import drop_other_boards, find_poses, pinhole_poses
from correction.fit.progress import Progress
from correction.fit.scene_fit import fit_scene
from correction.target import Chessboard
from correction.target.lattice_fit import BoardDetection
from rtpiv.verbs.calibrate import target_frames
from tests.correction.fit.tank_frames import (
    CAMERA_MM,
    FOCAL_PX,
    SHAPE,
    camera_axes,
    fermat_px,
    flat_tank,
    land,
    matrix_of,
    tank_frame,
)
from tracer.bodies import Window
from tracer.camera import Camera, look_at
from tracer.media import ConstantMedium
from tracer.scene.fit_section import FitCameraTable, FitTable, FitWallTable
from tracer.scene.scene import Scene

WATER = 1.333
AXES = camera_axes((0.01, 0.008, -0.02))
PRIORS = FitTable(
    camera=FitCameraTable(position_mm=30.0, rotation_deg=5.0, focal_px=0.3, principal_px=0.3, k1=1e-3),
    walls=FitWallTable(thickness_mm=30.0, tilt_deg=2.0),
    glasses={"water": 2e-4},
)
BOARD = Chessboard(16.0, 6.4)
FLAT = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
TILTED = ((-30.0, 20.0, -60.0), (0.3, 0.2, 0.1))
UPSIDE_DOWN = ((40.0, -20.0, -90.0), (-0.3, 0.3, np.pi - 0.15))
TANK = flat_tank(320.0, 260.0, WATER, (0.01, -0.015, 1.0))


def nominal_tank(thickness_mm):
    place = (0.0, 0.0, 600.0)
    middle = (0.5 * (SHAPE[1] - 1.0), 0.5 * (SHAPE[0] - 1.0))
    camera = Camera(FOCAL_PX, middle, SHAPE[::-1], place, look_at(place, (0.0, 0.0, 0.0)))
    wall = Window("tank", (0.0, 0.0, 330.0), (0.0, 0.0, 1.0), thickness_mm, 400.0, ConstantMedium(WATER, "water"))
    return Scene(camera, (wall,))


def value_of(fit, name):
    full = fit.unknowns.full(fit.x)
    return full[fit.unknowns.full_names.index(name)], fit.sigmas[fit.names.index(name)]


def test_rays_of_the_tests_land_where_fermat_says():
    planes = flat_tank(300.0, 260.0, WATER, (0.03, -0.02, 1.0))
    for pose in (FLAT, TILTED, UPSIDE_DOWN):
        board = np.array(((0.0, 0.0), (40.0, 30.0), (-60.0, 20.0), (10.0, -50.0)))
        world = np.array(pose[0]) + board @ matrix_of(pose[1])[:, :2].T
        assert land(fermat_px(world, planes, AXES), planes, pose, AXES) == pytest.approx(board, abs=1e-9)


def frames_of(*poses, planes=TANK, **how):
    """Frames at poses, the first of them at z = 0."""
    names = ["target_clear", *(f"target_clear_pose{number}" for number in range(1, len(poses)))]
    return [
        tank_frame(name, planes, pose, seed, axes=AXES, **how)
        for seed, (name, pose) in enumerate(zip(names, poses, strict=True))
    ]


def test_a_name_of_a_file_says_which_pose_by_hand_it_shows(tmp_path):
    for name in (
        "target_clear",
        "target_clear_z+10mm",
        "target_clear_pose1",
        "target_glass_pose1",
        "target_clear_pose_left",
    ):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full(SHAPE, 90, np.uint8))
    read = {frame.name: (frame.glass, frame.height_mm, frame.pose) for frame in target_frames(tmp_path, SHAPE)}
    assert read["target_clear_z+10mm"] == (False, 10.0, "")
    assert read["target_glass_pose1"] == (True, 0.0, "pose1")
    assert read["target_clear_pose_left"] == (False, 0.0, "pose_left")
    cv2.imwrite(str(tmp_path / "target_clear_tilted.png"), np.full(SHAPE, 90, np.uint8))
    with pytest.raises(ViewsMissing, match=r"for poses by hand target_clear_pose1\.tif"):
        target_frames(tmp_path, SHAPE)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_pinhole_sees_a_board_in_two_poses_one_of_which_is_right(mirrored):
    camera = nominal_tank(260.0).camera
    camera = camera.mirrored() if mirrored else camera
    index = np.stack(np.meshgrid(np.arange(-4, 5), np.arange(-3, 4)), axis=-1).reshape(-1, 2)
    world = np.array(UPSIDE_DOWN[0]) + BOARD.corner_mm(index) @ matrix_of(UPSIDE_DOWN[1])[:, :2].T
    pixel, axes, nothing = camera.project(world), np.zeros((len(index), 2, 2)), np.zeros((len(index), 2))
    found = pinhole_poses(camera, BoardDetection(BOARD, index, pixel, nothing, axes, nothing, {}))
    assert len(found) == 2
    assert found[0][:3] == pytest.approx(UPSIDE_DOWN[0], abs=1e-6)
    assert Rotation.from_rotvec(found[0][3:]).as_matrix() == pytest.approx(matrix_of(UPSIDE_DOWN[1]), abs=1e-8)


@pytest.mark.slow  # the frames below, by the whole fit; poses and refusals are held by the next tests
def test_a_tank_is_as_thick_as_boards_at_three_poses_show():
    fit = fit_scene(nominal_tank(250.0), frames_of(FLAT, TILTED, UPSIDE_DOWN), BOARD, PRIORS)
    thickness, sigma = value_of(fit, "tank.thickness")
    assert abs(thickness - 260.0) < 3.0 * sigma
    assert sigma < 4.0
    for name, true in (("pose1", TILTED), ("pose2", UPSIDE_DOWN)):
        for part, value in zip("xyz", true[0], strict=True):
            found, sigma = value_of(fit, f"target {name}.{part}")
            assert abs(found - value) < 4.0 * sigma
            assert sigma < 0.2


def work_with(frames, said=None):
    """A fit that knows camera and tank, before it looks for poses by hand."""
    place = tuple(CAMERA_MM.tolist())
    nominal = nominal_tank(260.0)
    camera = replace(nominal.camera, position_mm=place, rotation=tuple(map(tuple, AXES.tolist())))
    wall = replace(nominal.bodies[0], normal=tuple(TANK[0][0].tolist()))
    scene = replace(nominal, camera=camera, bodies=(wall,))
    return Progress(scene, frames, BOARD, PRIORS, (said if said is not None else []).append)


@pytest.mark.slow
def test_poses_are_found_through_the_tank_tilted_upside_down_and_partly_in_view():
    aside = ((60.0, 30.0, -70.0), (0.0, -0.35, 0.4))
    work = work_with(frames_of(FLAT, TILTED, UPSIDE_DOWN, aside, blur_px=1.5))
    find_poses(work)
    assert [frame.name[-5:] for frame in work.bare] == ["pose1", "pose2", "pose3"]
    for pose, true in zip(("pose1", "pose2", "pose3"), (TILTED, UPSIDE_DOWN, aside), strict=True):
        assert work.poses[pose][:3] == pytest.approx(true[0], abs=0.05)
        assert matrix_of(true[1]) == pytest.approx(
            Rotation.from_rotvec(work.poses[pose][3:]).as_matrix(), abs=1e-3
        )


@pytest.mark.slow
def test_frames_that_say_nothing_are_left_out_with_the_reason():
    frames = frames_of(FLAT, TILTED, UPSIDE_DOWN, TILTED)
    blank = replace(frames[1], name="target_clear_pose4", pose="pose4", image=np.full(SHAPE, 900, np.uint16))
    there = (10.0, 0.0, -70.0), (0.2, -0.3, 0.0)
    other = tank_frame("target_clear_pose5", TANK, there, 9, axes=AXES, wider=1.03)
    said = []
    work = work_with([*frames, blank, other], said)
    find_poses(work)
    assert drop_other_boards(work)
    assert [frame.name[-5:] for frame in work.bare] == ["pose1", "pose2"]
    same, nothing, wrong = said
    assert same.startswith(
        "warning: target_clear_pose3 left out: it shows the board at the same pose as target_clear_pose1"
    )
    assert nothing.startswith("warning: target_clear_pose4 left out: no chessboard in the frame")
    assert "px from any pose of the board: another board, or a bent one" in wrong
    assert not any(
        name.startswith(("target pose3", "target pose4", "target pose5")) for name in work.unknowns.names
    )
    assert sum(name.startswith("target pose") for name in work.unknowns.names) == 12


@pytest.mark.slow  # three fits; what is left open by other frames is held by test_messages.py
def test_parallel_boards_leave_numbers_open_and_tilted_ones_cure_that():
    known = PRIORS.model_copy(update={"camera": PRIORS.camera.model_copy(update={"focal_px": 1.0, "k1": 5e-3})})
    parallel = ((-30.0, 20.0, -60.0), (0.0, 0.0, 0.0)), ((40.0, -20.0, -90.0), (0.0, 0.0, 0.1))
    said, sigma = [], []
    for others in ((), parallel, (TILTED, UPSIDE_DOWN)):
        fit = fit_scene(nominal_tank(250.0), frames_of(FLAT, *others), BOARD, known)
        said.append([weakness.sentence for weakness in weaknesses(fit)])
        sigma.append(value_of(fit, "tank.thickness")[1])
    alone, open_, cured = said
    assert any("tank.thickness" in each and "add poses by hand, tilted" in each for each in alone)
    assert any("camera.focal_px" in each and "boards that are parallel" in each for each in open_)
    assert not any(
        "boards that are parallel" in each or "known no better than before, the" in each for each in cured
    )
    assert sigma[0] > 3.0 * sigma[2]
