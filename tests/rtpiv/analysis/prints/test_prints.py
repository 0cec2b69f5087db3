"""Targets on paper: read back from the PDF's own operators, and by detectors that are not ours."""

import re
import shlex
import zlib

import cv2
import numpy as np
import pytest
import yaml

from correction.target import Chessboard
from correction.target.board_file import PrintedBoard, read_board
from correction.target.board_search import find_board
from daq.errors import RunUsageError
from ground.errors import ConfigError
from rtpiv.analysis.prints import pages, sheets
from rtpiv.analysis.prints.choice import best_square, corners_of
from rtpiv.command_line.cli import main
from rtpiv.verbs.target import target
from tracer.board import CHIRAL
from tracer.errors import SceneError
from tracer.scene.scene_file import load_scene

POINT_MM = 25.4 / 72.0
PATH = re.compile(rb"(-?[\d.]+) (-?[\d.]+) ([ml])\b")


def streams(path):
    """Streams of a PDF that hold drawing operators, as text."""
    found = []
    for part in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", path.read_bytes(), re.DOTALL):
        try:
            text = zlib.decompress(part)
        except zlib.error:
            continue
        if b"/DeviceRGB CS" in text:  # a page; glyphs of letters have no colours
            found.append(text)
    return found


def vertices_mm(text):
    """End points of straight lines on a page [mm]."""
    return np.array([(float(x), float(y)) for x, y, _ in PATH.findall(text)]) * POINT_MM


def inked(sheet, points_mm):
    """Whether points (N, 2) are dark, from the shapes alone."""
    dark, order = np.zeros(len(points_mm), bool), np.argsort(points_mm[:, 0])
    along = points_mm[order, 0]
    for shape in sheet.polygons:
        low, high = shape.min(axis=0), shape.max(axis=0)
        there = order[slice(*np.searchsorted(along, (low[0], high[0])))]
        dark[there[(points_mm[there, 1] >= low[1]) & (points_mm[there, 1] < high[1])]] = True
    for (x, y, wide), black in zip(sheet.discs, sheet.disc_dark, strict=True):
        dark[np.hypot(points_mm[:, 0] - x, points_mm[:, 1] - y) < 0.5 * wide] = black
    return dark


def picture(sheet, px_per_mm):
    """The sheet as a camera without a lens sees it, y downwards."""
    x0, y0, x1, y1 = sheet.bounds_mm
    x = x0 - 2.0 + (np.arange(int((x1 - x0 + 4.0) * px_per_mm)) + 0.5) / px_per_mm
    y = y1 + 2.0 - (np.arange(int((y1 - y0 + 4.0) * px_per_mm)) + 0.5) / px_per_mm
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    shown = np.where(inked(sheet, points), 20, 235).astype(np.uint8).reshape(len(y), len(x))
    return shown, lambda uv: np.column_stack(
        (x0 - 2.0 + (uv[:, 0] + 0.5) / px_per_mm, y1 + 2.0 - (uv[:, 1] + 0.5) / px_per_mm)
    )


def test_the_board_is_the_one_that_a_fit_looks_for():
    board, sheet = Chessboard(2.5, 1.0, discs=CHIRAL), sheets.chessboard((60.0, 80.0), 2.5)
    points = np.random.default_rng(4).uniform(-29.0, 29.0, (20_000, 2))
    assert np.array_equal(inked(sheet, points), board.shade(points) == 0.0)


def test_squares_on_paper_are_where_the_page_says(tmp_path):
    """Corners in the file, in millimetres from each other; and bars as long as they claim."""
    sheet = sheets.chessboard((100.0, 120.0), 2.5)
    printed = pages.write_pages(tmp_path / "a.pdf", sheet, "A4", "words")
    (page,) = streams(tmp_path / "a.pdf")
    found = vertices_mm(page)
    moved = np.array([pages._middle(side, -half, half) for side, half in ((210.0, 50.0), (297.0, 60.0))])
    assert np.abs(moved).max() <= 0.5 * pages.DOT_MM
    on_page = sheet.polygons[7] + np.array([105.0, 148.5]) - moved
    for corner in on_page:
        assert np.min(np.linalg.norm(found - corner, axis=1)) < 2e-3
    across, up = printed.bars_mm
    low = found[np.abs(found[:, 1] - pages.EDGE_MM) < 2e-3]
    left = found[np.abs(found[:, 0] - pages.EDGE_MM) < 2e-3]
    assert np.ptp(low[:, 0]) == pytest.approx(across, abs=2e-3)
    assert np.ptp(left[:, 1]) == pytest.approx(up, abs=2e-3)
    again = pages.write_pages(tmp_path / "b.pdf", sheet, "A4", "words")
    assert again == printed
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()


def test_every_line_of_a_board_lies_between_two_dots_of_a_printer(tmp_path):
    """Measured in the file from the corner of the page: a printer moves none of them, or all alike."""
    assert main(["setup", "target", "--square-mm", "5", "-o", str(tmp_path)]) == 0
    board = read_board(tmp_path / "board.yaml")
    assert board.square_mm == pytest.approx(118 * 25.4 / 600, abs=1e-6)
    (page,) = streams(tmp_path / "target.pdf")
    found, squares = vertices_mm(page), np.array(board.squares)
    for axis in range(2):
        edges = found[:, axis][np.abs(found[:, axis] - 0.5 * (210.0, 297.0)[axis]) < 60.0]
        places, counts = np.unique(np.round(edges / (25.4 / 600.0), 1), return_counts=True)
        lines = places[counts >= squares[1 - axis]]  # squares end on each and begin; discs have rounder numbers
        assert len(lines) > 15
        assert np.abs(lines - np.rint(lines)).max() < 0.05
        assert set(np.diff(lines)) == {118.0}


def test_what_a_page_does_not_hold_goes_on_several_that_meet(tmp_path):
    sheet = sheets.dots((300.0, 200.0), 20.0)
    printed = pages.write_pages(tmp_path / "a.pdf", sheet, "A4", "words")
    assert printed.pages == (2, 1)
    assert len(streams(tmp_path / "a.pdf")) == 2


def test_a_charuco_board_is_read_by_opencv_where_it_is():
    """Every corner found lies where the board file's origin puts it."""
    sheet = sheets.charuco((42.0, 36.0), 5.0)
    about = sheet.about
    shown, to_mm = picture(sheet, 10.0)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, about["dictionary"]))
    board = cv2.aruco.CharucoBoard(tuple(about["squares"]), about["square_mm"], about["marker_mm"], dictionary)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(shown)
    across, up = about["squares"]
    assert len(ids) == (across - 1) * (up - 1)
    of_board = np.asarray(board.getChessboardCorners())[ids.ravel(), :2]  # y downwards from the top
    x, y = of_board[:, 0] / 5.0, up - of_board[:, 1] / 5.0
    expected = 5.0 * (np.column_stack((x, y)) - about["origin_corner"])
    assert np.max(np.abs(to_mm(corners.reshape(-1, 2)) - expected)) < 0.02


@pytest.mark.parametrize("kind", ["chessboard", "charuco"])
def test_a_printed_board_is_found_by_what_its_board_file_says(kind):
    sheet = {"chessboard": sheets.chessboard, "charuco": sheets.charuco}[kind]((42.0, 36.0), 5.0)
    board = PrintedBoard(kind=kind, **sheet.about).board()
    shown, to_mm = picture(sheet, 10.0)
    found = find_board(cv2.GaussianBlur(shown, (0, 0), 1.0), board)
    columns, rows = sheet.about["squares"]
    assert len(found) == (columns - 1) * (rows - 1)
    assert np.abs(to_mm(found.position_px) - found.plane_mm).max() < 0.02


def test_three_dots_tell_origin_and_turn():
    sheet = sheets.dots((40.0, 40.0), 4.0)
    large = sheet.discs[sheet.discs[:, 2] > 2.0, :2] / 4.0
    assert sorted(map(tuple, np.rint(large).astype(int).tolist())) == [(0, 0), (0, 2), (1, 0)]
    turns = [np.array([[0, -1], [1, 0]]), -np.eye(2, dtype=int), np.array([[0, 1], [-1, 0]])]
    shape = {tuple(dot) for dot in large - large.min(axis=0)}
    for turn in turns:
        turned = large @ turn.T
        assert {tuple(dot) for dot in turned - turned.min(axis=0)} != shape


def test_particles_are_as_many_and_wide_as_in_the_paper_and_the_same_for_a_seed():
    sheet = sheets.particles((50.0, 40.0), 12.0, seed=3)
    assert len(sheet.particles_mm) == pytest.approx(0.02 * 12.0**2 * 50.0 * 40.0, rel=0.05)
    assert sheet.particle_mm == pytest.approx(0.25)
    assert np.array_equal(sheet.particles_mm, sheets.particles((50.0, 40.0), 12.0, seed=3).particles_mm)


@pytest.fixture(scope="module")
def scene():
    from pathlib import Path

    return load_scene(Path(__file__).parents[4] / "examples" / "two_spheres_500.yaml")


@pytest.mark.slow
def test_the_squares_chosen_tell_most_of_the_ball_seen_worst(scene):
    chosen = best_square(scene, (178.0, 265.0))
    finer, coarser = (corners_of(scene, times * chosen.square_mm, (178.0, 265.0)) for times in (0.5, 2.0))
    assert chosen.worth >= max(finer.worth, coarser.worth)
    assert min(chosen.behind.values()) > 200


def test_a_board_file_keeps_what_the_bars_measure_in_any_folder(tmp_path, capsys):
    tmp_path = tmp_path / "Öl, {zwei}: b"
    assert main(["setup", "target", "-o", str(tmp_path)]) == 0
    assert read_board(tmp_path / "board.yaml").scale_sigma == (0.005, 0.005)
    printed = capsys.readouterr().out
    line = re.search("bench file: (.*)", printed)[1]
    assert yaml.safe_load(line) == {"target": {"board": str(tmp_path / "board.yaml")}}
    command = shlex.split(re.search("rtpiv (.*) X Y", printed)[1])
    assert main([*command, "189.62", "280.28"]) == 0
    board = read_board(tmp_path / "board.yaml")
    assert board.scale == pytest.approx((0.998, 1.001))
    assert board.scale_sigma == pytest.approx((0.1 / 190.0, 0.1 / 280.0))
    before = (tmp_path / "board.yaml").read_bytes()
    assert main(["setup", "target", str(tmp_path / "board.yaml"), "--measured-mm", "280.0", "190.0"]) == 2
    assert "print at 100 %" in capsys.readouterr().err
    assert (tmp_path / "board.yaml").read_bytes() == before


def test_bars_may_be_measured_by_a_program(tmp_path):
    target(square_mm=5.0, out=tmp_path / "t")
    target(tmp_path / "t" / "board.yaml", measured_mm=tuple(np.array((190.19, 279.72))))
    assert read_board(tmp_path / "t" / "board.yaml").scale == pytest.approx((1.001, 0.999))


def test_what_cannot_be_printed_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(SceneError, match="4 x 4"):
        target(square_mm=80.0, out=tmp_path / "t")
    with pytest.raises(RunUsageError):
        target(kind="particles", square_mm=2.0, out=tmp_path / "t")
    with pytest.raises(RunUsageError):
        target(measured_mm=(1.0, 1.0), out=tmp_path / "t")
    assert not (tmp_path / "t").exists()
    (tmp_path / "board.yaml").write_text("kind: chessboard\nsquare: 2.5\n")
    with pytest.raises(ConfigError, match="square"):
        target(tmp_path / "board.yaml", measured_mm=(190.0, 280.0))
