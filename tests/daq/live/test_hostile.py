"""Whoever sends nonsense to the page's server: nothing of it reaches the terminal, and viewers are served on."""

import json
import socket
import struct
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("websockets")

from daq.live.live_page import LivePage
from tests.daq.live.test_frozen_page import BYTES, shown_once
from tests.daq.live.test_page import taken, viewer

WISHES: tuple[Any, ...] = (
    None, True, -1, 1e308, float("nan"), float("inf"), 10**300, "x" * 3000, "\ud800", "ß∑𝄞", [], {}, [[]],
    [None] * 600, [0.5, float("nan")], [1, 2, 3], [2**70, -(2**70), 1], {"raw": [1, 0]},
    {"raw": [float("-inf"), 10**200]},
)  # fmt: skip
KEYS = "token", "wanted", "part", "columns", "room_px", "now", "drawn", "", "\udfff"


HANDSHAKE = (
    b"GET /frames HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nOrigin: http://127.0.0.1:%d\r\nUpgrade: websocket\r\n"
    b"Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


def sent(rng: np.random.Generator, port: int) -> socket.socket:
    """Send noise, or a handshake that is cut off or followed by noise; the socket, which may be open still."""
    found = socket.create_connection(("127.0.0.1", port), timeout=5.0)
    noise, asked = rng.bytes(int(rng.integers(1, 5000))), HANDSHAKE % (port, port)
    with suppress(OSError):
        found.sendall((noise, asked[: rng.integers(len(asked))], asked + noise)[rng.integers(3)])
        end = rng.integers(4)
        if end == 0:
            found.shutdown(socket.SHUT_WR)  # half closed
        elif end == 1:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            found.close()  # reset
        elif end == 2:
            found.close()
    return found


def memory_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS:")).split()[1]) / 1024.0


def test_nonsense_leaves_no_trace_and_viewers_are_served(capfd: pytest.CaptureFixture[str]) -> None:
    rng, left = np.random.default_rng(100), []
    with LivePage(BYTES) as page:
        server = page.server_pid
        shown_once(page, 1)
        for _ in range(60):
            left.append(sent(rng, page.port))
        with viewer(page) as found:  # while sockets are open still, silent or in the middle of a word
            assert taken(found)[0]["number"] == 1
            for key in KEYS:
                for wish in WISHES:
                    found.send(json.dumps({key: wish}))
            found.send('{"token": ' + "[" * 1900 + "]" * 1900 + "}")
            found.send(json.dumps({"now": True}))
            assert taken(found)[0]["number"] == 1
        for one in left:
            one.close()
        assert page.server_pid == server
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")


@pytest.mark.slow
def test_a_viewer_who_looks_everywhere_in_one_picture_fills_no_memory() -> None:
    with LivePage(BYTES) as page:
        shown_once(page, 1)
        with viewer(page) as found:
            taken(found)
            begun_mb = memory_mb(page.server_pid)
            for left in range(20):
                found.send("{}")
                found.send(json.dumps({"now": True, "part": [left, 0, 940]}))
                taken(found)
            assert memory_mb(page.server_pid) - begun_mb < 40.0  # 70 MB were sent


@pytest.mark.slow
def test_more_sockets_than_a_process_may_have_open_do_not_end_the_server() -> None:
    with LivePage(BYTES) as page:
        server = page.server_pid
        shown_once(page, 1)
        for _ in range(3):
            silent = []
            with suppress(OSError):
                silent = [socket.create_connection(("127.0.0.1", page.port), timeout=5.0) for _ in range(900)]
            time.sleep(1.0)
            for one in silent:
                one.close()
        with viewer(page) as found:
            assert taken(found)[0]["number"] == 1
        assert page.server_pid == server
