"""Setting SFNC features in an order that cameras accept, and reading every one back.

Features depend on one another: a selector decides which value a name means, a mode or switch decides whether a
feature exists or can be written, and values limit each other.  So selectors are written first, then modes and
switches (text and Booleans), then numbers, then the trigger, which is off while its source changes.  Names are
looked up when they are written; a feature that is refused is tried again after each one that is accepted, and what
a refused selector selects is not written at all.  Everything is read back at the end under the selectors as set,
and undone in reverse order where anything was refused.

Cameras that follow SFNC 1 have other names; both are tried where the unit is the same.
"""

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Protocol

from daq.cameras.camera import Setting
from daq.errors import SettingRefused, SettingsChanged

FLOAT_TOLERANCE = 0.1  # cameras round floats to their clock; further off than this is a refusal
OLD_NAMES = {  # by the name of SFNC 2, in the same unit
    "ExposureTime": "ExposureTimeAbs",
    "AcquisitionFrameRate": "AcquisitionFrameRateAbs",
    "AcquisitionFrameRateEnable": "AcquisitionFrameRateEnabled",
    "TriggerDelay": "TriggerDelayAbs",
}
NEW_NAMES = {old: new for new, old in OLD_NAMES.items()}
RATE_SWITCHES: dict[str, Setting] = {"AcquisitionFrameRateEnable": True, "AcquisitionFrameRateAuto": "Off"}
# by default
ONLY_ENTRIES = {"TriggerSelector": "FrameStart", "GainSelector": "All", "BlackLevelSelector": "All"}
# other selectors: what begins with their own name
SELECTED = {"RegionSelector": ("Width", "Height", "Offset")}
SWITCH_SUFFIXES = ("Auto", "Mode", "Enable", "Enabled")
STEMS = ("AcquisitionFrameRate", "BlackLevel", "Exposure", "Gain", "Gamma", "Line", "Trigger")
FRAME_TRIGGERS = ("ExposureStart", "FrameBurstStart")  # that start a frame each, the second by a count of 1
MODES = ("PixelFormat", "AcquisitionMode", "ExposureMode", "ExposureAuto", "GainAuto")
NUMBERS = (
    "BinningHorizontal",
    "BinningVertical",
    "DecimationHorizontal",
    "DecimationVertical",
    "Width",
    "Height",
    "OffsetX",
    "OffsetY",
    "ExposureTime",
    "Gain",
    "AcquisitionFrameRate",
)
TRIGGER = ("TriggerSource", "TriggerActivation", "TriggerDelay", "TriggerMode")


class Nodes(Protocol):
    """A camera's features by name, as a backend's library gives them."""

    def names(self) -> list[str]:
        """Every feature that may have a value."""

    def has(self, name: str) -> bool:
        """Return whether the feature exists and is available now."""

    def get(self, name: str) -> Setting:
        """Value, read from the camera."""

    def set(self, name: str, value: Setting) -> None:
        """Write a value; SettingRefused if the camera or its description forbids it."""

    def entries(self, name: str) -> Iterable[str]:
        """Available entries of an enumeration."""

    def can_execute(self, name: str) -> bool:
        """Return whether the command exists and is available now."""

    def execute(self, name: str) -> None:
        """Execute a command."""


def apply_settings(nodes: Nodes, settings: Mapping[str, Setting]) -> dict[str, Setting]:
    """Write settings in a safe order and return what the camera reads back.

    Where TriggerMode is set, the triggers of all other selectors are switched off.  FrameStart of a camera without
    TriggerSelector is its only trigger; such a selector is left out of what is returned.

    Raises
    ------
    SettingRefused
        A name is unknown, a value is not accepted, or it did not arrive; what had been written is put back.
    """
    for asked, value in settings.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise SettingRefused(f"{asked} = {value} is not a number that a camera accepts")
    writer = _Writer(nodes)
    try:
        written = writer.write_all(settings)
        readback = {asked: nodes.get(_resolve_name(nodes, asked)) for asked in written}
        wrong = differing(written, readback)
        if wrong:
            raise SettingRefused(f"the camera did not take {wrong}")
    except SettingRefused:
        writer.undo()
        raise
    return readback


def order_settings(settings: Mapping[str, Setting]) -> dict[str, Setting]:
    """Selectors first, then modes and switches, numbers, and the trigger at the end."""
    return dict(sorted(settings.items(), key=lambda item: _rank(*item)))


class _Writer:
    """Settings on their way into one camera, with the values that they replace."""

    def __init__(self, nodes: Nodes) -> None:
        self._nodes = nodes
        self._replaced: list[tuple[str, Setting]] = []  # in the order of writing

    def write_all(self, settings: Mapping[str, Setting]) -> dict[str, Setting]:
        """Write everything in order; return the settings that the camera has a feature for."""
        nodes, wanted = self._nodes, order_settings(settings)
        for name, value in ONLY_ENTRIES.items():
            stem = name.removesuffix("Selector")
            is_there = any(nodes.has(stem + suffix) for suffix in ("", "Raw", "Mode"))
            if wanted.get(name) == value and is_there and not nodes.has(name):
                del wanted[name]
        first = {name: value for name, value in wanted.items() if _rank(name, value)[0] <= MODE}
        if "AcquisitionFrameRate" in map(_new_name, wanted):
            first |= {name: value for name, value in RATE_SWITCHES.items() if name not in map(_new_name, wanted)}
        for name, refusal in self._write_in_turns(first).items():
            if name.endswith("Selector"):
                raise refusal
        for size, offset in (("Width", "OffsetX"), ("Height", "OffsetY")):  # a region grows from the corner only
            if size in wanted and nodes.has(offset) and nodes.get(offset) != 0:
                self._write(offset, 0)
        left = first | {name: value for name, value in wanted.items() if _rank(name, value)[0] > MODE}
        for name, refusal in self._write_in_turns(left | self._switch_triggers_off(wanted)).items():
            if name in wanted or name == "TriggerMode":
                raise refusal
        return wanted

    def undo(self) -> None:
        """Put back what was replaced, the last one first, so that each goes back under its own selector."""
        for name, value in reversed(self._replaced):
            with suppress(SettingRefused):  # the first refusal is the one to report
                self._nodes.set(name, value)
        self._replaced.clear()

    def _write_in_turns(self, pending: dict[str, Setting]) -> dict[str, SettingRefused]:
        """Write from the first again after each success; what stays pending is returned with its refusal."""
        refusals: dict[str, SettingRefused] = {}
        is_moving = True
        while is_moving:
            is_moving = False
            for name, value in list(pending.items()):
                if any(_is_selected(name, other) for other in pending):
                    continue
                try:
                    self._write(name, value)
                except SettingRefused as refusal:
                    refusals[name] = refusal
                    continue
                del pending[name]
                is_moving = True
                break
        return {name: refusals[name] for name in pending if name in refusals}

    def _write(self, name: str, value: Setting) -> None:
        nodes, known = self._nodes, _resolve_name(self._nodes, name)
        before = nodes.get(known)
        if type(before) is type(value) and before == value:
            return
        try:
            nodes.set(known, value)
        except SettingRefused as refusal:
            raise SettingRefused(f"{refusal}{_state(nodes, known)}{_advice(nodes, known, value)}") from refusal
        self._replaced.append((known, before))

    def _switch_triggers_off(self, settings: Mapping[str, Setting]) -> dict[str, Setting]:
        """Switch triggers off while their settings change; return what has to be switched on again after."""
        nodes = self._nodes
        if not any(_rank(*setting)[0] == TRIGGERED for setting in settings.items()) or not nodes.has(
            "TriggerMode"
        ):
            return {}
        if "TriggerMode" not in settings:
            before = nodes.get("TriggerMode")
            self._write("TriggerMode", "Off")
            return {"TriggerMode": before}
        chosen = nodes.get("TriggerSelector") if nodes.has("TriggerSelector") else None
        for selector in () if chosen is None else nodes.entries("TriggerSelector"):
            with suppress(SettingRefused):  # an entry may exist and not be available in this mode
                self._write("TriggerSelector", selector)
                self._write("TriggerMode", "Off")
        if chosen is None:
            self._write("TriggerMode", "Off")
        else:
            self._write("TriggerSelector", chosen)
        return {}


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
            f"the camera sends no chunk {names}, so it cannot distinguish exposure A from B; choose another "
            f"marker, or remove it from camera.chunks (available: {', '.join(known) or 'none'})"
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
    try:
        readback = {asked: nodes.get(_resolve_name(nodes, asked)) for asked in expected}
    except SettingRefused as gone:
        raise SettingsChanged(f"the camera lost its settings ({gone}); configure it again") from gone
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


def count_missed_triggers(nodes: Nodes, configured: Iterable[str]) -> bool:
    """Let the camera count triggers it had to ignore (SFNC FrameTriggerMissed).

    False if it cannot, or if its counters have been configured for something else.
    """
    if any(name.startswith("Counter") for name in configured):
        return False
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


SELECTOR, MODE, NUMBER, TRIGGERED = range(4)


def _rank(name: str, value: Setting) -> tuple[int, int]:
    """Stage of a setting, and its place there."""
    name = _new_name(name)
    if name.endswith("Selector"):
        return SELECTOR, 0
    if name in TRIGGER:
        return TRIGGERED, TRIGGER.index(name)
    if isinstance(value, bool | str) or name.endswith(SWITCH_SUFFIXES):
        return MODE, MODES.index(name) if name in MODES else len(MODES)
    return NUMBER, NUMBERS.index(name) if name in NUMBERS else len(NUMBERS)


def _new_name(name: str) -> str:
    return NEW_NAMES.get(name, name)


def _is_selected(name: str, selector: str) -> bool:
    """Return whether a feature may mean another value under another entry of this selector."""
    if not selector.endswith("Selector") or name == selector:
        return False
    return name.startswith(SELECTED.get(selector, (selector.removesuffix("Selector"),)))


def _resolve_name(nodes: Nodes, name: str) -> str:
    for candidate in (name, OLD_NAMES.get(name), NEW_NAMES.get(name)):
        if candidate is not None and nodes.has(candidate):
            return candidate
    other = name.removesuffix("Raw") if name.endswith("Raw") else f"{name}Raw"
    unit = f"; it has {other}, in another unit: set that, by its manual" if nodes.has(other) else ""
    raise SettingRefused(
        f"the camera has no feature {name}, or not in its present state{_state(nodes, name)}{unit}"
    )


def _state(nodes: Nodes, name: str) -> str:
    """Modes and switches that may keep a feature from being written, as they stand."""
    stem = next((stem for stem in STEMS if name.startswith(stem) and not name.endswith("Selector")), None)
    modes = [] if stem is None else [f"{stem}{suffix}" for suffix in SWITCH_SUFFIXES if f"{stem}{suffix}" != name]
    if stem == "AcquisitionFrameRate":  # many cameras have no rate while they are triggered
        modes.append("TriggerMode")
    found = [f"{mode} is {nodes.get(mode)}" for mode in modes if nodes.has(mode)]
    return f" ({', '.join(found)})" if found else ""


def _advice(nodes: Nodes, name: str, value: Setting) -> str:
    """Advice for a camera whose frames have another trigger than FrameStart."""
    if name != "TriggerSelector" or value != "FrameStart":
        return ""
    found = next((entry for entry in FRAME_TRIGGERS if entry in nodes.entries(name)), None)
    count = "AcquisitionBurstFrameCount" if found == "FrameBurstStart" else ""
    return f"; set TriggerSelector: {found}" * (found is not None) + f" and {count}: 1" * nodes.has(count)
