"""The process that talks to a GenTL producer through Harvesters.

The genicam binding keeps Python's lock inside every GenTL call, also while it waits for a frame: another thread of
the same process may stand still (github.com/genicam/harvesters/issues/508).  So this loop has a process of its
own, and only one thread: look for a request, fetch at most one frame, unpack it into a free slot, tell the parent.

Only a small part of Harvesters is used: add_file, update, create, node_map, start, raw fetch, stop.  Its own
unpacking is not (slow, wrong for padded rows), nor its background thread (drops frames without counting).
"""

import signal
import time
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from genicam import genapi, gentl
from harvesters.core import Callback, Harvester, ImageAcquirer, ParameterKey, ParameterSet

from daq.camera import Setting
from daq.cameras.formats import pixel_format
from daq.cameras.ring import FrameRing
from daq.cameras.sfnc import apply_or_restore, count_missed_triggers, exposure_us, verify_settings
from daq.cameras.wire import Message, pack_error, receive, send
from daq.errors import CameraBusy, CameraError, CameraLost, CameraSetupError, FrameError, SettingRefused

FETCH_S = 0.004  # longest wait for a frame before requests are looked at again
MIN_PRODUCER_BUFFERS = 3
GENICAM_ERRORS = (genapi.GenericException, gentl.GenericException)


class GenApiNodes:
    """A node map as `Nodes`."""

    def __init__(self, node_map: Any) -> None:  # noqa: ANN401 - genicam has no types
        self._map = node_map

    def names(self) -> list[str]:
        """Every feature below Root that has a value."""
        with_value = {genapi.EInterfaceType.intfIInteger, genapi.EInterfaceType.intfIFloat}
        with_value |= {genapi.EInterfaceType.intfIBoolean, genapi.EInterfaceType.intfIString}
        with_value.add(genapi.EInterfaceType.intfIEnumeration)
        return [
            entry.node.name
            for entry in self._map.nodes
            if entry.node.is_feature() and entry.node.principal_interface_type in with_value
        ]

    def has(self, name: str) -> bool:
        """Whether the feature exists and can be read or written now."""
        if not self._map.has_node(name):
            return False
        return self._map.get_node(name).get_access_mode() in (genapi.EAccessMode.RO, genapi.EAccessMode.RW)

    def get(self, name: str) -> Setting:
        """Value of a feature, past the cache."""
        feature = self._map.get_node(name)
        for node in (feature.node, *(child.node for child in feature.node.children)):
            node.invalidate_node()
        value = feature.value
        return value if isinstance(value, bool | int | float | str) else str(value)

    def set(self, name: str, value: Setting) -> None:
        """Write a feature; SettingRefused with the limits if it does not take the value."""
        feature = self._map.get_node(name)
        try:
            feature.value = value
        except (genapi.GenericException, TypeError, OverflowError) as error:
            raise SettingRefused(
                f"{name} = {value!r} is refused{self._limits(feature)}: {_line(error)}"
            ) from error

    def entries(self, name: str) -> tuple[str, ...]:
        """Entries of an enumeration."""
        return tuple(self._map.get_node(name).symbolics)

    def execute(self, name: str) -> None:
        """Execute a command."""
        self._map.get_node(name).execute()

    def _limits(self, feature: Any) -> str:  # noqa: ANN401
        try:
            if hasattr(feature, "symbolics"):
                return f" (one of {', '.join(feature.symbolics)})"
            return f" (from {feature.min} to {feature.max})"
        except (AttributeError, genapi.GenericException):
            return ""


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
        self._configured: dict[str, Setting] = {}
        self._incomplete = _CountIncomplete()
        self._underrun_before = 0
        self._counts_triggers = False
        self._exposure_us = float("nan")
        self._unpack: Callable[..., Any]
        self._calls: dict[str, Callable[..., Any]] = {
            "open": self._open,
            "configure": self._configure,
            "verify": lambda: verify_settings(self._nodes, self._configured),
            "settings": self._settings,
            "arm": self._arm,
            "trigger": lambda: self._nodes.execute("TriggerSoftware"),
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
                if is_armed and self._free:
                    self._grab()
                elif is_armed:
                    self._pipe.poll(FETCH_S)  # no slot free: frames wait in the producer, which counts underruns
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
        except CameraError as error:
            answer |= pack_error(error)
        except GENICAM_ERRORS as error:
            answer |= pack_error(self._translate(error, message["call"]))
        except Exception as error:  # the parent must hear of it; this process goes on
            answer |= pack_error(CameraError(f"{message['call']}: {type(error).__name__}: {_line(error)}"))
        send(self._pipe, answer)

    def _translate(self, error: Exception, call: str) -> CameraError:
        """Whose fault is it: a camera that does not answer a probe is lost, whatever the error says."""
        if call != "open":
            try:
                self._probe()
            except CameraError as lost:
                return lost
        return CameraError(f"{call}: {_line(error)}")

    def _open(self) -> Message:
        quiet = {ParameterKey.TIMEOUT_PERIOD_ON_UPDATE_EVENT_DATA_CALL: max(1, round(1e3 * FETCH_S))}
        self._harvester = harvester = Harvester()
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
                f"camera {found[0].serial_number} is listed and does not answer: {_line(error)}"
            ) from error
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # Harvesters takes Ctrl-C; the parent decides about it
        acquirer.add_callback(ImageAcquirer.Events.INCOMPLETE_BUFFER, self._incomplete)
        info = found[0]
        return {"vendor": info.vendor, "model": info.model, "serial": info.serial_number, "tl_type": info.tl_type}

    def _configure(self, settings: dict[str, Setting]) -> dict[str, Setting]:
        readback = apply_or_restore(self._nodes, settings, self._configured)
        self._configured.update(readback)
        return readback

    def _settings(self) -> dict[str, Setting]:
        nodes = self._nodes
        values = {}
        for name in nodes.names():
            try:
                if nodes.has(name):
                    values[name] = nodes.get(name)
            except GENICAM_ERRORS:
                continue  # not readable in the present state
        return values

    def _arm(self, ring: str, slots: int, pixels: int) -> Message:
        from daq.cameras.pixels import unpack, warm_up  # loads compiled kernels: not before they are needed

        assert self._acquirer is not None
        self._unpack = unpack
        self._ring = FrameRing(slots, pixels, ring)
        self._free = deque(range(slots))
        nodes = self._nodes
        self._counts_triggers = count_missed_triggers(nodes)
        self._exposure_us = exposure_us(nodes)
        self._incomplete.count = 0
        warm_up()
        try:
            # As many raw frames again: they bridge the time in which the system lets this process wait.
            self._acquirer.num_buffers = max(MIN_PRODUCER_BUFFERS, slots)
            self._acquirer.start()
        except BaseException:
            self._drop_ring()
            raise
        self._underrun_before = 0
        self._underrun_before = self._underrun()
        return {"counts_triggers": self._counts_triggers}

    def _grab(self) -> None:
        assert self._acquirer is not None
        assert self._ring is not None
        try:
            buffer = self._acquirer.try_fetch(timeout=FETCH_S, is_raw=True)
        except GENICAM_ERRORS as error:
            send(self._pipe, {"broken": _line(error)})
            time.sleep(FETCH_S)
            return
        if buffer is None:
            return
        received_ns = time.monotonic_ns()
        slot = self._free.popleft()
        message: Message
        try:
            form = pixel_format(int(buffer.pixel_format))
            raw = np.frombuffer(buffer.raw_buffer, np.uint8)[: _delivered_bytes(buffer)]
            image = self._unpack(raw, form, buffer.width, buffer.height, _padding(buffer), self._ring.slot(slot))
            message = {"frame": slot, "height": image.shape[0], "width": image.shape[1], "format": form.name}
        except FrameError as error:
            self._free.append(slot)
            message = {"bad_frame": str(error)}
        message |= {"id": _frame_id(buffer), "timestamp_ns": _timestamp_ns(buffer), "received_ns": received_ns}
        message |= {"exposure_us": self._exposure_us, "incomplete": self._incomplete.count}
        message["underrun"] = self._underrun()
        buffer.parent.queue_buffer(buffer)
        send(self._pipe, message)

    def _underrun(self) -> int:
        assert self._acquirer is not None
        try:
            return int(self._acquirer.data_streams[0].num_underrun) - self._underrun_before
        except gentl.GenericException:  # optional in the standard
            return 0

    def _counts(self) -> Message:
        ignored = int(self._nodes.get("CounterValue")) if self._counts_triggers else None
        return {"incomplete": self._incomplete.count, "underrun": self._underrun(), "ignored_triggers": ignored}

    def _probe(self) -> None:
        """Ask the camera for its width; CameraLost if it does not answer."""
        try:
            self._nodes.get("Width")
        except GENICAM_ERRORS as error:
            raise CameraLost(f"the camera does not answer ({_line(error)}); check cable and power") from error

    def _disarm(self) -> Message:
        assert self._acquirer is not None
        counts: Message = {"incomplete": self._incomplete.count, "underrun": 0, "ignored_triggers": None}
        try:
            counts = self._counts()
        except GENICAM_ERRORS as error:
            counts["lost"] = _line(error)
        self._acquirer.stop()
        self._drop_ring()
        return counts

    def _drop_ring(self) -> None:
        if self._ring is not None:
            self._ring.close()
            self._ring = None

    def _close(self) -> None:
        if self._acquirer is not None:
            self._acquirer.destroy()
        if self._harvester is not None:
            self._harvester.reset()
        self._drop_ring()


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__


def _delivered_bytes(buffer: Any) -> int:  # noqa: ANN401
    for name in ("data_size", "size_filled"):  # both are optional in GenTL
        try:
            return int(getattr(buffer, name))
        except gentl.GenericException:
            continue
    return int(buffer.size)


def _padding(buffer: Any) -> int:  # noqa: ANN401
    try:
        return int(buffer.padding_x)
    except gentl.GenericException:
        return 0


def _frame_id(buffer: Any) -> int:  # noqa: ANN401
    try:
        return int(buffer.frame_id)
    except gentl.GenericException:
        return -1


def _timestamp_ns(buffer: Any) -> int:  # noqa: ANN401
    for name in ("timestamp_ns", "timestamp"):
        try:
            return int(getattr(buffer, name))
        except gentl.GenericException:
            continue
    return 0


def serve(pipe: "Connection[Any, Any]", cti: str, serial: str | None) -> None:
    """Run the worker in a new process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Worker(pipe, cti, serial).run()
