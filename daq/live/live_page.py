"""Start the page, and show it moments: for whoever measures, who is told nothing of viewers and waits for none."""

import json
import secrets
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import find_spec
from types import TracebackType
from typing import Any, Self

from numpy.typing import NDArray

from correction.board import Chessboard
from daq.acquisition.pipeline.live_slot import SlotWriter
from daq.child import child
from daq.errors import DaqError
from daq.live.pace import Pace
from tracer.scene import Scene
from tracer.scene_file import dump_scene

ENDS_S = 2.0
BYTES_PER_PX = 12  # of a moment: a frame, and its correction on a plane of up to twice its pixels


class PageError(DaqError):
    """The page cannot be shown; the run could go on without it."""


class LivePage:
    """A page, its server and the place where both find the frames; a context manager.

    Parameters
    ----------
    most_bytes : int
        Bytes of the pictures of a moment together.
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
        self.pace = Pace()
        command, environment = child("daq.live.serve", str(self._slot.path))
        self._server = subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            orders: dict[str, Any] = {"token": self._token, "port": port}
            if scene is not None and board is not None:
                orders |= {"scene": dump_scene(scene), "board_mm": [board.square_mm, board.disc_mm]}
            self.port = self._said(orders)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        """Show the page until the end of the block."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End it."""
        self.close()

    @property
    def url(self) -> str:
        """Address for a browser; what stands behind the # lets it in."""
        return f"http://127.0.0.1:{self.port}/#{self._token}"

    @property
    def server_pid(self) -> int:
        """Process of the server."""
        return self._server.pid

    @property
    def is_due(self) -> bool:
        """Whether a moment would be shown now."""
        return self.pace.is_due(time.monotonic(), self._slot.is_watched)

    def show(self, words: Mapping[str, Any], pictures: Mapping[str, NDArray[Any]]) -> None:
        """Show a moment, unless the last one is too young for anybody to have seen it."""
        if self.is_due:
            self.pace.shown(time.monotonic(), self._slot.is_watched)
            self._slot.put(words, pictures)

    def close(self) -> None:
        """Take the page down: viewers are told that it is over."""
        self._slot.close()
        if self._server.stdin is not None:
            with suppress(OSError):
                self._server.stdin.close()
        try:
            self._server.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            self._server.kill()
            self._server.wait()
        if self._server.stdout is not None:
            self._server.stdout.close()

    def _said(self, orders: Mapping[str, Any]) -> int:
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        with suppress(OSError):
            self._server.stdin.write(json.dumps(dict(orders)) + "\n")
            self._server.stdin.flush()
        line = self._server.stdout.readline()
        try:
            said = json.loads(line)
        except ValueError:
            said = {}
        if "port" not in said:
            raise PageError(f"the page cannot be shown: {said.get('error', 'its server did not start')}")
        return int(said["port"])
