"""Frames from another process: the simulated world lives with the bench, the camera in its transport's process.

The server owns a frame source, a Unix socket and a file of one sensor image, both in a folder of its own.  The
client asks for one exposure at a time; the server draws it into the mapped file and answers with one line.  An
image that is not writeable will come again as it is: the first few of those get a number, are sent once, and are
named by it from then on, so that frames made beforehand cost next to nothing.  The folder is private to the user,
and nothing on a network can reach the socket.
"""

import json
import mmap
import os
import socket
import threading
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.camera.source import FrameSource, image_of

SOCKET_NAME, FRAME_NAME = "frames.sock", "frame.bin"
DEADLINE_S = 3600.0  # a renderer may think for minutes on a busy computer; a server that ends says so at once
MAX_LINE_BYTES = 4096
ASKED = ("trigger_index", "start_ns", "end_ns")
GONE = "the frame server is gone"
CONSTANTS = 16  # images that are numbered; both sides keep them


class FrameServer:
    """Serve a frame source to cameras in other processes.

    Parameters
    ----------
    source : FrameSource
        Asked from the server's thread, one exposure at a time.
    folder : path
        Empty folder for the socket and the frame; its path must be shorter than about 90 characters.
    width, height : int
        Sensor size [px].
    """

    def __init__(self, source: FrameSource, folder: Path | str, width: int, height: int) -> None:
        self.folder = Path(folder)
        self._source = source
        self._shape = (height, width)
        path = self.folder / FRAME_NAME
        with os.fdopen(os.open(path, os.O_CREAT | os.O_RDWR, 0o600), "r+b") as file:
            file.truncate(2 * height * width)
            self._map = mmap.mmap(file.fileno(), 2 * height * width)
        self._frame = np.frombuffer(self._map, np.uint16).reshape(height, width)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.bind(str(self.folder / SOCKET_NAME))
        (self.folder / SOCKET_NAME).chmod(0o600)
        self._socket.listen(4)
        self._drawing = threading.Lock()
        self._constants: list[NDArray[np.uint16]] = []
        self._clients: list[socket.socket] = []
        threading.Thread(target=self._accept, name="frame server", daemon=True).start()

    def arguments(self) -> dict[str, str]:
        """Source arguments for a camera's configuration, beside ``source="sim.camera.remote:RemoteSource"``."""
        return {"folder": str(self.folder)}

    def close(self) -> None:
        """Serve no more."""
        self._socket.close()
        for client in self._clients:
            with suppress(OSError):  # it may have gone by itself
                client.shutdown(socket.SHUT_RDWR)
        for name in (SOCKET_NAME, FRAME_NAME):
            (self.folder / name).unlink(missing_ok=True)

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._socket.accept()
            except OSError:
                return
            self._clients.append(client)
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        sent: set[int] = set()  # numbers of constant images that this client has
        try:
            with client, client.makefile("rb") as lines:
                while line := lines.readline(MAX_LINE_BYTES):
                    client.sendall(json.dumps(self._draw(line, sent)).encode() + b"\n")
        except OSError:
            return

    def _draw(self, line: bytes, sent: set[int]) -> dict[str, object]:
        try:
            asked = json.loads(line)
            with self._drawing:
                image = image_of(self._source, *(int(asked[name]) for name in ASKED))
                number = self._number_of(image)
                if number not in sent:
                    self._frame[:] = image
        except Exception as error:  # the camera's process shall know why there is no frame
            return {"error": f"{type(error).__name__}: {error}"}
        if number is None:
            return {"shape": list(self._shape)}
        sent.add(number)
        return {"shape": list(self._shape), "constant": number}

    def _number_of(self, image: NDArray[np.uint16]) -> int | None:
        if image.flags.writeable:
            return None
        for number, known in enumerate(self._constants):
            if known is image:
                return number
        if len(self._constants) == CONSTANTS:
            return None
        self._constants.append(image)
        return len(self._constants) - 1


class RemoteSource:
    """A frame source in another process.

    Parameters
    ----------
    folder : path
        Folder of its `FrameServer`.

    Raises
    ------
    ConnectionError
        It is gone.
    """

    def __init__(self, folder: Path | str) -> None:
        self._folder = Path(folder)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(DEADLINE_S)
        try:
            self._socket.connect(str(self._folder / SOCKET_NAME))
        except OSError as error:
            self._socket.close()
            raise ConnectionError(GONE) from error
        self._lines = self._socket.makefile("rb")
        self._constants: dict[int, NDArray[np.uint16]] = {}
        with (self._folder / FRAME_NAME).open("rb") as file:
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)

    def frame(self, trigger_index: int, time_ns: int) -> NDArray[np.uint16]:
        """Ask the server for one short exposure; OSError if it is gone or cannot draw."""
        return self.expose(trigger_index, time_ns, time_ns)

    def expose(self, trigger_index: int, start_ns: int, end_ns: int) -> NDArray[np.uint16]:
        """Ask the server for one exposure; OSError if it is gone or cannot draw."""
        request = dict(zip(ASKED, (trigger_index, start_ns, end_ns), strict=True))
        self._socket.sendall(json.dumps(request).encode() + b"\n")
        line = self._lines.readline(MAX_LINE_BYTES)
        answer = json.loads(line) if line else {"error": GONE}
        if "error" in answer:
            raise OSError(str(answer["error"]))
        number = int(answer.get("constant", -1))
        if number in self._constants:
            return self._constants[number]
        height, width = (int(side) for side in answer["shape"])
        image = np.frombuffer(self._map, np.uint16, height * width).reshape(height, width).copy()
        if number >= 0:
            image.flags.writeable = False
            self._constants[number] = image
        return image

    def close(self) -> None:
        """Leave the server."""
        self._lines.close()
        self._socket.close()
