"""PI beyond the contract: stages without a reference switch, and several controllers on one port."""

from contextlib import closing

import pytest

from sim.emulators.line import Line
from sim.emulators.pi_gcs2 import PiEmulator, StageMake
from sim.emulators.protocol_sim import put_up
from sim.mechanics.clock import VirtualClock
from sim.mechanics.motion import Mechanics, Motor
from stages.controller import Channel
from stages.drivers.pi_gcs2 import PiController
from stages.errors import StageError, StageUsageError, WrongDevice
from stages.protocols import pi_gcs2 as gcs

SCREW = Mechanics(lead_mm=1.0, steps_per_rev=2000, high_switch_mm=100.0, index_mm=50.0, power_up_mm=30.0)


def sent(made):
    return b"".join(chunk.data for chunk in made.controller.port.trace if chunk.sent)


@pytest.mark.parametrize(("firmware", "how"), [
    ({"stages": StageMake(switches="reference")}, b"FRF 1"), ({"stages": StageMake(switches="limits")}, b"FNL 1"),
    ({"knows_switches": False}, b"FRF 1"),
])  # fmt: skip
def test_what_finds_the_reference_is_asked(bench, firmware, how):
    """pipython's startup: FRF where there is a reference switch, FNL or FPL where there are limits only."""
    made = bench("pi_gcs2", firmware=firmware).homed()
    assert how in sent(made)
    datum_mm = made.world.true_mm("a")
    made.stage.move({"a": 60.0})
    made.stage.move({"a": 20.0})
    here_mm = made.world.true_mm("a")
    made.stage.move({"a": 50.0})
    assert made.world.true_mm("a") - here_mm == pytest.approx(30.0, abs=0.01)
    if how != b"FNL 1":
        return
    assert datum_mm == pytest.approx(0.0, abs=0.05), "referenced off its lower switch"


def test_the_positive_end_is_a_word_of_a_subclass(bench, monkeypatch):
    monkeypatch.setattr(PiController, "at_limit", "FPL")
    made = bench("pi_gcs2", firmware={"stages": StageMake(switches="limits")}).homed()
    assert b"FPL 1" in sent(made)
    made.stage.move({"a": 60.0})
    assert made.stage.where_mm()["a"] == pytest.approx(60.0, abs=0.01)


def test_a_stage_with_no_switch_at_all_is_not_homed(bench):
    made = bench("pi_gcs2", firmware={"stages": StageMake(switches="none")})
    with pytest.raises(StageUsageError, match="neither reference nor limit switches"):
        made.stage.home()
    assert b"FRF 1" not in sent(made)
    assert b"FNL 1" not in sent(made)


@pytest.mark.parametrize("said", ["3.0", "2.1"])
def test_a_controller_of_gcs_3_is_refused_by_name(bench, said):
    """pipython takes whatever says more than 2.0 to CSV? for GCS 3."""
    with pytest.raises(WrongDevice, match=f"C-663.12.* has command set {said}, which is GCS 3") as refused:
        bench("pi_gcs2", firmware={"command_set": said})
    assert "add-a-stage" in str(refused.value)


def test_a_controller_that_does_not_know_its_command_set_is_driven(bench):
    made = bench("pi_gcs2", firmware={"command_set": None}).homed({"a": 20.0})
    assert made.stage.where_mm()["a"] == pytest.approx(20.0, abs=0.01)


@pytest.fixture
def chain(bench, monkeypatch):
    """Two Mercurys on one port."""
    monkeypatch.setattr(PiController, "example_channels", ("1/1", "3/1"))
    return lambda **changes: bench("pi_gcs2", **changes)


def test_a_chain_of_controllers_is_driven_by_address(chain):
    made = chain()
    assert made.controller.identity.count("Physik Instrumente") == 2
    made.stage.home()
    made.stage.move({"a": 60.0, "b": 30.0})
    here_mm = made.world.true_mm("a"), made.world.true_mm("b")
    made.stage.move({"b": 40.0})
    assert made.world.true_mm("a") == here_mm[0]
    assert made.world.true_mm("b") - here_mm[1] == pytest.approx(10.0, abs=0.01)
    assert b"3 MOV 1 40.0" in sent(made)


@pytest.mark.parametrize("axis", ["a", "b"])
def test_a_stop_reaches_every_controller_of_a_chain(chain, axis):
    made = chain()
    made.stage.home()
    made.clock.at(made.clock.now_s() + 0.5, lambda: made.stage.stop())
    with pytest.raises(StageError):
        made.stage.move({axis: 110.0})
    rests_mm = made.world.true_mm(axis)
    assert rests_mm < 90.0
    made.clock.sleep_s(10.0)
    assert made.world.true_mm(axis) == rests_mm
    made.stage.clear_stop()
    made.stage.move({axis: 50.0})


def test_a_chain_without_the_controller_that_is_meant_is_refused(chain, monkeypatch):
    made = chain()
    made.controller.close()
    monkeypatch.setattr(PiController, "_identify", lambda self: "known")
    other = PiController("chain", {"2/1": Channel("2/1")}, made.clock)
    with pytest.raises(StageError):
        other.connect(made.table.controllers["box"].port)
    wrong = PiController("chain", {"1/7": Channel("1/7")}, made.clock)
    with pytest.raises(WrongDevice, match="has axes 1, not 1/7"):
        wrong.connect(made.table.controllers["box"].port)


@pytest.mark.parametrize("names", [("1/1", "2"), ("0/1",), ("17/1",), ("a/1",), ("1/",)])
def test_channels_that_are_none(names):
    with pytest.raises(StageUsageError):
        PiController("chain", {name: Channel(name) for name in names})


def test_an_answer_of_another_controller_is_nobodys():
    assert gcs.parse_answer(b"0 2 1=10.0\n") == gcs.Answer(("1=10.0",), 2)
    assert gcs.parse_answer(b"0\n") == gcs.Answer(("0",))
    assert gcs.Answer(("1=1", "2=2"), 4).to_bytes() == b"0 4 1=1 \n2=2\n"
    stream = gcs.CommandStream()
    assert stream.feed(b"2 \x053 POS? 1\n\x18") == [
        gcs.SingleByte(5, 2), gcs.Command("POS?", ("1",), 3), gcs.SingleByte(24),
    ]  # fmt: skip


def test_three_controllers_on_one_port_at_the_rate_of_their_front_switches():
    """Three axes, as they are mostly bought; the bench file says no rate."""
    clock = VirtualClock()
    motors = {f"{address}/1": Motor(SCREW) for address in (1, 2, 3)}
    line = Line(PiEmulator(motors, clock), clock)
    line.baud = 38_400
    controller = PiController("chain", {name: Channel(name) for name in motors}, clock)
    with put_up(line) as url, closing(controller):
        assert controller.connect(url).count("Physik Instrumente") == 3
        assert controller.baud == 38_400
        for number, name in enumerate(motors, 1):
            controller.token = controller.latch.count
            controller.start_home(name)
            while controller.moving(name):
                clock.sleep_s(0.1)
            controller.start_move(name, 10.0 * number, 20.0, 100.0)
            while controller.moving(name):
                clock.sleep_s(0.1)
        places = [controller.position_mm(name) for name in motors]
        assert places == pytest.approx([10.0, 20.0, 30.0], abs=0.002)
        assert [motor.carriage_mm for motor in motors.values()] == pytest.approx(places, abs=0.05)
