"""The page's server: a process of its own, which a stuck browser may hold up as long as it likes.

    slot (another process writes it) --> viewer thread --> WebSocket --> browser --acknowledges--> next moment

One thread a viewer: it sends the last moment, waits until the browser says that it has drawn it, and takes the
last one again; what came meanwhile is counted and never queued.

Safety.  Only this computer is listened to.  A page of another site can make a browser here ask for anything, under
any name that leads here (DNS rebinding), so that what is asked must carry our own address as its Host, and a
socket must come from our own page by its Origin.  Who asks for frames must know a token that stands in the page's
address behind the #, which browsers tell nobody; it is compared in constant time.  Nothing can be told to the
bench through here: there are frames in one direction and acknowledgements in the other.
"""

import hmac
import json
import sys
import threading
import time
from dataclasses import dataclass, field
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from typing import Any

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve

from daq.acquisition.pipeline.live_slot import Moment, NoSlotError, SlotReader
from daq.live.figures import histogram, particle_maps, saturated_share
from daq.live.picture import Part, sent, white_of

HOST = "127.0.0.1"
SOCKET = "/frames"
PAGES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
}
MOST_VIEWERS = 64
MOST_WORDS = 4096  # bytes of a message from a browser
TOKEN_S, LOOK_S = 5.0, 0.005  # patience with who has said nothing yet; between two looks into the slot
FAREWELL_S = 0.5
FIGURES_S = 0.5  # between two sets of figures: they cost 30 ms
POLICY, BUSY = 1008, 1013  # close codes


@dataclass
class Page:
    """What all viewers share.

    Parameters
    ----------
    slot : SlotReader
        Where the moments are.
    token : str
        What a viewer must know.
    """

    slot: SlotReader
    token: str
    port: int = 0
    viewers: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _moment: Moment | None = None
    _pictures: dict[tuple[int, str, Part], bytes] = field(default_factory=dict)
    _figures: dict[str, Any] = field(default_factory=dict)
    _figures_s: float = -FIGURES_S

    @property
    def addresses(self) -> tuple[str, str]:
        """Names under which we may be asked."""
        return f"{HOST}:{self.port}", f"localhost:{self.port}"

    def answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request for a page, refuse what is none; None for a socket of our own page."""
        if request.headers.get_all("Host") not in [[name] for name in self.addresses]:
            return _refusal(HTTPStatus.FORBIDDEN, "this address is not mine")
        if getattr(request, "method", "GET") != "GET":
            return _refusal(HTTPStatus.METHOD_NOT_ALLOWED, "there is nothing here but to look")
        if request.path == SOCKET:
            if request.headers.get_all("Origin") not in [[f"http://{name}"] for name in self.addresses]:
                return _refusal(HTTPStatus.FORBIDDEN, "frames are for this page only")
            return None
        if request.path not in PAGES:
            return _refusal(HTTPStatus.NOT_FOUND, "there is no such page")
        name, kind = PAGES[request.path]
        return _response(
            HTTPStatus.OK, files("daq.live").joinpath("page", name).read_bytes(), kind, self.addresses
        )

    def show(self, connection: ServerConnection) -> None:
        """Serve one viewer until it goes."""
        with self._lock:
            self.viewers += 1
            busy = self.viewers > MOST_VIEWERS
        try:
            if busy:
                connection.close(BUSY, "too many viewers")
            elif not self._knows_token(connection):
                connection.close(POLICY, "open the address that the run has printed")
            else:
                self._show_moments(connection)
        except (ConnectionClosed, TimeoutError):
            pass
        finally:
            with self._lock:
                self.viewers -= 1

    def _knows_token(self, connection: ServerConnection) -> bool:
        said = _understood(connection.recv(timeout=TOKEN_S))
        return hmac.compare_digest(str(said.get("token", "")).encode(), self.token.encode())

    def _show_moments(self, connection: ServerConnection) -> None:
        seen, missed, part = 0, 0, Part()
        wanted: tuple[str, ...] = ("raw", "corrected")
        while True:
            while (number := self.slot.number) == seen:
                if self.slot.is_over:
                    connection.send(json.dumps({"over": True}))
                    connection.close()
                    return
                time.sleep(LOOK_S)
            moment = self._latest(number)
            if moment is None or moment.number <= seen:
                time.sleep(LOOK_S)
                continue
            missed += moment.number - seen - 1 if seen else 0
            seen = moment.number
            names = [name for name in moment.pictures if name in wanted]
            words = moment.words | {"number": seen, "missed": missed, "shown": names} | self._worth(moment)
            connection.send(json.dumps(words))
            for name in names:
                connection.send(self._picture(moment, name, part))
            said = _understood(connection.recv())
            part = Part.of(said.get("part"))
            asked = said.get("wanted")
            if isinstance(asked, list):
                wanted = tuple(name for name in asked[:4] if isinstance(name, str))

    def _latest(self, number: int) -> Moment | None:
        """The last moment, copied once for all viewers."""
        with self._lock:
            if self._moment is None or self._moment.number < number:
                self._moment = self.slot.latest() or self._moment
                self._pictures.clear()
            return self._moment

    def _picture(self, moment: Moment, name: str, part: Part) -> bytes:
        key = moment.number, name, part
        with self._lock:
            found = self._pictures.get(key)
        if found is None:
            found = sent(name, moment.number, moment.pictures[name], white_of(moment.words, name), part)
            with self._lock:
                if self._moment is moment:
                    self._pictures[key] = found
        return found

    def _worth(self, moment: Moment) -> dict[str, Any]:
        """Figures, made anew twice a second and sent once each."""
        raw = moment.pictures.get("raw")
        with self._lock:
            due = raw is not None and time.monotonic() - self._figures_s >= FIGURES_S
            if due:
                self._figures_s = time.monotonic()
        if due and raw is not None:
            white = white_of(moment.words, "raw")
            self._figures = {
                "white": white,
                "saturated": saturated_share(raw, white),
                "histogram": histogram(raw, white),
                "maps": particle_maps(raw),
            }
        return {"figures": self._figures}


def _understood(message: str | bytes) -> dict[str, Any]:
    """What a browser has said; nothing if it makes no sense."""
    try:
        said = json.loads(message)
    except (ValueError, RecursionError):
        return {}
    return said if isinstance(said, dict) else {}


def _refusal(status: HTTPStatus, text: str) -> Response:
    return _response(status, text.encode(), "text/plain; charset=utf-8", ())


def _response(status: HTTPStatus, body: bytes, kind: str, addresses: tuple[str, ...]) -> Response:
    sockets = " ".join(f"ws://{name}" for name in addresses) or "'none'"
    policy = (
        f"default-src 'self'; connect-src {sockets}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    )
    head = {
        "Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close", "Cache-Control": "no-store",
        "Content-Security-Policy": policy, "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
    }  # fmt: skip
    return Response(status.value, status.phrase, Headers(head), body)


def opened(slot: Path, token: str, port: int = 0) -> tuple[Server, Page]:
    """Listen on this computer; the server is to be run by `serve_forever`."""
    page = Page(SlotReader(slot), token)
    server = serve(
        page.show, HOST, port, process_request=page.answer, compression=None, max_size=MOST_WORDS, max_queue=4
    )
    page.port = server.socket.getsockname()[1]
    return server, page


def main() -> int:
    """Serve until whoever started us is gone: its orders come by our input, which ends with it."""
    orders = json.loads(sys.stdin.readline())
    try:
        server, page = opened(Path(orders["slot"]), orders["token"], orders["port"])
    except (NoSlotError, OSError) as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return 3
    print(json.dumps({"port": page.port}), flush=True)
    threading.Thread(target=server.serve_forever, name="page", daemon=True).start()
    sys.stdin.read()
    until_s = time.monotonic() + FAREWELL_S
    while page.viewers and time.monotonic() < until_s:  # those who can hear it are told that it is over
        time.sleep(LOOK_S)
    server.shutdown()
    page.slot.path.unlink(missing_ok=True)  # whoever was killed could not take it down
    return 0


if __name__ == "__main__":
    sys.exit(main())
