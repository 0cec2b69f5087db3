"""Pages that a browser on this computer opens, and who is let in.

Only this computer is listened to.  A page of another site can make a browser here ask for anything, under any name
that leads here (DNS rebinding), so that what is asked must carry our own address as its Host, and a socket must
come from our own page by its Origin.  Who wants more than the empty page must know a token that stands in the
page's address behind the #, which browsers never send; it is compared in constant time.
"""

import hmac
import json
import logging
import secrets
import socket
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

from websockets.datastructures import Headers
from websockets.http11 import Request, Response
from websockets.server import ServerProtocol
from websockets.sync.server import Server, ServerConnection, serve

HOST = "127.0.0.1"
TOKEN_S = 5.0  # until who has said nothing yet is left
MOST_THREADS = 1600  # two and more a socket: fewer than the 1024 files that a process may have open
# what strangers send is not for the terminal
OUR_FAULTS = "connection handler failed", "process_request failed"
POLICY = 1008  # close code
FOLDER = files("daq.live") / "page"


@dataclass(frozen=True)
class LocalPage:
    """Contents and access rules of a local page.

    Parameters
    ----------
    token : str
        What a viewer must know.
    port : int
        Where we listen.
    socket_path : str
        Where sockets are opened.
    pages : mapping
        Path -> file, and its type.
    """

    token: str
    port: int
    socket_path: str
    pages: Mapping[str, tuple[Traversable, str]]

    @property
    def addresses(self) -> tuple[str, str]:
        """Names under which we may be asked."""
        return f"{HOST}:{self.port}", f"localhost:{self.port}"

    @property
    def url(self) -> str:
        """Address for a browser; what stands behind the # lets it in."""
        return f"http://{HOST}:{self.port}/#{self.token}"

    def answer(self, request: Request) -> Response | None:
        """Answer a request for a page, refuse what is none; None for a socket of our own page."""
        if request.headers.get_all("Host") not in [[name] for name in self.addresses]:
            return _refusal(HTTPStatus.FORBIDDEN, "this address is not mine")
        if getattr(request, "method", "GET") != "GET":
            return _refusal(HTTPStatus.METHOD_NOT_ALLOWED, "there is nothing here but to look")
        if request.path == self.socket_path:
            if request.headers.get_all("Origin") not in [[f"http://{name}"] for name in self.addresses]:
                return _refusal(HTTPStatus.FORBIDDEN, "frames are for this page only")
            return None
        if request.path not in self.pages:
            return _refusal(HTTPStatus.NOT_FOUND, "there is no such page")
        file, kind = self.pages[request.path]
        return _response(HTTPStatus.OK, file.read_bytes(), kind, self.addresses)

    def let_in(self, connection: ServerConnection) -> dict[str, Any] | None:
        """Return the first message of a viewer who knows the token; None, and the socket closed, for all others.

        Raises
        ------
        ConnectionClosed, TimeoutError
            It has gone, or says nothing.
        """
        said = parse_message(connection.recv(timeout=TOKEN_S))
        token = said.get("token")
        known = token.encode("utf-8", "surrogatepass") if isinstance(token, str) else b""
        if hmac.compare_digest(known, self.token.encode()):
            return said
        connection.close(POLICY, "open the address that the run has printed")
        return None


def page_files(document: str, script: str, folder: Traversable = FOLDER) -> dict[str, tuple[Traversable, str]]:
    """Return the files of a page for `LocalPage`: document and script in a folder, and the common style."""
    named = {"/": folder / document, "/page.css": FOLDER / "page.css", f"/{script}": folder / script}
    kinds = (f"text/{kind}; charset=utf-8" for kind in ("html", "css", "javascript"))
    return dict(zip(named, zip(named.values(), kinds, strict=True), strict=True))


class Connection(ServerConnection):
    """A socket, unless there are so many that one more could end the server: it is closed then."""

    def __init__(self, sock: socket.socket, protocol: ServerProtocol, server: Server, **options: Any) -> None:  # noqa: ANN401
        if threading.active_count() > MOST_THREADS:
            raise OSError("too many sockets")
        super().__init__(sock, protocol, server, **options)


def listening(
    show: Callable[[ServerConnection], None],
    answer: Callable[[ServerConnection, Request], Response | None],
    port: int,
    most_bytes: int,
) -> Server:
    """Listen on this computer; the server is to be run by `serve_forever`.

    Parameters
    ----------
    show : callable
        Serves one viewer until it goes.
    answer : callable
        Answers requests, see `LocalPage.answer`.
    port : int
        Where; 0 takes a free one.
    most_bytes : int
        Of a message from a browser.

    Raises
    ------
    OSError
        The port is taken.
    """
    logging.getLogger("websockets.server").addFilter(lambda record: record.msg in OUR_FAULTS)
    return serve(
        show, HOST, port, process_request=answer, compression=None, max_size=most_bytes, max_queue=4,
        open_timeout=TOKEN_S, create_connection=Connection,
    )  # fmt: skip


class PageServer:
    """A page on a port of this computer, served until `close`.

    Parameters
    ----------
    show : callable
        Serves one viewer until it goes.
    socket_path : str
        Where sockets are opened.
    pages : mapping
        As of `LocalPage`.
    port : int
        Port on this computer; 0 for any free one.
    most_bytes : int
        Of a message from a browser.

    Raises
    ------
    OSError
        The port is taken.
    """

    def __init__(
        self,
        show: Callable[[ServerConnection], None],
        socket_path: str,
        pages: Mapping[str, tuple[Traversable, str]],
        port: int,
        most_bytes: int,
    ) -> None:
        self._server = listening(show, self._answer, port, most_bytes)
        self.access = LocalPage(
            secrets.token_urlsafe(24), self._server.socket.getsockname()[1], socket_path, pages
        )

    def serve(self) -> None:
        """Serve until `close` is called."""
        self._server.serve_forever()

    def close(self) -> None:
        """Take the page down."""
        self._server.shutdown()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        return self.access.answer(request)


def parse_message(message: str | bytes) -> dict[str, Any]:
    """Parse a message of a browser; empty if it makes no sense."""
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
