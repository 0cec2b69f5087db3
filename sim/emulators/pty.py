"""A simulated line on a pseudo-terminal: programs open a device file and see a serial port.

One thread per line carries bytes.  Unplugging closes the far end: the near one then fails as that of a pulled
converter does.  The world's clock must be one that runs by itself (`ScaledClock`).
"""

import contextlib
import os
import select
import threading
import tty
from typing import Self

from sim.emulators.line import Line

PTY_POLL_S = 0.001  # how often answers that become due are looked for


class PtyPort:
    """Serves a `Line` on a pseudo-terminal until closed.

    Parameters
    ----------
    line : Line
        What stands behind the device file.
    """

    def __init__(self, line: Line) -> None:
        self.line = line
        self._far, self._near = os.openpty()
        tty.setraw(self._near)
        self.path = os.ttyname(self._near)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._carry, name=f"pty {self.path}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Take the device file away."""
        self._ended.set()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _carry(self) -> None:
        while not self._ended.is_set() and not self.line.dead:
            readable, _, _ = select.select([self._far], [], [], PTY_POLL_S)
            with contextlib.suppress(OSError):
                if readable:
                    self.line.send(os.read(self._far, 4096))
                if data := self.line.receive():
                    os.write(self._far, data)
        for descriptor in (self._far, self._near):
            os.close(descriptor)
