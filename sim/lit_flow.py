"""A flow that is dark until a laser fires: exposures show the light that fell while the shutter was open.

Whoever simulates the laser tells of every flash: `flash(0, t)` for light 1, `flash(1, t)` for light 2, in ns of
the machine's monotonic clock, before the exposure that holds it has been read out.  Light 1 begins a pair, with
particles of its own; light 2 shows the same particles where they have gone by then.  An exposure without light is
dark, one with two flashes shows both, and light 2 without a light 1 before it shows a pair that nobody has begun.

Without any laser on the bench light is taken to fall at the start of every exposure, as with a lamp that the
camera switches: an exposure within `LONGEST_DT_S` behind the last light 1 shows its light 2.
"""

import threading
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.flow.images import Flashed, FlowCamera
from sim.prepared_pairs import PreparedPairs

Frame = NDArray[np.uint16]

LONGEST_DT_S = 0.02
KEPT_FLASHES = 4096


class Flash(NamedTuple):
    """One pulse of light, when it is, and whether there are particles that it meets."""

    time_ns: int
    lit: Flashed
    is_seeded: bool


class LitFlow:
    """What a sensor sees of a flow that a laser lights.

    Parameters
    ----------
    first_pair : int
        Number of the first pair; a world that goes on must show none of its pairs again.
    since_s : float
        What time it is in the flow at the first flash.
    """

    def __init__(self, first_pair: int = 0, since_s: float = 0.0) -> None:
        self._flashes: deque[Flash] = deque(maxlen=KEPT_FLASHES)
        self._next_pair = first_pair
        self._since_s = since_s
        self._is_seeded = True
        self._begun: Flash | None = None
        self._start_ns: int | None = None
        self._lock = threading.Lock()
        self.has_laser = False

    def seed(self, is_open: bool) -> None:
        """Open or close the seeding, for all light from now on."""
        with self._lock:
            self._is_seeded = is_open

    def flash(self, pulse: int, time_ns: int) -> None:
        """Tell of light 1 (`pulse` 0) or light 2 (1) at a time; may be ahead of it."""
        with self._lock:
            self.has_laser = True
            self._flashes.append(self._flash(pulse, time_ns))

    def exposed(self, camera: FlowCamera, start_ns: int, end_ns: int, pairs: PreparedPairs | None = None) -> Frame:
        """Return the frame of an exposure, from pairs made beforehand if there are any."""
        with self._lock:
            if self.has_laser:
                seen = [flash for flash in self._flashes if start_ns <= flash.time_ns < end_ns]
            else:
                is_second = self._begun is not None and start_ns - self._begun.time_ns <= LONGEST_DT_S * 1e9
                seen = [self._flash(1 if is_second else 0, start_ns)]
        if not seen:
            return camera.dark(start_ns % 2**40)
        lit, is_seeded = [flash.lit for flash in seen], seen[0].is_seeded
        if pairs is not None and is_seeded and len(lit) == 1:
            return pairs.frame(lit[0].pair, lit[0].pulse, lit[0].since_first_s)
        return camera.flashed(lit, is_seeded=is_seeded)

    def _flash(self, pulse: int, time_ns: int) -> Flash:
        if self._start_ns is None:
            self._start_ns = time_ns
        if pulse == 1 and self._begun is not None:
            first = self._begun
            since_s = 1e-9 * (time_ns - first.time_ns)
            self._begun = None
            return Flash(time_ns, Flashed(first.lit.pair, 1, since_s, first.lit.time_s), first.is_seeded)
        time_s = self._since_s + 1e-9 * (time_ns - self._start_ns)
        flash = Flash(time_ns, Flashed(self._next_pair, pulse, 0.0, time_s), self._is_seeded)
        self._next_pair += 1
        self._begun = flash if pulse == 0 else None
        return flash
