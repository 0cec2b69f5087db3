"""A program that fires chunk after chunk: python -m tests.system.laser_client PORT BOX LAMPS PAIRS RATE_HZ."""

import os
import sys

from daq.timing.conditions import Conditions
from daq.timing.opened import open_laser
from daq.timing.pulses import LaserHead, PairExposures, PulseTiming
from daq.timing.supervisor import LaserSupervisor
from daq.timing.timing_table import TimingTable
from stages.clock import SYSTEM_CLOCK

GOOD = Conditions(True, True, True, 5.0, 10_000)
WIRED = {"q_switch_1": "B", "q_switch_2": "D", "camera": "E"}
LAMPS = {"lamp_1": "A", "lamp_2": "C"}
PIVLAB = {"q_switch_1": "2", "camera": "1"}


def table(port, box, has_lamps, rate_hz):
    head = LaserHead(max_rate_hz=rate_hz, warmup_s=0.0, lamp_to_q_switch_us=[180.0, 182.0] if has_lamps else None)
    wired = PIVLAB if box.startswith("pivlab") else WIRED | (LAMPS if has_lamps else {})
    uncounted = {"uncounted": True, "identity": "oltSync:0012"} if box.startswith("pivlab") else {}
    return TimingTable(box=box, port=port, channels=wired, head=head, **uncounted)


def main():
    port, box, has_lamps, pairs, rate_hz = sys.argv[1:]
    with open_laser(table(port, box, has_lamps == "lamps", float(rate_hz))) as laser:
        print("open", laser.box.watchdog.pid, os.getpid(), flush=True)
        laser.warm(float(rate_hz))
        exposures = PairExposures(500.0, 2_000.0, 2.0, two_triggers=False)
        laser.set(PulseTiming(100.0, float(rate_hz)), exposures)
        while True:
            laser.arm(GOOD, laser.challenge)
            laser.fire(int(pairs))
            print("fires", flush=True)
            with LaserSupervisor(laser, lambda: GOOD, SYSTEM_CLOCK, SYSTEM_CLOCK) as supervisor:
                supervisor.wait()
            print("done", flush=True)


if __name__ == "__main__":
    main()
