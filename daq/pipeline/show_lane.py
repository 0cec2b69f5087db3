"""The last frame on its way to whoever looks: a thread of low priority shows it, and no other lane waits for that.

One frame lies in a tray until the thread takes it; a newer one takes its place. So at most two buffers of the
camera are held for it, the one in the tray and the one that is being shown. What goes wrong in showing is said
once and ends the showing: the run goes on.
"""

import threading
import warnings

import numpy as np
from numpy.typing import NDArray

from daq.pipeline.job import SharedJob, Show
from daq.pipeline.priority import lower_priority

PATIENCE_S = 10.0


class ShowLane:
    """Shows the last frame.

    Parameters
    ----------
    show : callable
        Called with a frame and its correction, or None instead of it.
    """

    def __init__(self, show: Show) -> None:
        self._show_to = show
        self._tray: tuple[SharedJob, NDArray[np.float32] | None] | None = None
        self._wake = threading.Condition()
        self._ends = False
        self._thread = threading.Thread(target=self._work, name="show lane", daemon=True)
        self._thread.start()

    def offer(self, shared: SharedJob, corrected: NDArray[np.float32] | None) -> None:
        """Lay a frame into the tray; nobody may write into its correction any more."""
        with self._wake:
            if self._ends:
                return
            shared.hold()
            older, self._tray = self._tray, (shared, corrected)
            self._wake.notify()
        if older is not None:
            older[0].let_go()

    def close(self) -> None:
        """End; what lies in the tray is still shown."""
        with self._wake:
            self._ends = True
            self._wake.notify()
        self._thread.join(PATIENCE_S)

    def _work(self) -> None:
        lower_priority(2)
        try:
            while (taken := self._taken()) is not None:
                shared, corrected = taken
                try:
                    self._show_to(shared.job, corrected)
                finally:
                    shared.let_go()
                del taken, shared, corrected  # memory that is large
        except Exception as error:
            with self._wake:
                self._ends, left, self._tray = True, self._tray, None
            if left is not None:
                left[0].let_go()
            warnings.warn(f"the live page shows nothing any more: {error!r}", RuntimeWarning, stacklevel=1)

    def _taken(self) -> tuple[SharedJob, NDArray[np.float32] | None] | None:
        """What lies in the tray, waited for; None when that was all."""
        with self._wake:
            while self._tray is None and not self._ends:
                self._wake.wait()
            taken, self._tray = self._tray, None
            return taken
