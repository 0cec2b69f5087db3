"""A run goes on only with the controllers it began with."""

import pytest

from daq.runner.session import require_same_boxes
from stages.errors import WrongDevice

BEGAN = {"glass": "X-MCB2 serial 70001", "target": "X-MCB2 serial 70002", "rail": "grbl 1.1h"}


def journal(*sessions):
    return [{"kind": "session", "controllers": boxes} for boxes in sessions] + [{"kind": "end"}]


def test_the_same_boxes_and_a_new_run_pass():
    require_same_boxes([], BEGAN)
    require_same_boxes([{"kind": "session"}], BEGAN)  # a session from before identities were written down
    require_same_boxes(journal(BEGAN, BEGAN), dict(BEGAN))
    require_same_boxes(journal({**BEGAN, "rail": ""}), BEGAN)  # one that did not tell


def test_swapped_cables_are_named():
    swapped = {**BEGAN, "glass": BEGAN["target"], "target": BEGAN["glass"]}
    with pytest.raises(WrongDevice, match=r"glass: .*70002.* answers.*70001.*the box that was target; swap"):
        require_same_boxes(journal(BEGAN), swapped)


def test_another_box_is_named_whichever_session_knew_the_right_one():
    other = {**BEGAN, "target": "X-MCB2 serial 99999"}
    with pytest.raises(WrongDevice, match=r"target: .*99999.* answers.*70002.*put the box back"):
        require_same_boxes(journal({**BEGAN, "target": ""}, BEGAN), other)
