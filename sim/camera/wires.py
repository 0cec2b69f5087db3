"""Wires from a simulated timing unit to the input lines of simulated cameras, in this process and in others.

A pulse is sent whole, with the times of both edges on the machine's monotonic clock, so the camera exposes at the
edge itself and not when the word of it arrives.  Pulses may be sent a little ahead of their time; those that other
pulses are judged by, such as a marker, are sent first.
"""

import json
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

NAME = "wires.sock"
MAX_LINE_BYTES = 4096
Pulse = Callable[[int, int, int], None]  # line, rise and fall [ns]


class Wires:
    """The end at the timing unit.

    Parameters
    ----------
    folder : path
        Folder for the socket, which is made when a camera elsewhere asks for it; its path must be shorter than
        about 90 characters.
    """

    def __init__(self, folder: Path | str) -> None:
        self._path = Path(folder) / NAME
        self._listener: socket.socket | None = None
        self._cameras: list[socket.socket] = []
        self._here: list[Pulse] = []
        self._lock = threading.Lock()

    @property
    def path(self) -> Path:
        """Socket at which cameras of other processes listen."""
        if self._listener is None:
            self._listener = listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            listener.bind(str(self._path))
            self._path.chmod(0o600)
            listener.listen(4)
            threading.Thread(target=self._accept, args=(listener,), name="wires", daemon=True).start()
        return self._path

    def lead_to(self, pulse: Pulse) -> None:
        """Call `pulse` of a camera in this process for every pulse from now on."""
        self._here.append(pulse)

    def pulse(self, line: int, rise_ns: int, fall_ns: int) -> None:
        """Tell every camera of a pulse on an input line."""
        for tell in self._here:
            tell(line, rise_ns, fall_ns)
        data = json.dumps([line, rise_ns, fall_ns]).encode() + b"\n"
        with self._lock:
            for camera in list(self._cameras):
                try:
                    camera.sendall(data)
                except OSError:  # unplugged
                    self._cameras.remove(camera)

    def close(self) -> None:
        """Cut every wire."""
        self._here.clear()
        if self._listener is not None:
            self._listener.close()
        with self._lock:
            for camera in self._cameras:
                with suppress(OSError):
                    camera.shutdown(socket.SHUT_RDWR)
                camera.close()
            self._cameras.clear()
        self._path.unlink(missing_ok=True)

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                camera, _ = listener.accept()
            except OSError:
                return
            with self._lock:
                self._cameras.append(camera)


def listen(path: str, pulse: Pulse) -> None:
    """Call `pulse` for every pulse from now on, from a thread of its own, until the other end closes."""
    end = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    end.connect(path)

    def serve() -> None:
        with end, end.makefile("rb") as lines, suppress(OSError):
            while line := lines.readline(MAX_LINE_BYTES):
                number, rise_ns, fall_ns = json.loads(line)
                pulse(int(number), int(rise_ns), int(fall_ns))

    threading.Thread(target=serve, name="input lines", daemon=True).start()
