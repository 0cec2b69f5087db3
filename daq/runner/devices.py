"""Axes and camera in the shape that Bluesky expects, without importing it.

`bluesky.protocols` are structural: an object with the right methods is a device.  So a laboratory that runs its
plans on a Bluesky RunEngine can use this bench, and our own runner is checked against that engine (tests/system).

    AxisDevice     Movable, Readable, Locatable, Stoppable, Checkable, with hints
    CameraDevice   Triggerable, Readable, Stageable

    with open_session("bench.yaml", home=True) as bench:
        axes = axis_devices(bench.stage)
        engine(scan([], axes["target_z"], -5.0, 5.0, 11))

An engine judges nothing before it moves. Here every ``set`` goes through the one door of the bench: limits,
keep-out with fresh positions of all axes, the turn, a stop that holds, a laser that bars. What is refused fails
the plan with the sentence that says why, and nothing has moved.
"""

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from daq.runner.camera_session import CameraSession
from daq.runs.raw_frame import checksum
from stages.stage import Stage

Reading = dict[str, dict[str, Any]]


class Work:
    """A status: work that goes on in a thread of its own.

    Parameters
    ----------
    function : callable
        The work; what it raises is the status' exception.
    """

    def __init__(self, function: Callable[[], object]) -> None:
        self._done = threading.Event()
        self._error: BaseException | None = None
        self._callbacks: list[Callable[[Work], None]] = []
        self._lock = threading.Lock()
        threading.Thread(target=self._run, args=(function,), daemon=True).start()

    @property
    def done(self) -> bool:
        """True if the work has ended, well or not."""
        return self._done.is_set()

    @property
    def success(self) -> bool:
        """True if it has ended well."""
        return self.done and self._error is None

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Return what the work raised, waiting for its end; TimeoutError if that takes longer."""
        if not self._done.wait(timeout):
            raise TimeoutError("the work goes on")
        return self._error

    def add_callback(self, callback: "Callable[[Work], None]") -> None:
        """Call back at the end, or now if that is over."""
        with self._lock:
            if not self.done:
                self._callbacks.append(callback)
                return
        callback(self)

    def __repr__(self) -> str:
        """Text that an engine shows of a status that has failed."""
        if not self.done:
            return "under way"
        return "done" if self._error is None else f"{type(self._error).__name__}: {self._error}"

    def _run(self, function: Callable[[], object]) -> None:
        try:
            function()
        except BaseException as error:  # raised where the status is waited for
            self._error = error
        with self._lock:
            self._done.set()
            callbacks = list(self._callbacks)
        for callback in callbacks:
            callback(self)


def axis_devices(stage: Stage) -> "dict[str, AxisDevice]":
    """Every axis of a stage as a device, by name.

    Parameters
    ----------
    stage : Stage
        Open, homed.
    """
    return {name: AxisDevice(stage, name) for name in stage.axes}


class AxisDevice:
    """One axis of a stage.

    Parameters
    ----------
    stage : Stage
        Open, homed.
    name : str
        The axis.
    """

    parent = None

    def __init__(self, stage: Stage, name: str) -> None:
        self.name = name
        self._stage = stage

    @property
    def hints(self) -> dict[str, list[str]]:
        """Fields of a reading that an engine shows."""
        return {"fields": [self.name]}

    @property
    def position(self) -> float:
        """Measured position [mm]."""
        return self._stage.axis(self.name).position_mm

    def set(self, value: float) -> Work:
        """Move to a position [mm]; limits and keep-out are judged as for every other move.

        Two axes that are set at once move one after the other, the second judged from where the first has come to.
        """
        return Work(lambda: self._stage.move({self.name: float(value)}))

    def check_value(self, value: float) -> None:
        """Raise if a position [mm] must not be asked for."""
        self._stage.axis(self.name).check(float(value))

    def stop(self, success: bool = True) -> None:
        """End every motion; harmless at rest.

        An engine says this to every device at the end of each run and at each pause (`success`), and goes on
        afterwards. Where something has failed the bench is held as well, until `Stage.clear_stop`.
        """
        if success:
            self._stage.halt()
        else:
            self._stage.stop("the scan engine has stopped the bench")

    def locate(self) -> dict[str, float]:
        """Return where it is [mm]; the set-point is where it came to rest."""
        here_mm = self._stage.axis(self.name).position_mm
        return {"setpoint": here_mm, "readback": here_mm}

    def read(self) -> Reading:
        """Measured position [mm]."""
        return {self.name: {"value": self._stage.axis(self.name).position_mm, "timestamp": time.time()}}

    def describe(self) -> Reading:
        """Units and kind of what `read` gives."""
        return {self.name: {"source": f"stage:{self.name}", "dtype": "number", "shape": [], "units": "mm"}}


class CameraDevice:
    """The camera of a bench.

    Parameters
    ----------
    exposures : CameraSession
        Open camera with its account.
    keep : callable, optional
        Gets the pixels of every frame, to be copied if they are to be kept.
    """

    name = "camera"
    parent = None

    def __init__(self, exposures: CameraSession, keep: Callable[[Any], None] | None = None) -> None:
        self._exposures = exposures
        self._keep = keep
        self._last: dict[str, tuple[Any, str]] = {}

    def stage(self) -> "list[CameraDevice]":
        """Configure the camera."""
        self._exposures.set_up()
        return [self]

    def unstage(self) -> "list[CameraDevice]":
        """End the acquisition."""
        self._exposures.end()
        return [self]

    def trigger(self) -> Work:
        """Take one whole frame."""
        return Work(self._take)

    def read(self) -> Reading:
        """Checksum, ids and clocks of the last frame."""
        now = time.time()
        return {f"camera_{key}": {"value": value, "timestamp": now} for key, (value, _) in self._last.items()}

    def describe(self) -> Reading:
        """Kind of what `read` gives."""
        about: Mapping[str, str] = {key: kind for key, (_, kind) in self._last.items()}
        return {f"camera_{key}": {"source": "camera", "dtype": kind, "shape": []} for key, kind in about.items()}

    def _take(self) -> None:
        for _, frame in self._exposures.frames(1):
            with frame:
                if self._keep is not None:
                    self._keep(frame.pixels)
                meta = frame.meta
                self._last = {
                    "crc32": (checksum(frame.pixels), "string"),
                    "frame_id": (meta.frame_id, "integer"),
                    "timestamp_ns": (meta.timestamp_ns, "integer"),
                    "received_ns": (meta.received_ns, "integer"),
                }
