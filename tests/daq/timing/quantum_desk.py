"""A Quantum Composers box on a line in memory, with its laser, as several tests have it on the desk."""

from contextlib import contextmanager

from daq.timing.conditions import Conditions, Rules
from daq.timing.drivers.quantum_composers import QuantumComposersBox
from daq.timing.laser import Laser
from daq.timing.pulses import LaserHead, PairExposures, PulseTiming, Role
from daq.timing.states import LaserState
from sim.emulators.faults import FaultSchedule
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.mechanics.clock import VirtualClock
from sim.timing_boxes.quantum_composers import QuantumComposersEmulator, Variant

WIRING = {
    Role.LAMP_1: "A", Role.Q_SWITCH_1: "B", Role.LAMP_2: "C", Role.Q_SWITCH_2: "D", Role.CAMERA: "E",
    Role.MARKER: "F",
}  # fmt: skip
PUMPED = {Role.Q_SWITCH_1: "A", Role.Q_SWITCH_2: "B", Role.CAMERA: "C", Role.CAMERA_B: "D"}
HEAD = LaserHead(max_rate_hz=15.0, lamp_to_q_switch_us=[180.0, 185.0])
EXPOSURES = PairExposures(100.0, 20_000.0, 2.0)
GOOD = Conditions(True, True, True, 5.0, 1000)


class Desk:
    """A box on a line in memory, and a laser."""

    def __init__(self, wiring=WIRING, head=HEAD, faults=(), **firmware):
        self.clock = VirtualClock()
        self.emulator = QuantumComposersEmulator(self.clock, Variant(**firmware))
        self.line = Line(self.emulator, self.clock, FaultSchedule(faults))
        self.box = QuantumComposersBox("laser", wiring, self.clock)
        self.laser = Laser("laser", self.box, head, Rules(warmup_s=1.0), self.clock)

    def to_ready(self, dt_us=20.0, rate_hz=10.0, exposures=EXPOSURES):
        self.laser.open("sim://desk")
        if self.laser.state is LaserState.UNKNOWN:
            self.laser.safe()
        self.laser.warm(rate_hz)
        self.clock.sleep_s(1.1)
        self.laser.set(PulseTiming(dt_us, rate_hz), exposures)

    def to_armed(self, dt_us=20.0, rate_hz=10.0, exposures=EXPOSURES):
        self.to_ready(dt_us, rate_hz, exposures)
        self.laser.arm(GOOD, self.laser.challenge)

    def firing(self, pairs=50, after_s=1.0):
        """Arm, fire, and let some time pass."""
        self.to_armed()
        self.laser.fire(pairs)
        self.clock.sleep_s(after_s)

    def burst(self, pairs=5):
        self.to_armed()
        self.laser.fire(pairs)
        self.laser.wait()

    def pulses(self, role):
        self.emulator.advance()
        return self.emulator.outputs.count[self.box.wiring[role]]


@contextmanager
def desk(**options):
    made = Desk(**options)
    LINES["desk"] = made.line
    try:
        yield made
    finally:
        LINES.pop("desk")
