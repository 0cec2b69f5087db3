"""The port on real pseudo-terminals: unplugging, sharing, deadlines, threads."""

import threading
import time
from contextlib import ExitStack

import pytest
import serial

from sim.mechanics.clock import ScaledClock
from sim.stages import SimulatedStages
from stages.clock import SYSTEM_CLOCK
from stages.drivers_by_name import DRIVERS
from stages.errors import DeviceLost, MotionStopped, NoReply, NotReferenced, PortUnavailable, StageError
from stages.port import Port
from stages.stage import Stage
from stages.states import AxisState
from tests.slow_cases import slow_but
from tests.stages.benches import screws, stages_table

SPEED = 25.0  # the simulated world runs that much faster than the wall clock


@pytest.fixture
def served():
    """Factory: the stages of a driver behind a device file, the world running by itself."""
    with ExitStack() as stack:

        def make(driver: str, speed: float = SPEED) -> tuple[Stage, SimulatedStages]:
            table = stages_table(driver)
            world = SimulatedStages(table, ScaledClock(speed), screws(table))
            stage = stack.enter_context(Stage.open(stack.enter_context(world.serve())))
            return stage, world

        yield make


def homed(stage):
    stage.home()
    stage.move({"a": 40.0})


SOME = slow_but(DRIVERS, "zaber_ascii", "grbl")


@pytest.mark.parametrize("box", SOME)
def test_a_device_file_behaves_like_the_controller(served, box):
    stage, world = served(box)
    homed(stage)
    datum_mm = world.true_mm("a")
    for target_mm in (42.0, 41.0):
        stage.move({"a": target_mm})
        assert world.true_mm("a") - datum_mm == pytest.approx(target_mm - 40.0, abs=0.010)


@pytest.mark.parametrize("box", SOME)
def test_pulled_out_in_motion(served, box):
    """Error within half a second, position unknown, absolute moves refused."""
    stage, world = served(box)
    homed_in_haste(stage, world)
    line = world.lines["box"]
    pulled = []

    def pull():
        pulled.append(time.monotonic())
        line.unplug()

    timer = threading.Timer(0.4, pull)
    timer.start()
    with pytest.raises(DeviceLost, match="plug it in"):
        stage.move({"a": 110.0})
    assert time.monotonic() - pulled[0] <= 0.5
    assert stage.axis("a").state is AxisState.LOST
    with pytest.raises(DeviceLost):
        stage.move({"a": 50.0})
    assert stage.where_mm()["a"] is None
    timer.join()


def homed_in_haste(stage, world):
    """Home at the speed of tests, then go on in real time: in real time homing takes its time."""
    world.clock.set_speed(10.0 * SPEED)
    stage.home()
    stage.move({"a": 40.0})
    world.clock.set_speed(1.0)


def test_stop_from_another_thread_gets_through(served, driver):
    stage, world = served(driver)
    homed_in_haste(stage, world)
    threading.Timer(0.3, stage.stop).start()
    begun_s = time.monotonic()
    with pytest.raises(MotionStopped):
        stage.move({"a": 110.0})
    assert time.monotonic() - begun_s < 3.0
    time.sleep(0.05)
    rests_mm = world.true_mm("a")
    time.sleep(0.1)
    assert world.true_mm("a") == rests_mm < 109.0


def test_a_port_that_is_not_there_says_so():
    with pytest.raises(PortUnavailable, match="does not exist"):
        Port("/dev/ttyNOBODY", 9600)
    with pytest.raises(PortUnavailable, match="does not exist"):
        Port("sim://nobody", 9600)
    with pytest.raises(PortUnavailable):
        Port("nonsense://x", 9600)


def test_reading_ends_at_its_deadline():
    port = Port("loop://", 9600)
    begun_s = time.monotonic()
    with pytest.raises(NoReply):
        port.read(SYSTEM_CLOCK.now_s() + 0.1)
    assert 0.08 < time.monotonic() - begun_s < 1.0
    port.write(b"abc")
    assert port.read(SYSTEM_CLOCK.now_s() + 1.0).startswith(b"a")
    port.write(b"def")
    assert port.drain(0.05).endswith(b"def")
    assert port.trace[0].sent
    port.close()
    with pytest.raises(DeviceLost):
        port.write(b"x")


@pytest.mark.parametrize(
    "failure",
    [
        OSError(5, "EIO"),
        pytest.param("termios", marks=pytest.mark.posix("an error of termios")),
        serial.SerialException("gone"),
        TypeError("closed"),
    ],
)
def test_every_way_to_vanish_is_one_error(mocker, failure):
    if failure == "termios":
        import termios

        failure = termios.error(5, "EIO")
    port = Port("loop://", 9600)
    mocker.patch.object(type(port._serial), "in_waiting", property(mocker.Mock(side_effect=failure)))
    with pytest.raises(DeviceLost, match="loop://"):
        port.pending()
    assert port.is_lost
    mocker.stopall()
    with pytest.raises(DeviceLost):  # once lost, lost
        port.write(b"x")
    port.close()


def test_the_driver_of_nobody_gives_up_in_time():
    table = stages_table("pi_gcs2")
    stage = Stage(table)
    controller = stage.controllers["box"]
    begun_s = time.monotonic()
    with pytest.raises(StageError):
        controller.connect("loop://")  # answers everything with an echo
    assert time.monotonic() - begun_s < 10.0
    assert controller.is_lost
    with pytest.raises((DeviceLost, NotReferenced)):
        stage.move({"a": 50.0})
