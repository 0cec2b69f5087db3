"""Frames in shared memory: one process writes slots, others read them, without copies.

The owner creates the memory and removes it.  Which slot is free is said by messages, not by flags in the memory,
so a slot is never written while it is held.
"""

import os
import sys
import weakref
from multiprocessing import resource_tracker
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
        size = 2 * slots * pixels
        self._memory = _create(size) if name is None else _attach(name)
        if self._memory.size < size:
            self._memory.close()
            raise ValueError(f"shared memory {name} is smaller than {slots} frames of {pixels} px")
        self._let_go = weakref.finalize(self, _let_go, self._memory, os.getpid() if name is None else 0)

    @property
    def name(self) -> str:
        """Name by which another process attaches."""
        return self._memory.name

    def slot(self, index: int) -> NDArray[np.uint16]:
        """Pixels (N,) uint16 of one slot.

        Raises
        ------
        IndexError
            There is no slot of this index.
        """
        if not 0 <= index < self.slots:
            raise IndexError(f"slot {index} of {self.slots}")
        assert self._memory.buf is not None
        return np.frombuffer(self._memory.buf, np.uint16, self.pixels, 2 * index * self.pixels)

    def close(self) -> None:
        """Let go; the owner also removes the name.  Memory lives on while frames still refer to it."""
        self._let_go()


def _let_go(memory: SharedMemory, owner: int) -> None:
    """Also called at the end of the process; a fork of the owner removes nothing."""
    if owner == os.getpid():
        memory.unlink()
    try:
        memory.close()
    except BufferError:  # a frame still shows these pixels; the block goes with its last view
        # SharedMemory would try, and complain, again when it is collected.
        memory._mmap = None  # type: ignore[attr-defined]
        memory._buf = None  # type: ignore[attr-defined]


def _create(size: int) -> SharedMemory:
    """Memory that the tracker, a process of its own, gives back if this one is killed: without its warning."""
    before = list(sys.warnoptions)
    # a process that is started now is given these
    sys.warnoptions.append("ignore:resource_tracker:UserWarning")
    try:
        resource_tracker.ensure_running()
    finally:
        sys.warnoptions[:] = before
    return SharedMemory(create=True, size=size)


def _attach(name: str) -> SharedMemory:
    """Memory of another process; this one's tracker must not know it, for it would remove it at our end."""
    if sys.version_info >= (3, 13):
        return SharedMemory(name=name, track=False)
    register = resource_tracker.register
    resource_tracker.register = lambda *_: None
    try:
        return SharedMemory(name=name)
    finally:
        resource_tracker.register = register
