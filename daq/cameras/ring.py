"""Frames in shared memory: one process writes slots, others read them, nobody copies.

The owner creates the memory and removes it.  Which slot is free is said by messages, not by flags in the memory,
so a slot is never written while somebody holds it.
"""

from multiprocessing.shared_memory import SharedMemory

import numpy as np
from numpy.typing import NDArray


class FrameRing:
    """Equal slots of uint16 pixels in one block of shared memory.

    Parameters
    ----------
    slots : int
        Number of slots.
    pixels : int
        Pixels a slot can hold.
    name : str, optional
        Attach to this block instead of creating one.
    """

    def __init__(self, slots: int, pixels: int, name: str | None = None) -> None:
        if slots < 1 or pixels < 1:
            raise ValueError(f"a ring of {slots} slots with {pixels} px each cannot hold a frame")
        self.slots = slots
        self.pixels = pixels
        self._is_owner = name is None
        size = 2 * slots * pixels
        self._memory = SharedMemory(name=name, create=name is None, size=size if name is None else 0)
        if self._memory.size < size:
            self._memory.close()
            raise ValueError(f"shared memory {name} is smaller than {slots} frames of {pixels} px")

    @property
    def name(self) -> str:
        """Name by which another process attaches."""
        return self._memory.name

    def slot(self, index: int) -> NDArray[np.uint16]:
        """Pixels (N,) uint16 of one slot."""
        if not 0 <= index < self.slots:
            raise IndexError(f"slot {index} of {self.slots}")
        assert self._memory.buf is not None
        return np.frombuffer(self._memory.buf, np.uint16, self.pixels, 2 * index * self.pixels)

    def close(self) -> None:
        """Let go; the owner also removes the name.  Memory lives on while frames still refer to it."""
        if self._is_owner:
            self._memory.unlink()
            self._is_owner = False
        try:
            self._memory.close()
        except BufferError:  # a frame still shows these pixels; the block goes with its last view
            # SharedMemory would try, and complain, again when it is collected.
            self._memory._mmap = None  # type: ignore[attr-defined]
            self._memory._buf = None  # type: ignore[attr-defined]
