"""The table of messages in the docs holds every refusal of the fit, as the code words it, with a test of each."""

import ast
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy

from correction.errors import FitFailed, TargetNotFound
from correction.fit import camera_stage, glass_stage
from correction.fit.camera_stage import find_camera
from correction.fit.judge.weakness import describe_numbers, list_names
from correction.fit.progress import Progress
from correction.fit.seen.measurement import MeasuredFrame, TargetFrame
from tests.correction.fit.drawn_labs import photographed
from tests.correction.fit.drawn_optics import Lab
from tests.correction.fit.faulty_labs import right
from tests.loops import loop_over
from tests.slow_cases import slow
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene

HOME = Path(__file__).parents[3]
PAGE = (HOME / "docs" / "calibration-messages.md").read_text(encoding="utf-8")
ROWS = [[cell.strip() for cell in line.split("|")[1:-1]] for line in PAGE.splitlines() if line.startswith("| `")]
CODE = sorted((HOME / "correction" / "fit").rglob("*.py"))
REFUSALS = ("FitFailed", "GlassNotSeen", "ViewsMissing", "FrameError")


def words_in(tree: ast.AST) -> str:
    """All that a piece of code says, one literal after the other."""
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    return "".join(str(node.value) for node in sorted(nodes, key=lambda node: (node.lineno, node.col_offset)))


@cache
def words_of_the_fit() -> str:
    return "\n".join(words_in(ast.parse(path.read_text(encoding="utf-8"))) for path in CODE)


def fragments(row: list[str]) -> list[str]:
    return re.findall(r"`([^`]+)`", row[0])


@loop_over("row", ROWS)
def test_every_message_of_the_table_is_one_of_the_code_and_has_a_test(row):
    assert all(fragment in words_of_the_fit() for fragment in fragments(row))
    file, _, name = row[3].strip("`").partition("::")
    text = (Path(__file__).parent / file).read_text(encoding="utf-8")
    assert f"def {name}(" in text if name else "def test_" in text


def test_every_refusal_of_the_code_is_in_the_table():
    known = [fragment for row in ROWS for fragment in fragments(row)]
    missing = []
    for path in CODE:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                kind, said = getattr(node.exc.func, "id", ""), words_in(node.exc)
                if kind in REFUSALS and len(said) > 20 and not any(one in said for one in known):
                    missing.append(f"{path.name}:{node.lineno}: {said[:60]}")
    assert not missing


def test_what_the_search_has_made_of_a_scene_is_no_reason_to_print_larger_squares(monkeypatch):
    """Squares of the scene as given are wide; where the search has gone astray they may look narrow."""
    case = right(1)
    widths = iter((25.0, 3.0))
    monkeypatch.setattr(glass_stage, "square_behind_px", lambda *given: next(widths))
    monkeypatch.setattr(glass_stage, "feasible_scene", lambda *given: (case.given, 0.0))
    unknowns = SimpleNamespace(pose=lambda *given: None, start=None)
    work = SimpleNamespace(
        unknowns=unknowns, full=None, height_number=lambda frame: 0, glass_frames=[None], print_found=case.board
    )
    said = glass_stage._why_none(work, case.given)
    assert "print" not in said
    assert all(word in said for word in ("radius", "glass", "hollow", "not listed"))


def bare_fit(share: float, told: float, nearer_mm: float = 0.0) -> Progress:
    """The camera's stage with bare targets at three heights, all off by a share, of which one is told.

    The file has the camera nearer than it is.
    """
    case = right(2)
    camera = case.bare.camera
    view = camera.position_mm[2] * camera.sensor_px[0] / camera.focal_px
    heights = (0.0, -0.12 * view, 0.12 * view)
    found: dict[float, MeasuredFrame] = {}
    for number, height in enumerate(heights):
        true, rng = height * (1.0 + share), np.random.default_rng((59, number))
        x, y, z = camera.position_mm
        below = Scene(replace(camera, position_mm=(x, y, z - true)), ())  # the world, seen from the board
        found[height] = photographed(below, Lab(below.camera, ()), case.board, False, 0.01, 0.01, rng)
    image = np.arange(16, dtype=np.uint16).reshape(4, 4)
    frames = [TargetFrame(f"bare{h:+g}", image, False, h * (1.0 + told)) for h in heights]
    x, y, z = case.given.camera.position_mm
    given = case.given.with_camera(replace(case.given.camera, position_mm=(x, y, z - nearer_mm)))
    work = Progress(given, [*frames, TargetFrame("glass", image, True)], case.board, FitTable(), lambda _: None)
    measured = {frame.name: found[h] for frame, h in zip(frames, heights, strict=True)}

    def taken(
        frame: TargetFrame, board: object, camera: object, number: int, reach: object
    ) -> tuple[object, object]:
        one = measured[frame.name]
        return replace(one, corners=replace(one.corners, height_number=number)), board

    with pytest.MonkeyPatch.context() as context:
        context.setattr(camera_stage, "bare_frame", taken)
        find_camera(work)
    return work


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.03, slow(-0.03)])
def test_heights_that_are_off_by_one_factor_are_named_and_followed_by_a_right_fit(share):
    with pytest.raises(FitFailed, match="heights of the target seem to be") as refused:
        bare_fit(share, 0.0)
    assert ("too small" if share > 0.0 else "too large") in str(refused.value)
    named = float(re.search(r"seem to be ([\d.]+)", str(refused.value))[1])
    assert named == pytest.approx(3.0, abs=0.5)
    work = bare_fit(share, float(np.sign(share)) * 0.01 * named)  # the advice, followed
    assert np.abs(work.unknowns.free(work.full)).max() < 3.0


def test_a_distance_that_moved_far_is_a_warning_and_the_right_one_is_none():
    for nearer in (4.0, 0.0):
        work = bare_fit(0.0, 0.0, nearer * FitTable().camera.position_mm)
        said = [str(step) for step in work.history if "sigmas from what was known of it before" in str(step)]
        assert bool(said) == (nearer > 0.0)
        assert all("camera.z" in one and "measure the distance" in one for one in said)


@pytest.mark.slow
def test_frames_out_of_focus_are_named_as_such():
    """Discs of 0.4 squares are lost in edges blurred by 0.25; sharp frames without discs are none of these."""
    case = right(1)
    height, width = case.given.camera.shape
    v, u = np.mgrid[0:height, 0:width]
    side = case.board.square_mm * case.given.camera.focal_px / case.given.camera.position_mm[2]
    light = 500.0 + 2000.0 * ((u // side + v // side) % 2)
    for blur, said in ((0.25, "out of focus"), (0.03, "bring them into view")):
        image = scipy.ndimage.gaussian_filter(light, blur * side).astype(np.uint16)
        frames = [TargetFrame("bare", image, False), TargetFrame("glass", image, True)]
        work = Progress(case.given, frames, case.board, FitTable(), lambda _: None)
        with pytest.raises(TargetNotFound, match=said):
            find_camera(work)


# Sentences on what frames leave open of many balls: one for all of a quantity.


BALLS = [f"ball{k}" for k in range(17)]


def fitted(names, sigmas):
    return SimpleNamespace(names=tuple(names), sigmas=np.array(sigmas))


def test_one_quantity_of_many_balls_is_summarised_with_its_range():
    names = tuple(f"{ball}.radius" for ball in BALLS)
    words = describe_numbers(fitted(names, np.linspace(0.01, 0.02, 17)), names)
    assert words.startswith("radius of 17 bodies (ball0, ball1 and others): +-")
    assert " to " in words
    assert len(words) < 80


def test_few_numbers_and_different_ones_are_named_with_their_sigmas():
    names = ("ball0.radius", "ball1.radius", "glass.n", "ball2.z")
    words = describe_numbers(fitted(names, [0.01, 0.02, 0.001, 0.1]), names)
    assert all(f"{name} (+-" in words for name in names)
    assert list_names(["a"]) == "a"
    assert list_names(["a", "b", "c"]) == "a, b and c"
