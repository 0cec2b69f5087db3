"""A laser on a fake box, armed, and how things stand when all is well."""

from daq.timing.conditions import Conditions, Rules
from daq.timing.laser import Laser
from daq.timing.low_energy import LowEnergyRules
from daq.timing.pulses import LaserHead, PairExposures, PulseTiming
from sim.mechanics.clock import VirtualClock
from tests.daq.timing.fake_box import FakeBox

HEAD = LaserHead(max_rate_hz=15.0, lamp_to_q_switch_us=[180.0, 185.0])
RULES = Rules(warmup_s=60.0, align=LowEnergyRules(q_switch_delay_us=80.0))
EXPOSURES = PairExposures(100.0, 20_000.0, 2.0)
TIMING = PulseTiming(20.0, 10.0)
GOOD = Conditions(True, True, True, 5.0, 1000)


def laser_on(clock=None, head=HEAD, rules=RULES):
    clock = clock or VirtualClock()
    box = FakeBox(clock)
    laser = Laser("laser", box, head, rules, clock)
    laser.open("fake://")
    return laser, box, clock


def ready(clock=None, **options):
    laser, box, clock = laser_on(clock, **options)
    laser.warm(10.0)
    clock.sleep_s(laser.warm_in_s + 1e-3)
    laser.set(TIMING, EXPOSURES)
    return laser, box, clock


def armed(clock=None, **options):
    laser, box, clock = ready(clock, **options)
    laser.arm(GOOD, laser.challenge)
    return laser, box, clock


def conditions_with(**changes):
    values = {field: getattr(GOOD, field) for field in GOOD.__dataclass_fields__}
    return Conditions(**{**values, **changes})
