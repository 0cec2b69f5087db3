"""Zaber beyond the contract: a motion has its own speed, and settings that are kept over power stay as found."""

import pytest

from stages.errors import CommandRejected
from stages.protocols.zaber_ascii import Command


def sent(made):
    return b"".join(chunk.data for chunk in made.controller.port.trace if chunk.sent)


@pytest.mark.parametrize(("firmware", "writes"), [("7.33", False), ("7.01", False), ("6.28", True)])
def test_settings_are_left_alone_where_a_motion_takes_its_own(bench, firmware, writes):
    """ASCII manual, settings: maxspeed and accel are non-volatile; move: `move abs P maxspeed accel`."""
    made = bench("zaber_ascii", firmware={"firmware": firmware})
    box = made.line.emulator.axis(1, 1)
    before = dict(box.settings)
    made.stage.home()
    begun_s = made.clock.now_s()
    made.stage.move({"a": 100.0})
    assert (box.settings == before) is not writes
    assert (b" set " in sent(made)) is writes
    assert (b" 13107 7:" in sent(made)) is not writes
    assert 4.0 < made.clock.now_s() - begun_s < 7.0, "100 mm at 20 mm/s"
    assert made.world.true_mm("a") == pytest.approx(100.0, abs=0.02)


def test_older_firmware_refuses_a_motion_with_a_speed(bench):
    made = bench("zaber_ascii", firmware={"firmware": "6.28"}).homed()
    with pytest.raises(CommandRejected, match="BADDATA"):
        made.controller._tell("1/1", "move abs 4000 1000 20")


@pytest.mark.parametrize("checked", [True, False])
def test_an_answer_has_a_checksum_if_its_command_had(bench, checked):
    made = bench("zaber_ascii")
    box = made.line.emulator
    box.take_answers()
    box.feed(Command("get pos", 1, 1, 7, checked).to_bytes())
    (said,) = box.take_answers()
    assert (b":" in said.data) is checked
