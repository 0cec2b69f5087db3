"""A folder of TIFF files as a camera: replay a run, or run the bench without any device.

Files are shown in the order of their names, one for every software trigger (TriggerMode On) or one per
1/AcquisitionFrameRate (TriggerMode Off).  The id of a frame is the number at the end of the file's name, so a
hole in a recorded run is a hole here too; without numbers the files are counted.
"""

import re
import time
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from daq.cameras.camera import CameraBase, CameraInfo, Counters, Setting
from daq.cameras.formats import pixel_format
from daq.cameras.frame import Frame, FrameMeta
from daq.cameras.ids import IdTracker
from daq.errors import BadFrame, CameraLost, CameraSetupError, CameraTimeout, CameraUsageError, SettingRefused

CHOICES = {
    "TriggerMode": ("Off", "On"),
    "TriggerSource": ("Software",),
    "TriggerSelector": ("FrameStart",),
    "PixelFormat": ("Mono16", "Mono14", "Mono12", "Mono10", "Mono8"),
}
RANGES = {"ExposureTime": (1.0, 1e7), "AcquisitionFrameRate": (0.01, 1000.0), "Gain": (0.0, 48.0)}


class FilesCamera(CameraBase):
    """Frames from files.

    Parameters
    ----------
    folder : path
        Folder with `.tif` or `.tiff` files, each one (H, W) image of 8 or 16 bit.
    repeat : bool
        Start again after the last file, as a camera would go on; ids then continue to rise.
    """

    def __init__(self, folder: Path | str, repeat: bool = False) -> None:
        self._folder = Path(folder)
        self._repeat = repeat
        self._paths: list[Path] = []
        self._is_open = False
        self._values: dict[str, Setting] = {}
        self._due_ns: deque[int] | None = None
        self._next_file = 0
        self._ids = IdTracker()
        self._counters = Counters()

    @property
    def info(self) -> CameraInfo:
        """The folder, presented as a camera."""
        return CameraInfo("files", "rtpiv", "folder", self._folder.name, str(self._folder))

    @property
    def counters(self) -> Counters:
        """Counters since the last `arm`."""
        return self._counters

    def open(self) -> None:
        """List the files; CameraSetupError if there are none."""
        if not self._folder.is_dir():
            raise CameraSetupError(f"{self._folder} is not a folder; a files camera needs a folder of TIFF files")
        self._paths = sorted(p for p in self._folder.iterdir() if p.suffix.lower() in {".tif", ".tiff"})
        if not self._paths:
            raise CameraSetupError(f"{self._folder} holds no .tif files")
        height, width = self._read(self._paths[0]).shape
        self._values = {
            "Width": width,
            "Height": height,
            "PixelFormat": "Mono16",
            "ExposureTime": 1000.0,
            "Gain": 0.0,
            "AcquisitionFrameRate": 10.0,
            "TriggerSelector": "FrameStart",
            "TriggerMode": "Off",
            "TriggerSource": "Software",
        }
        self._is_open = True

    def configure(self, settings: Mapping[str, Setting], chunks: Sequence[str] = ()) -> dict[str, Setting]:
        """Take settings that make sense for files; sizes must be those of the files, and they carry no chunks."""
        self._require_open()
        if chunks:
            raise SettingRefused(
                f"files carry no chunk {', '.join(chunks)}; exposure A cannot be distinguished from B by them"
            )
        for name, value in settings.items():
            self._check(name, value)
        self._values.update(settings)
        return {name: self._values[name] for name in settings}

    def verify(self) -> None:
        """Files forget nothing."""
        self._require_open()

    def settings(self) -> dict[str, Setting]:
        """Every setting with its value."""
        self._require_open()
        return dict(self._values)

    def read(self, names: Sequence[str]) -> dict[str, Setting]:
        """Those of the settings."""
        self._require_open()
        return {name: self._values[name] for name in names if name in self._values}

    def arm(self, buffers: int = 24) -> None:
        """Start at the first file; `buffers` bounds the triggers that may wait.

        CameraUsageError if it is closed or armed already.
        """
        self._require_open()
        self._require_disarmed()
        self._due_ns = deque(maxlen=buffers)
        self._next_file = 0
        self._ids = IdTracker()
        self._counters = Counters(ignored_triggers=0)
        if self._values["TriggerMode"] == "Off":
            self._due_ns.append(time.monotonic_ns())

    def clock_ns(self) -> int:
        """Clock of this computer; it stamps the frames."""
        return time.monotonic_ns()

    def trigger(self) -> int:
        """Show the next file; a trigger beyond the free buffers is ignored and counted.

        CameraUsageError if TriggerMode is not On.
        """
        due, before_ns = self._due, self.clock_ns()
        if self._values["TriggerMode"] != "On":
            raise CameraUsageError("set TriggerMode to On before sending software triggers")
        if len(due) == due.maxlen:
            old = self._counters
            self._counters = Counters(old.delivered, ignored_triggers=(old.ignored_triggers or 0) + 1)
        else:
            due.append(time.monotonic_ns())
        return before_ns

    def probe(self, timeout_s: float) -> None:
        """Files always answer."""
        self._require_armed()

    def next_frame(self, timeout_s: float) -> Frame:
        """Return the next file's frame when it is due; CameraTimeout if that is later, or there is none."""
        frame = self.poll(timeout_s)
        if frame is None:
            raise CameraTimeout(
                f"no frame within {timeout_s:g} s: {self._next_file} of {len(self._paths)} files shown, "
                f"TriggerMode {self._values['TriggerMode']}"
            )
        return frame

    def poll(self, timeout_s: float) -> Frame | None:
        """Return the next file's frame when it is due; None if that is later, or there is none."""
        due = self._due
        if not due or (self._next_file >= len(self._paths) and not self._repeat):
            time.sleep(timeout_s)
            return None
        wait_s = max(0.0, (due[0] - time.monotonic_ns()) / 1e9)
        time.sleep(min(wait_s, timeout_s))
        if wait_s > timeout_s:
            return None
        due_ns = due.popleft()
        if self._values["TriggerMode"] == "Off":
            due.append(due_ns + round(1e9 / float(self._values["AcquisitionFrameRate"])))
        return self._show(due_ns)

    def disarm(self) -> Counters:
        """Stop; files not shown are simply not shown."""
        self._due_ns = None
        return self._counters

    def close(self) -> None:
        """Forget the folder's list."""
        self._due_ns = None
        self._is_open = False

    def _show(self, due_ns: int) -> Frame:
        turn, index = divmod(self._next_file, len(self._paths))
        path = self._paths[index]
        number = re.search(r"(\d+)$", path.stem)
        span = len(self._paths)
        last = re.search(r"(\d+)$", self._paths[-1].stem)
        frame_id = int(number.group(1)) if number else index
        frame_id += turn * (int(last.group(1)) + 1 if last else span)
        pixels = self._read(path)
        self._next_file += 1
        sequence = self._ids.note(frame_id)
        old = self._counters
        self._counters = Counters(
            old.delivered + 1, missing=self._ids.missing(0), ignored_triggers=old.ignored_triggers
        )
        form = str(self._values["PixelFormat"])
        bits = pixel_format(form).significant_bits
        exposure_us = float(self._values["ExposureTime"])
        meta = FrameMeta(frame_id, sequence, due_ns, time.monotonic_ns(), exposure_us, form, bits)
        return Frame(pixels, meta)

    def _read(self, path: Path) -> NDArray[np.uint16]:
        try:
            image = tifffile.imread(path)
        except FileNotFoundError as error:
            raise CameraLost(f"{path} is gone; the folder changed while it was shown") from error
        except (OSError, ValueError, IndexError) as error:
            raise BadFrame(f"{path} is not readable as TIFF: {error}") from error
        if image.ndim != 2 or image.dtype not in (np.dtype("u1"), np.dtype("u2")):
            raise BadFrame(f"{path} is {image.shape} {image.dtype}; a frame is (H, W) of 8 or 16 bit")
        return np.asarray(image, dtype=np.uint16)

    def _check(self, name: str, value: Setting) -> None:
        if name not in self._values:
            raise SettingRefused(f"a files camera has no {name}; available: {', '.join(self._values)}")
        if name in CHOICES and value not in CHOICES[name]:
            raise SettingRefused(f"{name} = {value!r} is not one of {', '.join(CHOICES[name])}")
        if name in RANGES and not (isinstance(value, int | float) and RANGES[name][0] <= value <= RANGES[name][1]):
            raise SettingRefused(f"{name} = {value!r} is outside {RANGES[name][0]:g} to {RANGES[name][1]:g}")
        if name in ("Width", "Height") and value != self._values[name]:
            raise SettingRefused(f"{name} is {self._values[name]} in the files and cannot be {value!r}")

    def _require_open(self) -> None:
        if not self._is_open:
            raise CameraUsageError("the camera is closed; open it first")

    @property
    def _is_armed(self) -> bool:
        return self._due_ns is not None

    @property
    def _due(self) -> deque[int]:
        """Times at which the next frames are due; CameraUsageError unless it is armed."""
        self._require_open()
        self._require_armed()
        assert self._due_ns is not None
        return self._due_ns
