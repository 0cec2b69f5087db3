"""The page's server: a process of its own, which a stuck browser may hold up as long as it likes.

    slot (another process writes it) --> viewer thread --> WebSocket --> browser --acknowledges--> next snapshot

One thread a viewer: it sends the last snapshot, waits until the browser says that it has drawn it, and takes the
last one again; what came meanwhile is counted and never queued. Pictures are made where the frames lie, as large
as the viewer has room for; what seldom changes is sent when it has. While nothing new comes, twice a second a word
says that the server lives, what the run does and for how long. All of it is of lower priority than the run,
and none of it happens while there is no viewer.

Who is let in: `daq.live.local_page`.  The bench takes no commands through here: there are frames in one
direction and acknowledgements in the other.
"""

import json
import os
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection

from daq.live.frame_quality import FrameQuality
from daq.live.local_page import LocalPage, listening, page_files, parse_message
from daq.live.picture import EVERY, LARGEST_PX, Columns, Part, columns_of, picture_bytes, room_px, white_of
from daq.pipeline.live_slot import NoSlotError, SlotReader, Snapshot
from daq.pipeline.priority import lower_process
from daq.signal_handling import flush_or_leave

if TYPE_CHECKING:
    from daq.live.monitor import Monitor

SOCKET = "/frames"
PAGES = page_files("index.html", "page.js")
MOST_VIEWERS = 64
MOST_KEPT = 16  # pictures, of up to 2 MB
MOST_WORDS = 4096  # bytes of a message from a browser
SNAPSHOT_POLL_S = 0.005  # between two looks into the slot
OVER_S = 0.2  # between two looks whether the run is over
ALIVE_S = 0.5  # between two signs of life
FAREWELL_S = 1.5  # for those who look, on a busy computer; the run waits 2 s for our end
KILLED = "killed: its program is gone"
NAMES = "raw", "corrected"  # of pictures
SELDOM = "lines", "figures", "arrows"  # words that are sent when they have changed
BUSY = 1013  # close code


Key = tuple[int, str, Part, int, Columns]


@dataclass
class ViewRequest:
    """Request of a viewer for the next snapshot."""

    wanted: tuple[str, ...] = NAMES
    part: Part = field(default_factory=Part)
    room_px: int = LARGEST_PX
    columns: dict[str, Columns] = field(default_factory=dict)

    def heard(self, said: dict[str, Any]) -> bool:
        """Take what a browser has said; whether it is said out of turn, before the last snapshot is drawn."""
        self.part, self.room_px = Part.of(said.get("part")), room_px(said.get("room_px"))
        seen = said.get("columns")
        seen = seen if isinstance(seen, dict) else {}
        self.columns = {name: columns_of(seen.get(name)) for name in NAMES}
        asked = said.get("wanted")
        if isinstance(asked, list):
            self.wanted = tuple(name for name in asked[:4] if isinstance(name, str))
        return said.get("now") is True


@dataclass(frozen=True)
class Update:
    """Message about a snapshot: words, and pictures by the place where they are kept for others."""

    number: int
    words: dict[str, Any]
    pictures: dict[Key, bytes]


@dataclass
class Page:
    """State shared by all viewers.

    Parameters
    ----------
    slot : SlotReader
        Where the snapshots are.
    token : str
        What a viewer must know.
    monitors : tuple of Monitor
        What is found out beside.
    lines : dict
        View -> what is drawn over its frames.
    """

    slot: SlotReader
    token: str
    port: int = 0
    monitors: "tuple[Monitor, ...]" = ()
    lines: dict[str, Any] = field(default_factory=dict)
    doing: tuple[str, int] = "", 0
    over: str = ""
    viewers: int = 0
    quality: FrameQuality = field(init=False)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _pictures: dict[Key, bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Judge frames as well."""
        self.quality = FrameQuality(self.slot)

    @property
    def access(self) -> LocalPage:
        """Access rules of the page."""
        return LocalPage(self.token, self.port, SOCKET, PAGES)

    def answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request, see `LocalPage.answer`."""
        return self.access.answer(request)

    def show(self, connection: ServerConnection) -> None:
        """Serve one viewer until it goes."""
        with suppress(ConnectionClosed, TimeoutError):
            said = self.access.let_in(connection)
            if said is None:
                return
            with self._lock:  # a viewer without the token keeps no other out
                self.viewers += 1
                busy = self.viewers > MOST_VIEWERS
            try:
                if busy:
                    connection.close(BUSY, "too many viewers")
                    return
                self._show_snapshots(connection, said)
            finally:
                with self._lock:
                    self.viewers -= 1

    def _show_snapshots(self, connection: ServerConnection, said: dict[str, Any]) -> None:
        seen, missed, request = 0, 0, ViewRequest()
        request.heard(said)
        known: dict[str, Any] = {}
        while (last := self._wait_for_snapshot(seen, connection, request)) is not None:
            seen = last
            update = self.slot.read(lambda snapshot: self._update_for(snapshot, request))
            if update is None or update.number <= seen:
                time.sleep(SNAPSHOT_POLL_S)
                continue
            self._keep(update)
            missed += update.number - seen - 1 if seen else 0
            seen = update.number
            words = update.words | self._doing() | {"missed": missed}
            for name in SELDOM:
                if name in words and words[name] == known.get(name):
                    del words[name]
            known |= {name: words[name] for name in SELDOM if name in words}
            connection.send(json.dumps(words))
            for picture in update.pictures.values():
                connection.send(picture)
            while request.heard(parse_message(connection.recv())):  # it has drawn them, or wants others at once
                pass
        connection.send(json.dumps({"over": self.over}))
        connection.close()

    def _wait_for_snapshot(self, seen: int, connection: ServerConnection, request: ViewRequest) -> int | None:
        """Wait for a snapshot that was not seen, or for a viewer who wants the last one in another way.

        Returns
        -------
        int or None
            Number of the last snapshot that need not be shown again; None when there will be no other.
        """
        alive_s = 0.0
        while not self.over:
            self.slot.ask()
            if self.slot.number != seen:
                return seen
            if time.monotonic() >= alive_s:
                connection.send(json.dumps(self._doing()))
                alive_s = time.monotonic() + ALIVE_S
            with suppress(TimeoutError):
                request.heard(parse_message(connection.recv(timeout=SNAPSHOT_POLL_S)))
                return max(seen - 1, 0)
        return None

    def _doing(self) -> dict[str, Any]:
        """Name of the current work, and its duration."""
        text, since_ns = self.doing
        return {"doing": text, "doing_s": (time.monotonic_ns() - since_ns) / 1e9}

    def _update_for(self, snapshot: Snapshot, request: ViewRequest) -> Update:
        """Make a viewer's update of a snapshot, in the memory where it lies."""
        said, white = snapshot.words, white_of(snapshot.words)
        pictures = {}
        for name in snapshot.pictures:
            if name in request.wanted:
                how = request.part, request.room_px, request.columns.get(name, EVERY)
                key = snapshot.number, name, *how
                pictures[key] = self._pictures.get(key) or picture_bytes(
                    name, snapshot.number, snapshot.pictures[name], white, *how
                )
        counters = dict(said.get("counters", {}))
        for monitor in (self.quality, *self.monitors):
            counters |= monitor.said
        shown: dict[str, Any] = {
            "age_s": (time.monotonic_ns() - snapshot.taken_ns) / 1e9,
            "number": snapshot.number,
        }
        shown |= {"shown": [key[1] for key in pictures], "has": list(snapshot.pictures)}
        seldom = {"lines": self.lines.get(said.get("view", ""), {}), "figures": self.quality.figures, "arrows": []}
        return Update(snapshot.number, seldom | said | shown | {"white": white, "counters": counters}, pictures)

    def _keep(self, update: Update) -> None:
        """Keep pictures for other viewers, of the last snapshot only."""
        with self._lock:
            kept = next(iter(self._pictures), (0,))[0]
            if kept < update.number:
                self._pictures = update.pictures
            elif kept == update.number:
                self._pictures = dict([*self._pictures.items(), *update.pictures.items()][-MOST_KEPT:])


def start_server(slot: Path, token: str, port: int = 0) -> tuple[Server, Page]:
    """Listen on this computer; the server is to be run by `serve_forever`."""
    page = Page(SlotReader(slot), token)
    server = listening(page.show, page.answer, port, MOST_WORDS)
    page.port = server.socket.getsockname()[1]
    page.quality.start()
    return server, page


def _look_at_scene(page: Page, text: str, board: dict[str, Any]) -> None:
    """Draw what a scene says over its frames, and look whether it is so."""
    from daq.live.monitors import begin, board_told, scene_told
    from daq.live.scene_lines import scene_lines

    scene = scene_told(text)
    if scene is None:
        return
    page.lines = scene_lines(scene, whole=False)
    page.monitors = begin(page.slot, scene, board_told(board))
    while not (page.slot.is_watched and page.slot.number):  # the run has compiled then what folds are found with
        if page.slot.is_over:
            return
        time.sleep(OVER_S)
    page.lines = scene_lines(scene, whole=True)


def main() -> int:
    """Serve until the parent process is gone: its words come by our input, which ends with it."""
    lower_process()
    slot = Path(sys.argv[1])  # known before any order: the parent may be killed before it can remove it
    orders = _next_words()
    if orders:
        try:
            server, page = start_server(slot, orders["token"], orders["port"])
        except (NoSlotError, OSError) as error:
            _say({"error": str(error)})
            return 3
        _serve(server, page, orders)
    slot.unlink(missing_ok=True)
    return 0


def _serve(server: Server, page: Page, orders: dict[str, Any]) -> None:
    """Serve until there are no more words."""
    page.doing = tuple(orders.get("doing", page.doing))

    def accept() -> None:
        server.serve_forever()
        if not page.over:  # it can take no more sockets: another process may
            os._exit(4)

    threading.Thread(target=accept, name="page", daemon=True).start()
    _say({"port": page.port})
    if orders.get("scene"):
        arguments = page, orders["scene"], orders["board"]
        threading.Thread(target=_look_at_scene, args=arguments, name="scene", daemon=True).start()
    while not page.over:
        words = _next_words() or {"over": KILLED}
        page.doing = tuple(words.get("doing", page.doing))
        page.over = words.get("over", "")
    until_s = time.monotonic() + FAREWELL_S
    while page.viewers and time.monotonic() < until_s:  # tell viewers that it is over
        time.sleep(SNAPSHOT_POLL_S)
    server.shutdown()


def _next_words() -> dict[str, Any]:
    """Wait for a line from the parent process; nothing where the line is cut off, for then it was killed."""
    line = sys.stdin.readline()
    return dict(json.loads(line)) if line.endswith("\n") else {}


def _say(words: dict[str, Any]) -> None:
    """Say it to the parent process, if it is still there."""
    with suppress(OSError):
        print(json.dumps(words), flush=True)
    flush_or_leave()


if __name__ == "__main__":
    sys.exit(main())
