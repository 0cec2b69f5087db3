"""A frame and what is known about it.

Two clocks are kept apart.  ``timestamp_ns`` counts on the camera's clock from the start of the exposure;
``received_ns`` is the host's monotonic clock when the frame was complete.  Their difference drifts, so it is
recorded and never assumed.

The camera's own ``frame_id`` may start anywhere and wrap (16 bit GigE ids go 65535 -> 1).  ``sequence`` is the
unwrapped count since arming: 0 for the first frame that was seen, with gaps where frames are missing.  Pairs are
made from ``sequence`` and ``timestamp_ns``, never from the order of arrival.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType
from typing import Self

import numpy as np
from numpy.typing import NDArray


class FrameStatus(Enum):
    """Permitted use of the pixels."""

    COMPLETE = "complete"
    INCOMPLETE = "incomplete"  # pixels are missing; for looking at, not for measuring


@dataclass(frozen=True, slots=True)
class FrameMeta:
    """Everything known about one frame besides its pixels.

    Parameters
    ----------
    frame_id : int
        Id as the camera gave it; may wrap.
    sequence : int
        Unwrapped id since arming, 0 for the first frame seen; gaps are missing frames.
    timestamp_ns : int
        Camera clock at the start of the exposure; 0 if the camera has no clock, or stamps on arrival.
    received_ns : int
        Host ``time.monotonic_ns`` when the frame was complete.
    exposure_us : float
        Exposure time as read back from the camera; NaN if it does not tell.
    pixel_format : str
        SFNC name of the format on the wire, e.g. "Mono12p".
    significant_bits : int
        Bits a pixel can use: 8, 10, 12, 14, 16.
    positions_mm : mapping of str to float
        Measured axis positions while the frame was taken; empty until the runner adds them.
    status : FrameStatus
        COMPLETE, or INCOMPLETE where pixels are missing.
    id_told : bool
        Whether the id is the camera's; False if it tells none and the backend counts what arrives.
    chunks : mapping of str to number
        Chunk data that was asked for and came with the frame, by SFNC name, e.g. "LineStatusAll".
    """

    frame_id: int
    sequence: int
    timestamp_ns: int
    received_ns: int
    exposure_us: float
    pixel_format: str
    significant_bits: int
    positions_mm: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    status: FrameStatus = FrameStatus.COMPLETE
    id_told: bool = True
    chunks: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))


class Frame:
    """Pixels (H, W) uint16 and their `FrameMeta`.

    The pixels may lie in a slot of shared memory that the camera needs back: call `release`, or use the frame
    as a context manager, or take `copy` to keep them.  A slot that is never given back is counted by the camera
    as an underrun sooner or later; it never overwrites pixels that are still held.

    Parameters
    ----------
    pixels : (H, W) uint16
        Grey values, [row, col], not scaled: a 12 bit camera uses 0 to 4095.
    meta : FrameMeta
        Ids, clocks, exposure, positions.
    release : callable, optional
        Gives the memory of the pixels back to its owner; called at most once.
    slot : int, optional
        Index of the shared-memory slot that holds the pixels, for consumers in other processes.
    """

    __slots__ = ("_release", "meta", "pixels", "slot")

    def __init__(
        self,
        pixels: NDArray[np.uint16],
        meta: FrameMeta,
        release: Callable[[], None] | None = None,
        slot: int | None = None,
    ) -> None:
        if pixels.ndim != 2 or pixels.dtype != np.uint16:
            raise ValueError(f"a frame is (H, W) uint16, not {pixels.shape} {pixels.dtype}")
        self.pixels = pixels
        self.meta = meta
        self.slot = slot
        self._release = release

    def copy(self) -> "Frame":
        """Return the frame with pixels of its own, and give the memory of this one back."""
        own = Frame(self.pixels.copy(), self.meta)
        self.release()
        return own

    def with_positions_mm(self, positions_mm: Mapping[str, float]) -> "Frame":
        """Return the same pixels with measured axis positions [mm]; ownership of the memory moves along."""
        meta = replace(self.meta, positions_mm=MappingProxyType(dict(positions_mm)))
        moved = Frame(self.pixels, meta, self._release, self.slot)
        self._release = None
        return moved

    def release(self) -> None:
        """Give the memory of the pixels back; do not touch them afterwards.  Harmless when repeated."""
        give_back, self._release = self._release, None
        if give_back is not None:
            give_back()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()
