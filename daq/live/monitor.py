"""Evaluation in the page's process: a thread of low priority looks at the last frame shown.

A frame is looked at now and then, whichever is there, while the page has viewers. Each watch works for
`MONITOR_DUTY` at most, so that a slow or busy computer looks less often.
"""

import threading
import time
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

from daq.pipeline.live_slot import SlotReader, Snapshot
from daq.pipeline.priority import lower_priority

MONITOR_DUTY = 0.05
SLOT_POLL_S = 0.1


class Monitor(ABC):
    """Looks at frames of a slot; `said` are counters for the page, name -> [text, whether it is wrong].

    Parameters
    ----------
    slot : SlotReader
        Where frames are shown.
    every_s : float
        Between two looks.
    """

    def __init__(self, slot: SlotReader, every_s: float) -> None:
        self.said: dict[str, list[Any]] = {}
        self._slot, self._every_s, self._seen = slot, every_s, 0

    def start(self) -> None:
        """Look until the run is over."""
        threading.Thread(target=self._work, name=type(self).__name__, daemon=True).start()

    def look(self) -> None:
        """Look at the last snapshot, if it is a new one with a raw frame."""
        snapshot = self._slot.read(_raw_of)
        if snapshot is not None and snapshot.number != self._seen and "raw" in snapshot.pictures:
            self._seen = snapshot.number
            self.see(snapshot)

    @abstractmethod
    def see(self, snapshot: Snapshot) -> None:
        """Find out what it tells."""

    def _work(self) -> None:
        lower_priority()
        next_s = 0.0
        while not self._slot.is_over:
            if self._slot.is_watched and time.monotonic() >= next_s:
                begun_s = time.monotonic()
                self.look()
                took_s = time.monotonic() - begun_s  # longer than it needed, where others need the processor
                next_s = time.monotonic() + max(self._every_s, took_s / MONITOR_DUTY)
            time.sleep(SLOT_POLL_S)


def _raw_of(snapshot: Snapshot) -> Snapshot:
    """A snapshot with its raw frame alone, copied."""
    pictures = {name: pixels.copy() for name, pixels in snapshot.pictures.items() if name == "raw"}
    return replace(snapshot, pictures=pictures)
