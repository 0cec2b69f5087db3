"""The live page in a real browser, and whoever has no business with it."""

import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.slow_cases import slow_but

pytest.importorskip("websockets")
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from daq.child import child
from daq.live.live_page import LivePage
from daq.live.picture import HEAD
from daq.pipeline.live_slot import SlotWriter
from tests.correction.alignment.drawn import BOARD, scene_of
from tests.daq.live.chromium import chromium, tab_at

SIDE = 1008
EVIL = "<img src=x onerror='window.hit=1'><script>window.hit=1</script>"


def snapshot(number: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A snapshot as a run shows it: particles, one saturated square, and a corrected half."""
    rng = np.random.default_rng(number % 4)
    raw = rng.integers(90, 130, (SIDE, SIDE)).astype(np.uint16)
    raw[100:110, 200:210] = 4095
    raw[::16, ::16] = 1200
    corrected = raw.astype(np.float32)
    corrected[:, : SIDE // 4] = np.nan
    counters = {"frames": [str(number), False], "lost": ["3", True], "focus": ["turn back", False]}
    line = [[200.0, 200.0], [800.0, 200.0], [500.0, 700.0]]
    words = {"run": EVIL, "doing": "step 1", "bits": 12, "counters": counters, "laser": ["firing", True]}
    words["lines"] = {name: {"lines": [[EVIL, line]], "cross": [504.0, 504.0]} for name in ("raw", "corrected")}
    words["arrows"] = [[900.0, 900.0, 10.0, 0.0]]
    return words, {"raw": raw, "corrected": corrected}


class Showing:
    """Somebody who measures at a rate, and shows what there is."""

    def __init__(self, page: LivePage, rate_hz: float) -> None:
        self.page, self._snapshots = page, [snapshot(number) for number in range(4)]
        self.shown, self._ends, self._period_s = 0, threading.Event(), 1.0 / rate_hz
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        while not self._ends.wait(self._period_s):
            self.page.show(*self._snapshots[self.shown % 4])
            self.shown += 1

    def end(self) -> None:
        self._ends.set()
        self._thread.join()


@contextmanager
def showing(rate_hz: float = 20.0) -> Iterator[Showing]:
    with LivePage(2 * 6 * SIDE * SIDE) as page:
        measures = Showing(page, rate_hz)
        try:
            yield measures
        finally:
            measures.end()


@pytest.fixture(scope="module")
def measures() -> Iterator[Showing]:
    with showing() as found:
        yield found


@contextmanager
def viewer(page: LivePage, token: str | None = None, **options: Any) -> Iterator[ClientConnection]:
    """A viewer with the token, or another one; how long a busy computer takes to let it in is not judged."""
    options = {"origin": f"http://127.0.0.1:{page.port}", "open_timeout": 60.0, "close_timeout": 0.5} | options
    address = f"ws://127.0.0.1:{page.port}/frames"
    with connect(address, compression=None, max_size=None, **options) as found:
        found.send(json.dumps({"token": page.url.split("#")[1] if token is None else token}))
        yield found


def until_closed(found: ClientConnection) -> None:
    """Take what comes; ConnectionClosed in the end."""
    while True:
        found.recv(timeout=20.0)


def taken(found: ClientConnection) -> tuple[dict[str, Any], list[bytes]]:
    """Words and pictures of the next snapshot; signs of life between are let go."""
    words: dict[str, Any] = {}
    while "number" not in words:
        words = json.loads(found.recv(timeout=20.0))
    return words, [bytes(found.recv(timeout=20.0)) for _ in words.get("shown", ())]


@pytest.mark.skipif(chromium() is None, reason="there is no Chromium on this computer")
def test_a_browser_shows_frames(measures: Showing) -> None:
    with tab_at(measures.page.url) as tab:
        tab.ask("Emulation.setDeviceMetricsOverride", width=1600, height=1300, deviceScaleFactor=1, mobile=False)
        tab.until("window.rtpivLive && window.rtpivLive.drawn > 5")
        assert tab.value("window.rtpivLive.first_ms") < 5000.0  # 1 s on a quiet computer
        begun, begun_s = tab.value("window.rtpivLive.drawn"), time.monotonic()
        time.sleep(2.0)
        rate_hz = (tab.value("window.rtpivLive.drawn") - begun) / (time.monotonic() - begun_s)
        print(f"first picture after {tab.value('window.rtpivLive.first_ms'):.0f} ms, {rate_hz:.1f} a second")
        assert rate_hz > 1.0
        # a name with script in it is text
        assert tab.value("document.getElementById('run').textContent") == EVIL
        assert tab.value("window.hit") is None
        # saturated pixels are red, particles are not, what is not recovered is dark blue
        # one canvas lies beside the other, no wider than its share; in split mode together they are one picture
        widths = "['raw', 'corrected'].map((id) => document.getElementById(id).width)"
        assert tab.value(widths) == [SIDE // 2, SIDE // 2]
        colour = "[...document.getElementById('%s').getContext('2d').getImageData(%d, %d, 1, 1).data]"
        whole = "!document.getElementById('%s').hidden && document.getElementById('%s').width === 1008"
        tab.value("document.querySelector('[data-mode=raw]').click()")
        tab.until(whole % ("raw", "raw"))
        assert tab.value(colour % ("raw", 205, 105)) == [255, 32, 32, 255]
        red, green, blue, _ = tab.value(colour % ("raw", 208, 208))
        assert red == green == blue > 200
        tab.value("document.querySelector('[data-mode=corrected]').click()")
        tab.until(whole % ("corrected", "corrected"))
        assert tab.value(colour % ("corrected", 100, 500)) == [16, 32, 64, 255]
        assert "wrong" in tab.value("document.getElementById('counters').innerHTML")
        tab.until(
            "document.getElementById('advice').textContent.length > 0 || window.rtpivLive.words.figures.maps"
        )
        # what a person at the ring reads is no row of the table
        assert tab.value("document.getElementById('focus').textContent").startswith("focus ")
        assert "focus" not in tab.value("document.getElementById('counters').textContent")
        assert tab.value("document.getElementById('laser')?.textContent") == "laser firing"
        assert tab.value("document.getElementById('laser').className") == "wrong"
        drawn = (
            "(() => { const c = document.getElementById('marks'), pen = c.getContext('2d'); let n = 0;"
            " const d = pen.getImageData(0, 0, c.width, c.height).data;"
            " for (let i = 0; i < d.length; i += 4) if (d[i + 3] && d[i] %s 150) n += 1; return n; })()"
        )
        tab.until(f"{drawn % '>'} > 20")  # the arrow is yellow
        assert tab.value(drawn % "<") > 500  # outline and cross are blue
        for key in ("o", "v"):
            tab.value(f"document.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}'}}))")
        tab.until(f"{drawn % '>'} + {drawn % '<'} === 0")
        assert "displacements of the last pair" in tab.value("document.getElementById('moved').textContent")
        tab.value("document.dispatchEvent(new KeyboardEvent('keydown', {key: 'b'}))")
        tab.until("window.rtpivLive.view.mode === 'blink'")


@pytest.mark.skipif(chromium() is None, reason="there is no Chromium on this computer")
def test_a_laser_is_unknown_once_its_run_has_ended() -> None:
    with ExitStack() as stack:
        with showing() as measures:
            tab = stack.enter_context(tab_at(measures.page.url))
            tab.until("document.getElementById('laser')?.textContent === 'laser firing'")
        tab.until("document.getElementById('laser')?.textContent === 'laser unknown: rtpiv laser off'")
        assert tab.value("document.getElementById('laser').className") == "wrong"


def test_what_others_ask_is_refused(measures: Showing) -> None:
    port = measures.page.port

    def status(method: str, path: str, host: str) -> int:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
        try:
            connection.putrequest(method, path, skip_host=True)
            connection.putheader("Host", host)
            connection.endheaders()
            return connection.getresponse().status
        except (http.client.HTTPException, OSError):
            return 0  # cut off
        finally:
            connection.close()

    good = f"127.0.0.1:{port}"
    assert status("GET", "/", good) == 200
    assert status("GET", "/page.js", f"localhost:{port}") == 200
    assert status("GET", "/", f"evil.example:{port}") == 403
    assert status("GET", "/", "127.0.0.1") == 403
    assert status("GET", "/../serve.py", good) == 404
    assert status("GET", "/page/index.html", good) == 404
    for method in ("POST", "PUT", "DELETE", "OPTIONS"):
        assert status(method, "/", good) != 200
    for origin in ("http://evil.example", None, "null", f"https://127.0.0.1:{port}"):
        with pytest.raises(InvalidStatus) as refused, viewer(measures.page, origin=origin):
            pass
        assert refused.value.response.status_code == 403
    for token in ("", "x" * 32, measures.page.url.split("#")[1][:-1]):
        with viewer(measures.page, token) as found:
            with pytest.raises(ConnectionClosed):
                found.recv(timeout=20.0)
            assert found.close_code == 1008
    with viewer(measures.page) as found:
        taken(found)
        found.send("x" * 100_000)
        with pytest.raises(ConnectionClosed):
            until_closed(found)


def test_the_page_may_run_nothing_from_elsewhere(measures: Showing) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", measures.page.port, timeout=10.0)
    connection.request("GET", "/")
    answer = connection.getresponse()
    policy, body = answer.headers["Content-Security-Policy"], answer.read().decode()
    connection.close()
    assert "default-src 'self'" in policy
    assert "unsafe" not in policy
    assert "http://" not in body
    assert "https://" not in body
    assert answer.headers["Cache-Control"] == "no-store"


def test_what_a_viewer_missed_is_counted(measures: Showing) -> None:
    with viewer(measures.page) as found:
        first, pictures = taken(found)
        assert first["shown"] == ["raw", "corrected"]
        assert len(pictures[0]) == HEAD.size + 2 * SIDE * SIDE
        got, last = 1, first
        for pause_s in (0.0, 0.5, 0.0, 0.3):
            time.sleep(pause_s)
            found.send(json.dumps({"drawn": last["number"], "wanted": ["raw"], "part": [100, 100, 64]}))
            last, pictures = taken(found)
            got += 1
        assert last["missed"] + got == last["number"] - first["number"] + 1
        assert last["missed"] > 1
        assert len(pictures) == 1
        assert len(pictures[0]) == HEAD.size + 2 * 64 * 64
        for nonsense in (
            "[",
            '{"part": [1, 2]}',
            '{"part": "x", "wanted": 3}',
            "[" * 3000,
            '{"part": [-5, 1e9, 2]}',
        ):
            found.send(nonsense)
            taken(found)


def test_what_seldom_changes_is_sent_when_it_has_and_pictures_fit_the_room() -> None:
    """Lines are those of the view; a viewer with little room gets small pictures, others beside it large ones."""
    scene = scene_of()
    with (
        LivePage(12 * SIDE * SIDE, scene=scene, board=BOARD) as page,
        viewer(page) as found,
        viewer(page) as other,
    ):
        view, last, sent = "glass", 0, {"figures": 0, "arrows": 0}
        lines: dict[str, Any] = {}
        seen: dict[str, dict[str, Any]] = {}
        end_s = time.monotonic() + 40.0
        while len(seen) < 2 and time.monotonic() < end_s:
            words, pictures = snapshot(last)
            words["view"] = view
            del words["lines"]
            page.show(words, pictures)
            time.sleep(0.03)
            if page._slot._count == last:
                continue
            last = page._slot._count
            words, pictures = taken(found)
            assert [len(picture) for picture in pictures] == [
                HEAD.size + 2 * (SIDE // (3 if last > 1 else 1)) ** 2
            ] * 2
            found.send(json.dumps({"drawn": last, "room_px": 390}))
            for name in sent:
                sent[name] += name in words
            lines = words.get("lines", lines)
            if lines:
                seen[view], view = lines, "clear"
                time.sleep(0.3)
        assert last > 2
        assert sent["arrows"] == 1
        assert 1 <= sent["figures"] < last
        assert [name for name, _ in seen["glass"]["raw"]["lines"]] == [ball.name for ball in scene.spheres]
        words, pictures = taken(other)
        assert len(pictures[0]) == HEAD.size + 2 * SIDE**2


@pytest.mark.slow
def test_nobody_copies_while_nobody_looks() -> None:
    with showing() as measures:
        time.sleep(1.6)
        shown = measures.page._slot._count
        assert 1 <= shown <= 3
        with viewer(measures.page) as found:
            taken(found)
            for _ in range(6):
                found.send("{}")
                taken(found)
        assert measures.page._slot._count - shown >= 6
        measures.end()
        with viewer(measures.page) as found:
            taken(found)  # what was shown last, though nothing comes any more


@pytest.mark.slow
def test_stalled_viewers_and_a_killed_page_hold_nobody_up() -> None:
    with showing() as measures, ExitStack() as stack:
        stalled = [stack.enter_context(viewer(measures.page)) for _ in range(20)]
        stack.enter_context(socket.create_connection(("127.0.0.1", measures.page.port)))  # says nothing at all
        time.sleep(0.5)
        before = measures.shown
        time.sleep(0.5)
        assert measures.shown - before > 4
        with viewer(measures.page) as found:
            taken(found)
        os.kill(measures.page.server_pid, signal.SIGKILL)
        before = measures.shown
        time.sleep(0.5)
        assert measures.shown - before > 3
        assert len(stalled) == 20


def test_viewers_are_told_that_it_is_over() -> None:
    with ExitStack() as stack:
        with showing() as measures:
            found = stack.enter_context(viewer(measures.page))
            taken(found)
            path = measures.page._slot.path
            assert path.stat().st_mode & 0o077 == 0
        assert not path.exists()
        with pytest.raises(ConnectionClosed):
            until_closed(found)


def test_whoever_is_killed_leaves_nothing_in_memory(tmp_path: Path) -> None:
    """kill -9 of the program that measures: its server ends, and takes the place of the frames down."""
    text = (
        "import time\nfrom daq.live.live_page import LivePage\n"
        "page = LivePage(1000)\nprint(page._slot.path, page.server_pid, flush=True)\ntime.sleep(60.0)\n"
    )
    program = subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None
    path, server = program.stdout.readline().split()
    assert Path(path).exists()
    program.kill()
    program.wait()
    program.stdout.close()
    end_s = time.monotonic() + 20.0
    while Path(path).exists() or Path(f"/proc/{server}").exists():
        assert time.monotonic() < end_s
        time.sleep(0.05)


@pytest.mark.slow
@pytest.mark.parametrize("heard", slow_but(["all", "half", "nothing"], "half"))
def test_a_server_whose_program_is_killed_as_it_begins_says_nothing_and_gives_memory_back(heard: str) -> None:
    slot = SlotWriter(1000)
    command, environment = child("daq.live.serve", str(slot.path))
    server = subprocess.Popen(
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert server.stdin is not None
    assert server.stdout is not None
    assert server.stderr is not None
    orders = json.dumps({"token": "x", "port": 0}).encode() + b"\n"
    server.stdin.write({"all": orders, "half": orders[:8], "nothing": b""}[heard])
    server.stdin.close()
    server.stdout.close()
    said = server.stderr.read().decode()
    server.stderr.close()
    assert (server.wait(20.0), said) == (0, "")
    assert not slot.path.exists()
