"""An axis that something else drives (another program, a pendant) has no position to judge by until it rests."""

import pytest

from stages.errors import StageUsageError

OTHER_PROGRAM = {
    "zaber_ascii": b"/1 1 set maxspeed 300\n/1 1 move abs 4000\n",
    "pi_gcs2": b"SVO 1 1\nVEL 1 0.4\nMOV 1 30\n",
    "thorlabs_apt": bytes.fromhex(  # 0.4 mm/s, 10 mm/s2; to 30 mm
        "13 04 0e 00 a1 01 01 00 00 00 00 00 2c 00 00 00 8c 21 00 00 53 04 06 00 a1 01 01 00 e0 2e 00 00"
    ),
    "grbl": b"$J=G53G90G21X-90F24\n",
}  # an isel at work is mute


@pytest.fixture(params=OTHER_PROGRAM)
def creeping(request, bench):
    """A bench whose axis a creeps so slowly that two readings agree."""
    made = bench(request.param).homed({"a": 60.0, "b": 30.0})
    made.line.emulator.feed(OTHER_PROGRAM[request.param])
    made.clock.sleep_s(0.5)
    made.line.emulator.take_answers()  # answered through the other interface
    return made


@pytest.mark.provokes
def test_it_is_said_and_not_believed(creeping):
    before_mm = creeping.world.true_mm("a")
    with pytest.raises(StageUsageError, match="is moving; wait until it stops"):
        _ = creeping.stage.axis("a").position_mm
    creeping.clock.sleep_s(0.5)
    assert creeping.world.true_mm("a") != before_mm


@pytest.mark.provokes
def test_the_next_move_begins_at_rest(creeping):
    with pytest.raises(StageUsageError, match="wait until it stops"):
        creeping.stage.move({"a": 40.0})
    creeping.clock.sleep_s(120.0)
    creeping.stage.move({"a": 40.0})
    assert creeping.stage.where_mm()["a"] == pytest.approx(40.0, abs=0.01)
