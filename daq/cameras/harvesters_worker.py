"""The process that talks to a GenTL producer through Harvesters.

The genicam binding keeps Python's lock inside every GenTL call, also while it waits for a frame: another thread of
the same process may stand still (github.com/genicam/harvesters/issues/508).  So this loop has a process of its
own, and only one thread: look for a request, fetch at most one frame, unpack it into a free slot, tell the parent.
It waits where something is to come next: for the frame of a software trigger in the producer, and between such
frames for a request, so that a trigger does not find it waiting for nothing.

Only a small part of Harvesters is used: add_file, update, create, node_map, start, raw fetch, stop.  Its own
unpacking is not (slow, wrong for padded rows), nor its background thread (drops frames without counting).

Complaints that mean nothing are kept away from the terminal: the genicam library writes a line for every GenTL
function of the newest standard that a vendor's producer does not have.  None of them is used here; what else is
written to standard error is passed on.
"""

import os
import signal
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any

from genicam import genapi, gentl
from harvesters.core import Callback, Harvester, ImageAcquirer, ParameterKey, ParameterSet

from daq.cameras.features import CameraFeatures, read_all
from daq.cameras.genicam_objects import GenApiNodes, chunks_of, frame_id, image_of, one_line, timestamp_ns
from daq.cameras.harvesters_process import Message, pack_error, receive, send
from daq.cameras.ring import FrameRing
from daq.cameras.sfnc import read_known
from daq.errors import BadFrame, CameraBusy, CameraError, CameraLost, CameraSetupError, SettingRefused

COMPLAINT = b"GenTL producer does not implement"


@contextmanager
def without_complaints() -> Iterator[None]:
    """Hold standard error (the file descriptor, for C libraries) back, and pass on what is no such complaint."""
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as held:
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            held.seek(0)
            for line in held:
                if not line.startswith(COMPLAINT):
                    os.write(2, line)


FETCH_S = 0.004  # longest wait for a frame before requests are looked at again
NO_FRAME_POLL_S = 0.001  # the same where no frame is expected
MIN_PRODUCER_BUFFERS = 3
GENICAM_ERRORS = (genapi.GenericException, gentl.GenericException)


class _CountIncomplete(Callback):  # type: ignore[misc]
    """Harvesters tells of incomplete buffers only through a callback."""

    def __init__(self) -> None:
        self.count = 0

    def emit(self, context: object | None = None) -> None:
        self.count += 1


class Worker:
    """State of the camera's process."""

    def __init__(self, pipe: "Connection[Any, Any]", cti: str, serial: str | None) -> None:
        self._pipe = pipe
        self._cti = cti
        self._serial = serial
        self._harvester: Harvester | None = None
        self._acquirer: ImageAcquirer | None = None
        self._ring: FrameRing | None = None
        self._free: deque[int] = deque()
        self._features = CameraFeatures()
        self._incomplete = _CountIncomplete()
        self._underrun_before = 0
        self._grabbed = 0
        self._incomplete_told = 0
        self._triggers = self._unanswered = 0  # of this arm
        self._unpack: Callable[..., Any]
        self._calls: dict[str, Callable[..., Any]] = {
            "open": self._open,
            "configure": lambda **asked: self._features.configure(self._nodes, **asked),
            "verify": lambda: self._features.verify(self._nodes),
            "settings": lambda: read_all(self._nodes, GENICAM_ERRORS),
            "read": lambda names: read_known(self._nodes, names),
            "arm": self._arm,
            "clock": lambda: self._features.clock_ns(self._nodes),
            "trigger": self._trigger,
            "counts": self._counts,
            "probe": self._probe,
            "disarm": self._disarm,
        }

    def run(self) -> None:
        """Serve until the parent closes the pipe."""
        try:
            while True:
                is_armed = self._ring is not None
                while self._pipe.poll(0 if is_armed else None):
                    self._serve(receive(self._pipe))
                    is_armed = self._ring is not None
                if is_armed and self._free and self._triggers and not self._unanswered:
                    if not self._pipe.poll(FETCH_S):
                        self._grab(NO_FRAME_POLL_S)
                elif is_armed and self._free:
                    self._grab(FETCH_S)
                elif is_armed:
                    # no slot free: frames wait in the producer, which counts underruns
                    self._pipe.poll(FETCH_S)
        except (EOFError, OSError):
            self._close()

    @property
    def _nodes(self) -> GenApiNodes:
        assert self._acquirer is not None
        return GenApiNodes(self._acquirer.remote_device.node_map)

    def _serve(self, message: Message) -> None:
        if "release" in message:
            self._free.append(int(message["release"]))
            return
        answer: Message = {"answer": message["number"]}
        try:
            answer["result"] = self._calls[message["call"]](**message.get("arguments", {}))
        except SettingRefused as error:
            answer |= pack_error(self._find_loss() or error)
        except CameraError as error:
            answer |= pack_error(error)
        except GENICAM_ERRORS as error:
            answer |= pack_error(self._translate(error, message["call"]))
        except Exception as error:  # the parent must hear of it; this process goes on
            answer |= pack_error(CameraError(f"{message['call']}: {type(error).__name__}: {one_line(error)}"))
        send(self._pipe, answer)

    def _translate(self, error: Exception, call: str) -> CameraError:
        """Translate an error: a camera that does not answer a probe is lost, whatever the error says."""
        lost = self._find_loss() if call != "open" else None
        return lost or CameraError(f"{call}: {one_line(error)}")

    def _find_loss(self) -> CameraError | None:
        """CameraLost where the camera does not answer; a lost camera refuses everything."""
        try:
            self._probe()
        except CameraError as lost:
            return lost
        return None

    def _open(self) -> Message:
        quiet = {ParameterKey.TIMEOUT_PERIOD_ON_UPDATE_EVENT_DATA_CALL: max(1, round(1e3 * FETCH_S))}
        self._harvester = harvester = Harvester()
        with without_complaints():
            harvester.add_file(self._cti)
            harvester.update()
        found = [info for info in harvester.device_info_list if self._serial in (None, info.serial_number)]
        if not found:
            known = ", ".join(info.serial_number for info in harvester.device_info_list) or "none"
            wanted = f"camera {self._serial}" if self._serial else "any camera"
            raise CameraSetupError(f"{self._cti} does not list {wanted}; it lists: {known}")
        index = harvester.device_info_list.index(found[0])
        try:
            self._acquirer = acquirer = harvester.create(index, config=ParameterSet(quiet))
        except (gentl.ResourceInUseException, gentl.AccessDeniedException) as error:
            raise CameraBusy(f"another process holds camera {found[0].serial_number}; close it there") from error
        except (gentl.IoException, gentl.NotAvailableException) as error:
            raise CameraLost(
                f"camera {found[0].serial_number} is listed and does not answer: {one_line(error)}"
            ) from error
        finally:
            # Harvesters takes Ctrl-C; the parent decides about it
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        acquirer.add_callback(ImageAcquirer.Events.INCOMPLETE_BUFFER, self._incomplete)
        info = found[0]
        return {"vendor": info.vendor, "model": info.model, "serial": info.serial_number, "tl_type": info.tl_type}

    def _trigger(self) -> int | None:
        before_ns = None
        with suppress(
            *GENICAM_ERRORS
        ):  # a clock that cannot be read is none; a lost camera takes no trigger either
            before_ns = self._features.clock_ns(self._nodes)
        self._nodes.execute("TriggerSoftware")
        self._triggers += 1
        self._unanswered += 1
        return before_ns

    def _arm(self, ring: str, slots: int, pixels: int) -> Message:
        from daq.cameras.pixels import (  # loads compiled kernels: not before they are needed
            unpack,
            warm_up,
        )

        assert self._acquirer is not None
        self._unpack = unpack
        self._ring = FrameRing(slots, pixels, ring)
        self._free = deque(range(slots))
        self._features.begin(self._nodes)
        self._incomplete.count = self._incomplete_told = self._grabbed = 0
        self._triggers = self._unanswered = 0
        warm_up(is_read_only=True)  # raw_buffer is bytes
        try:
            # As many raw frames again: they bridge the time in which the system lets this process wait.
            self._acquirer.num_buffers = max(MIN_PRODUCER_BUFFERS, slots)
            self._acquirer.start()
        except BaseException:
            self._drop_ring()
            raise
        self._underrun_before = 0
        self._underrun_before = self._underrun()
        return {"counts_triggers": self._features.counts_triggers}

    def _grab(self, wait_s: float) -> None:
        assert self._acquirer is not None
        assert self._ring is not None
        try:
            self._acquirer.timeout_period_on_update_event_data_call = round(1e3 * wait_s)
            buffer = self._acquirer.try_fetch(timeout=wait_s, is_raw=True)
        except GENICAM_ERRORS as error:
            send(self._pipe, {"broken": one_line(error)})
            time.sleep(FETCH_S)
            return
        if buffer is None:
            self._tell_incomplete()
            return
        received_ns = time.monotonic_ns()
        self._unanswered = max(0, self._unanswered - 1)
        slot = self._free.popleft()
        message: Message
        try:
            image = image_of(buffer)
            size = (image.form, image.width, image.height, image.padding_bytes)
            pixels = self._unpack(image.payload, *size, self._ring.slot(slot))
            message = {"frame": slot, "height": pixels.shape[0], "width": pixels.shape[1]}
            message["format"] = image.form.name
        except BadFrame as error:
            self._free.append(slot)
            message = {"bad_frame": str(error)}
        underrun = self._underrun()
        given_id = frame_id(buffer)
        # A producer that tells no ids hides what was lost on the link; what it counts itself still makes gaps.
        message["id"] = self._grabbed + self._incomplete.count + underrun if given_id is None else given_id
        message["id_told"] = given_id is not None
        message["chunks"] = chunks_of(buffer, self._nodes, self._features.chunks)
        self._grabbed += 1
        message |= {"timestamp_ns": timestamp_ns(buffer), "received_ns": received_ns}
        message |= {"exposure_us": self._features.exposure_us, "incomplete": self._incomplete.count}
        message["underrun"] = underrun
        buffer.parent.queue_buffer(buffer)
        send(self._pipe, message)

    def _tell_incomplete(self) -> None:
        """Say at once that a frame was put aside: who waits for it need not wait any longer."""
        if self._incomplete.count != self._incomplete_told:
            self._incomplete_told = self._incomplete.count
            self._unanswered = max(0, self._unanswered - 1)
            send(self._pipe, {"incomplete": self._incomplete.count})

    def _underrun(self) -> int:
        assert self._acquirer is not None
        try:
            return int(self._acquirer.data_streams[0].num_underrun) - self._underrun_before
        except gentl.GenericException:  # optional in the standard
            return 0

    def _counts(self) -> Message:
        ignored = self._features.count_ignored(self._nodes)
        return {"incomplete": self._incomplete.count, "underrun": self._underrun(), "ignored_triggers": ignored}

    def _probe(self) -> None:
        """Ask the camera for its width; CameraLost if it does not answer."""
        try:
            self._nodes.get("Width")
        except GENICAM_ERRORS as error:
            raise CameraLost(f"the camera does not answer ({one_line(error)}); check cable and power") from error

    def _disarm(self) -> Message:
        assert self._acquirer is not None
        counts: Message = {"incomplete": self._incomplete.count, "underrun": 0, "ignored_triggers": None}
        try:
            counts = self._counts()
        except GENICAM_ERRORS as error:
            counts["lost"] = one_line(error)
        self._acquirer.stop()
        self._drop_ring()
        return counts

    def _drop_ring(self) -> None:
        if self._ring is not None:
            self._ring.close()
            self._ring = None

    def _close(self) -> None:
        """Let go of what there is; a camera that does not answer any more cannot be stopped, and is not asked."""
        if self._acquirer is not None:
            with suppress(*GENICAM_ERRORS):
                self._acquirer.destroy()
        if self._harvester is not None:
            with suppress(*GENICAM_ERRORS):
                self._harvester.reset()
        self._drop_ring()


def serve(pipe: "Connection[Any, Any]", cti: str, serial: str | None) -> None:
    """Run the worker in a new process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Worker(pipe, cti, serial).run()
