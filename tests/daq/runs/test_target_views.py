"""Heights of the board as the stages measured them, and the board itself, from the run and from nobody's name."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import BoardError
from correction.target import Chessboard
from correction.target.board_file import PrintedBoard, board_text, write_board
from daq.errors import RunDamaged
from daq.runs.journal import Journal
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import board_of, target_views
from tests.daq.small_run import BENCH, about_run, keep_frame, planned

UNMEASURED = (0.005, 0.005)  # scale sigmas of a print that was not measured
AXES_Z = BENCH.replace("target_x", "target_z").replace("along: x", "along: z")
PIXELS = np.full((4, 4), 7, np.uint16)


def run_of(path, heights, **more):
    """A target run: (view, planned, measured position) of each step, at home at 0."""
    steps = [
        planned(k, f"frame{k}", view, "chessboard") | {"on_plane": commanded == 3.0}
        for k, (view, commanded, _) in enumerate(heights)
    ]
    bench = AXES_Z.replace("scene: scene.yaml", "scene: scene.yaml\nscene_at_mm: {target_z: 3.0}")
    folder = RunFolder.create(path, "target", about_run(steps, **({"bench": bench} | more)))
    journal = Journal(folder.journal_path)
    for k, (_, commanded, measured) in enumerate(heights):
        places = {"planned_mm": {"target_z": commanded}, "measured_mm": {"target_z": measured}}
        keep_frame(folder, journal, k, PIXELS, step=k, tag=f"frame{k}", **places)
    journal.close()
    return folder.path


def test_heights_are_measured_from_where_the_board_stood_in_the_plane(tmp_path):
    stops = [("clear", 3.0, 3.002), ("clear", -7.0, -6.9995), ("glass", 3.0, 3.004), ("glass", -7.0, -7.0005)]
    views = target_views(run_of(tmp_path, stops))
    assert [view.tag for view in views] == [f"frame{k}" for k in range(4)]
    assert [view.glass for view in views] == [False, False, True, True]
    assert [view.height_mm for view in views] == [0.0, pytest.approx(-10.003), 0.0, views[1].height_mm]
    assert [view.path.name for view in views] == [f"{k:06d}.tif" for k in range(4)]


def test_no_height_is_too_small_to_be_seen(tmp_path):
    views = target_views(run_of(tmp_path, [("clear", 3.0, 3.0), ("clear", 3.00001, 3.00001)]))
    assert [view.height_mm for view in views] == [0.0, pytest.approx(1e-5)]


def test_a_bench_or_a_place_that_cannot_be_read_is_one_sentence(tmp_path):
    with pytest.raises(RunDamaged, match="its bench cannot be read"):
        target_views(run_of(tmp_path, [("clear", 3.0, 3.0)], bench="name: bench\n"))
    with pytest.raises(RunDamaged, match="frame 0 lacks the position of 'target_x'"):
        target_views(run_of(tmp_path, [("clear", 3.0, 3.0)], bench=BENCH))


def test_a_run_knows_its_board_and_nobody_contradicts_it(tmp_path):
    run = run_of(tmp_path, [("clear", 3.0, 3.0)], square_mm=5.0, disc_mm=2.0)
    frame = run / "frames" / "000000.tif"
    assert board_of([run]) == board_of([frame], 5.0, 2.0) == Chessboard(5.0, 2.0, scale_sigma=UNMEASURED)
    for options, words in (
        ((2.5,), "square_mm 5, the options say 2.5"),
        ((5.0, 1.0), "disc_mm 2, the options say 1"),
    ):
        with pytest.raises(BoardError, match=words):
            board_of([frame], *options)
    other = run_of(tmp_path, [("clear", 3.0, 3.0)], square_mm=4.0)
    old = board_of([other], disc_mm=1.6)  # an older run does not say its discs
    assert old == Chessboard(4.0, 1.6, scale_sigma=UNMEASURED)
    with pytest.raises(BoardError, match="frames of one board"):
        board_of([frame, other])


def test_lone_files_have_the_given_board_with_the_scale_sigma_of_an_unmeasured_print(tmp_path):
    unmeasured = PrintedBoard(kind="chessboard", square_mm=5.0, disc_mm=2.0).board()
    assert unmeasured.scale_sigma == UNMEASURED
    assert board_of([tmp_path / "a.tif"]) == replace(unmeasured, square_mm=2.5, disc_mm=1.0)
    assert board_of([tmp_path / "a.tif"], 5.0, 2.0) == unmeasured


BOARD = PrintedBoard(
    kind="chessboard", square_mm=3.0, disc_mm=1.2, bars_mm=[190.0, 280.0], measured_mm=[190.19, 279.72]
)


def test_a_run_keeps_its_board_file_and_the_scale_of_the_print(tmp_path):
    said = {"square_mm": 3.0, "disc_mm": 1.2, "board": board_text(BOARD)}
    run, other = (run_of(tmp_path, [("clear", 3.0, 3.0)], **more) for more in (said, {"square_mm": 3.0}))
    found = board_of([run])
    assert found.scale == pytest.approx((1.001, 0.999))
    assert found.corner_mm((10, 10)) == pytest.approx((30.03, 29.97))
    assert found.scale_sigma == pytest.approx((0.1 / 190.0, 0.1 / 280.0))
    write_board(tmp_path / "same.yaml", BOARD)
    write_board(tmp_path / "new.yaml", BOARD.model_copy(update={"measured_mm": [190.0, 280.0]}))
    assert board_of([run], board=tmp_path / "same.yaml") == board_of([], board=tmp_path / "same.yaml") == found
    unmeasured = board_text(BOARD.model_copy(update={"measured_mm": None}))
    before = run_of(tmp_path, [("clear", 3.0, 3.0)], **{**said, "board": unmeasured})
    assert board_of([before]).scale == (1.0, 1.0)
    assert board_of([before], board=tmp_path / "same.yaml") == found  # measured after its frames were taken
    for paths, told, words in (
        ([run], {"board": tmp_path / "new.yaml"}, "another board"),
        ([run, other], {}, "keeps no board file"),
        ([run], {"square_mm": 3.0}, "omit square_mm"),
    ):
        with pytest.raises(BoardError, match=words):
            board_of(paths, **told)
