"""The simulated camera itself: registers, triggers, exposures, frames, faults.

One thread per camera.  It sleeps until the next frame has left the sensor, asks the frame source for the pixels,
crops, packs and hands the payload to the transport's sink.  Time is the host's monotonic clock; time stamps count
from power-up on the camera's own clock.

Frame numbers and ids rise from power-up and are not reset by AcquisitionStart, as with many real cameras.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from sim.camera.config import CameraConfig
from sim.camera.darkroom import Darkroom, Picture
from sim.camera.exposure import Exposure, Shutter
from sim.camera.packing import payload_bytes
from sim.camera.registers import RegisterMap, Value, WriteProtected
from sim.camera.source import FrameSource, PatternSource, load_source

log = logging.getLogger(__name__)
VENDOR = "rtpiv"
MODEL = "SimCamera"
CLOCK = ("TimestampLatch", "TimestampLatchValue")


class CameraGone(Exception):  # noqa: N818 - what the client will see
    """The simulated camera is unplugged; nothing answers."""


@dataclass(frozen=True, slots=True)
class SimFrame:
    """One frame on its way to a transport."""

    number: int
    frame_id: int
    trigger_index: int
    timestamp_ns: int
    picture: Picture
    is_incomplete: bool


@dataclass(frozen=True, slots=True)
class _Pending:
    trigger_index: int
    exposure: Exposure


class SimCamera:
    """A camera under simulated power.

    Parameters
    ----------
    config : CameraConfig
        Sensor, serial number, frame source, faults.
    source : FrameSource, optional
        Use this object instead of the source the configuration names.
    """

    def __init__(self, config: CameraConfig, source: FrameSource | None = None) -> None:
        self.config = config
        self.registers = RegisterMap(VENDOR, MODEL, () if config.has_clock else CLOCK)
        self.sink: Callable[[SimFrame], None] | None = None
        self.on_lost: Callable[[], None] | None = None
        self._source = source or _source_of(config)
        self._shutter = Shutter()
        self._power_up_ns = time.monotonic_ns()
        self._lost_ns: int | None = None
        self._was_lost = False
        self._wake = threading.Condition(threading.RLock())
        self._pending: deque[_Pending] = deque()
        self._is_acquiring = False
        self._is_off = False
        self._triggers = 0
        self._frames = 0
        self._next_id = config.first_frame_id
        self._frames_left = -1
        self._missed_before = 0
        self._next_free_run_ns = 0
        self._darkroom = Darkroom(self.registers, config.bits, config.delivers)
        self.registers.on_write = self._written
        self.registers.before_read = self._refresh
        self._power_up_settings()
        self._thread = threading.Thread(target=self._run, name=f"camera {config.serial}", daemon=True)
        self._thread.start()

    @property
    def is_lost(self) -> bool:
        """Whether the camera is unplugged just now; it may come back by itself."""
        if self._lost_ns is None:
            return False
        with self._wake:
            if self._lost_ns is None:
                return False
            back_s = self.config.faults.back_after_s
            if back_s is None or time.monotonic_ns() - self._lost_ns < back_s * 1e9:
                return True
            self._lost_ns = None
            self._power_up_settings()
            return False

    def now_ns(self) -> int:
        """Time on the camera's own clock."""
        return time.monotonic_ns() - self._power_up_ns

    def read(self, address: int, length: int) -> bytes:
        """Read registers as a client; CameraGone or BadAddress.

        No lock: a GenTL client reads while it holds the lock of its node map and Python's lock.  To wait here
        would let another thread run into the node map's lock with Python's lock in hand.
        """
        if self.is_lost:
            raise CameraGone
        return self.registers.read(address, length)

    def write(self, address: int, data: bytes) -> None:
        """Write a register as a client; CameraGone, BadAddress, BadValue or WriteProtected."""
        if self.is_lost:
            raise CameraGone
        with self._wake:
            self.registers.write(address, data)

    def line_edge(self) -> None:
        """Rising edge on Line1, from a simulated synchroniser."""
        with self._wake:
            if self.registers.entry("TriggerSource") == "Line1":
                self._trigger()

    def stop(self) -> None:
        """Stop the acquisition (a client left)."""
        with self._wake:
            self._stop()

    def power_off(self) -> None:
        """End the camera's thread."""
        with self._wake:
            self._is_off = True
            self._wake.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(5.0)
        leave = getattr(self._source, "close", None)  # only remote sources hold something open
        if callable(leave):
            leave()

    def _power_up_settings(self) -> None:
        put = self.registers.put
        self.registers.reset()
        put("DeviceVendorName", VENDOR)
        put("DeviceModelName", MODEL)
        put("DeviceVersion", "1.0")
        put("DeviceSerialNumber", self.config.serial)
        for axis, size in (("Width", self.config.width), ("Height", self.config.height)):
            put(f"Sensor{axis}", size)
            put(axis, size)
        self._update_derived()

    def _update_derived(self) -> None:
        registers = self.registers
        for size, offset, sensor in (
            ("Width", "OffsetX", self.config.width),
            ("Height", "OffsetY", self.config.height),
        ):
            registers.put(f"{size}Max", sensor - registers.integer(offset))
            registers.put(f"{offset}Max", sensor - registers.integer(size))
        size_bytes = payload_bytes(
            registers.entry("PixelFormat"), registers.integer("Width"), registers.integer("Height")
        )
        registers.put("PayloadSize", size_bytes)

    def _refresh(self, name: str) -> None:
        if name == "CounterValue":
            counts = self.registers.entry("CounterEventSource") == "FrameTriggerMissed"
            self.registers.put(name, self._shutter.missed - self._missed_before if counts else 0)

    def _written(self, name: str, value: Value) -> None:
        commands = {
            "AcquisitionStart": self._start,
            "AcquisitionStop": self._stop,
            "TriggerSoftware": self._software_trigger,
            "DeviceReset": self._reset,
            "CounterReset": self._reset_counter,
            "TimestampLatch": self._latch,
        }
        if name in commands:
            commands[name]()
            return
        if self._is_acquiring and name in ("Width", "Height", "OffsetX", "OffsetY", "PixelFormat"):
            raise WriteProtected(f"{name} while the acquisition runs")
        self.registers.put(name, value)
        self._update_derived()
        if name in ("AcquisitionFrameRate", "AcquisitionFrameRateEnable", "TriggerMode"):
            self._next_free_run_ns = time.monotonic_ns()
        if name == "CounterEventSource":
            self._reset_counter()
        self._wake.notify_all()

    def _reset_counter(self) -> None:
        self._missed_before = self._shutter.missed

    def _latch(self) -> None:
        self.registers.put("TimestampLatchValue", self.now_ns())

    def _reset(self) -> None:
        self._stop()
        self._power_up_settings()

    def _start(self) -> None:
        mode = self.registers.entry("AcquisitionMode")
        counts = {
            "Continuous": -1,
            "SingleFrame": 1,
            "MultiFrame": self.registers.integer("AcquisitionFrameCount"),
        }
        self._frames_left = counts[mode]
        self._pending.clear()
        self._is_acquiring = True
        self._next_free_run_ns = time.monotonic_ns()
        self._wake.notify_all()

    def _stop(self) -> None:
        self._is_acquiring = False
        self._pending.clear()
        self._wake.notify_all()

    def _software_trigger(self) -> None:
        if self.registers.entry("TriggerSource") == "Software":
            self._trigger()

    def _trigger(self) -> None:
        if not self._is_acquiring or self.registers.entry("TriggerMode") != "On":
            self._shutter.missed += 1
            return
        self._expose(time.monotonic_ns())

    def _expose(self, now_ns: int) -> None:
        registers = self.registers
        exposure_ns = round(registers.number("ExposureTime") * 1e3)
        readout_ns = round(registers.integer("Height") * self.config.row_time_us * 1e3)
        is_double = registers.integer("DoubleFrameEnable") == 1
        interval_ns = round(registers.number("DoubleFrameInterval") * 1e3) if is_double else None
        exposures = self._shutter.fire(now_ns, exposure_ns, readout_ns, interval_ns)
        if not exposures:
            return
        for exposure in exposures:
            if self._frames_left != 0:
                self._pending.append(_Pending(self._triggers, exposure))
                self._frames_left -= 1 if self._frames_left > 0 else 0
        self._triggers += 1
        self._wake.notify_all()

    def _run(self) -> None:
        while True:
            with self._wake:
                if self._is_off:
                    return
                due_ns = self._step(time.monotonic_ns())
                if due_ns is None or due_ns > time.monotonic_ns():
                    wait_s = 0.5 if due_ns is None else (due_ns - time.monotonic_ns()) / 1e9
                    self._wake.wait(max(0.0, wait_s))
                    continue
                pending = self._pending.popleft() if self._pending else None
                if pending is not None and pending.exposure.read_ns > time.monotonic_ns():
                    self._pending.appendleft(pending)  # what was due is the next free-running exposure
                    continue
            if pending is not None:
                self._finish(pending)

    def _step(self, now_ns: int) -> int | None:
        """Start a free-running exposure if one is due; return when something is to be done next."""
        if not self._is_acquiring or self.is_lost:
            return None
        if self.registers.entry("TriggerMode") == "Off" and self._frames_left != 0 and len(self._pending) < 2:
            exposure_ns = round(self.registers.number("ExposureTime") * 1e3)
            start_ns = max(self._next_free_run_ns, self._shutter.earliest_ns(exposure_ns))
            if start_ns > now_ns:
                return min(start_ns, self._pending[0].exposure.read_ns) if self._pending else start_ns
            self._expose(now_ns)
            limited = self.registers.integer("AcquisitionFrameRateEnable") == 1
            period_ns = round(1e9 / self.registers.number("AcquisitionFrameRate")) if limited else 0
            late = now_ns - self._next_free_run_ns > 5 * period_ns
            self._next_free_run_ns = (now_ns if late else self._next_free_run_ns) + period_ns
        return self._pending[0].exposure.read_ns if self._pending else None

    def _finish(self, pending: _Pending) -> None:
        """Read the sensor out: faults first, then pixels, then the transport."""
        number = self._frames
        faults = self.config.faults
        if number == faults.lost_at and not self._was_lost:
            self._lose()
            return
        if number == faults.reset_at:
            with self._wake:
                running = self._is_acquiring
                self._power_up_settings()
                self._is_acquiring = running
        self._frames += 1
        frame_id, self._next_id = self._next_id, self._next_id + 1
        if number == faults.restart_at:
            self._restart()
            return
        try:
            sensor = self._source.frame(pending.trigger_index, pending.exposure.start_ns)
        except OSError as error:  # a remote world that ended takes its camera along
            log.error("no picture for frame %d: %s", number, error)
            self._lose()
            return
        if not self._is_acquiring:
            return
        frame = SimFrame(
            number,
            frame_id,
            pending.trigger_index,
            pending.exposure.start_ns - self._power_up_ns + self.config.stamp_offset_ns,
            self._darkroom.develop(sensor),
            number in faults.incomplete,
        )
        time.sleep(float(faults.late_s.get(str(number), 0.0)))
        sink = self.sink
        if sink is not None and number not in faults.dropped:
            sink(frame)

    def _restart(self) -> None:
        """Begin anew, and go on acquiring with the settings after power-up."""
        with self._wake:
            running = self._is_acquiring
            self._power_up_settings()
            self._is_acquiring = running
            self._pending.clear()
            self._power_up_ns = time.monotonic_ns()
            self._next_free_run_ns = self._power_up_ns
            self._next_id = self.config.first_frame_id

    def _lose(self) -> None:
        with self._wake:
            self._lost_ns = time.monotonic_ns()
            self._was_lost = True
            self._stop()
        if self.on_lost is not None:
            self.on_lost()


def _source_of(config: CameraConfig) -> FrameSource:
    if config.source == "sim.camera.source:PatternSource" and not config.source_arguments:
        return PatternSource(config.width, config.height, config.bits)
    return load_source(config.source, config.source_arguments)
