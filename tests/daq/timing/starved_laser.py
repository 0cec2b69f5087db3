"""A laser that fires for 8 s while the computer has no time for us: python -m tests.daq.timing.starved_laser.

Prints how often the conditions were asked for, the longest time that took, and `done` or why it went off.  An
answer takes what one of a stage on a serial line takes: four waits of 2 ms and some arithmetic between them.
Another process halts this one for 0.6 s again and again, with 4 ms between, which busy programs never do for sure.
"""

import os
import subprocess
import sys
import time

from daq.errors import DaqError
from daq.timing.conditions import Rules
from daq.timing.pulses import LaserHead
from daq.timing.supervisor import LaserSupervisor
from stages.clock import SYSTEM_CLOCK
from tests.daq.timing.armed_laser import GOOD, armed

TAKER = """
import os, signal, sys, time
signal.signal(signal.SIGTERM, lambda *_: sys.exit())
pid, end = int(sys.argv[1]), time.monotonic() + 60
try:
    while time.monotonic() < end and os.getppid() == pid:
        os.kill(pid, signal.SIGSTOP)
        time.sleep(0.6)
        os.kill(pid, signal.SIGCONT)
        time.sleep(0.004)
finally:
    os.kill(pid, signal.SIGCONT)
"""


def main():
    laser, _, clock = armed(SYSTEM_CLOCK, rules=Rules(warmup_s=0.0), head=LaserHead(max_rate_hz=1000.0))
    longest_s, asked = [0.0], [0]

    def ask():
        begun_s = time.monotonic()
        for _ in range(4):
            time.sleep(0.002)
            sum(range(20_000))
        asked[0] += 1
        longest_s[0] = max(longest_s[0], time.monotonic() - begun_s)
        return GOOD

    what = "done"
    laser.fire(80)
    taker = subprocess.Popen([sys.executable, "-c", TAKER, str(os.getpid())])
    try:
        with LaserSupervisor(laser, ask, clock, SYSTEM_CLOCK) as supervisor:
            supervisor.wait()
    except DaqError as error:
        what = str(error)
    finally:
        taker.terminate()
        taker.wait()
    print(asked[0], f"{longest_s[0]:.3f}", what)


if __name__ == "__main__":
    main()
