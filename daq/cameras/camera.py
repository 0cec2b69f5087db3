"""Interface of every camera backend.

Life of a camera: ``open -> configure -> arm -> (trigger, next_frame)* -> disarm -> ... -> close``.  Settings have
their SFNC names (PixelFormat, ExposureTime [us], Gain, Width, TriggerMode ...) and are always read back.

Counters are kept apart, because each has another cause and another cure:

=================  ==================================================================================
delivered          frames handed over complete
incomplete         frames that arrived with pixels missing and were put aside (link, packet size)
underrun           frames the camera sent while no buffer was free (consumer too slow)
missing            ids that never arrived in any form (neither delivered, incomplete nor underrun)
resent             packets that arrived at the second request (the link is marginal, nothing is lost)
ignored_triggers   triggers that came while the camera was busy; None if the camera cannot tell
unused             frames that arrived whole and were not handed over: not fetched before the camera was
                   disarmed, or in contradiction to what they announced
=================  ==================================================================================

Waiting for a frame is the same for every backend: first for the frame, then for a sign of life.
"""

import time
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from daq.cameras.frame import Frame
from daq.errors import CameraTimeout, CameraUsageError, FrameIncomplete

Setting = bool | int | float | str


@dataclass(frozen=True, slots=True)
class Counters:
    """Frames since arming, by what became of them; see the table in the module's text."""

    delivered: int = 0
    incomplete: int = 0
    underrun: int = 0
    missing: int = 0
    resent: int = 0
    ignored_triggers: int | None = None
    unused: int = 0

    @property
    def losses(self) -> int:
        """Frames that the camera exposed and that will never be complete."""
        return self.incomplete + self.underrun + self.missing


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """Identity of a camera, for the run's record."""

    backend: str
    vendor: str
    model: str
    serial: str
    address: str  # producer file, network address or folder


@runtime_checkable
class Camera(Protocol):
    """A camera as plans and pipeline see it.

    All calls come from one thread.  Every wait has a deadline.  After `CameraLost` only `close` and `open` are
    allowed; a camera that came back has to be configured again because its settings may have been reset.

    Calls in the wrong order raise CameraUsageError. Every call that asks the camera may raise CameraLost if it
    does not answer, and CameraError if it refuses.
    """

    @property
    def info(self) -> CameraInfo:
        """Vendor, model, serial number; CameraUsageError before `open`."""

    @property
    def counters(self) -> Counters:
        """Counters since the last `arm`."""

    def open(self) -> None:
        """Take control of the camera.

        Raises
        ------
        CameraSetupError
            A library, producer or folder is missing or does not list the camera.
        CameraBusy
            Another process controls the camera; close it there.
        CameraLost
            The camera does not answer; check cable, power and address.
        CameraUsageError
            It is open already; close it first.
        """

    def configure(self, settings: Mapping[str, Setting], chunks: Sequence[str] = ()) -> dict[str, Setting]:
        """Set SFNC features in a safe order and return what the camera reads back.

        The camera may round a float.

        Parameters
        ----------
        settings : mapping
            By SFNC name.
        chunks : sequence of str
            Chunk data that every frame has to carry, by SFNC name; it is found in the frame's `meta.chunks`.

        Raises
        ------
        SettingRefused
            A name is unknown or a value did not arrive; what was configured before is put back.
        CameraUsageError
            The camera is closed, or armed; open or disarm it first.
        """

    def verify(self) -> None:
        """Read the configured settings back once more; SettingsChanged if the camera lost any."""

    def settings(self) -> dict[str, Setting]:
        """Every readable feature with its value, to be saved with the run."""

    def read(self, names: Sequence[str]) -> dict[str, Setting]:
        """Values of a few features, also while it is armed; those that the camera has not are left out."""

    def arm(self, buffers: int = 24) -> None:
        """Allocate `buffers` frames of memory and start the acquisition; counters begin at zero.

        Raises
        ------
        CameraUsageError
            The camera is closed, or armed already; open or disarm it first.
        """

    def clock_ns(self) -> int | None:
        """The camera's own clock now, the one that stamps its frames; None if it cannot be read."""

    def trigger(self) -> int | None:
        """Send one software trigger; return `clock_ns` of the moment right before.

        Raises
        ------
        CameraUsageError
            The camera is not armed.
        CameraError
            It does not take the trigger; look at its TriggerMode and TriggerSource.
        """

    def poll(self, timeout_s: float) -> Frame | None:
        """Wait for the next complete frame; None if none came.  Asks the camera nothing, 0 s only looks.

        Raises
        ------
        FrameIncomplete
            A frame came with pixels missing; it is counted, and the next call goes on.
        BadFrame
            A frame is not what the camera announced; it is not used.
        CameraUsageError
            The camera is not armed.
        """

    def probe(self, timeout_s: float) -> None:
        """CameraLost unless the camera answers within this time."""

    def next_frame(self, timeout_s: float) -> Frame:
        """Wait for the next complete frame.

        Raises
        ------
        CameraTimeout
            None came, and the camera answers; look at its trigger.
        CameraLost
            None came, and the camera does not answer.
        BadFrame
            A frame is not what the camera announced; it is not used.
        """

    def disarm(self) -> Counters:
        """Stop the acquisition; frames not fetched are gone and counted as unused."""

    def close(self) -> None:
        """Give the camera back; harmless when repeated or after a loss."""


PROBE_MIN_S = 0.5


def probe_s(timeout_s: float) -> float:
    """Time for a camera to answer after a frame did not come; a wait lasts half as long again at most."""
    return max(PROBE_MIN_S, timeout_s / 2)


def wait_for_frame(camera: Camera, timeout_s: float) -> Frame:
    """Wait for the next complete frame; incomplete ones are left to the counters.

    Raises
    ------
    CameraTimeout
        None came, and the camera answers.
    CameraLost
        None came, and it does not.
    """
    deadline_s = time.monotonic() + timeout_s
    while True:
        try:
            frame = camera.poll(max(0.0, deadline_s - time.monotonic()))
        except FrameIncomplete:
            continue
        if frame is not None:
            return frame
        if time.monotonic() >= deadline_s:
            break
    camera.probe(probe_s(timeout_s))
    with suppress(FrameIncomplete):
        frame = camera.poll(0.0)  # the probe may have let a late one through
        if frame is not None:
            return frame
    raise CameraTimeout(f"no frame within {timeout_s:g} s; the camera answers, so look at its trigger")


class CameraBase(Camera):
    """Base of the backends: identity, order of the calls, and the wait for a frame."""

    _info: CameraInfo | None = None  # None while it is closed

    @property
    def info(self) -> CameraInfo:
        """Vendor, model, serial number; CameraUsageError before `open`."""
        if self._info is None:
            raise CameraUsageError("the camera is closed; open it first")
        return self._info

    @property
    @abstractmethod
    def _is_armed(self) -> bool:
        """Return whether the acquisition runs."""

    def next_frame(self, timeout_s: float) -> Frame:
        """Wait for the next complete frame; incomplete ones are left to the counters."""
        return wait_for_frame(self, timeout_s)

    def _require_armed(self) -> None:
        if not self._is_armed:
            raise CameraUsageError("the camera is not armed; call arm first")

    def _require_disarmed(self) -> None:
        if self._is_armed:
            raise CameraUsageError("the camera is armed; disarm it first")
