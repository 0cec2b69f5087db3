"""A laser's box that does not answer, said with its rate; tests/stages/test_bench_words.py has all other words."""

import pytest

from daq.timing.drivers.pivlab_synchroniser import OltSyncBox, XmSyncBox
from daq.timing.drivers.quantum_composers import QuantumComposersBox
from daq.timing.drivers.srs_dg645 import Dg645Box
from daq.timing.pulses import Role
from sim.emulators.line import Line
from sim.emulators.protocol_sim import put_up
from sim.mechanics.clock import VirtualClock
from sim.timing_boxes.pivlab_synchroniser import OltSyncEmulator, XmSyncEmulator
from sim.timing_boxes.quantum_composers import QuantumComposersEmulator
from sim.timing_boxes.srs_dg645 import Dg645Emulator
from stages.errors import DeviceLost, StageError
from tests.stages.test_bench_words import Mute

WIRED = {
    QuantumComposersBox: ({Role.Q_SWITCH_1: "A", Role.CAMERA: "C"}, QuantumComposersEmulator, 38_400),
    OltSyncBox: ({Role.CAMERA: "1", Role.Q_SWITCH_1: "2"}, OltSyncEmulator, 9600),
    Dg645Box: ({Role.Q_SWITCH_1: "AB", Role.CAMERA: "EF"}, Dg645Emulator, 9600),
    XmSyncBox: ({Role.CAMERA: "1", Role.Q_SWITCH_1: "2"}, XmSyncEmulator, 9600),
}


@pytest.fixture(params=WIRED, ids=lambda driver: driver.__name__)
def driver(request):
    return request.param


def box_of(driver, clock):
    box = driver("laser", WIRED[driver][0], clock)
    box.address = OltSyncEmulator(clock).name
    return box


def test_off_or_silent(driver):
    clock = VirtualClock()
    words = rf"laser on sim://.* at {WIRED[driver][2]} baud says nothing; is it switched on, .* --probe sim"
    with put_up(Line(Mute({}, clock), clock)) as url, pytest.raises(StageError, match=words):
        box_of(driver, clock).connect(url)


def test_a_box_that_falls_silent_half_way(driver):
    clock = VirtualClock()
    line, box = Line(WIRED[driver][1](clock), clock), box_of(driver, clock)
    with put_up(line) as url:
        box.connect(url)
        box.silence()
        line.emulator.switch_off()
        words = rf"laser on {url} at {WIRED[driver][2]} baud has answered before .* switched off"
        with pytest.raises(StageError, match=words):
            box.silence()
        line.unplug()
        with pytest.raises(DeviceLost, match="plug it in"):
            box.silence()
