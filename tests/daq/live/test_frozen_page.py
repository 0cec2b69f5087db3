"""The page of a run that stands still, and of a server that is killed: neither looks as if it went on."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress

import pytest

pytest.importorskip("websockets")
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import connect

from daq.live.live_page import LivePage
from rtpiv.command_line.cli import main
from tests.daq.live.chromium import chromium, tab_at
from tests.daq.live.test_page import SIDE, snapshot, taken, until_closed, viewer

BYTES = 2 * 6 * SIDE * SIDE
STATE = "(document.getElementById('state')?.textContent ?? '')"
AGE = "(document.getElementById('age')?.hidden === false && document.getElementById('age').textContent)"
PROGRAM = f"""
import sys
from daq.live.live_page import LivePage
from tests.daq.live.test_page import snapshot
with LivePage({BYTES}) as page:
    page.show(*snapshot(1))
    print(page.url, flush=True)
    sys.stdin.readline()
    raise ValueError("the camera was pulled out")
"""


def shown_once(page: LivePage, number: int) -> None:
    while not page.is_due:
        time.sleep(0.01)
    page.show(*snapshot(number))


@pytest.mark.slow
@pytest.mark.skipif(chromium() is None, reason="there is no Chromium on this computer")
def test_a_page_says_what_is_waited_for_and_how_old_its_picture_is_and_draws_what_is_chosen_at_once() -> None:
    with LivePage(BYTES) as page, tab_at(page.url) as tab:
        page.say("homing glass_y")
        tab.until(f"{STATE}.startsWith('no picture yet: homing glass_y, for ')")
        page.say("waiting for the camera's first frame")
        tab.until(f'{STATE} === "no picture yet: waiting for the camera\'s first frame, for 2 s"')
        shown_once(page, 1)
        shown_s = time.monotonic()
        page.say("exposing")
        tab.until("window.rtpivLive && rtpivLive.drawn >= 1 && document.getElementById('age').hidden")
        tab.until(f"{AGE} === 'this picture is 2 s old'")
        assert time.monotonic() - shown_s < 3.0  # 2.0 s, and half a second between two looks
        page.say("paused")
        tab.until(f"{STATE}.startsWith('paused, for ')")
        frozen = tab.value("rtpivLive.words.number")
        tab.value("document.querySelector('[data-mode=raw]').click()")
        assert tab.value("document.getElementById('corrected').hidden && !document.getElementById('raw').hidden")
        grey = "document.getElementById('raw').getContext('2d').getImageData(5, 5, 1, 1).data[0]"
        before = tab.value(grey)
        tab.value("(() => { const high = document.getElementById('high'); high.value = 200; high.oninput(); })()")
        assert tab.value(grey) != before  # drawn by the slider, not by a frame
        tab.value("document.querySelector('[data-mode=blink]').click()")
        for name in ("raw", "corrected", "raw"):
            tab.until(f"!document.getElementById('{name}').hidden")
        tab.value("document.getElementById('stage').ondblclick({clientX: 300, clientY: 300})")
        tab.until("rtpivLive.shown.raw.width < 600")  # the part is another one, of the same snapshot
        assert tab.value("rtpivLive.words.number") == frozen
        old_s = time.monotonic() - shown_s
        tab.ask("Page.reload")  # whoever comes late is told how old it is all the same
        tab.until("window.rtpivLive && rtpivLive.drawn >= 1")
        tab.until(f"parseInt(({AGE} || '').replace('this picture is ', '')) >= {int(old_s)}")


@pytest.mark.slow
@pytest.mark.skipif(chromium() is None, reason="there is no Chromium on this computer")
def test_a_page_finds_its_server_again_and_knows_it_from_a_run_that_is_gone() -> None:
    with LivePage(BYTES) as page, tab_at(page.url) as tab:
        shown_once(page, 1)
        tab.until("window.rtpivLive && rtpivLive.drawn >= 1")
        killed = page.server_pid
        os.kill(killed, signal.SIGKILL)
        tab.until(f"{STATE}.startsWith('the server of this page has said nothing for ')")
        shown_once(page, 2)
        tab.until("rtpivLive.words.number === 2 && rtpivLive.drawn >= 2")  # the page was not loaded again
        assert page.server_pid != killed
        os.kill(page.server_pid, signal.SIGSTOP)  # it is stuck: the same for who looks, and nothing for the run
        tab.until(f"{STATE}.startsWith('the server of this page has said nothing for ')")
        for number in range(3000):
            page.say(f"step {number}")
        os.kill(page.server_pid, signal.SIGCONT)
        tab.until(f"{STATE}.startsWith('step ')")
        tab.until(f"{AGE}.startsWith('this picture is ')")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ends", "said"), [("killed", "killed: its program is gone"), ("fails", "stopped: the camera was pulled out")]
)
@pytest.mark.skipif(chromium() is None, reason="there is no Chromium on this computer")
def test_a_page_says_that_its_run_was_killed_or_why_it_stopped(ends: str, said: str) -> None:
    command = [sys.executable, "-c", PROGRAM]
    pipe = subprocess.PIPE
    program = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True)
    assert program.stdin is not None
    assert program.stdout is not None
    try:
        with tab_at(program.stdout.readline().strip()) as tab:
            tab.until("window.rtpivLive && rtpivLive.drawn >= 1")
            if ends == "killed":
                program.kill()
            else:
                program.stdin.write("\n")
                program.stdin.flush()
            tab.until(f"{STATE} === '{said}'")
            time.sleep(2.0)
            assert tab.value(STATE) == said  # and stays so: nobody tries to reach what is gone
    finally:
        program.kill()
        program.wait()
        program.stdin.close()
        program.stdout.close()


@pytest.mark.slow
def test_a_server_that_dies_is_started_again_under_the_same_address() -> None:
    with LivePage(BYTES) as page:
        killed, url = page.server_pid, page.url
        page.say("paused")
        shown_once(page, 1)
        os.kill(killed, signal.SIGKILL)
        end_s = time.monotonic() + 60.0
        while True:
            assert time.monotonic() < end_s
            with suppress(OSError, WebSocketException), viewer(page) as found:
                words, pictures = taken(found)
                break
            time.sleep(0.05)
        assert (page.url, page.server_pid != killed) == (url, True)
        assert (words["number"], len(pictures), words["doing"]) == (1, 2, "paused")
        assert words["age_s"] <= words["doing_s"] < 60.0
        path = page._slot.path
    assert not path.exists()


def test_what_is_wished_out_of_turn_is_answered_with_the_same_moment() -> None:
    with LivePage(BYTES) as page, viewer(page) as found:
        while not page.is_due:
            pass
        page.show(*snapshot(1))
        words, _ = taken(found)
        found.send(json.dumps({"drawn": words["number"]}))
        found.send(json.dumps({"now": True, "wanted": ["raw"]}))
        again, pictures = taken(found)
        assert again["number"] == words["number"]
        assert again["shown"] == ["raw"]
        assert len(pictures) == 1


def test_a_token_that_is_no_text_is_refused_without_a_trace(capfd: pytest.CaptureFixture[str]) -> None:
    with LivePage(BYTES) as page, viewer(page, token="\ud800") as found, pytest.raises(ConnectionClosed) as ended:
        until_closed(found)
    assert ended.value.rcvd is not None
    assert ended.value.rcvd.reason == "open the address that the run has printed"
    assert "Traceback" not in capfd.readouterr().err


def test_sockets_without_a_token_keep_no_viewer_out() -> None:
    with LivePage(BYTES) as page:
        origin, address = f"http://127.0.0.1:{page.port}", f"ws://127.0.0.1:{page.port}/frames"
        silent = [connect(address, origin=origin, compression=None) for _ in range(70)]
        with viewer(page) as found:
            while not page.is_due:
                pass
            page.show(*snapshot(1))
            words, _ = taken(found)
            assert words["number"] == 1
        for one in silent:
            one.socket.close()


def test_a_port_that_cannot_be_is_a_slip_of_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", "live", "--bench", "bench.yaml", "--port", "70000"])
    assert ended.value.code == 2
    assert "should be 0 to 65535, not '70000'" in capsys.readouterr().err
