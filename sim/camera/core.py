"""A core of Micro-Manager with one camera, as far as programs call it that take images of a simulated world.

`adapters` is a folder with a file camera.json: the configuration of a simulated camera (`sim.camera.config`).
Names, types and habits are those of pymmcore and of its DemoCamera: exposures in ms, properties as text, a buffer
that overflows when no images are taken out of it, images numbered from 0 within a sequence.
"""

import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.camera.config import CameraConfig
from sim.camera.packing import to_format_bits
from sim.camera.source import PatternSource, load_source

CONFIG = "camera.json"
TYPES = {"PixelType": 1, "BitDepth": 1, "Gain": 2, "CCDTemperature": 2}  # text, number with a fraction
LARGEST_WAIT_S = 10.0


class Metadata:
    """Tags of an image."""

    def __init__(self) -> None:
        self.tags: dict[str, str] = {}

    def GetKeys(self) -> tuple[str, ...]:  # noqa: N802 - the core's own name
        """Names of the tags."""
        return tuple(self.tags)

    def GetSingleTag(self, name: str) -> "Tag":  # noqa: N802
        """One of them."""
        return Tag(self.tags[name])


class Tag:
    """One tag."""

    def __init__(self, value: str) -> None:
        self._value = value

    def GetValue(self) -> str:  # noqa: N802
        """Its text."""
        return self._value


class SimCore:
    """The core."""

    def __init__(self) -> None:
        self._folder = Path()
        self._labels: dict[str, tuple[str, str]] = {}
        self._properties = {"PixelType": "16bit", "BitDepth": "12", "Gain": "0", "CCDTemperature": "-10.0"}
        self._exposure_ms, self._triggers = 10.0, 0
        self._images: deque[tuple[NDArray[Any], int]] = deque()
        self._room_bytes, self._overflowed = 1 << 26, False
        self._ends = threading.Event()
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    def setDeviceAdapterSearchPaths(self, paths: list[str]) -> None:  # noqa: N802, D102
        self._folder = Path(paths[0])

    def loadDevice(self, label: str, library: str, device: str) -> None:  # noqa: N802, D102
        if library != "SimCamera":
            raise RuntimeError(f'Failed to load device "{device}" from adapter module "{library}"')
        self._labels[label] = (library, device)

    def initializeDevice(self, label: str) -> None:  # noqa: N802, D102
        self.config = config = CameraConfig.from_json((self._folder / CONFIG).read_text())
        is_pattern = config.source == CameraConfig().source
        pattern = PatternSource(config.width, config.height, config.bits)
        self._source = pattern if is_pattern else load_source(config.source, config.source_arguments)
        self._roi = [0, 0, config.width, config.height]

    def setCameraDevice(self, label: str) -> None:  # noqa: N802, D102
        self._labels[label]

    def getDeviceLibrary(self, label: str) -> str:  # noqa: N802, D102
        return self._labels[label][0]

    def getDeviceName(self, label: str) -> str:  # noqa: N802, D102
        return self._labels[label][1]

    def getDevicePropertyNames(self, label: str) -> tuple[str, ...]:  # noqa: N802, D102
        return tuple(self._properties)

    def hasProperty(self, label: str, name: str) -> bool:  # noqa: N802, D102
        return name in self._properties

    def isPropertyPreInit(self, label: str, name: str) -> bool:  # noqa: N802, D102
        return False

    def getPropertyType(self, label: str, name: str) -> int:  # noqa: N802, D102
        return TYPES[name]

    def getProperty(self, label: str, name: str) -> str:  # noqa: N802, D102
        return self._properties[name]

    def setProperty(self, label: str, name: str, value: str) -> None:  # noqa: N802, D102
        allowed = {"PixelType": ("8bit", "16bit"), "BitDepth": ("8", "10", "12", "14", "16")}
        if name == "CCDTemperature" or value not in allowed.get(name, (value,)):
            raise RuntimeError(f'Cannot set property "{name}" to value "{value}"')
        self._properties[name] = value

    def getImageWidth(self) -> int:  # noqa: N802, D102
        return self._roi[2]

    def getImageHeight(self) -> int:  # noqa: N802, D102
        return self._roi[3]

    def getBytesPerPixel(self) -> int:  # noqa: N802, D102
        return 1 if self._properties["PixelType"] == "8bit" else 2

    def getImageBitDepth(self) -> int:  # noqa: N802, D102
        return 8 if self._properties["PixelType"] == "8bit" else int(self._properties["BitDepth"])

    def getNumberOfComponents(self) -> int:  # noqa: N802, D102
        return 1

    def getROI(self) -> list[int]:  # noqa: N802, D102
        return list(self._roi)

    def setROI(self, x: int, y: int, width: int, height: int) -> None:  # noqa: N802, D102
        self._roi = [x, y, width, height]

    def clearROI(self) -> None:  # noqa: N802, D102
        self._roi = [0, 0, self.config.width, self.config.height]

    def getExposure(self) -> float:  # noqa: N802, D102
        return self._exposure_ms

    def setExposure(self, exposure_ms: float) -> None:  # noqa: N802, D102
        self._exposure_ms = exposure_ms

    def setCircularBufferMemoryFootprint(self, megabytes: int) -> None:  # noqa: N802, D102
        self._room_bytes = megabytes << 20
        self.clearCircularBuffer()

    def clearCircularBuffer(self) -> None:  # noqa: N802, D102
        with self._lock:
            self._images.clear()
            self._overflowed = False

    def startSequenceAcquisition(self, number: int, interval_ms: float, stop_on_overflow: bool) -> None:  # noqa: N802
        """Take images until so many are there, or there is no room."""
        if self.isSequenceRunning():
            raise RuntimeError("Camera is busy acquiring images")
        self._ends = ends = threading.Event()
        arguments = (number, stop_on_overflow, ends)
        self._thread = threading.Thread(target=self._acquire, args=arguments, daemon=True)
        self._thread.start()

    def stopSequenceAcquisition(self) -> None:  # noqa: N802, D102
        self._ends.set()
        if self._thread is not None:
            self._thread.join(LARGEST_WAIT_S)

    def isSequenceRunning(self) -> bool:  # noqa: N802, D102
        return self._thread is not None and self._thread.is_alive()

    def isBufferOverflowed(self) -> bool:  # noqa: N802, D102
        return self._overflowed

    def getRemainingImageCount(self) -> int:  # noqa: N802, D102
        return len(self._images)

    def popNextImageMD(self, tags: Metadata) -> NDArray[Any]:  # noqa: N802, D102
        with self._lock:
            image, number = self._images.popleft()
        tags.tags = {"ImageNumber": str(number), "Camera": "Camera"}
        return image

    def unloadAllDevices(self) -> None:  # noqa: N802, D102
        self.stopSequenceAcquisition()
        leave = getattr(getattr(self, "_source", None), "close", None)
        if callable(leave):
            leave()

    def _acquire(self, number: int, stop_on_overflow: bool, ends: threading.Event) -> None:
        for index in range(number):
            start_ns = time.monotonic_ns()
            if ends.wait(self._exposure_ms / 1e3):
                return
            trigger, self._triggers = self._triggers, self._triggers + 1
            image = self._develop(self._source.frame(trigger, start_ns))
            with self._lock:
                if ends.is_set():
                    return
                if (len(self._images) + 1) * image.nbytes > self._room_bytes:
                    self._overflowed = True
                    if stop_on_overflow:
                        return
                    self._images.clear()
                self._images.append((image, index))

    def _develop(self, sensor: NDArray[np.uint16]) -> NDArray[Any]:
        x, y, width, height = self._roi
        bits = self.getImageBitDepth()
        image = to_format_bits(sensor[y : y + height, x : x + width], self.config.bits, f"Mono{bits}")
        return image.astype(np.uint8) if bits == 8 else image.copy()
