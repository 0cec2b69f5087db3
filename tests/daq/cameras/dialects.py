"""Features as cameras of several makers have them: names, selectors, and what must be set before what.

Made after descriptions that users of EPICS publish (github.com/areaDetector/ADGenICam, folder xml), the last two
after reports of users.  Only what decides about the order of setting differs from the table in `features`:

    blackfly_s   FLIR BFS, ORX: a rate exists with its switch; automatics lock exposure and gain; the source of a
                 trigger is locked while the trigger is on
    flea3        Point Grey Flea3 GE: an older name of the switch, an automatic rate, both only without trigger;
                 triggers ExposureStart and ExposureActive
    grasshopper  Point Grey GS3, Blackfly: the same with a trigger FrameStart
    ace          Basler acA GigE: ExposureTimeAbs, AcquisitionFrameRateAbs, GainRaw, a trigger of acquisitions
    pilot        Basler piA: a trigger of acquisitions alone
    manta        Allied Vision Manta, Mako, GT: Abs names, a rate without switch, four triggers
    vieworks     Vieworks VNP: trigger ExposureStart, gain analog and digital
    hikrobot     a trigger of bursts alone
    plain        no selector of triggers; the source of the trigger exists while it is on
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from sim.camera.features import FEATURES, Feature

Changes = Mapping[str, Mapping[str, Any]]  # of rows of the table, by name and field
_TRIGGER = ("TriggerMode", "TriggerSource", "TriggerActivation", "TriggerSoftware", "TriggerDelay")
_DELAY = Feature(
    "TriggerDelay", "AcquisitionControl", "float", 0.0, 0.0, 1e6, unit="us", length=8, is_per_entry=True
)


def _entries(*names: str) -> tuple[tuple[str, int], ...]:
    return tuple((name, number) for number, name in enumerate(names))


def _automatic(name: str, default: int = 0, **changes: Any) -> Feature:
    return Feature(
        name, "AcquisitionControl", "enum", default, entries=_entries("Off", "Once", "Continuous"), **changes
    )


def _triggers(*names: str, **source: Any) -> Changes:
    """A selector of these triggers, each with its own mode and source."""
    return {
        "TriggerSelector": {"entries": _entries(*names), "selects": _TRIGGER},
        "TriggerMode": {"is_per_entry": True},
        "TriggerSource": {"is_per_entry": True, "default": 1, **source},
        "TriggerActivation": {"is_per_entry": True},
    }


def _raw_gain(*selectors: str) -> tuple[Changes, Feature]:
    gain: Changes = {
        "GainSelector": {"entries": _entries(*selectors), "selects": ("GainRaw",)},
        "Gain": {"shown": None},
    }
    return gain, Feature("GainRaw", "AnalogControl", "int", 36, 0, 500, is_per_entry=True)


def _changed(changes: Changes, *added: Feature) -> tuple[Feature, ...]:
    return tuple(replace(feature, **changes.get(feature.name, {})) for feature in FEATURES) + added


_OFF: tuple[str | int, ...] = ("Off",)
_OLD_RATE: Changes = {
    "AcquisitionFrameRateEnable": {
        "shown": "AcquisitionFrameRateEnabled", "default": 0, "exists_while": (("TriggerMode", _OFF),),
    },
    "AcquisitionFrameRate": {
        "exists_while": (("TriggerMode", _OFF),),
        "writable_while": (("AcquisitionFrameRateEnable", (1,)), ("AcquisitionFrameRateAuto", _OFF)),
    },
    "ExposureMode": {"entries": _entries("Timed", "TriggerWidth")},
    "ExposureTime": {"writable_while": (("ExposureMode", ("Timed",)), ("ExposureAuto", _OFF))},
    "Gain": {"writable_while": (("GainAuto", _OFF),)},
}  # fmt: skip
_OLD_MODES = (
    _automatic("AcquisitionFrameRateAuto", 2, writable_while=(("AcquisitionFrameRateEnable", (1,)),)),
    _automatic("ExposureAuto", 2),
    _automatic("GainAuto", 2),
    _DELAY,
)
_ABS: Changes = {
    "ExposureTime": {"shown": "ExposureTimeAbs", "writable_while": (("ExposureAuto", _OFF),)},
    "AcquisitionFrameRate": {"shown": "AcquisitionFrameRateAbs"},
}
_LOCKED_RATE: Changes = {
    "AcquisitionFrameRateEnable": {"default": 0},
    "AcquisitionFrameRate": {
        "shown": "AcquisitionFrameRateAbs", "writable_while": (("AcquisitionFrameRateEnable", (1,)),),
    },
}  # fmt: skip
_ACE_GAIN, _ACE_RAW = _raw_gain("All", "AnalogAll", "DigitalAll", "Tap1", "Tap2")
_PILOT_GAIN, _PILOT_RAW = _raw_gain("All", "Tap1", "Tap2")
_DELAY_ABS = replace(_DELAY, shown="TriggerDelayAbs")

BLACKFLY_S = _changed(
    {
        **_triggers(
            "AcquisitionStart", "FrameStart", "FrameBurstStart", writable_while=(("TriggerMode", _OFF),)
        ),
        "AcquisitionFrameRateEnable": {"default": 0},
        "AcquisitionFrameRate": {"exists_while": (("AcquisitionFrameRateEnable", (1,)),)},
        "ExposureMode": {"entries": _entries("Timed", "TriggerWidth")},
        "ExposureTime": {"writable_while": (("ExposureMode", ("Timed",)), ("ExposureAuto", _OFF))},
        "Gain": {"writable_while": (("GainAuto", _OFF),)},
    },
    _automatic("ExposureAuto", 2), _automatic("GainAuto", 2), _DELAY,
)  # fmt: skip
FLEA3 = _changed({**_OLD_RATE, **_triggers("ExposureStart", "ExposureActive")}, *_OLD_MODES)
GRASSHOPPER = _changed({**_OLD_RATE, **_triggers("FrameStart", "ExposureActive")}, *_OLD_MODES)
ACE = _changed(
    {**_ABS, **_LOCKED_RATE, **_ACE_GAIN, **_triggers("AcquisitionStart", "FrameStart")},
    _automatic("ExposureAuto"), _ACE_RAW, _DELAY_ABS,
)  # fmt: skip
PILOT = _changed(
    {**_ABS, **_LOCKED_RATE, **_PILOT_GAIN, **_triggers("AcquisitionStart")},
    _automatic("ExposureAuto"), _PILOT_RAW, _DELAY_ABS,
)  # fmt: skip
MANTA = _changed(
    {
        **_ABS, **_triggers("FrameStart", "AcquisitionStart", "AcquisitionEnd", "AcquisitionRecord"),
        "AcquisitionFrameRateEnable": {"shown": None}, "GainSelector": {"entries": _entries("All")},
    },
    _automatic("ExposureAuto"), _DELAY_ABS,
)  # fmt: skip
VIEWORKS = _changed(
    {
        **_triggers("ExposureStart"),
        "GainSelector": {"entries": _entries("DigitalAll", "AnalogAll"), "selects": ("Gain",)},
        "Gain": {"is_per_entry": True},
    }
)
HIKROBOT = _changed(_triggers("FrameBurstStart"), _automatic("ExposureAuto"))
PLAIN = _changed(
    {
        "TriggerSelector": {"shown": None}, "GainSelector": {"shown": None},
        "TriggerSource": {"default": 1, "exists_while": (("TriggerMode", ("On",)),)},
        "ExposureMode": {"entries": _entries("Timed", "TriggerWidth"), "default": 1},
        "ExposureTime": {"exists_while": (("ExposureMode", ("Timed",)),)},
    }
)  # fmt: skip
