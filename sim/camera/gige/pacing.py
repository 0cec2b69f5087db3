"""Not to flood a plain UDP socket on this machine.

A real camera is slowed by its cable; a simulated one on the loopback is not, and the kernel's default receive
buffer (212 kB) is smaller than a frame.  On Linux the fill of the receiver's queue can be read, so the camera
waits while it is full.  A client that reads through a packet socket never empties the queue of its UDP socket;
if the queue does not shrink for a while, pacing gives up for this stream.
"""

import time
from pathlib import Path

TABLE = Path("/proc/net/udp")
FULL_BYTES = 50_000
PATIENCE_S = 0.05
NAP_S = 0.0002


class Pacer:
    """Waits for one receiver.

    Parameters
    ----------
    port : int
        UDP port of the receiver on this machine.
    """

    def __init__(self, port: int) -> None:
        self._mark = f":{port:04X} "
        self.is_useful = TABLE.exists()

    def wait(self) -> None:
        """Return when the receiver's queue has room, or when waiting turned out to be in vain."""
        if not self.is_useful:
            return
        deadline = time.monotonic() + PATIENCE_S
        lowest = self._queued()
        while lowest is not None and (now := self._queued()) is not None and now > FULL_BYTES:
            if now < lowest:
                lowest, deadline = now, time.monotonic() + PATIENCE_S
            if time.monotonic() > deadline:
                self.is_useful = False
                return
            time.sleep(NAP_S)

    def _queued(self) -> int | None:
        try:
            lines = TABLE.read_text().splitlines()
        except OSError:
            return None
        for line in lines[1:]:
            fields = line.split()
            if len(fields) > 4 and (fields[1] + " ").endswith(self._mark):
                return int(fields[4].split(":")[1], 16)
        return None
