"""A camera's features through libaravis, as `Nodes`."""

import ctypes
from ctypes import POINTER, c_char_p, c_void_p

from daq.cameras.camera import Setting
from daq.cameras.libaravis import AravisError, GSList, call, strings
from daq.errors import CameraError, SettingRefused

INTEGERS = {"Integer", "IntReg", "MaskedIntReg", "IntSwissKnife", "IntConverter"}
FLOATS = {"Float", "FloatReg", "SwissKnife", "Converter"}
TEXTS = {"String", "StringReg", "Enumeration"}
MAX_DEPTH = 20


class AravisNodes:
    """Features of one open device.

    Parameters
    ----------
    device : int
        Pointer of the ArvDevice.
    """

    def __init__(self, device: int) -> None:
        self._device = device

    def names(self) -> list[str]:
        """Every feature below Root that has a value."""
        found: list[str] = []
        self._collect("Root", found, MAX_DEPTH)
        return found

    def has(self, name: str) -> bool:
        """Whether the feature exists and is available now."""
        if self._kind(name) is None:
            return False
        try:
            return bool(call("arv_device_is_feature_available", self._device, name.encode()))
        except AravisError:
            return False

    def get(self, name: str) -> Setting:
        """Value of a feature, read from the camera.

        Raises
        ------
        CameraError
            There is no such feature, it has no value (a command, a category), or it cannot be read now.
        """
        kind, key = self._kind(name), name.encode()
        if kind in INTEGERS:
            return int(call("arv_device_get_integer_feature_value", self._device, key))
        if kind in FLOATS:
            return float(call("arv_device_get_float_feature_value", self._device, key))
        if kind == "Boolean":
            return bool(call("arv_device_get_boolean_feature_value", self._device, key))
        if kind in TEXTS:
            text = call("arv_device_get_string_feature_value", self._device, key)
            return text.decode("utf-8", "replace") if text else ""
        raise CameraError(f"{name} is a {kind} and has no value")

    def is_float(self, name: str) -> bool:
        """Whether a feature is a number with a fraction."""
        return self._kind(name) in FLOATS

    def set(self, name: str, value: Setting) -> None:
        """Write a feature; SettingRefused if the camera or its description forbids it."""
        kind, key = self._kind(name), name.encode()
        try:
            if kind in INTEGERS and isinstance(value, int):
                call("arv_device_set_integer_feature_value", self._device, key, value)
            elif kind in FLOATS and isinstance(value, int | float):
                call("arv_device_set_float_feature_value", self._device, key, float(value))
            elif kind == "Boolean" and isinstance(value, bool):
                call("arv_device_set_boolean_feature_value", self._device, key, int(value))
            elif kind in TEXTS and isinstance(value, str):
                call("arv_device_set_string_feature_value", self._device, key, value.encode())
            else:
                raise SettingRefused(f"{name} = {value!r} does not fit a feature of the kind {kind}")
        except (AravisError, ctypes.ArgumentError) as error:
            raise SettingRefused(f"{name} = {value!r} is refused: {error}") from error

    def entries(self, name: str) -> list[str]:
        """Available entries of an enumeration."""
        return strings(
            "arv_device_dup_available_enumeration_feature_values_as_strings", self._device, name.encode()
        )

    def can_execute(self, name: str) -> bool:
        """Whether the command exists and is available now."""
        return self._kind(name) == "Command" and self.has(name)

    def execute(self, name: str) -> None:
        """Execute a command."""
        call("arv_device_execute_command", self._device, name.encode())

    def _kind(self, name: str) -> str | None:
        node = call("arv_device_get_feature", self._device, name.encode())
        return call("arv_dom_node_get_node_name", node).decode() if node else None

    def _collect(self, category: str, found: list[str], depth: int) -> None:
        node = call("arv_device_get_feature", self._device, category.encode())
        item = call("arv_gc_category_get_features", node) if node and depth else None
        while item:
            entry = ctypes.cast(c_void_p(item), POINTER(GSList)).contents
            name = (ctypes.cast(entry.data, c_char_p).value or b"").decode("utf-8", "replace")
            kind = self._kind(name)
            if kind == "Category":
                self._collect(name, found, depth - 1)
            elif kind in INTEGERS | FLOATS | TEXTS | {"Boolean"} and name not in found:
                found.append(name)
            item = entry.next
