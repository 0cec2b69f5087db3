"""The page that draws a mask: what a browser sends becomes the picture, and nobody else can write it."""

import http.client
import json
from contextlib import contextmanager

import cv2
import numpy as np
import pytest
import tifffile

pytest.importorskip("websockets")
from websockets.exceptions import ConnectionClosed, InvalidStatus

from daq.live.mask_page import MOST_POINTS, MaskPage, outlines_of
from rtpiv.command_line.cli import USAGE, main
from tests.daq.live.local_pages import browser_of, say, served
from tracer.masked import left_out

H, W = 60, 80
FRAME = np.random.default_rng(0).integers(0, 4096, (H, W)).astype(np.uint16)
SQUARE = [[9.5, 19.5], [29.5, 19.5], [29.5, 39.5], [9.5, 39.5]]


@contextmanager
def shown(path, begun=()):
    with served(MaskPage("a.tif", FRAME, path, begun)) as page:
        yield page


@contextmanager
def drawing(page, token=None, **options):
    """A browser that is let in, or is not; what it is told first, and the frame."""
    with browser_of(page, "/outlines", token, **options) as browser:
        yield json.loads(browser.recv(5.0)), browser.recv(5.0), lambda words: say(browser, words)


def test_what_is_drawn_becomes_the_picture_and_is_gone_on_from(tmp_path):
    path = tmp_path / "mask.png"
    with shown(path) as page, drawing(page) as (words, frame, ask):
        assert (words["name"], words["width"], words["height"], words["outlines"]) == ("a.tif", W, H, [])
        grey = np.frombuffer(frame, np.uint8).reshape(H, W)
        assert np.corrcoef(grey.ravel(), FRAME.ravel())[0, 1] > 0.99
        assert ask({"outlines": [SQUARE]}) == {"saved": "mask.png", "share": pytest.approx(400 / (H * W))}
    wanted = np.zeros((H, W), np.uint8)
    wanted[20:40, 10:30] = 255
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), wanted)
    with shown(path, left_out(path, (W, H))) as page, drawing(page) as (words, _, ask):
        (before,) = words["outlines"]
        corner = [[-5, -5], [5.4, -5], [5.4, 5.4], [-5, 5.4]]
        assert "saved" in ask({"outlines": [before, corner]})
    wanted[:6, :6] = 255
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), wanted)


NONSENSE = (
    {}, [], "nonsense", b"\xff\xfe", {"outlines": []}, {"outlines": [[]]}, {"outlines": [SQUARE[:2]]},
    {"outlines": [[*SQUARE, [1, None]]]}, {"outlines": [[*SQUARE, [True, 1]]]},
    {"outlines": [[*SQUARE, "ab"]]},
    {"outlines": [SQUARE] * 1001}, {"outlines": [[[1e300, 1], *SQUARE]]}, {"outlines": "SQUARE"},
    '{"outlines": [[[1, 2], [3, 4], [NaN, 5]]]}', '{"outlines": ' + 3000 * "[" + 3000 * "]" + "}",
    {"outlines": [[[100, 100], [110, 100], [105, 110]]]},
    {"outlines": [[[-9, -9], [99, -9], [99, 99], [-9, 99]]]},
)  # fmt: skip


def test_nonsense_is_refused_in_one_sentence_and_writes_nothing(tmp_path):
    with shown(tmp_path / "mask.png") as page, drawing(page) as (_, _, ask):
        for said in NONSENSE:
            assert set(ask(said)) == {"refused"}, said
            assert not (tmp_path / "mask.png").exists()
        assert "saved" in ask({"outlines": [SQUARE]})  # and is served on


def test_outlines_without_end_are_none():
    assert outlines_of([[[1.0, 2.0]] * (MOST_POINTS + 1)]) is None
    assert outlines_of([[[10**400, 1], [1, 1], [2, 2]]]) is None


def test_a_file_that_cannot_be_written_is_said(tmp_path):
    with shown(tmp_path / "missing" / "mask.png") as page, drawing(page) as (_, _, ask):
        assert "mask.png: no such file or directory" in ask({"outlines": [SQUARE]})["refused"].lower()


def test_who_does_not_know_the_token_or_comes_from_elsewhere_is_not_let_in(tmp_path):
    with shown(tmp_path / "mask.png") as page:
        for token in ("", "x", page.access.token[:-1]):
            with pytest.raises(ConnectionClosed), drawing(page, token):
                pass
        for origin in ("http://evil.example", None):
            with pytest.raises(InvalidStatus), drawing(page, origin=origin):
                pass
        for host, status in ((f"127.0.0.1:{page.access.port}", 200), ("evil.example", 403)):
            asked = http.client.HTTPConnection("127.0.0.1", page.access.port, timeout=5.0)
            asked.request("GET", "/", headers={"Host": host})
            assert asked.getresponse().status == status
            asked.close()
        assert not (tmp_path / "mask.png").exists()


def test_the_verb_refuses_what_it_cannot_draw_on(tmp_path, capsys):
    tifffile.imwrite(tmp_path / "a.tif", FRAME)
    cv2.imwrite(str(tmp_path / "small.png"), np.eye(20, dtype=np.uint8))
    for words, said in (
        ([str(tmp_path / "missing.tif")], "cannot be read"),
        ([str(tmp_path / "a.tif"), "-o", "mask.jpg"], "mask.jpg: a mask is written as PNG; name it mask.png"),
        ([str(tmp_path / "a.tif"), "-o", str(tmp_path / "small.png")], "is 20 x 20 px, and the camera 80 x 60"),
    ):
        assert main(["setup", "mask", *words]) == USAGE
        error = capsys.readouterr().err
        assert said in error
        assert len(error.strip().splitlines()) == 1
    with shown(tmp_path / "mask.png") as page:
        assert (
            main(
                [
                    "setup",
                    "mask",
                    str(tmp_path / "a.tif"),
                    "-o",
                    str(tmp_path / "m.png"),
                    "--port",
                    str(page.access.port),
                ]
            )
            == USAGE
        )
        assert "the page cannot be shown: Address already in use" in capsys.readouterr().err
