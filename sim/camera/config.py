"""Configuration of one simulated camera, its faults included.

It travels as JSON into the process that the camera lives in.  Faults are scheduled by frame number so that every
test can repeat them: frames are numbered from power-up, 0 first, whether they are received or not.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Self


@dataclass(frozen=True, slots=True)
class FaultPlan:
    """Faults of a camera, and the frames at which they happen.

    Parameters
    ----------
    incomplete : tuple of int
        Frames that arrive with a part of their pixels missing.
    dropped : tuple of int
        Frames whose id is used up but which never leave the camera.
    skipped : tuple of int
        Exposures, counted from power-up, that are never made: no frame, no id.
    doubled : tuple of int
        Frames that are sent a second time, with an id of their own.
    first_skipped : int
        Most exposures that are skipped whenever the acquisition starts; how many is drawn anew each time.
    late_s : mapping of str to float
        Extra delay before a frame leaves [s], by frame number (a string, as JSON has it).
    lost_at : int, optional
        The camera stops answering when this frame is due.
    back_after_s : float, optional
        It answers again this long after it was lost [s], all settings reset; None: never.
    reset_at : int, optional
        Settings go back to their defaults when this frame is due, and nothing is said about it.
    restart_at : int, optional
        The camera restarts when this frame is due, and loses it: settings, clock and ids begin anew, and nothing
        is said about it.
    packet_loss : float
        Share of GigE stream packets that get lost on the way, 0 to 1.
    seed : int
        Seed of the packet loss, and of how many first exposures are skipped.
    """

    incomplete: tuple[int, ...] = ()
    dropped: tuple[int, ...] = ()
    skipped: tuple[int, ...] = ()
    doubled: tuple[int, ...] = ()
    first_skipped: int = 0
    late_s: Mapping[str, float] = field(default_factory=dict)
    lost_at: int | None = None
    back_after_s: float | None = None
    reset_at: int | None = None
    restart_at: int | None = None
    packet_loss: float = 0.0
    seed: int = 0


@dataclass(frozen=True, slots=True)
class CameraConfig:
    """A simulated camera before power-up.

    Parameters
    ----------
    width, height : int
        Sensor size [px].
    bits : int
        Significant bits of the sensor.
    serial : str
        Serial number; identifies the camera on every transport.
    row_time_us : float
        Readout time of one sensor row [us]; limits the frame rate.
    first_frame_id : int
        Id of the first frame after power-up; real cameras start anywhere.
    source, source_arguments : str, mapping
        Frame source as "package.module:factory" and its arguments; the default is a pattern of sensor size.
    lock_path : str
        File that is locked while the camera is open, so that a second process finds it busy; "" for none.
    hold_gil : bool
        Let the producer keep Python's lock while it waits, as compiled producers do through their binding.
    delivers : str
        Pixel format that frames have whatever PixelFormat says, as some producers do it; "" for what it says.
    has_clock : bool
        Whether the clock can be read (TimestampLatch); frames are stamped all the same.
    stamp_offset_ns : int
        By how much the stamps of frames are ahead of the clock that can be read: another clock.
    wires : str
        Socket of `sim.camera.wires.Wires`, over which pulses come to the input lines; "" where none is wired.
    has_chunks : bool
        Whether frames can carry chunk data.
    clock_ppm : float
        By how much the camera's clock is faster than this computer's.
    celsius : float
        Temperature that it tells; it does not get warm.
    features : str
        Its table of features, a tuple of `sim.camera.features.Feature`, as "package.module:NAME".
    id_bits : int
        16 for ids that go 65535 -> 1.
    write_log : str
        File that gets a line of JSON for every write of a client; "" for none.
    faults : FaultPlan
        Scheduled faults.
    """

    width: int = 640
    height: int = 480
    bits: int = 12
    serial: str = "SIM0001"
    row_time_us: float = 10.0
    first_frame_id: int = 1
    source: str = "sim.camera.source:PatternSource"
    source_arguments: Mapping[str, Any] = field(default_factory=dict)
    lock_path: str = ""
    hold_gil: bool = False
    delivers: str = ""
    has_clock: bool = True
    stamp_offset_ns: int = 0
    wires: str = ""
    has_chunks: bool = True
    clock_ppm: float = 0.0
    celsius: float = 41.5
    features: str = "sim.camera.features:FEATURES"
    id_bits: int = 64
    write_log: str = ""
    faults: FaultPlan = field(default_factory=FaultPlan)

    def to_json(self) -> str:
        """One line of JSON."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Inverse of `to_json`; an unknown name is a TypeError."""
        data = json.loads(text)
        faults = dict(data.pop("faults", {}))
        for name in ("incomplete", "dropped", "skipped", "doubled"):
            faults[name] = tuple(faults.get(name, ()))
        return cls(faults=FaultPlan(**faults), **data)
