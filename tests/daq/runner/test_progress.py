"""What a person reads while a run goes on."""

import pytest

from daq.runner.progress import Progress, line
from daq.runs.frame_accounting import FrameAccounting
from daq.timing.states import LaserState


@pytest.mark.parametrize(
    ("laser", "counts", "words"),
    [
        (LaserState.FIRING, {"triggered": 16, "rejected": 16}, "waiting for light, 16 dark frames so far"),
        (
            LaserState.FIRING,
            {"triggered": 20, "rejected": 16, "written": 4},
            "20 triggered = 4 written + 16 dark or surplus",
        ),
        (None, {"triggered": 5, "rejected": 1, "written": 4}, "5 triggered = 4 written + 1 rejected"),
    ],
)
def test_frames_without_light_are_no_alarm(laser, counts, words):
    made = Progress(steps=2, tag="flow", laser=laser, accounting=FrameAccounting(**counts))
    assert line(made).split("; ")[-1] == words
