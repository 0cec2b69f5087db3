"""A board file that says another thing than the picture shows: one sentence with a cure, nothing is written."""

import re

import pytest
import tifffile

from correction.target import Chessboard
from correction.target.board_file import PrintedBoard, write_board
from rtpiv.command_line.cli import USAGE, main
from tests.correction.synthetic_board import photographed, soft_board

SIDE_PX, PX_PER_MM = 260, 7.0
SCENE = f"""camera: {{focal_px: 3500.0, sensor_px: [{SIDE_PX}, {SIDE_PX}], position_mm: [0.0, 0.0, 500.0]}}
bodies: []
"""
RIGHT = PrintedBoard(kind="chessboard", square_mm=2.5, disc_mm=1.0)
CODES = PrintedBoard(
    kind="charuco", square_mm=2.5, marker_mm=1.8, squares=[20, 20], origin_corner=[10, 10],
    dictionary="DICT_4X4_1000",
)  # fmt: skip
WRONG = {  # what the file says of the board in the picture -> what is said of that
    "squares of 4 mm": (
        PrintedBoard(kind="chessboard", square_mm=4.0, disc_mm=1.6),
        "a lattice of 15 x 15 corners",
    ),
    "squares of 1.5 mm": (
        PrintedBoard(kind="chessboard", square_mm=1.5, disc_mm=0.6),
        "a lattice of 15 x 15 corners",
    ),
    "wider discs": (
        PrintedBoard(kind="chessboard", square_mm=2.5, disc_mm=1.5),
        r"the discs measure 0\.4\d squares across, those of the board described 0\.60; .*describe this one",
    ),
    "codes": (CODES, "0 markers of the board could be read.*give the dictionary that it was printed with"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Frames of a folder that is no run, and its scene."""
    place = tmp_path_factory.mktemp("board")

    def to_board(pixels):
        return (pixels - (SIDE_PX - 1) / 2.0) / PX_PER_MM * (1.0, -1.0)

    for seed, name in enumerate(("target_clear.tif", "target_glass.tif")):
        image = soft_board(to_board, (SIDE_PX, SIDE_PX), discs=Chessboard().discs, disc_mm=1.0)
        tifffile.imwrite(place / name, photographed(image, seed))
    (place / "scene.yaml").write_text(SCENE)
    return place


def calibrated(folder, place, printed):
    """How `calibrate` ends with a board file."""
    write_board(place / "board.yaml", printed)
    return main(["calibrate", str(folder), "--scene", str(folder / "scene.yaml"), "-o", str(place / "fit"),
                 "--board", str(place / "board.yaml"), "--no-pictures"])  # fmt: skip


@pytest.mark.parametrize("told", WRONG)
def test_a_board_file_that_contradicts_the_picture_is_one_sentence(folder, tmp_path, capsys, told):
    printed, words = WRONG[told]
    assert calibrated(folder, tmp_path, printed) == USAGE
    said = capsys.readouterr().err.strip().splitlines()
    assert re.match(f"rtpiv calibrate: target_clear: .*{words}", said[-1]), said
    assert ";" in said[-1], "the cure stands behind it"
    assert not any("Traceback" in line for line in said)
    assert [path.name for path in tmp_path.iterdir()] == ["board.yaml"]


def test_the_same_picture_is_read_by_the_board_that_it_shows(folder, tmp_path, capsys):
    """So that the sentences above are about the file: here it is the glass that is not in the picture."""
    assert calibrated(folder, tmp_path, RIGHT) == USAGE
    said = capsys.readouterr().err
    assert "camera on target_clear: 225 corners" in said
    assert "target_glass: only 0 corners where the spheres should be" in " ".join(said.split())
