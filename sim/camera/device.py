"""The simulated camera itself: registers, triggers, exposures, frames, faults.

One thread per camera.  It sleeps until the next frame has left the sensor, asks the frame source for the pixels,
crops, packs and hands the payload to the transport's sink.  Time is the host's monotonic clock; time stamps count
from power-up on the camera's own clock.

Frame numbers and ids rise from power-up and are not reset by AcquisitionStart, as with many real cameras.
"""

import json
import logging
import random
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.camera.config import CameraConfig
from sim.camera.exposure import RESET_LINE, Exposure, Lines, Shutter
from sim.camera.features import CHUNK_FEATURES, CHUNKS
from sim.camera.packing import payload_bytes
from sim.camera.payload import Picture, SensorReadout, tail, tail_bytes
from sim.camera.registers import RegisterMap, Value, WriteProtected
from sim.camera.source import FrameSource, PatternSource, image_of, load_named, load_source
from sim.camera.wires import listen
from tracer.errors import SceneError

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
    chunks: Mapping[str, float] = field(default_factory=dict)  # by name, in the order in which they are sent

    @property
    def tail(self) -> bytes:
        """Bytes sent behind the pixels."""
        return tail(self.picture.payload.size, self.chunks)


@dataclass(frozen=True, slots=True)
class _Pending:
    """A frame that is to be read out: one exposure, or A and B of a double-height frame."""

    trigger_index: int
    exposures: tuple[Exposure, ...]
    of_trigger: int  # its number among the frames of its trigger, 1 first

    @property
    def read_ns(self) -> int:
        return self.exposures[-1].read_ns


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
        without_chunks = () if config.has_chunks else tuple(feature.name for feature in CHUNK_FEATURES)
        without_clock = () if config.has_clock else CLOCK
        without = (*without_clock, *without_chunks)
        self.registers = RegisterMap(VENDOR, MODEL, without, load_named(config.features))
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
        self._exposures = 0  # that were asked for, whether they were made or skipped
        self._skip = 0
        self._random = random.Random(config.faults.seed)
        self._next_struck: deque[tuple[str, float]] = deque()  # what the next frames meet, with a delay [s]
        self._lines = Lines()
        self._chunks_on: set[str] = set()
        self._readout = SensorReadout(self.registers, config.bits, config.delivers)
        self.registers.on_write = self._on_write
        self.registers.before_read = self._refresh
        self._power_up_settings()
        self._thread = threading.Thread(target=self._run, name=f"camera {config.serial}", daemon=True)
        self._thread.start()
        if config.wires:
            listen(config.wires, self.line_pulse)

    @property
    def is_lost(self) -> bool:
        """Return whether the camera is unplugged just now; it may come back by itself."""
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

    def strike(self, what: str, delay_s: float = 0.0) -> None:
        """Let a fault happen: "unplug" now; "late", "lost", "cut" or "doubled" to the next frame."""
        if what == "unplug":
            self._lose()
            return
        self._next_struck.append((what, delay_s))

    def now_ns(self) -> int:
        """Time on the camera's own clock."""
        return self._on_own_clock_ns(time.monotonic_ns())

    def _on_own_clock_ns(self, host_ns: int) -> int:
        since_ns = host_ns - self._power_up_ns
        return since_ns + round(since_ns * self.config.clock_ppm * 1e-6)

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
            is_taken = False
            try:
                self.registers.write(address, data)
                is_taken = True
            finally:
                self._log_write(address, data, is_taken)

    def _log_write(self, address: int, data: bytes, is_taken: bool) -> None:
        """Note what a client wrote, and under which selectors."""
        feature = self.registers.at(address)
        if self.config.write_log and feature is not None:
            value = self.registers.decode(feature.name, data)
            value = next((entry for entry, number in feature.entries if number == value), value)
            line = [feature.shown or feature.name, value, self.registers.selection(), is_taken]
            with Path(self.config.write_log).open("a") as file:
                file.write(json.dumps(line) + "\n")

    def line_pulse(self, line: int, rise_ns: int, fall_ns: int) -> None:
        """Take a pulse on an input line, with its edges on the host's monotonic clock."""
        with self._wake:
            self._lines.note(line, rise_ns, fall_ns)
            if self.registers.entry("TriggerSource") == f"Line{line}":
                self._trigger(rise_ns)

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
        self._chunks_on.clear()
        put("DeviceVendorName", VENDOR)
        put("DeviceModelName", MODEL)
        put("DeviceVersion", "1.0")
        put("DeviceSerialNumber", self.config.serial)
        put("DeviceTemperature", self.config.celsius)
        for axis, size in (("Width", self.config.width), ("Height", self.config.height)):
            put(f"Sensor{axis}", size)
            put(axis, size)
        self._update_derived()

    def _update_derived(self) -> None:
        registers = self.registers
        for size, offset, axis, pixels in (
            ("Width", "OffsetX", "Horizontal", self.config.width),
            ("Height", "OffsetY", "Vertical", self.config.height * (2 if self._is_stacked else 1)),
        ):
            binned = pixels // registers.integer(f"Binning{axis}")
            sensor = binned // registers.integer(f"Decimation{axis}")
            if registers.integer(size) + registers.integer(offset) > sensor:  # what does not fit any more
                registers.put(offset, 0)
                registers.put(size, min(registers.integer(size), sensor))
            registers.put(f"{size}Max", sensor - registers.integer(offset))
            registers.put(f"{offset}Max", sensor - registers.integer(size))
        size_bytes = payload_bytes(
            registers.entry("PixelFormat"), registers.integer("Width"), registers.integer("Height")
        )
        registers.put("PayloadSize", size_bytes + tail_bytes(len(self._chunk_names())))

    @property
    def _is_stacked(self) -> bool:
        """Return whether A and B of a double frame are sent as one picture, A on top."""
        registers = self.registers
        return registers.integer("DoubleFrameEnable") == 1 and registers.entry("DoubleFrameLayout") == "OneBuffer"

    def _chunk_names(self) -> list[str]:
        """Chunks that frames carry now."""
        if not (self.config.has_chunks and self.registers.integer("ChunkModeActive")):
            return []
        return [name for name in CHUNKS if name in self._chunks_on]

    def _refresh(self, name: str) -> None:
        if name == "CounterValue":
            counts = self.registers.entry("CounterEventSource") == "FrameTriggerMissed"
            self.registers.put(name, self._shutter.missed - self._missed_before if counts else 0)
        if name == "ChunkEnable":
            self.registers.put(name, int(self.registers.entry("ChunkSelector") in self._chunks_on))

    def _on_write(self, name: str, value: Value) -> None:
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
        was_stacked = self._is_stacked
        self.registers.put(name, value)
        if name == "ChunkEnable":
            change = self._chunks_on.add if value else self._chunks_on.discard
            change(self.registers.entry("ChunkSelector"))
        if self._is_stacked != was_stacked:
            self.registers.put("OffsetY", 0)
            self.registers.put("Height", self.config.height * (2 if self._is_stacked else 1))
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
        self._skip = self._random.randint(0, self.config.faults.first_skipped)
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

    def _trigger(self, at_ns: int | None = None) -> None:
        if not self._is_acquiring or self.registers.entry("TriggerMode") != "On":
            self._shutter.missed += 1
            return
        self._expose(time.monotonic_ns() if at_ns is None else at_ns)

    def _expose(self, now_ns: int) -> None:
        registers = self.registers
        exposure_ns = round(registers.number("ExposureTime") * 1e3)
        is_double, is_stacked = registers.integer("DoubleFrameEnable") == 1, self._is_stacked
        rows = registers.integer("Height") // (2 if is_stacked else 1)
        readout_ns = round(rows * self.config.row_time_us * 1e3)
        interval_ns = round(registers.number("DoubleFrameInterval") * 1e3) if is_double else None
        is_burst = (
            registers.entry("TriggerMode") == "On" and registers.entry("TriggerSelector") == "FrameBurstStart"
        )
        burst = registers.integer("AcquisitionBurstFrameCount") if is_burst else 1
        exposures = self._shutter.fire(now_ns, exposure_ns, readout_ns, interval_ns, burst)
        if not exposures:
            return
        frames = [exposures] if is_stacked else [(exposure,) for exposure in exposures]
        made = 0
        for frame in frames:
            if self._frames_left == 0 or self._is_skipped():
                continue
            made += 1
            self._pending.append(_Pending(self._triggers, frame, made))
            self._frames_left -= 1 if self._frames_left > 0 else 0
        self._triggers += 1
        self._wake.notify_all()

    def _is_skipped(self) -> bool:
        """Return whether the next exposure is not made, though nothing says so."""
        number, self._exposures = self._exposures, self._exposures + 1
        is_first, self._skip = self._skip > 0, max(0, self._skip - 1)
        return is_first or number in self.config.faults.skipped

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
                if pending is not None and pending.read_ns > time.monotonic_ns():
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
                return min(start_ns, self._pending[0].read_ns) if self._pending else start_ns
            self._expose(now_ns)
            limited = self.registers.integer("AcquisitionFrameRateEnable") == 1
            period_ns = round(1e9 / self.registers.number("AcquisitionFrameRate")) if limited else 0
            late = now_ns - self._next_free_run_ns > 5 * period_ns
            self._next_free_run_ns = (now_ns if late else self._next_free_run_ns) + period_ns
        return self._pending[0].read_ns if self._pending else None

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
        frame_id, self._next_id = self._next_id, self._id_after(self._next_id)
        if number == faults.restart_at:
            self._restart()
            return
        try:
            sensor = self._picture(pending)
        except (OSError, SceneError) as error:  # a world that ended, or that cannot be, takes its camera along
            log.error("no picture for frame %d: %s", number, error)
            self._lose()
            return
        if not self._is_acquiring:
            return
        struck, struck_s = self._next_struck.popleft() if self._next_struck else ("", 0.0)
        start_ns = pending.exposures[0].start_ns
        frame = SimFrame(
            number,
            frame_id,
            pending.trigger_index,
            self._on_own_clock_ns(start_ns) + self.config.stamp_offset_ns,
            self._readout.develop(sensor),
            number in faults.incomplete or struck == "cut",
            self._chunk_values(pending.exposures[0], pending.of_trigger),
        )
        time.sleep(float(faults.late_s.get(str(number), struck_s)))
        sink = self.sink
        if sink is not None and number not in faults.dropped and struck != "lost":
            sink(frame)
            if number in faults.doubled or struck == "doubled":
                frame_id, self._next_id = self._next_id, self._id_after(self._next_id)
                sink(replace(frame, frame_id=frame_id))

    def _id_after(self, frame_id: int) -> int:
        return frame_id % 0xFFFF + 1 if self.config.id_bits == 16 else frame_id + 1

    def _picture(self, pending: _Pending) -> NDArray[np.uint16]:
        """Image on the sensor; of a double-height frame both images, A on top."""
        images = [
            image_of(self._source, pending.trigger_index, exposure.start_ns, exposure.end_ns)
            for exposure in pending.exposures
        ]
        return images[0] if len(images) == 1 else np.vstack(images)

    def _chunk_values(self, exposure: Exposure, of_trigger: int) -> dict[str, float]:
        """Chunk data of a frame."""
        start_ns = exposure.start_ns
        with self._wake:
            names = self._chunk_names()
            self._lines.expose(start_ns)
            values: dict[str, float] = {
                "LineStatusAll": self._lines.status(start_ns),
                "CounterValue": self._lines.exposures_since(RESET_LINE, start_ns),
                "FramesPerTriggerCounter": of_trigger,
                "Timestamp": self._on_own_clock_ns(start_ns) + self.config.stamp_offset_ns,
                "ExposureTime": (exposure.end_ns - start_ns) / 1e3,
            }
        return {name: values[name] for name in names}

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
