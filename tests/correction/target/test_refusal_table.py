"""Every refusal of the board search is in the table, and advice in it is followed: the board is then found."""

import ast
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from correction.errors import TargetNotFound
from correction.target import Chessboard
from correction.target.board_origin import Placing
from correction.target.board_search import find_board, track_board
from correction.target.chessboard import QUARTER_TURNS
from correction.target.evidence import contradiction
from correction.target.scale_search import find_patches
from tests.correction.synthetic_board import photographed, soft_board
from tests.correction.target.count_degraded import judged
from tests.correction.target.test_board_search import SHAPE, miss_mm, view
from tests.slow_cases import slow_but
from tracer.board import OLDER

ROOT = Path(__file__).resolve().parents[3]
ROW = re.compile(r"^\| (?!message|-)(.+?) \| (.+?) \| `(.+?)` \|$", re.MULTILINE)
FILES = [*sorted((ROOT / "correction" / "target").glob("*.py")), ROOT / "correction" / "fit" / "camera_stage.py"]
PLAIN, DISCS = Chessboard(discs=()), Chessboard(discs=OLDER)
ASIDE_MM = np.array((40.0, -35.0))  # of the origin: no disc is in the frame


def text_of(node):
    """Constant parts of a string or f-string, in one."""
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    return "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in parts)


def refusals():
    """All strings of the search that are raised, or given back as the reason of a refusal."""
    for path in FILES[:-1]:
        if path.name in ("board_file.py", "chessboard.py"):  # they refuse files, not frames
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            strings = [node.exc.args[0]] if _raises(node) else []
            if (
                isinstance(node, ast.FunctionDef)
                and isinstance(node.returns, ast.Name)
                and node.returns.id == "str"
            ):
                strings = [some.value for some in ast.walk(node) if isinstance(some, ast.Return)]
            for one in strings:
                if isinstance(one, ast.JoinedStr | ast.Constant) and len(text_of(one)) > 40:
                    yield f"{path.name}:{one.lineno}", text_of(one)


def _raises(node):
    call = node.exc if isinstance(node, ast.Raise) else None
    return isinstance(call, ast.Call) and getattr(call.func, "id", "") == "TargetNotFound"


def test_every_refusal_has_a_row_and_every_row_its_message_and_its_test():
    rows = ROW.findall((ROOT / "docs" / "board-refusals.md").read_text())
    # Messages go over several lines of source: what stands between two pieces of one is taken out.
    said = re.sub(r'"\s*f?"', "", "".join(path.read_text() for path in FILES))
    tests = {path: path.read_text() for path in (ROOT / "tests" / "correction").rglob("test_*.py")}
    for message, _, name in rows:
        assert message in said, message
        assert any(path.name == name or f"def {name}(" in text for path, text in tests.items()), name
    missing = [(at, text) for at, text in refusals() if not any(message in text for message, _, _ in rows)]
    assert not missing


@cache
def painted(turn_deg, aside_mm):
    base = view(turn_deg)
    return soft_board(lambda pixels: base(pixels) + aside_mm, SHAPE)


def board_image(turn_deg=3.0, aside_mm=(0.0, 0.0), blur=0.0, noise=0.0):
    image = painted(turn_deg, tuple(aside_mm)) + np.random.default_rng(1).normal(0.0, noise, SHAPE)
    return photographed(cv2.GaussianBlur(image, (0, 0), blur) if blur else image, 0)


def predicted(off_mm=0.0, aside_mm=(0.0, 0.0), px_per_mm=9.0):
    def predict(points):
        c, s = np.cos(np.radians(3.0)), np.sin(np.radians(3.0))
        x, y = (np.asarray(points)[:, :2] - aside_mm + off_mm).T
        return np.column_stack((231.4 + px_per_mm * (c * x - s * y), 208.7 - px_per_mm * (s * x + c * y)))

    return predict


ASIDE = {"aside_mm": ASIDE_MM}
REFUSED_AND_FOLLOWED = {  # words of a refusal: the board, what is given (picture and prediction), what as advised
    "too noisy to be measured; bring more light": (PLAIN, ({"noise": 1000.0}, {}), ({"noise": 100.0}, {})),
    "too noisy to be measured": (PLAIN, ({"noise": 2500.0}, {}), ({"noise": 100.0}, {})),
    "hangs turned against the camera as described": (PLAIN, ({"turn_deg": 48.0}, {}), ({}, {})),
    "camera should see too little of the board": (PLAIN, ({}, {"px_per_mm": 400.0}), ({}, {})),
    "lies more than half a square from its prediction": (
        DISCS, (ASIDE, ASIDE | {"off_mm": (2.5, 0.0)}), (ASIDE, ASIDE | {"off_mm": 0.4}),
    ),
    "corners could be fitted": (
        DISCS, (ASIDE | {"blur": 10.0}, ASIDE | {"off_mm": 0.1}), (ASIDE | {"blur": 1.0}, ASIDE | {"off_mm": 0.1}),
    ),
}  # fmt: skip


@pytest.mark.parametrize("words", slow_but(REFUSED_AND_FOLLOWED, *[*REFUSED_AND_FOLLOWED][::2]))
def test_a_refusal_followed_finds_the_board(words):
    board, *given = REFUSED_AND_FOLLOWED[words]
    reach, aside = (None, ASIDE_MM) if board is DISCS else (0.7, (0.0, 0.0))

    def found(picture, prediction):
        return track_board(board_image(**picture), board, predicted(**prediction), reach=reach)

    with pytest.raises(TargetNotFound, match=words):
        found(*given[0])
    assert miss_mm(found(*given[1]), lambda pixels: view(3.0)(pixels) + aside) < 0.02


def test_shades_that_contradict_the_marks_are_named():
    patch = find_patches(board_image(), PLAIN)[0]
    board = replace(PLAIN, odd_bright=bool(np.mean((patch.index.sum(axis=1) % 2 == 1) == (patch.sign > 0)) > 0.5))
    here, beside = (Placing(QUARTER_TURNS[0], (shift, 0)) for shift in (0, 1))
    assert contradiction(board, patch, here) == ""
    assert "% of the corners have bright and dark squares exchanged" in contradiction(board, patch, beside)


def test_spots_like_discs_are_refused_and_masked_as_advised():
    spots = tuple((i + 5, j + 3) for i, j in OLDER)
    image = photographed(soft_board(view(3.0), SHAPE, discs=(*OLDER, *spots)), 0)
    with pytest.raises(TargetNotFound, match="pattern of 3 discs fits the frame 2 times; clean the board or mask"):
        find_board(image, DISCS)
    mask = np.ones(SHAPE, bool)
    u, v = np.rint(predicted()(np.array([(5.5 * 2.5, 3.5 * 2.5)]))[0]).astype(int)
    mask[v - 50 : v + 50, u - 50 : u + 50] = False
    assert miss_mm(find_board(image, DISCS, mask), view(3.0)) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "words"),
    [
        (31024, "show a disc where the edges"),
        (40054, "so few may be misread"),
        (40460, "corners between four squares are in view"),
    ],
)
def test_drawn_boards_of_which_little_is_in_view_are_refused_with_what_is_missing(seed, words):
    said, about, why = judged(seed, [])
    assert said == "refused"
    assert "flipped" in about or "hidden" in about
    assert words in why
