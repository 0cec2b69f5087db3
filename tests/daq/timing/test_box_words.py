"""The first day at a laser's box: each way in which it does not answer is a sentence of its own, with its cure."""

import pytest

from daq.timing.drivers.pivlab_synchroniser import OltSyncBox, XmSyncBox
from daq.timing.drivers.quantum_composers import QuantumComposersBox
from daq.timing.drivers.srs_dg645 import Dg645Box
from daq.timing.pulses import Role
from sim.emulators.device import Emulator
from sim.emulators.grbl import GrblEmulator
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.emulators.zaber_ascii import ZaberEmulator
from sim.mechanics.clock import VirtualClock
from sim.mechanics.motion import Mechanics, Motor
from sim.timing_boxes.pivlab_synchroniser import OltSyncEmulator, XmSyncEmulator
from sim.timing_boxes.pulsing import PulsingEmulator
from sim.timing_boxes.quantum_composers import QuantumComposersEmulator
from sim.timing_boxes.srs_dg645 import Dg645Emulator
from stages.errors import DeviceLost, PortUnavailable, StageError

WIRED = {
    QuantumComposersBox: ({Role.Q_SWITCH_1: "A", Role.CAMERA: "C"}, QuantumComposersEmulator, 38_400),
    OltSyncBox: ({Role.CAMERA: "1", Role.Q_SWITCH_1: "2"}, OltSyncEmulator, 9600),
    Dg645Box: ({Role.Q_SWITCH_1: "AB", Role.CAMERA: "EF"}, Dg645Emulator, 9600),
    XmSyncBox: ({Role.CAMERA: "1", Role.Q_SWITCH_1: "2"}, XmSyncEmulator, 9600),
}
STAGE = Mechanics(lead_mm=5.0, steps_per_rev=800, high_switch_mm=150.0, index_mm=75.0, power_up_mm=20.0)


class Mute(Emulator):
    """Hears everything and says nothing."""

    def _take(self, data):
        pass


@pytest.fixture(params=WIRED, ids=lambda driver: driver.__name__)
def driver(request):
    return request.param


@pytest.fixture
def on_line():
    """Put something on a line in memory; the line and its clock."""

    def put(made, motors=()):
        clock = VirtualClock()
        is_unit = issubclass(made, PulsingEmulator)
        emulator = made(clock) if is_unit else made({name: Motor(STAGE) for name in motors}, clock)
        LINES["desk"] = Line(emulator, clock)
        return LINES["desk"], clock

    yield put
    LINES.pop("desk", None)


def box_of(driver, clock=None):
    box = driver("laser", WIRED[driver][0], clock or VirtualClock())
    box.address = OltSyncEmulator(VirtualClock()).name
    return box


def test_off_or_silent(driver, on_line):
    _, clock = on_line(Mute)
    words = rf"laser on sim://desk at {WIRED[driver][2]} baud says nothing; is it switched on, .*"
    words += " rtpiv doctor --probe sim://desk"
    with pytest.raises(StageError, match=words):
        box_of(driver, clock).connect("sim://desk")


def test_a_wrong_rate(driver, on_line):
    line, clock = on_line(WIRED[driver][1])
    line.baud = 57_600
    with pytest.raises(
        StageError, match=rf"laser on sim://desk at {WIRED[driver][2]} baud .* rate .* rtpiv doctor --probe"
    ):
        box_of(driver, clock).connect("sim://desk")
    assert box_of(driver, clock).connect("sim://desk", 57_600)


@pytest.mark.parametrize(("there", "motors", "words"), [
    (GrblEmulator, ("X", "Y"), "a Grbl board .driver: grbl"),
    (ZaberEmulator, ("1/1",), "says nothing; is it switched on"),
])  # fmt: skip
def test_a_swapped_cable(driver, on_line, there, motors, words):
    _, clock = on_line(there, motors)
    with pytest.raises(
        StageError, match=rf"laser on sim://desk at {WIRED[driver][2]} baud .*{words}.*rtpiv doctor --probe"
    ):
        box_of(driver, clock).connect("sim://desk")


def test_another_box_of_a_laser(on_line):
    _, clock = on_line(QuantumComposersEmulator)
    with pytest.raises(StageError, match=r"pulse generator .box: qc9520.*rtpiv doctor --probe"):
        box_of(OltSyncBox, clock).connect("sim://desk")


def test_a_box_that_falls_silent_half_way(driver, on_line):
    line, clock = on_line(WIRED[driver][1])
    box = box_of(driver, clock)
    box.connect("sim://desk")
    box.silence()
    line.emulator.switch_off()
    words = rf"laser on sim://desk at {WIRED[driver][2]} baud has answered before .* switched off"
    with pytest.raises(StageError, match=words):
        box.silence()
    line.unplug()
    with pytest.raises(DeviceLost, match="plug it in"):
        box.silence()


def test_a_port_that_cannot_be_opened_is_said_with_the_rate(driver):
    """Busy and forbidden ones are those of all boxes: tests/stages/test_bench_words.py."""
    with pytest.raises(PortUnavailable, match=rf"laser .{WIRED[driver][2]} baud.: /dev/no-port does not exist"):
        box_of(driver).connect("/dev/no-port")
