"""The page of a run that stands still, and of a server that is killed: neither looks as if it went on."""

import json
import os
import signal

import pytest

pytest.importorskip("websockets")
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from daq.cli import main
from daq.live.live_page import LivePage
from tests.daq.live.chromium import chromium, tab_at
from tests.daq.live.test_page import SIDE, moment, taken, until_closed, viewer

BYTES = 2 * 6 * SIDE * SIDE
STATE = "(document.getElementById('state')?.textContent ?? '')"


@pytest.mark.skipif(chromium() is None, reason="there is no Chromium on this computer")
def test_buttons_draw_at_once_and_the_age_is_said_while_nothing_comes() -> None:
    with LivePage(BYTES) as page, tab_at(page.url) as tab:
        tab.until(f"{STATE}.startsWith('waiting for the first frame for ')")
        tab.until("rtpivLive.drawn === 0 && document.readyState === 'complete'")
        while not page.is_due:
            pass
        page.show(*moment(1))
        tab.until("rtpivLive.drawn >= 1")
        tab.until(f"{STATE}.startsWith('no new picture for ')", 10.0)
        frozen = tab.value("rtpivLive.words.number")
        tab.value("document.querySelector('[data-mode=raw]').click()")
        assert tab.value("document.getElementById('corrected').hidden && !document.getElementById('raw').hidden")
        tab.value("document.getElementById('stage').ondblclick({clientX: 300, clientY: 300})")
        tab.until("rtpivLive.shown.raw.width < 600")  # the part is another one, of the same moment
        assert tab.value("rtpivLive.words.number") == frozen
        os.kill(page.server_pid, signal.SIGKILL)
        tab.until(f"{STATE}.startsWith('the page has lost the run for ')", 10.0)


def test_what_is_wished_out_of_turn_is_answered_with_the_same_moment() -> None:
    with LivePage(BYTES) as page, viewer(page) as found:
        while not page.is_due:
            pass
        page.show(*moment(1))
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
            page.show(*moment(1))
            words, _ = taken(found)
            assert words["number"] == 1
        for one in silent:
            one.socket.close()


def test_a_port_that_cannot_be_is_a_slip_of_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["live", "--bench", "bench.yaml", "--port", "70000"])
    assert ended.value.code == 2
    assert "should be 0 to 65535, not '70000'" in capsys.readouterr().err
