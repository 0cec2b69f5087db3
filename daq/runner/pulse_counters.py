"""Count the pulses of one plug of a timing unit, in stretches between marks.

A mark is set while the plug is quiet: right before a burst begins, or some time after it was switched off. A
camera stamps every exposure on its own clock, so a mark is that clock, and a frame belongs to the stretch in which
it was exposed, however late it arrives.
"""

import threading
import time
from bisect import bisect_right
from collections.abc import Collection
from dataclasses import dataclass, field
from math import inf, nan
from typing import Protocol

from daq.bench.bench_table import CameraSection
from daq.cameras.camera import Camera
from daq.errors import BadFrame, CameraError, RunUsageError
from daq.runner.camera_session import CameraSession
from daq.timing.drivers.pulse_box import PulseBox
from daq.timing.pulses import Pulse, Role

TAIL_S = 3.0  # without a frame, after which no more are waited for
FIRST_FRAME_S = 60.0  # until the first frame of the last stretch has come
COUNTER_POLL_S = 0.02


@dataclass(frozen=True, slots=True)
class Stretch:
    """Pulses between two marks; `times_s` of each on the counter's clock, empty for a counter without one."""

    pulses: float
    times_s: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Counted:
    """Every stretch, the one before the first mark included, and what may be missing in them ("" if nothing)."""

    stretches: tuple[Stretch, ...]
    trouble: str = ""


class Counter(Protocol):
    """Counter whose input is connected to one plug at a time."""

    def begin(self, roles: Collection[Role], period_us: float, pulse: Pulse) -> None:
        """Begin to count at the plug with these roles, whose pulses come one a period."""

    def mark(self) -> float:
        """End a stretch and begin the next one; return the counter's clock [s], NaN if it has none."""

    def end(self) -> Counted:
        """Wait for what is still on its way; the last stretch has pulses, unless the plug gives none."""

    def close(self) -> None:
        """Count no more; harmless when repeated."""


@dataclass(slots=True)
class _Exposures:
    """Frames since the counter began."""

    stamps_ns: list[int] = field(default_factory=list)
    marks_ns: list[int] = field(default_factory=list)
    trouble: str = ""
    last_s: float = -inf  # when a frame arrived last, on the computer's clock


class CameraCounter:
    """Count by the exposures of a camera whose trigger input is connected to the plug.

    Parameters
    ----------
    camera : Camera
        Open.
    section : CameraSection
        How it is set up, with its pairs.
    """

    def __init__(self, camera: Camera, section: CameraSection) -> None:
        self._camera, self._session = camera, CameraSession(camera, section)
        assert section.pairs is not None
        self._frames_a_pair = section.pairs.frames
        self._has_two_triggers = section.pairs.shape == "straddling"
        self._frames = 1  # of a pulse, or of a pair at the camera's own plug
        self._seen = _Exposures()
        self._lock = threading.Lock()  # of the camera: it is asked by two threads
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        self.settings = self._session.set_up()

    def begin(self, roles: Collection[Role], period_us: float, pulse: Pulse) -> None:
        """Arm the camera, and fetch what it exposes from now on.

        Raises
        ------
        RunUsageError
            The camera's clock cannot be read, so late frames could not be separated from those of the next burst.
        """
        self.close()
        one_a_pulse = self._has_two_triggers and Role.CAMERA not in roles
        self._frames = 1 if one_a_pulse else self._frames_a_pair
        self._seen = _Exposures()
        self._session.begin()
        self._session.make_ready()
        if self._camera.clock_ns() is None:
            self._session.end()
            raise RunUsageError(
                "the clock of the camera cannot be read, so its frames cannot be assigned to bursts; "
                "name a pulse counter in the bench file (docs/laser.md)"
            )
        self._ended.clear()
        self._thread = threading.Thread(target=self._fetch, name="pulse counter", daemon=True)
        self._thread.start()

    def mark(self) -> float:
        """Latch the camera's clock."""
        with self._lock:
            now_ns = self._camera.clock_ns()
        if now_ns is None:
            raise RunUsageError("the clock of the camera cannot be read any more")
        self._seen.marks_ns.append(now_ns)
        return 1e-9 * now_ns

    def end(self) -> Counted:
        """Wait for the frames of the last stretch, disarm, and assign every frame by its time stamp."""
        begun_s = time.monotonic()
        while not self._has_all(begun_s) and not self._seen.trouble:
            time.sleep(COUNTER_POLL_S)
        self.close()
        seen = self._seen
        stretches: list[list[float]] = [[] for _ in range(len(seen.marks_ns) + 1)]
        for stamp_ns in sorted(seen.stamps_ns):
            stretches[bisect_right(seen.marks_ns, stamp_ns)].append(1e-9 * stamp_ns)
        frames = self._frames
        return Counted(
            tuple(Stretch(len(times) / frames, tuple(times[::frames])) for times in stretches), seen.trouble
        )

    def close(self) -> None:
        """Disarm the camera, and take over what it says of frames that were lost."""
        self._ended.set()
        if self._thread is None:
            return
        self._thread.join()
        self._thread = None
        self._session.end()
        missing = self._camera.counters.losses
        if missing and not self._seen.trouble:
            self._seen.trouble = f"{missing} frames were lost on their way"

    def _has_all(self, begun_s: float) -> bool:
        seen, now_s = self._seen, time.monotonic()
        has_last = bool(seen.marks_ns and seen.stamps_ns) and seen.stamps_ns[-1] >= seen.marks_ns[-1]
        quiet_s = now_s - max(seen.last_s, begun_s)
        return quiet_s > TAIL_S and (has_last or now_s - begun_s > FIRST_FRAME_S)

    def _fetch(self) -> None:
        seen = self._seen
        while not self._ended.is_set():
            try:
                with self._lock:
                    frame = self._camera.poll(COUNTER_POLL_S)
            except BadFrame as error:
                seen.trouble = seen.trouble or str(error)
                continue
            except CameraError as error:
                seen.trouble = str(error)
                return
            if frame is None:
                time.sleep(1e-3)  # lets a mark have the camera
                continue
            with frame:
                stamp_ns = frame.meta.timestamp_ns
            seen.last_s = time.monotonic()
            if stamp_ns == 0:
                seen.trouble = "the frames of the camera have no time stamps"
            seen.stamps_ns.append(stamp_ns)


class BoxCounter:
    """Count by a pulse box whose input is connected to the plug; it records no times.

    Parameters
    ----------
    box : PulseBox
        Connected.
    """

    def __init__(self, box: PulseBox) -> None:
        self._box = box
        self._found: list[int] = []

    def begin(self, roles: Collection[Role], period_us: float, pulse: Pulse) -> None:
        """Begin to count.

        Raises
        ------
        RunUsageError
            The box cannot count such pulses.
        """
        if Role.CAMERA_B in roles:
            raise RunUsageError(
                "a pulse box cannot count two triggers a pair; take it out of the bench file: the camera counts"
            )
        self._box.expect(period_us, pulse)
        self._found = []

    def mark(self) -> float:
        """Begin another stretch."""
        self._found.append(self._box.restart())
        return nan

    def end(self) -> Counted:
        """Return every count; a pulse is counted as soon as it has come."""
        self._found.append(self._box.stop())
        most = self._box.most
        trouble = (
            f"the pulse box counts to {most} pulses at this rate; lower it" if max(self._found) > most else ""
        )
        return Counted(tuple(Stretch(found) for found in self._found), trouble)

    def close(self) -> None:
        """Nothing is held."""
