"""Cameras that Micro-Manager knows, some 55 families, through its core (extra `micromanager`): for frames at rest.

    camera: {backend: micromanager, options: {library: DemoCamera, device: DCam, adapters: /opt/mm}, ...}

Further options are properties that the adapter wants before it is initialised, such as the number of a camera.

Settings have SFNC names where the core knows them (below), or are properties of the adapter by their own names:

    ExposureTime [us]              Width, Height, OffsetX, OffsetY       the region
    PixelFormat Mono8 ... Mono16   by the properties PixelType and BitDepth, where the adapter has them
    TriggerMode On                 a software trigger each: a sequence of one image, with the buffer cleared before
    TriggerMode Off                a sequence until it is disarmed; images are counted by `ImageNumber`

The core tells no time of an exposure, and of single images no number: nothing says which light pulse an image
shows, so flow runs are refused (bench_table).  A frame of a software trigger has the number of its trigger.  A
buffer of the core that overflows ends the run: what it threw away is not reported.

Every call is made by one thread with a deadline of ours (stages.foreign.calls): adapters may never return.
`CoreNodes` are its settings as `sfnc.Nodes`, for use in that thread.  A property is text: it is read back as a
number where the adapter says that it is one.
"""

import importlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from daq.cameras.camera import CameraBase, CameraInfo, Counters, Setting
from daq.cameras.formats import FORMATS
from daq.cameras.frame import Frame, FrameMeta
from daq.cameras.ids import IdTracker
from daq.cameras.sfnc import differing, order_settings
from daq.errors import (
    BadFrame,
    CameraError,
    CameraLost,
    CameraSetupError,
    CameraUsageError,
    SettingRefused,
    SettingsChanged,
)
from ground.named_program import import_program
from stages.errors import DeviceLost
from stages.foreign.calls import Calls, first_line

REGION = ("OffsetX", "OffsetY", "Width", "Height")  # as the core returns it
CHOICES = {"TriggerMode": ("Off", "On"), "TriggerSource": ("Software",), "TriggerSelector": ("FrameStart",)}
INTEGER, FLOAT = 3, 2  # the core's types of properties
PLAIN = {form.significant_bits: name for name, form in FORMATS.items() if form.wire_bits in (8, 16)}


class CoreNodes:
    """A camera's features.

    Parameters
    ----------
    core : CMMCore
        With the camera.
    label : str
        Its label.
    values : dict
        What the core does not hold: how triggers come.
    """

    def __init__(self, core: Any, label: str, values: dict[str, Setting]) -> None:  # noqa: ANN401 - third-party
        self._core = core
        self._label = label
        self._values = values

    def has(self, name: str) -> bool:
        """Return whether the camera has the feature."""
        known = name in (*REGION, "ExposureTime", "PixelFormat", *self._values)
        return known or bool(self._core.hasProperty(self._label, name))

    def get(self, name: str) -> Setting:
        """Value of a feature."""
        core = self._core
        if name in self._values:
            return self._values[name]
        if name == "ExposureTime":
            return 1e3 * float(core.getExposure())
        if name in REGION:
            return int(core.getROI()[REGION.index(name)])
        if name == "PixelFormat":
            bits = int(core.getImageBitDepth())
            is_grey = int(core.getNumberOfComponents()) == 1 and int(core.getBytesPerPixel()) <= 2
            return PLAIN.get(bits, f"{bits} bits") if is_grey else "colours"
        text, kind = str(core.getProperty(self._label, name)), int(core.getPropertyType(self._label, name))
        try:
            return int(text) if kind == INTEGER else float(text) if kind == FLOAT else text
        except ValueError:
            return text

    def all(self) -> dict[str, Setting]:
        """Every feature with its value."""
        names = [*REGION, "ExposureTime", "PixelFormat", *self._values]
        names += [name for name in self._core.getDevicePropertyNames(self._label) if name not in names]
        return {name: self.get(name) for name in names}

    def apply(self, settings: Mapping[str, Setting]) -> dict[str, Setting]:
        """Set features, the format and the region first, and return what reads back; SettingRefused by name."""
        for name, value in settings.items():
            if not self.has(name):
                raise SettingRefused(f"the camera has no feature {name}, and its adapter no such property")
            if isinstance(value, float) and not math.isfinite(value):
                raise SettingRefused(f"{name} = {value} is not a number that a camera accepts")
            if name in CHOICES and value not in CHOICES[name]:
                raise SettingRefused(f"{name} = {value!r} is refused (one of {', '.join(CHOICES[name])})")
        region = {name: settings[name] for name in REGION if name in settings}
        others = [name for name in order_settings(settings) if name not in (*REGION, "PixelFormat")]
        try:
            if "PixelFormat" in settings:
                self._set_format(str(settings["PixelFormat"]))
            for name in others:
                self._set(name, settings[name])
            if region:
                self._set_region(region)
        except SettingRefused:
            raise
        except Exception as error:  # whatever an adapter says
            raise SettingRefused(f"{', '.join(settings)}: refused: {first_line(error)}") from error
        return {name: self.get(name) for name in settings}

    def _set(self, name: str, value: Setting) -> None:
        if name in self._values:
            self._values[name] = value
        elif name == "ExposureTime":
            if isinstance(value, str) or value <= 0:
                raise SettingRefused(f"ExposureTime = {value!r} is not a time")
            self._core.setExposure(float(value) / 1e3)
        else:
            self._core.setProperty(self._label, name, str(int(value)) if isinstance(value, bool) else str(value))

    def _set_format(self, name: str) -> None:
        """By the two properties that most adapters have; what they made of it is read back."""
        bits = next((bits for bits, known in PLAIN.items() if known == name), None)
        if bits is None:
            raise SettingRefused(f"PixelFormat = {name!r} is refused (one of {', '.join(PLAIN.values())})")
        for key, value in (("PixelType", f"{8 if bits == 8 else 16}bit"), ("BitDepth", str(bits))):
            if self._core.hasProperty(self._label, key):
                self._core.setProperty(self._label, key, value)

    def _set_region(self, region: Mapping[str, Setting]) -> None:
        """Of the whole sensor: a region within a region would move with it."""
        wanted = {**dict(zip(REGION, map(int, self._core.getROI()), strict=True)), **region}
        if any(isinstance(value, bool | float | str) for value in wanted.values()):
            raise SettingRefused(f"a region is whole pixels, not {dict(region)}")
        self._core.clearROI()
        x, y, width, height = (int(wanted[name]) for name in REGION)
        most = int(self._core.getImageWidth()), int(self._core.getImageHeight())
        if not (x >= 0 and y >= 0 and 0 < width <= most[0] - x and 0 < height <= most[1] - y):
            fits = f"{most[0]} x {most[1]} px"
            raise SettingRefused(f"a region of {width} x {height} px at {x}, {y} does not fit into {fits}")
        self._core.setROI(x, y, width, height)


LABEL = "Camera"
CORE_POLL_S = 0.002
CORE_TIMEOUT_S = 30.0  # an adapter may look for its camera for a while
ENDLESS = 2_000_000_000  # images of a sequence that ends when it is disarmed
MAX_IMAGE_BYTES = 1 << 29

T = TypeVar("T")


class MicroManagerCamera(CameraBase):
    """A camera of one core.

    Parameters
    ----------
    library, device : str
        Adapter, and device in it.
    adapters : str, optional
        Folder of the adapters; their interface number must be pymmcore's.
    core : str
        "package.module:Class" of the core.
    call_s : float
        Longest time that a call may take.
    properties
        Of the adapter, set before it is initialised.
    """

    _is_armed = False

    def __init__(
        self,
        library: str,
        device: str,
        adapters: str | None = None,
        core: str = "pymmcore:CMMCore",
        call_s: float = CORE_TIMEOUT_S,
        **properties: Setting,
    ) -> None:
        self._device, self._library, self._adapters = device, library, adapters
        self._properties = properties
        self._dotted, self._call_s = core, call_s
        self._calls: Calls | None = None
        self._core: Any = None
        self._values: dict[str, Setting] = {}  # what the core does not hold
        self._configured: dict[str, Setting] = {}
        self._ids = IdTracker()
        self._triggers, self._counters = 0, Counters()

    @property
    def counters(self) -> Counters:
        """Counters since the last `arm`."""
        return self._counters

    def open(self) -> None:
        """Load the adapter in a thread of its own.

        CameraSetupError if the core, the adapter or the device is not there, CameraLost if it does not return.
        """
        if self._calls is not None:
            raise CameraUsageError("the camera is open already; close it first")
        make = _class_of(self._dotted)
        self._calls = Calls(f"camera {self._device}", self._call_s, lambda: False, self._unload)
        try:
            self._info = self._ask("to load its adapter", lambda: self._load(make))
        except CameraLost:
            self.close()
            raise
        except CameraError as error:
            self.close()
            raise CameraSetupError(str(error)) from error
        self._values = {"TriggerMode": "Off", "TriggerSource": "Software", "TriggerSelector": "FrameStart"}

    def configure(self, settings: Mapping[str, Setting], chunks: Sequence[str] = ()) -> dict[str, Setting]:
        """Set what the core or the adapter knows; what was configured before is put back where one is refused."""
        _ = self.info
        self._require_disarmed()
        if chunks:
            raise SettingRefused("a camera by Micro-Manager sends no chunk data; leave camera.chunks out")
        before = dict(self._values)
        try:
            readback = self._ask("to be set", lambda: self._nodes.apply(settings))
            if wrong := differing(settings, readback):
                raise SettingRefused(f"the camera did not take {wrong}")
        except SettingRefused:
            self._values.update(before)
            self._ask("to be set back", lambda: self._nodes.apply(self._configured))
            raise
        self._configured.update(readback)
        return readback

    def verify(self) -> None:
        """Read the configured settings back once more; SettingsChanged if the camera lost any."""
        _ = self.info
        back = self._ask("for its settings", lambda: {name: self._nodes.get(name) for name in self._configured})
        if wrong := differing(self._configured, back, tolerance=1e-6):
            raise SettingsChanged(f"the camera lost its settings ({wrong}); configure it again")

    def settings(self) -> dict[str, Setting]:
        """Return what the core has under SFNC names, and every property of the adapter."""
        _ = self.info
        return self._ask("for its settings", lambda: self._nodes.all())

    def read(self, names: Sequence[str]) -> dict[str, Setting]:
        """Those of the settings that the camera has."""
        _ = self.info
        return self._ask("for values", lambda: {n: self._nodes.get(n) for n in names if self._nodes.has(n)})

    def arm(self, buffers: int = 24) -> None:
        """Give the core memory for so many images; start the sequence unless triggers begin each."""
        _ = self.info
        self._require_disarmed()
        self._ids, self._counters, self._triggers = IdTracker(), Counters(), 0

        def prepare() -> None:
            width, height = int(self._core.getImageWidth()), int(self._core.getImageHeight())
            size = width * height * int(self._core.getBytesPerPixel())
            if not 0 < size <= MAX_IMAGE_BYTES:
                raise BadFrame(f"the camera announces images of {width} x {height} px and {size} bytes")
            self._core.setCircularBufferMemoryFootprint(max(2, -(-buffers * size // (1 << 20)) + 1))  # in MB
            if not self._is_triggered:
                self._core.startSequenceAcquisition(ENDLESS, 0.0, True)

        self._ask("to begin", prepare)
        self._is_armed = True

    def clock_ns(self) -> int | None:
        """Not known."""
        _ = self.info
        return None

    def trigger(self) -> int | None:
        """Begin a sequence of one image; nothing of an earlier one can come any more."""
        self._require_armed()
        if not self._is_triggered:
            raise CameraUsageError("set TriggerMode to On before sending software triggers")

        def begin() -> None:
            if self._core.isSequenceRunning():
                self._core.stopSequenceAcquisition()
            self._core.clearCircularBuffer()
            self._core.startSequenceAcquisition(1, 0.0, True)

        self._triggers += 1
        self._ask("to expose", begin)
        return None

    def poll(self, timeout_s: float) -> Frame | None:
        """Next image, or None; CameraError if the core's buffer has overflowed."""
        self._require_armed()
        deadline_s = time.monotonic() + timeout_s
        while True:
            found = self._ask("for an image", self._pop)
            if found is not None:
                return self._frame(*found)
            if time.monotonic() >= deadline_s:
                return None
            time.sleep(CORE_POLL_S)

    def probe(self, timeout_s: float) -> None:
        """CameraLost unless the adapter answers."""
        self._require_armed()
        self._ask("for its exposure", lambda: self._core.getExposure())

    def disarm(self) -> Counters:
        """End the sequence; images not fetched count as unused."""
        if not self._is_armed:
            return self._counters
        self._is_armed = False

        def finish() -> int:
            self._core.stopSequenceAcquisition()
            left = int(self._core.getRemainingImageCount())
            self._core.clearCircularBuffer()
            return left

        left = self._ask("to end", finish)
        self._counters = self._count(unused=left)
        return self._counters

    def close(self) -> None:
        """Unload the adapter; harmless when repeated, and where a call has never returned."""
        calls, self._calls = self._calls, None
        self._info, self._is_armed, self._configured = None, False, {}
        if calls is not None:
            calls.end()

    @property
    def _is_triggered(self) -> bool:
        return self._values["TriggerMode"] == "On"

    @property
    def _nodes(self) -> CoreNodes:
        return CoreNodes(self._core, LABEL, self._values)

    def _load(self, make: Callable[[], Any]) -> CameraInfo:
        core = self._core = make()
        if self._adapters is not None:
            core.setDeviceAdapterSearchPaths([self._adapters])
        core.loadDevice(LABEL, self._library, self._device)
        for name, value in self._properties.items():
            core.setProperty(LABEL, name, str(int(value)) if isinstance(value, bool) else str(value))
        core.initializeDevice(LABEL)
        core.setCameraDevice(LABEL)
        where = f"{core.getDeviceLibrary(LABEL)} {core.getDeviceName(LABEL)}"
        serial = core.getProperty(LABEL, "CameraID") if core.hasProperty(LABEL, "CameraID") else ""
        return CameraInfo("micromanager", "Micro-Manager", where, str(serial), self._adapters or "")

    def _unload(self) -> None:
        if self._core is not None:
            self._core.unloadAllDevices()

    def _pop(self) -> tuple[NDArray[Any], int] | None:
        """An image of the core and its number, in the core's thread."""
        core = self._core
        if core.isBufferOverflowed():
            raise CameraError(
                "the image buffer of Micro-Manager has overflowed, and does not report which frames it dropped; "
                "increase buffers of the camera, or reduce rate or frame size"
            )
        if not core.getRemainingImageCount():
            return None
        tags = importlib.import_module(self._dotted.partition(":")[0]).Metadata()
        pixels = np.array(core.popNextImageMD(tags))
        number = tags.GetSingleTag("ImageNumber").GetValue() if "ImageNumber" in tags.GetKeys() else "-1"
        return pixels, int(number)

    def _frame(self, pixels: NDArray[Any], number: int) -> Frame:
        received_ns = time.monotonic_ns()
        frame_id = self._triggers if self._is_triggered else number
        if frame_id < 0:
            raise CameraError("the adapter does not number its images; use software triggers (TriggerMode On)")
        sequence = self._ids.note(frame_id)
        form = FORMATS.get(str(self._ask("for its format", lambda: self._nodes.get("PixelFormat"))))
        if pixels.ndim != 2 or pixels.dtype not in (np.dtype("u1"), np.dtype("u2")) or form is None:
            self._counters = self._count(unused=1)
            raise BadFrame(f"an image is {pixels.shape} {pixels.dtype}; a frame is grey of 8 or 16 bit")
        exposure_us = 1e3 * float(self._ask("for its exposure", lambda: self._core.getExposure()))
        self._counters = self._count(delivered=1)
        meta = FrameMeta(frame_id, sequence, 0, received_ns, exposure_us, form.name, form.significant_bits)
        return Frame(np.ascontiguousarray(pixels, dtype=np.uint16), meta)

    def _count(self, delivered: int = 0, unused: int = 0) -> Counters:
        old = self._counters
        missing = 0 if self._is_triggered else self._ids.missing(0)
        return Counters(old.delivered + delivered, missing=missing, unused=old.unused + unused)

    def _ask(self, words: str, function: Callable[[], T]) -> T:
        if self._calls is None:
            raise CameraUsageError("the camera is closed; open it first")
        try:
            return self._calls.ask(words, function)
        except DeviceLost as error:
            said = f"was asked {self._calls.stuck} and has not answered" if self._calls.stuck else "is closed"
            raise CameraLost(f"the adapter of {self._device} {said}; end this program and begin anew") from error
        except CameraError:
            raise
        except Exception as error:  # whatever an adapter says
            raise CameraError(f"{words}: Micro-Manager reports {first_line(error)}") from error

    def _require_armed(self) -> None:
        _ = self.info
        super()._require_armed()


def _class_of(dotted: str) -> Any:  # noqa: ANN401 - third-party
    try:
        return import_program(dotted)
    except (ImportError, AttributeError) as error:
        raise CameraSetupError(f"{dotted} cannot be imported ({error}); install rtpiv[micromanager]") from error
