"""A board file that says another thing than the picture shows: one sentence with a cure, nothing is written."""

import re

import pytest
import tifffile

from correction.target import Chessboard
from correction.target.board_file import PrintedBoard, write_board
from rtpiv.command_line.cli import USAGE, main
from tests.correction.synthetic_board import photographed, soft_board
from tests.correction.target.drawn_boards import NOMINAL
from tests.correction.target.test_size_seen import seen
from tests.slow_cases import slow
from tracer.bodies import Sphere
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene

SIDE_PX, PX_PER_MM = 260, 7.0
SCENE = f"""camera: {{focal_px: 3500.0, sensor_px: [{SIDE_PX}, {SIDE_PX}], position_mm: [0.0, 0.0, 500.0]}}
bodies: []
"""
BALL = Sphere("ball", (0.0, 0.0, 12.0), 10.0, ConstantMedium(1.5))
RIGHT = PrintedBoard(kind="chessboard", square_mm=2.5, disc_mm=1.0)
CODES = PrintedBoard(
    kind="charuco", square_mm=2.5, marker_mm=1.8, squares=[20, 20], origin_corner=[10, 10],
    dictionary="DICT_4X4_250",
)  # fmt: skip
WRONG = {  # what the file says of the board in the picture -> what is said of that
    "squares of 4 mm": (
        PrintedBoard(kind="chessboard", square_mm=4.0, disc_mm=1.6),
        r"0\.62\d times as large as .* of 4 mm \(28\.0 px\); give the right square_mm \(about 2\.5\)",
    ),
    "squares of 1.5 mm": (
        PrintedBoard(kind="chessboard", square_mm=1.5, disc_mm=0.6),
        r"1\.6\d times as large as .* of 1\.5 mm \(10\.5 px\); give the right square_mm \(about 2\.5\)",
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
    assert "target_glass: only 0 corners where the glass should be" in " ".join(said.split())


KINDS = {
    "chessboard": {"square_mm": 3.0, "disc_mm": 1.2},
    "charuco": {"square_mm": 4.8, "marker_mm": 3.36},
    "dots": {"pitch_mm": 3.0, "dot_mm": 1.2, "large_dot_mm": 1.95},
}
MORE = {"charuco": {"squares": [12, 10], "origin_corner": [6, 5], "dictionary": "DICT_4X4_100"}}


@pytest.fixture(scope="module", params=KINDS)
def drawn(request, tmp_path_factory):
    """Frames of a board that hangs as it should, and its kind."""
    kind, place = request.param, tmp_path_factory.mktemp(request.param)
    for name in ("target_clear.tif", "target_glass.tif"):
        tifffile.imwrite(place / name, seen({"chessboard": "discs"}.get(kind, kind), NOMINAL))
    (place / "scene.yaml").write_text(dump_scene(Scene(NOMINAL, (BALL,))))
    return kind, place


@pytest.mark.parametrize("times", [*map(slow, (0.5, 0.7, 0.97, 1.03, 1.05, 1.25, 2.0)), 0.95])
def test_squares_said_too_large_or_small_are_named_with_both_sizes(drawn, tmp_path, capsys, times):
    """By the search, or where it finds the board all the same, by the camera that would have to be elsewhere."""
    kind, folder = drawn
    sizes = {key: times * size for key, size in KINDS[kind].items()}
    assert calibrated(folder, tmp_path, PrintedBoard(kind=kind, **sizes, **MORE.get(kind, {}))) == USAGE
    said = capsys.readouterr().err.strip().splitlines()[-1]
    key = "pitch_mm" if kind == "dots" else "square_mm"
    side = sizes[key]
    words = (
        rf"target_clear: the (squares|dots) in the frame are {side / times * 16 / 3:.1f} px (wide|from one to the"
        rf" next), (\S+) times as large as the camera should see those of {side:g} mm \({side * 16 / 3:.1f} px\);"
        rf" give the right {key} \(about (\S+)\), or correct focal length and distance of the camera"
    )
    match = re.search(words, said)
    assert match is not None, said
    assert float(match[3]) == pytest.approx(1.0 / times, rel=0.01)
    assert float(match[4]) == pytest.approx(KINDS[kind][key], rel=0.01)
