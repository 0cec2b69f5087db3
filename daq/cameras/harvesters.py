"""Any GenICam camera through a vendor's GenTL producer (.cti): GigE, USB3, CoaXPress, Camera Link HS.

The library runs in a process of its own (see harvesters_worker); frames arrive in shared memory.  Every wait has
a deadline.  A process that gives no answer within 1.5 times the timeout of a call is ended, and the camera counts
as lost: a producer that hangs inside a C call can be cured in no other way.
"""

import os
import subprocess
import threading
import time
import weakref
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from daq.cameras import harvesters_process
from daq.cameras.camera import CameraBase, CameraInfo, Counters, Setting
from daq.cameras.formats import pixel_format
from daq.cameras.frame import Frame, FrameMeta
from daq.cameras.harvesters_process import Message, raise_error, receive, send
from daq.cameras.ids import IdTracker
from daq.cameras.ring import FrameRing
from daq.errors import BadFrame, CameraError, CameraLost, CameraSetupError, CameraUsageError, FrameIncomplete

OPEN_S = 30.0  # a new Python process, numba, a producer that looks for cameras
CALL_TIMEOUT_S = 5.0
WATCHDOG = 1.5


class HarvestersCamera(CameraBase):
    """A camera behind a GenTL producer.

    Parameters
    ----------
    cti : path
        The producer's file.
    serial : str, optional
        Serial number; default is the first camera the producer lists.
    """

    def __init__(self, cti: Path | str, serial: str | None = None) -> None:
        self._cti = Path(cti)
        self._serial = serial
        self._process: subprocess.Popen[bytes] | None = None
        self._end_process: weakref.finalize[..., HarvestersCamera] | None = None
        self._pipe: Any = None
        self._send_lock = threading.Lock()
        self._id_bits = 64
        self._number = 0
        self._waiting: deque[Message] = deque()
        self._answers: dict[int, Message] = {}
        self._ring: FrameRing | None = None
        self._ids = IdTracker()
        self._counts: Message = {}
        self._delivered = 0
        self._unused = 0
        self._incomplete_told = 0

    @property
    def counters(self) -> Counters:
        """Counters since the last `arm`; asks the camera while it is armed."""
        if self._ring is not None:
            self._counts |= self._call("counts")
        return self._count()

    def open(self) -> None:
        """Start the camera's process and take control of the camera.

        CameraSetupError if the producer's file is missing or does not list the camera, CameraUsageError if the
        camera is open already.
        """
        if self._process is not None:
            raise CameraUsageError("the camera is open already; close it first")
        if not self._cti.is_file():
            raise CameraSetupError(
                f"there is no GenTL producer {self._cti}; install the camera vendor's, or fix the path"
            )
        self._process, self._pipe = harvesters_process.start(str(self._cti), self._serial)
        self._end_process = weakref.finalize(
            self, _end, self._process, os.getpid()
        )  # also where it is never closed
        try:
            found = self._call("open", OPEN_S)
        except CameraError:
            self.close()
            raise
        self._id_bits = 16 if found["tl_type"] == "GEV" else 64
        self._info = CameraInfo("harvesters", found["vendor"], found["model"], found["serial"], str(self._cti))

    def configure(self, settings: Mapping[str, Setting], chunks: Sequence[str] = ()) -> dict[str, Setting]:
        """Set SFNC features in a safe order; returns what the camera reads back."""
        self._require_disarmed()
        readback: dict[str, Setting] = self._call("configure", settings=dict(settings), chunks=list(chunks))
        return readback

    def verify(self) -> None:
        """Read the configured settings back once more; SettingsChanged if the camera lost any."""
        self._call("verify")

    def settings(self) -> dict[str, Setting]:
        """Every readable feature with its value."""
        values: dict[str, Setting] = self._call("settings", OPEN_S)
        return values

    def read(self, names: Sequence[str]) -> dict[str, Setting]:
        """Values of a few features; those that the camera has not are left out."""
        values: dict[str, Setting] = self._call("read", names=list(names))
        return values

    def arm(self, buffers: int = 24) -> None:
        """Allocate `buffers` frames of shared memory, as many raw ones, and start the acquisition.

        CameraUsageError if it is armed already, or does not tell its Width or Height.
        """
        self._require_disarmed()
        values = self.settings()
        try:
            pixels = int(values["Width"]) * int(values["Height"])
        except KeyError as error:
            raise CameraUsageError(f"the camera does not report its {error}") from error
        ring = FrameRing(buffers, pixels)
        self._waiting.clear()
        self._ids = IdTracker(self._id_bits)
        self._counts = {}
        self._delivered = self._unused = self._incomplete_told = 0
        try:
            self._call("arm", OPEN_S, ring=ring.name, slots=buffers, pixels=pixels)
        except CameraError:
            ring.close()
            raise
        self._ring = ring

    def clock_ns(self) -> int | None:
        """The camera's own clock now; None if it cannot be read."""
        now_ns: int | None = self._call("clock")
        return now_ns

    def trigger(self) -> int | None:
        """Send one software trigger; returns the camera's clock right before."""
        self._require_armed()
        before_ns: int | None = self._call("trigger")
        return before_ns

    def poll(self, timeout_s: float) -> Frame | None:
        """Next complete frame, or None; FrameIncomplete when one came with pixels missing."""
        self._require_armed()
        deadline = time.monotonic() + timeout_s
        while not self._waiting and self._incomplete_told == self._incomplete:
            left_s = deadline - time.monotonic()
            if not self._receive(max(0.0, left_s)) and left_s <= 0:
                return None
        if self._waiting:
            return self._frame(self._waiting.popleft())
        number, self._incomplete_told = self._incomplete - self._incomplete_told, self._incomplete
        raise FrameIncomplete(f"{number} frame came with pixels missing; look at the link")

    def probe(self, timeout_s: float) -> None:
        """CameraLost unless the camera answers within this time."""
        self._call("probe", timeout_s)

    def disarm(self) -> Counters:
        """Stop the acquisition; frames not fetched count as unused."""
        if self._ring is None:
            return self._count()
        try:
            self._counts |= self._call("disarm")
        finally:
            for message in self._waiting:
                self._ids.note(message["id"])
                self._unused += 1
            self._waiting.clear()
            self._drop_ring()
        return self._count()

    def close(self) -> None:
        """End the camera's process; harmless when repeated."""
        self._drop_ring()
        self._info = None
        if self._pipe is not None:
            with self._send_lock:
                self._pipe.close()
        if self._process is not None:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(CALL_TIMEOUT_S)
            self._kill()
        self._pipe = None

    @property
    def _incomplete(self) -> int:
        return int(self._counts.get("incomplete", 0))

    def _count(self) -> Counters:
        underrun = int(self._counts.get("underrun", 0))
        missing = self._ids.missing(self._incomplete + underrun)  # ids of unused frames are known
        return Counters(
            self._delivered,
            self._incomplete,
            underrun,
            missing,
            ignored_triggers=self._counts.get("ignored_triggers"),
            unused=self._unused,
        )

    def _frame(self, message: Message) -> Frame:
        self._counts |= {name: message[name] for name in ("incomplete", "underrun")}
        sequence = self._ids.note(int(message["id"]))
        if "bad_frame" in message:
            self._unused += 1
            raise BadFrame(str(message["bad_frame"]))
        assert self._ring is not None
        slot = int(message["frame"])
        height, width = int(message["height"]), int(message["width"])
        pixels = self._ring.slot(slot)[: height * width].reshape(height, width)
        form = pixel_format(message["format"])
        meta = FrameMeta(
            int(message["id"]),
            sequence,
            int(message["timestamp_ns"]),
            int(message["received_ns"]),
            float(message["exposure_us"]),
            form.name,
            form.significant_bits,
            id_told=bool(message["id_told"]),
            chunks=message["chunks"],
        )
        self._delivered += 1
        ring = self._ring
        return Frame(pixels, meta, lambda: self._release(ring, slot), slot)

    def _release(self, ring: FrameRing, slot: int) -> None:
        with self._send_lock:
            if self._ring is ring and self._pipe is not None:
                try:
                    send(self._pipe, {"release": slot})
                except OSError:
                    return  # the process is gone; the next call says so

    def _call(self, call: str, timeout_s: float = CALL_TIMEOUT_S, **arguments: object) -> Any:  # noqa: ANN401
        if self._pipe is None:
            raise CameraUsageError("the camera is closed; open it first")
        self._number += 1
        number = self._number
        try:
            with self._send_lock:
                send(self._pipe, {"number": number, "call": call, "arguments": arguments})
        except OSError as error:
            raise self._end_as_lost("its process has ended") from error
        deadline = time.monotonic() + (timeout_s if call == "probe" else WATCHDOG * timeout_s)
        while number not in self._answers:
            left_s = deadline - time.monotonic()
            if left_s <= 0:
                raise self._end_as_lost(f"{call} gave no answer within {timeout_s:g} s")
            self._receive(left_s)
        answer = self._answers.pop(number)
        raise_error(answer)
        return answer.get("result")

    def _receive(self, timeout_s: float) -> bool:
        """Take one message from the camera's process; False if none came in time."""
        try:
            if not self._pipe.poll(timeout_s):
                return False
            message = receive(self._pipe)
        except (EOFError, OSError) as error:
            raise self._end_as_lost("its process has ended") from error
        if "answer" in message:
            self._answers[int(message["answer"])] = message
        elif "broken" in message:
            raise CameraLost(f"the stream is broken ({message['broken']}); close the camera and open it again")
        elif "id" in message:
            self._waiting.append(message)
        else:
            self._counts |= message
        return True

    def _end_as_lost(self, why: str) -> CameraLost:
        self._kill()
        self._drop_ring()
        return CameraLost(f"the camera is lost: {why}; close it and open it again")

    def _kill(self) -> None:
        self._process = None
        if self._end_process is not None:
            self._end_process()

    def _drop_ring(self) -> None:
        ring, self._ring = self._ring, None
        if ring is not None:
            ring.close()

    def _require_armed(self) -> None:
        if self._pipe is not None and self._process is None:  # another call may have found out
            raise self._end_as_lost("its process has ended")
        super()._require_armed()

    @property
    def _is_armed(self) -> bool:
        return self._ring is not None


def _end(process: "subprocess.Popen[bytes]", owner: int) -> None:
    if os.getpid() == owner:  # a fork of it does not own the camera
        process.kill()  # harmless if it has ended
        process.wait()
