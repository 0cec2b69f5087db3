"""The last look at a flow step: a camera that has lost its settings meanwhile is found before the step counts."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from daq.errors import SettingsChanged
from daq.runner.flow_step import FlowStep


@pytest.mark.parametrize("forgets", [0, 1])
def test_every_camera_is_verified_before_a_step_of_a_flow_counts(forgets):
    """Two cameras whose pairs are all on the disk; one of them has lost power."""
    sides = [MagicMock(), MagicMock()]
    for side in sides:
        side.whole_pairs.return_value = 8
        side.chunks_so_far.return_value = 1
        side.source.exposures.settings = {}
        side.source.section.frames = 2
    laser = MagicMock()
    light = SimpleNamespace(prepare=lambda order, settings, tell: laser)
    step = SimpleNamespace(pulses=SimpleNamespace(rate_hz=10.0, chunk=4), frames=8)
    flow = FlowStep(sides, MagicMock(), MagicMock(), lambda said: None, light)
    assert flow.take(step, {})
    sides[forgets].source.exposures.verify.side_effect = SettingsChanged("it lost its settings")
    with pytest.raises(SettingsChanged):
        flow.take(step, {})
