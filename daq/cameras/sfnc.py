"""Setting SFNC features in an order that cameras accept, and reading every one back.

The order matters: pixel format and region change the limits of everything after them; offsets must go to zero
before a region may grow; a trigger is switched off while its source changes and on at the very end.  Cameras that
follow SFNC 1 call some features otherwise; both names are tried.
"""

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Protocol

from daq.cameras.camera import Setting
from daq.errors import SettingRefused, SettingsChanged

FLOAT_TOLERANCE = 0.1  # cameras round floats to their clock; further off than this is a refusal
OLD_NAMES = {"ExposureTime": "ExposureTimeAbs", "AcquisitionFrameRate": "AcquisitionFrameRateAbs"}
ORDER = (
    "PixelFormat",
    "ReverseX",
    "ReverseY",
    "BinningHorizontal",
    "BinningVertical",
    "DecimationHorizontal",
    "DecimationVertical",
    "Width",
    "Height",
    "OffsetX",
    "OffsetY",
    "AcquisitionMode",
    "ExposureAuto",
    "GainAuto",
    "ExposureMode",
    "ExposureTime",
    "Gain",
    "AcquisitionFrameRateEnable",
    "AcquisitionFrameRate",
)
TRIGGER_ORDER = ("TriggerSelector", "TriggerSource", "TriggerActivation", "TriggerDelay", "TriggerMode")


class Nodes(Protocol):
    """A camera's features by name, as a backend's library gives them."""

    def has(self, name: str) -> bool:
        """Whether the feature exists and is available now."""
        ...

    def get(self, name: str) -> Setting:
        """Value, read from the camera."""
        ...

    def set(self, name: str, value: Setting) -> None:
        """Write a value; SettingRefused if the camera or its description forbids it."""
        ...

    def entries(self, name: str) -> Iterable[str]:
        """Available entries of an enumeration."""
        ...

    def can_execute(self, name: str) -> bool:
        """Whether the command exists and is available now."""
        ...

    def execute(self, name: str) -> None:
        """Execute a command."""
        ...


def apply_settings(nodes: Nodes, settings: Mapping[str, Setting]) -> dict[str, Setting]:
    """Write settings in a safe order and return what the camera reads back.

    Raises
    ------
    SettingRefused
        A name is unknown, a value is not accepted, or it did not arrive.
    """
    names = {asked: _known_name(nodes, asked) for asked in settings}
    for asked, value in settings.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise SettingRefused(f"{asked} = {value} is no number a camera could take")
    if "Width" in settings or "Height" in settings:
        for offset in ("OffsetX", "OffsetY"):
            if nodes.has(offset) and nodes.get(offset) != 0:  # a fixed region lets nobody write a 0 either
                nodes.set(offset, 0)
    enable = "AcquisitionFrameRateEnable"
    if "AcquisitionFrameRate" in settings and nodes.has(enable) and nodes.get(enable) is not True:
        nodes.set(enable, True)
    if any(name.startswith("Trigger") for name in settings):
        _triggers_off(nodes)
    for asked in sorted(settings, key=_rank):
        nodes.set(names[asked], settings[asked])
    readback = {asked: nodes.get(names[asked]) for asked in settings}
    wrong = differing(settings, readback)
    if wrong:
        raise SettingRefused(f"the camera did not take {wrong}")
    return readback


def apply_or_restore(
    nodes: Nodes, settings: Mapping[str, Setting], configured: Mapping[str, Setting]
) -> dict[str, Setting]:
    """Write settings as `apply_settings`; if one is refused, go back to what was configured before."""
    try:
        return apply_settings(nodes, settings)
    except SettingRefused:
        with suppress(SettingRefused):  # the first refusal is the one to tell
            apply_settings(nodes, configured)
        raise


def enable_chunks(nodes: Nodes, chunks: Iterable[str]) -> dict[str, Setting]:
    """Let every frame carry chunk data; return what has to read back for that.

    Parameters
    ----------
    nodes : Nodes
        The camera's features.
    chunks : iterable of str
        SFNC names, such as LineStatusAll.

    Raises
    ------
    SettingRefused
        The camera has no such chunk.
    """
    wanted = tuple(chunks)
    if not wanted:
        return {}
    known = list(nodes.entries("ChunkSelector")) if nodes.has("ChunkSelector") else []
    missing = [name for name in wanted if name not in known]
    if missing or not nodes.has("ChunkModeActive"):
        names = ", ".join(missing or wanted)
        raise SettingRefused(
            f"the camera sends no chunk {names}, so nothing would tell exposure A from B by it; choose another "
            f"marker, or leave it out of camera.chunks (it sends {', '.join(known) or 'none'})"
        )
    nodes.set("ChunkModeActive", True)
    for name in wanted:
        nodes.set("ChunkSelector", name)
        if nodes.has("ChunkEnable") and nodes.get("ChunkEnable") is not True:
            nodes.set("ChunkEnable", True)
        if nodes.has("ChunkEnable") and nodes.get("ChunkEnable") is not True:
            raise SettingRefused(f"the camera does not switch its chunk {name} on")
    return {"ChunkModeActive": True}


def verify_settings(nodes: Nodes, expected: Mapping[str, Setting]) -> None:
    """Compare the camera with what it read back when it was configured; SettingsChanged if it differs."""
    readback = {asked: nodes.get(_known_name(nodes, asked)) for asked in expected}
    wrong = differing(expected, readback, tolerance=1e-6)
    if wrong:
        raise SettingsChanged(f"the camera lost its settings ({wrong}); configure it again")


def differing(asked: Mapping[str, Setting], got: Mapping[str, Setting], tolerance: float = FLOAT_TOLERANCE) -> str:
    """Say which settings differ, or "" if none does."""
    wrong = []
    for name, value in asked.items():
        back = got[name]
        if isinstance(back, float) and isinstance(value, int | float):
            same = math.isclose(back, value, rel_tol=tolerance, abs_tol=1e-9)
        else:
            same = back == value
        if not same:
            wrong.append(f"{name} = {value} reads {back}")
    return ", ".join(wrong)


def read_known(nodes: Nodes, names: Iterable[str]) -> dict[str, Setting]:
    """Values of the features among these that the camera has now."""
    return {name: nodes.get(name) for name in names if nodes.has(name)}


def exposure_us(nodes: Nodes) -> float:
    """Exposure time as the camera has it [us]; NaN if it does not tell."""
    for name in ("ExposureTime", OLD_NAMES["ExposureTime"]):
        if nodes.has(name):
            return float(nodes.get(name))
    return math.nan


def count_missed_triggers(nodes: Nodes) -> bool:
    """Let the camera count triggers it had to ignore (SFNC FrameTriggerMissed); False if it cannot."""
    if not (nodes.has("CounterEventSource") and nodes.has("CounterValue")):
        return False
    if "FrameTriggerMissed" not in nodes.entries("CounterEventSource"):
        return False
    try:
        nodes.set("CounterEventSource", "FrameTriggerMissed")
        if nodes.can_execute("CounterReset"):
            nodes.execute("CounterReset")
    except SettingRefused:
        return False
    return True


def _known_name(nodes: Nodes, name: str) -> str:
    for candidate in (name, OLD_NAMES.get(name)):
        if candidate is not None and nodes.has(candidate):
            return candidate
    raise SettingRefused(f"the camera has no feature {name}, or not in its present state")


def _rank(name: str) -> int:
    if name in ORDER:
        return ORDER.index(name)
    if name in TRIGGER_ORDER:
        return 1000 + TRIGGER_ORDER.index(name)
    return 500


def _triggers_off(nodes: Nodes) -> None:
    if not nodes.has("TriggerMode"):
        return
    selectors = list(nodes.entries("TriggerSelector")) if nodes.has("TriggerSelector") else []
    if not selectors:
        nodes.set("TriggerMode", "Off")
        return
    chosen = nodes.get("TriggerSelector")
    for selector in selectors:
        with suppress(SettingRefused):  # an entry may exist and not be available in this mode
            nodes.set("TriggerSelector", selector)
            nodes.set("TriggerMode", "Off")
    nodes.set("TriggerSelector", chosen)
