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

LENGTHS = 0, 1, 125, 126, 127, 4096, 65535, 65536, 2**31, 2**62, 2**64 - 1
WISHES: tuple[Any, ...] = (
    None, True, -1, 1e308, float("nan"), float("inf"), 10**300, "x" * 3000, "\ud800", "ß∑𝄞", [], {}, [[]],
    [None] * 900, [0.5, float("nan")], [1, 2, 3], [2**70, -(2**70), 1], {"raw": [1, 0]},
    {"raw": [float("-inf"), 10**200]},
)  # fmt: skip
KEYS = "token", "wanted", "part", "columns", "room_px", "now", "drawn", "", "\udfff"


def request(rng: np.random.Generator, port: int, is_ours: bool) -> bytes:
    """A request for the socket, or one that is wrong somewhere."""
    good = {
        "Host": f"127.0.0.1:{port}", "Origin": f"http://127.0.0.1:{port}", "Upgrade": "websocket",
        "Connection": "Upgrade", "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version": "13",
    }  # fmt: skip
    line = "GET /frames HTTP/1.1"
    if not is_ours:
        wrong = (
            "",
            "x",
            "evil.example",
            "\x00",
            "ÿé",
            "x" * 9000,
            "-1",
            "99999999999999999999",
            "a\r\nB: c",
            "13, 13",
        )
        for _ in range(rng.integers(1, 4)):
            name = str(rng.choice([*good, "Content-Length", "Transfer-Encoding", "Cookie", "X" * 9000, ":", "é"]))
            good[name] = str(rng.choice(wrong))
        if rng.random() < 0.3:
            del good[str(rng.choice(list(good)))]
        lines = ("GET / HTTP/1.1", "GET /%00%ff HTTP/1.1", "POST /frames HTTP/1.1", "GET  HTTP/9", "\x16\x03", "",
                 "GET /" + "a" * 70_000 + " HTTP/1.1", "GET http://[::1/ HTTP/1.1", line)  # fmt: skip
        line = str(rng.choice(lines))
    many = [f"X-{number}: y" for number in range(300)] if rng.random() < 0.05 else []
    head = "\r\n".join([line, *(f"{name}: {value}" for name, value in good.items()), *many, "", ""])
    return head.encode("utf-8", "replace")


def frame(
    data: bytes, opcode: int = 1, first: int = 0x80, length: int | None = None, masked: bool = True
) -> bytes:
    """A frame as a browser sends it, or one that says another length than it has."""
    length = len(data) if length is None else length
    size = (
        struct.pack(">B", length | masked << 7) if length < 126
        else struct.pack(">BH", 126 | masked << 7, length) if length < 65536
        else struct.pack(">BQ", 127 | masked << 7, length)
    )  # fmt: skip
    return bytes([first | opcode]) + size + (bytes(4) if masked else b"") + data


def nonsense(rng: np.random.Generator, token: str) -> bytes:
    """A frame after a handshake that was right."""
    kind = rng.integers(7)
    noise = rng.bytes(int(rng.integers(300)))
    if kind == 0:
        return noise
    if kind == 1:
        return frame(noise, int(rng.integers(16)), int(rng.integers(16)) << 4, masked=bool(rng.integers(2)))
    if kind == 2:
        return frame(noise, length=int(LENGTHS[rng.integers(len(LENGTHS))]))
    if kind == 3:
        return frame(noise, opcode=8)  # a farewell of no known kind
    deep = int(rng.integers(1, 1900))
    wish = WISHES[rng.integers(len(WISHES))]
    said = json.dumps({KEYS[rng.integers(len(KEYS))]: wish} | ({"token": token} if kind < 6 else {}))
    text = said if kind < 6 else '{"token": ' + "[" * deep + "]" * deep + "}"
    return frame(text.encode()[:4000])


def sent(rng: np.random.Generator, port: int, token: str) -> socket.socket:
    """Send something random to the server; its socket, which may be open still."""
    found = socket.create_connection(("127.0.0.1", port), timeout=5.0)
    with suppress(OSError):
        kind = rng.random()
        if kind < 0.15:
            found.sendall(rng.bytes(int(rng.integers(1, 5000))))
        else:
            asked = request(rng, port, is_ours=kind > 0.5)
            cut = int(rng.integers(len(asked))) if rng.random() < 0.15 else len(asked)
            found.sendall(asked[:cut])  # and the rest never
            if kind > 0.5 and cut == len(asked):
                found.recv(4096)
                if rng.random() < 0.5:
                    found.sendall(frame(json.dumps({"token": token}).encode()))
                for _ in range(rng.integers(1, 5)):
                    found.sendall(nonsense(rng, token))
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


@pytest.mark.parametrize("count", [100, pytest.param(2000, marks=pytest.mark.slow)])
def test_nonsense_leaves_no_trace_and_viewers_are_served(count: int, capfd: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(count)
    with LivePage(BYTES) as page:
        server, token = page.server_pid, page.url.split("#")[1]
        shown_once(page, 1)
        before_mb, left = 0.0, []
        for number in range(count):
            if number == count // 2:
                before_mb = memory_mb(server)
            left.append(sent(rng, page.port, token))
            while len(left) > 40:
                left.pop(0).close()
        with viewer(page) as found:  # while 40 sockets are open still, silent or in the middle of a word
            words, pictures = taken(found)
            assert (words["number"], len(pictures)) == (1, 2)
        for one in left:
            one.close()
        grown_mb = memory_mb(server) - before_mb
        assert page.server_pid == server
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")
    print(f"{grown_mb:.1f} MB more after {count - count // 2} inputs")
    assert grown_mb < 40.0  # bounded: 170 MB in all after 3000 as after 5000


def test_a_viewer_who_looks_everywhere_in_one_picture_fills_no_memory() -> None:
    with LivePage(BYTES) as page:
        shown_once(page, 1)
        with viewer(page) as found:
            taken(found)
            begun_mb = memory_mb(page.server_pid)
            for left in range(60):
                found.send("{}")
                found.send(json.dumps({"now": True, "part": [left, 0, 940]}))
                taken(found)
            assert memory_mb(page.server_pid) - begun_mb < 60.0  # 200 MB were sent


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
