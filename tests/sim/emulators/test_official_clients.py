"""The vendors' own clients on our emulators: judges that share nothing with us."""

import statistics
import time
from itertools import pairwise

import pytest

from sim.emulators.faults import Fault, FaultSchedule
from sim.emulators.line import Line
from sim.emulators.pi_gcs2 import PiEmulator, StageMake
from sim.emulators.pty import PtyPort
from sim.emulators.zaber_ascii import ZaberEmulator
from sim.mechanics.clock import ScaledClock
from sim.mechanics.motion import Mechanics, Motor

SCREW = Mechanics(lead_mm=4.0, steps_per_rev=12_800, high_switch_mm=150.0, index_mm=75.0, power_up_mm=20.0)
PER_MM = 3200


@pytest.fixture
def zaber():
    """The official client, connected to one device with two axes."""
    ascii_api = pytest.importorskip("zaber_motion.ascii", reason="zaber-motion is not installed")
    clock = ScaledClock(20.0)
    motors = {"1/1": Motor(SCREW), "1/2": Motor(SCREW)}
    line = Line(ZaberEmulator(motors, clock), clock)
    with PtyPort(line) as port, ascii_api.Connection.open_serial_port(port.path) as connection:
        yield connection, motors, line


@pytest.mark.slow
def test_zaber_official_client_detects_homes_moves_and_waits(zaber):
    connection, motors, _ = zaber
    devices = connection.detect_devices(identify_devices=False)
    assert [device.device_address for device in devices] == [1]
    axis = devices[0].get_axis(1)
    assert axis.warnings.get_flags() == {"WR"}
    assert not axis.is_homed()
    axis.home()
    assert axis.is_homed()
    zero_mm = motors["1/1"].carriage_mm
    assert zero_mm == pytest.approx(0.0, abs=0.01)
    axis.move_absolute(25 * PER_MM)
    assert motors["1/1"].carriage_mm - zero_mm == pytest.approx(25.0, abs=0.001)
    axis.move_relative(-5 * PER_MM)
    assert axis.get_position() == 20 * PER_MM
    assert motors["1/1"].carriage_mm - zero_mm == pytest.approx(20.0, abs=0.001)
    assert motors["1/2"].carriage_mm == 20.0  # the other axis never moved


def test_zaber_official_client_reads_who_it_is_and_sets_how_it_moves(zaber):
    connection, _, _ = zaber
    device = connection.get_device(1)
    for name, value in (("deviceid", 50081), ("system.axiscount", 2), ("version", 7.33)):
        assert device.settings.get(name) == value
    assert device.settings.get("system.serial") > 0
    axis = device.get_axis(1)
    axis.settings.set("accel", 205)
    assert axis.settings.get("accel") == 205


def test_zaber_official_client_understands_our_faults_and_refusals(zaber):
    zaber_motion = pytest.importorskip("zaber_motion")
    connection, motors, _ = zaber
    axis = connection.get_device(1).get_axis(1)
    axis.home()
    with pytest.raises(zaber_motion.CommandFailedException, match="BADDATA"):
        axis.move_absolute(10**9)
    motors["1/1"].obstacle_mm = motors["1/1"].carriage_mm + 10.0
    with pytest.raises(zaber_motion.MovementFailedException, match="FS"):
        axis.move_absolute(30 * PER_MM)


def test_zaber_official_client_stops_a_motion(zaber):
    connection, motors, _ = zaber
    axis = connection.get_device(1).get_axis(1)
    axis.home()
    axis.settings.set("maxspeed", round(5 * PER_MM * 1.6384))
    axis.move_absolute(100 * PER_MM, wait_until_idle=False)
    time.sleep(0.1)
    assert axis.is_busy()
    axis.stop()
    rests_mm = motors["1/1"].carriage_mm
    assert 0.5 < rests_mm < 90.0
    assert not axis.is_busy()


def test_zaber_speed_units_are_the_vendors(zaber):
    """What the client sets as 10 mm/s is driven as 10 mm/s."""
    connection, motors, line = zaber
    axis = connection.get_device(1).get_axis(1)
    axis.home()
    axis.settings.set("maxspeed", round(10 * PER_MM * 1.6384))
    axis.move_absolute(100 * PER_MM, wait_until_idle=False)
    time.sleep(0.05)  # a second of the simulated clock, past the ramp
    samples = []
    for _ in range(9):  # a moment in which this process does not run spoils one interval, not the median
        line.emulator.advance()
        samples.append((line.clock.now_s(), motors["1/1"].carriage_mm))
        time.sleep(0.03)
    axis.stop()
    speeds = [(x1 - x0) / (t1 - t0) for (t0, x0), (t1, x1) in pairwise(samples)]
    assert statistics.median(speeds) == pytest.approx(10.0, rel=0.05)


def test_zaber_official_client_drives_at_a_velocity_and_to_the_ends(zaber):
    connection, motors, line = zaber
    axis = connection.get_device(1).get_axis(1)
    axis.home()
    axis.move_velocity(round(20 * PER_MM * 1.6384))
    first_s, first_mm = line.clock.now_s(), motors["1/1"].carriage_mm
    while line.clock.now_s() < first_s + 2.0:
        time.sleep(0.005)
    assert motors["1/1"].carriage_mm > first_mm + 5.0
    axis.stop()
    rests_mm = motors["1/1"].carriage_mm
    axis.move_velocity(-round(20 * PER_MM * 1.6384))
    axis.wait_until_idle()
    assert motors["1/1"].carriage_mm < rests_mm
    axis.settings.set("limit.max", 40 * PER_MM)
    axis.move_max()
    assert axis.get_position() == axis.settings.get("limit.max")
    axis.move_min()
    assert axis.get_position() == axis.settings.get("limit.min")
    before = axis.settings.get("maxspeed")
    axis.move_absolute(5 * PER_MM, velocity=round(10 * PER_MM * 1.6384), acceleration=100)
    assert axis.settings.get("maxspeed") == before


def test_zaber_official_client_notices_a_pulled_plug(zaber):
    zaber_motion = pytest.importorskip("zaber_motion")
    connection, _, line = zaber
    axis = connection.get_device(1).get_axis(1)
    axis.home()
    line.faults = FaultSchedule([Fault("unplug", time_s=line.clock.now_s() + 1.0)])

    def to_and_fro():
        for _ in range(1000):
            axis.move_absolute(50 * PER_MM)
            axis.move_absolute(10 * PER_MM)

    gone = ("ConnectionClosedException", "ConnectionFailedException", "RequestTimeoutException")
    with pytest.raises(tuple(getattr(zaber_motion, name) for name in gone)):  # where in a request it was pulled
        to_and_fro()


@pytest.fixture
def pi_serial(monkeypatch):
    """The official client's port, which tells every device that was ever made of another one."""
    serial = pytest.importorskip(
        "pipython.pidevice.interfaces.piserial", reason="pipython is not installed"
    ).PISerial
    monkeypatch.setattr(serial, "_connection_status_changed_callbacks", [])
    return serial


@pytest.mark.slow
def test_pi_official_client_starts_references_and_moves(pi_serial):
    """pipython is a bench tool with a licence of its own: never required, used where somebody has it."""
    from pipython import GCSDevice, GCSError, pitools

    clock = ScaledClock(20.0)
    motors = {"1": Motor(SCREW), "2": Motor(SCREW)}
    line = Line(PiEmulator(motors, clock), clock)
    with PtyPort(line) as port, pi_serial(port.path, 115200) as gateway:
        device = GCSDevice(gateway=gateway)
        assert "Physik Instrumente" in device.qIDN()
        assert device.axes == ["1", "2"]
        with pytest.raises(GCSError, match="unreferenced"):
            device.MOV("1", 10.0)
        device.SVO("1", True)
        device.FRF("1")
        pitools.waitonreferencing(device, axes="1", timeout=60)
        device.MOV("1", 60.0)
        pitools.waitontarget(device, axes="1", timeout=60)
        zero_mm = motors["1"].carriage_mm - 60.0
        device.MOV("1", 50.0)
        pitools.waitontarget(device, axes="1", timeout=60)
        assert motors["1"].carriage_mm - zero_mm == pytest.approx(50.0, abs=0.001)
        assert device.qPOS("1")["1"] == pytest.approx(50.0, abs=1e-3)
        with pytest.raises(GCSError, match="out of limits"):
            device.MOV("1", 1e4)
        device.STP(noraise=True)


@pytest.mark.slow
@pytest.mark.parametrize(("switches", "how"), [("reference", "FRF"), ("limits", "FNL"), ("limits", "FPL")])
def test_pi_official_client_starts_up_sets_speeds_and_stops(pi_serial, switches, how):
    """Its own startup: servos on, each axis referenced, waited for by byte 7 as long as HLP? lists it."""
    from pipython import GCSDevice, pitools

    clock = ScaledClock(20.0)
    motors = {"1": Motor(SCREW), "2": Motor(SCREW)}
    line = Line(PiEmulator(motors, clock, StageMake(switches=switches)), clock)
    with PtyPort(line) as port, pi_serial(port.path, 115200) as gateway:
        device = GCSDevice(gateway=gateway)
        pitools.startup(device, stages=None, refmodes=[how, how])
        assert device.qFRF() == {"1": True, "2": True}
        assert set(device.qTRS().values()) == {switches == "reference"}
        assert set(device.qLIM().values()) == {True}
        for set_it in (device.VEL, device.ACC, device.DEC):
            set_it("1", 40.0)
        device.MOV({"1": 60.0, "2": 30.0})
        assert device.IsMoving("1")["1"]
        assert device.IsControllerReady()
        pitools.waitontarget(device, timeout=60)
        assert list(device.qPOS().values()) == pytest.approx([60.0, 30.0], abs=0.001)
        device.MOV("1", 120.0)
        device.StopAll(noraise=True)
        pitools.waitontarget(device, timeout=60)
        assert device.qPOS("1")["1"] < 110.0
