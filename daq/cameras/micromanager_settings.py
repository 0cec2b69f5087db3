"""Settings of a camera by Micro-Manager as `sfnc.Nodes` knows them; to be used in the thread of its core.

SFNC names where the core has a call of its own; every other name is a property of the adapter, as its author
called it.  A property is text: it is read back as a number where the adapter says that it is one.
"""

import math
from collections.abc import Mapping
from typing import Any

from daq.cameras.camera import Setting
from daq.cameras.formats import FORMATS
from daq.errors import SettingRefused

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

    def __init__(self, core: Any, label: str, values: dict[str, Setting]) -> None:  # noqa: ANN401 - somebody else's
        self._core = core
        self._label = label
        self._values = values

    def has(self, name: str) -> bool:
        """Whether the camera has the feature."""
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
                raise SettingRefused(f"{name} = {value} is no number a camera could take")
            if name in CHOICES and value not in CHOICES[name]:
                raise SettingRefused(f"{name} = {value!r} is refused (one of {', '.join(CHOICES[name])})")
        region = {name: settings[name] for name in REGION if name in settings}
        others = [name for name in settings if name not in (*REGION, "PixelFormat")]
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
            said = (str(error).strip().splitlines() or [type(error).__name__])[0][:300]
            raise SettingRefused(f"{', '.join(settings)}: refused: {said}") from error
        return {name: self.get(name) for name in settings}

    def _set(self, name: str, value: Setting) -> None:
        if name in self._values:
            self._values[name] = value
        elif name == "ExposureTime":
            if isinstance(value, str) or value <= 0:
                raise SettingRefused(f"ExposureTime = {value!r} is no time")
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
