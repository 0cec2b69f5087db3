"""Ways of triggering a camera, by name: what has to be set for each, in SFNC names.

A trigger that is half set up looks like a broken wire, so a bench file may name one of these instead of four to
seven settings.  Whatever is set is read back, and `rtpiv camera test` tries it out.

==============  ==============================================================================================
preset          a frame is
==============  ==============================================================================================
free_running    taken by the camera's own clock (AcquisitionFrameRate)
software        asked for by us
edge            begun by a rising edge on `line`, exposed for ExposureTime
falling_edge    the same by a falling edge, as of inverted outputs
pulse_width     exposed as long as `line` is high: the timing unit says the exposure
burst           two of a burst, begun by a rising edge on `line` (shape burst)
==============  ==============================================================================================
"""

from typing import Literal

from daq.cameras.camera import Setting

Preset = Literal["free_running", "software", "edge", "falling_edge", "pulse_width", "burst"]
LINE = "line"  # stands for the input
_EDGE: dict[str, Setting] = {
    "TriggerSelector": "FrameStart",
    "TriggerSource": LINE,
    "TriggerActivation": "RisingEdge",
    "ExposureMode": "Timed",
    "TriggerMode": "On",
}
PRESETS: dict[str, dict[str, Setting]] = {
    "free_running": {"TriggerSelector": "FrameStart", "TriggerMode": "Off"},
    "software": {"TriggerSelector": "FrameStart", "TriggerSource": "Software", "TriggerMode": "On"},
    "edge": _EDGE,
    "falling_edge": {**_EDGE, "TriggerActivation": "FallingEdge"},
    "pulse_width": {**_EDGE, "TriggerActivation": "LevelHigh", "ExposureMode": "TriggerWidth"},
    "burst": {**_EDGE, "TriggerSelector": "FrameBurstStart", "AcquisitionBurstFrameCount": 2},
}


def needs_line(preset: Preset) -> bool:
    """Whether a preset hangs on an input line."""
    return LINE in PRESETS[preset].values()


def settings_of(preset: Preset, line: str | None) -> dict[str, Setting]:
    """What a preset sets.

    Parameters
    ----------
    preset : str
        Its name.
    line : str or None
        The input, such as Line1.
    """
    return {name: line if value == LINE and line else value for name, value in PRESETS[preset].items()}
