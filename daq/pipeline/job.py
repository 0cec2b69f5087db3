"""A frame on its way, and how several threads hold its memory together."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.cameras.frame import Frame
from daq.plans.steps import Step


@dataclass(frozen=True)
class Job:
    """A frame on its way.

    Parameters
    ----------
    step : Step
        What it belongs to.
    number : int
        Its number within the run.
    frame : Frame
        The pixels.
    record : dict
        Further fields of its journal line.
    """

    step: Step
    number: int
    frame: Frame
    record: dict[str, Any]


Show = Callable[[Job, NDArray[np.float32] | None], None]  # gets a frame and its correction


class SharedJob:
    """A job that some threads hold; the last one to let go gives the memory back.

    Parameters
    ----------
    job : Job
        The frame.
    holders : int
        How many hold it.
    """

    def __init__(self, job: Job, holders: int) -> None:
        self.job = job
        self._holders = holders
        self._lock = threading.Lock()

    def hold(self) -> None:
        """Hold it once more; only where it is held already."""
        with self._lock:
            self._holders += 1

    def let_go(self) -> None:
        """Hold it no longer."""
        with self._lock:
            self._holders -= 1
            last = self._holders == 0
        if last:
            self.job.frame.release()
