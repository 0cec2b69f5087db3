"""A timing unit as a process of its own: python -m tests.system.timing_box LINK LOG [BOX].

Puts a pseudo-terminal up under LINK and writes every pulse with the system's clock into LOG, until it is killed.
"""

import os
import sys
import time
from pathlib import Path

from sim.emulators.line import Line
from sim.emulators.pty import PtyPort
from sim.mechanics.clock import ScaledClock
from sim.timing import emulator_of


def main():
    link, log, box = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    clock = ScaledClock()
    emulator = emulator_of(box)(clock)
    with log.open("w", buffering=1) as lines, PtyPort(Line(emulator, clock)) as port:
        emulator.outputs.listen(lambda pulse: lines.write(f"{time.monotonic():.6f} {pulse.output}\n"))
        link.symlink_to(port.path)
        parent = os.getppid()
        while os.getppid() == parent:  # a test that is ended takes it along
            time.sleep(0.2)


if __name__ == "__main__":
    main()
