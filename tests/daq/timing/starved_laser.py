"""A laser that fires for 8 s while other programs have the computer: python -m tests.daq.timing.starved_laser.

Prints how often somebody was asked how things stand, the longest time that took, and `done` or why it went off.
An answer takes what one of a stage on a serial line takes: four waits of 2 ms and some arithmetic between them.
"""

import os
import subprocess
import sys
import threading
import time

from daq.errors import DaqError
from daq.timing.laser_head import LaserHead
from daq.timing.rules import Rules
from daq.timing.vigil import Vigil
from stages.clock import SYSTEM_CLOCK
from tests.daq.timing.armed_laser import GOOD, armed

EACH = 3  # programs a core
HOG = "import time\nend = time.monotonic() + 60\nwhile time.monotonic() < end: pass"
OURS, THEIRS = 14, 5  # niceness


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

    hogs = [subprocess.Popen([sys.executable, "-c", HOG]) for _ in range(EACH * (os.cpu_count() or 1))]
    what = "done"
    try:
        for hog in hogs:
            os.setpriority(os.PRIO_PROCESS, hog.pid, THEIRS)
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), OURS)  # the threads of the vigil inherit it
        laser.fire(80)
        with Vigil(laser, ask, clock, SYSTEM_CLOCK) as vigil:
            vigil.wait()
    except DaqError as error:
        what = str(error)
    finally:
        for hog in hogs:
            hog.kill()
    print(asked[0], f"{longest_s[0]:.3f}", what)


if __name__ == "__main__":
    main()
