"""A camera that sends both exposures of a pair in one buffer, A on top: cut in two, it is a camera like others.

Every buffer becomes two frames with its id and stamp and with neighbouring sequence numbers, the even one first.
They share the camera's memory, which is given back when both are released.  Counters count halves.
"""

import threading
from collections import deque
from dataclasses import replace
from typing import Any, cast

from daq.cameras.camera import Camera, Counters, Setting, wait_for_frame
from daq.cameras.frame import Frame
from daq.errors import BadFrame


class DoubleHeightCamera:
    """A `Camera` that cuts the buffers of another one; what is not said here is as that does it.

    Parameters
    ----------
    camera : Camera
        Open or not.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._halves: deque[Frame] = deque()
        self._uncut = 0  # buffers that could not be

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever a camera has
        return getattr(self._camera, name)

    @property
    def counters(self) -> Counters:
        """Halves since the last `arm`."""
        return self._in_halves(self._camera.counters)

    def settings(self) -> dict[str, Setting]:
        """As the camera says, with the height of a half."""
        found = dict(self._camera.settings())
        height = found.get("Height")
        return found | ({"Height": height // 2} if isinstance(height, int) else {})

    def arm(self, buffers: int = 24) -> None:
        """Start the acquisition."""
        self._halves.clear()
        self._uncut = 0
        self._camera.arm(buffers)

    def poll(self, timeout_s: float) -> Frame | None:
        """Next half, A before B; BadFrame if a buffer cannot be cut."""
        if not self._halves:
            whole = self._camera.poll(timeout_s)
            if whole is None:
                return None
            self._cut(whole)
        return self._halves.popleft()

    def next_frame(self, timeout_s: float) -> Frame:
        """Next half, waited for."""
        return wait_for_frame(cast("Camera", self), timeout_s)

    def disarm(self) -> Counters:
        """Stop the acquisition; halves not fetched count as unused."""
        left = len(self._halves)
        while self._halves:
            self._halves.popleft().release()
        counts = self._in_halves(self._camera.disarm())
        return replace(counts, delivered=counts.delivered - left, unused=counts.unused + left)

    def _cut(self, whole: Frame) -> None:
        rows = whole.pixels.shape[0]
        if rows % 2:
            whole.release()
            self._uncut += 1
            raise BadFrame(f"a buffer of {rows} rows cannot hold two exposures of one height; set an even Height")
        lock, held = threading.Lock(), [2]

        def release() -> None:
            with lock:
                held[0] -= 1
                is_last = held[0] == 0
            if is_last:
                whole.release()

        for half in range(2):
            pixels = whole.pixels[half * rows // 2 : (half + 1) * rows // 2]
            meta = replace(whole.meta, sequence=2 * whole.meta.sequence + half)
            self._halves.append(Frame(pixels, meta, release, whole.slot))

    def _in_halves(self, counts: Counters) -> Counters:
        uncut = self._uncut
        return replace(
            counts,
            delivered=2 * (counts.delivered - uncut),
            incomplete=2 * counts.incomplete,
            underrun=2 * counts.underrun,
            missing=2 * counts.missing,
            unused=2 * (counts.unused + uncut),
        )
