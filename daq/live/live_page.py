"""Start the page, and show it snapshots: the side of the measurement, which never waits for viewers.

A server that dies is started again under the same address, and pages that are open find it by themselves. What is
done while no frame comes, and how it ended, goes to the server as lines on its input; a line for which there is no
room there, because the server is stuck, is dropped. An input that ends without a last word: it was killed.

A run is shown as often as eyes like while it keeps up, less when the computer has too much to do (`RateLimiter`).
A frame that is not corrected while the run goes on is the first thing that a full computer leaves out, and a page,
whose browser may draw on the same cores, is the first thing that can do with less.  So once a second the rate goes
down by a third if more than `BEHIND` of the frames were left out, to `LEAST_HZ`, and up by one if not.  While
there is no viewer, one frame a second is shown, so that a new viewer has a picture at once.

Frames come when they come: one that comes late is made up for by the next, so that of 20 frames a second 12 are
shown, and not every other one.
"""

import json
import math
import os
import secrets
import subprocess
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from importlib.util import find_spec
from types import TracebackType
from typing import IO, Any, Self

from numpy.typing import NDArray

from correction.target import Chessboard
from daq.child import child
from daq.errors import DaqError
from daq.pipeline.live_slot import SlotWriter
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene

MOST_HZ, LEAST_HZ, IDLE_HZ = 12.0, 2.0, 1.0
BEHIND = 0.25
CHECK_S = 1.0
SLOWER, FASTER_HZ = 0.7, 1.0


class RateLimiter:
    """Says when the next snapshot is due."""

    def __init__(self) -> None:
        self.most_hz = MOST_HZ
        self._from_s = -math.inf
        self._checked_s, self._done, self._left_out = -math.inf, 0, 0

    def is_due(self, now_s: float, is_watched: bool) -> bool:
        """Return whether a frame is to be shown now.

        Parameters
        ----------
        now_s : float
            On any clock that only goes forward.
        is_watched : bool
            Whether there is a viewer.
        """
        return now_s - self._from_s >= self._period_s(is_watched)

    def note_shown(self, now_s: float, is_watched: bool) -> None:
        """Say that one was shown."""
        period_s = self._period_s(is_watched)
        self._from_s = max(self._from_s + period_s, now_s - period_s)

    def see(self, now_s: float, done: int, left_out: int) -> None:
        """Look at how many frames have been corrected so far, and how many left out."""
        if now_s - self._checked_s < CHECK_S:
            return
        new, lost = done - self._done, left_out - self._left_out
        self._checked_s, self._done, self._left_out = now_s, done, left_out
        if lost > BEHIND * (new + lost):
            self.most_hz = max(LEAST_HZ, SLOWER * self.most_hz)
        else:
            self.most_hz = min(MOST_HZ, self.most_hz + FASTER_HZ)

    @property
    def sentence(self) -> str:
        """Notice for viewers; "" if there is none."""
        if self.most_hz == MOST_HZ:
            return ""
        return f"at most {self.most_hz:.0f} a second: this computer has too much to do"

    def _period_s(self, is_watched: bool) -> float:
        return 1.0 / (self.most_hz if is_watched else IDLE_HZ)


ENDS_S = 2.0
# until a server that died is started again, at first and when it dies again at once
AGAIN_S, SELDOM_S = 0.2, 20.0
MOST_CHARACTERS = 1000  # of why it has stopped
BYTES_PER_PX = 12  # of a snapshot: a frame, and its correction on a plane of up to twice its pixels


class PageError(DaqError):
    """The page cannot be shown; the run could go on without it."""


class LivePage:
    """A page, its server and the place where both find the frames; a context manager.

    Parameters
    ----------
    most_bytes : int
        Bytes of the pictures of a snapshot together.
    port : int
        Where it listens on this computer; 0 takes a free one.
    scene : Scene, optional
        Whose glass is looked for in the frames; not without it.
    board : Chessboard, optional
        What frames of a chessboard show.

    Raises
    ------
    PageError
        The extra is not installed, or the port is taken.
    """

    def __init__(
        self, most_bytes: int, port: int = 0, scene: Scene | None = None, board: Chessboard | None = None
    ) -> None:
        if find_spec("websockets") is None:
            raise PageError("the page needs an extra: pip install 'rtpiv[live]'")
        self._slot = SlotWriter(most_bytes)
        self._token = secrets.token_urlsafe(24)
        self.rate_limiter = RateLimiter()
        self._orders: dict[str, Any] = {"token": self._token}
        if scene is not None and board is not None:
            self._orders |= {"scene": dump_scene(scene), "board": asdict(board)}
        self._server: subprocess.Popen[bytes] | None = None
        self._input: IO[bytes] | None = None  # of a server that has its orders
        self._doing, self._over = "", threading.Event()
        self._starts = threading.Lock()
        self.say("starting")
        self._keeper = threading.Thread(target=self._keep, name="page", daemon=True)
        try:
            self.port = self._start_server(port)
        except BaseException:
            self.close()
            raise
        self._keeper.start()

    def __enter__(self) -> Self:
        """Show the page until the end of the block."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End it, and tell viewers why."""
        if error is None:
            self.close()
        else:
            self.close(
                f"stopped: {str(error)[:MOST_CHARACTERS]}" if isinstance(error, Exception) else "stopped by hand"
            )

    @property
    def url(self) -> str:
        """Address for a browser; what stands behind the # lets it in."""
        return f"http://127.0.0.1:{self.port}/#{self._token}"

    @property
    def server_pid(self) -> int:
        """Process of the server."""
        assert self._server is not None
        return self._server.pid

    @property
    def is_due(self) -> bool:
        """True if a snapshot would be shown now."""
        return self.rate_limiter.is_due(time.monotonic(), self._slot.is_watched)

    def show(self, words: Mapping[str, Any], pictures: Mapping[str, NDArray[Any]]) -> None:
        """Show a snapshot, unless the last one is too young to have been seen."""
        if self.is_due:
            self.rate_limiter.note_shown(time.monotonic(), self._slot.is_watched)
            self._slot.put(words, pictures)

    def say(self, doing: str) -> None:
        """Say what is done now; a page without a new picture shows it, with how long it has lasted."""
        if doing != self._doing:
            self._doing = doing
            self._orders["doing"] = [doing, time.monotonic_ns()]
            self._tell({"doing": self._orders["doing"]})

    def close(self, why: str = "ended") -> None:
        """Take the page down: viewers learn why."""
        self._tell({"over": why})
        with self._starts:  # from here on none is started
            self._over.set()
        self._slot.close()
        if self._server is None:
            return
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        with suppress(OSError):
            self._server.stdin.close()
        try:
            self._server.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            self._server.kill()
            self._server.wait()
        if self._keeper.ident is not None:
            self._keeper.join()
        self._server.stdout.close()

    def _keep(self) -> None:
        """Start the server again when it has died."""
        pause_s, begun_s = AGAIN_S, time.monotonic()
        while True:
            assert self._server is not None
            self._server.wait()
            pause_s = AGAIN_S if time.monotonic() - begun_s > SELDOM_S else min(2.0 * pause_s, SELDOM_S)
            if self._over.wait(pause_s):
                return
            begun_s = time.monotonic()
            with suppress(PageError, OSError):  # its port is taken, or no process can be started: once more, later
                self._start_server(self.port)

    def _start_server(self, port: int) -> int:
        """Start the server; the port on which it listens."""
        command, environment = child("daq.live.serve", str(self._slot.path))
        pipe = subprocess.PIPE
        with self._starts:
            if self._over.is_set():
                return port
            before, self._input = self._server, None
            for stream in () if before is None else (before.stdin, before.stdout):
                assert stream is not None
                stream.close()
            server = self._server = subprocess.Popen(
                command, bufsize=0, env=environment, stdin=pipe, stdout=pipe, start_new_session=True
            )
        assert server.stdin is not None
        assert server.stdout is not None
        with suppress(OSError, ValueError):
            server.stdin.write(json.dumps(self._orders | {"port": port}).encode() + b"\n")
        try:
            said = json.loads(server.stdout.readline())
        except ValueError:
            said = {}
        if "port" not in said:
            raise PageError(f"the page cannot be shown: {said.get('error', 'its server did not start')}")
        if os.name == "posix":  # elsewhere a server that hangs makes its run wait
            os.set_blocking(server.stdin.fileno(), False)
        self._input = server.stdin
        self._tell({"doing": self._orders["doing"]})  # it may have changed meanwhile
        return int(said["port"])

    def _tell(self, words: Mapping[str, Any]) -> None:
        """Tell the server, if it lives and listens."""
        with self._starts, suppress(OSError, ValueError):  # it is gone, it is stuck, its input is closed
            if self._input is not None:
                self._input.write(json.dumps(dict(words)).encode() + b"\n")
