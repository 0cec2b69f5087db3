"""A bench on device files whose world lives in the test: programs may be stopped and killed, the truth stays."""

import os
import re
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

from daq.bench.bench_file import load_bench
from sim.bench_table import SimulationTable
from sim.mechanics.clock import ScaledClock
from sim.stages import SimulatedStages
from tests.daq.small_bench import FILES_CAMERA, write_bench

HASTE = 150.0  # speed of the world while nothing is to be seen


class Served:
    """A bench file in a folder, its device files served by this process."""

    def __init__(self, folder, path, world, clock):
        self.folder, self.path, self.world, self.clock = folder, path, world, clock
        self._started = []

    def true_mm(self, axis):
        return self.world.true_mm(axis)

    def wait_until(self, what, patience_s=120.0):
        end_s = time.monotonic() + patience_s
        while not what():
            assert time.monotonic() < end_s, "it did not happen"
            time.sleep(0.002)

    def running(self):
        for axis in self.world.motors:
            self.true_mm(axis)
        return [axis for axis, motor in self.world.motors.items() if motor.running]

    def rests(self, quiet_s=0.5):
        """Wait until nothing has moved for a while."""
        since_s = time.monotonic()
        end_s = since_s + 120.0
        while time.monotonic() - since_s < quiet_s:
            assert time.monotonic() < end_s, f"{self.running()} do not come to rest"
            if self.running():
                since_s = time.monotonic()
            time.sleep(0.005)

    def start(self, *arguments, **options):
        """Start a verb of the command line in the folder."""
        command = [sys.executable, "-u", "-m", "rtpiv.command_line.cli", *map(str, arguments)]
        environment = os.environ | {"TMPDIR": str(self.folder), "COLUMNS": "200"}
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        process = subprocess.Popen(command, cwd=self.folder, env=environment, text=True, **pipes | options)
        self._started.append(process)
        return process

    def close(self):
        """End every program that was started, whatever it is doing."""
        for process in self._started:
            process.kill()
            process.wait(60)
            for pipe in filter(None, (process.stdin, process.stdout, process.stderr)):
                pipe.close()

    def run(self, *arguments, lines=""):
        """Run a verb to its end in haste; exit code, output, errors."""
        self.clock.set_speed(HASTE)
        process = self.start(*arguments)
        out, errors = process.communicate(lines, timeout=300)
        self.clock.set_speed(1.0)
        return process.returncode, out, errors


@contextmanager
def served_bench(folder, change=lambda text: text, camera=FILES_CAMERA):
    """Serve the example bench; `change` may edit its file first."""
    path = write_bench(folder, camera=camera, is_brisk=False)
    path.write_text(change(path.read_text()))
    bench = load_bench(path)
    simulation = SimulationTable.model_validate(bench.table.simulation)
    firmware = {
        name: {"settings": {int(number): value for number, value in settings.items()}}
        for name, settings in simulation.firmware.items()
    }
    clock = ScaledClock(1.0)
    world = SimulatedStages(bench.table.stages, clock, simulation.axes, firmware)
    with world.serve() as offered:
        text = path.read_text()
        for name, table in offered.controllers.items():
            text = re.sub(rf"(    {name}: \{{driver: \w+, port: )[^,}}]+", rf"\g<1>{table.port}", text)
        path.write_text(text)
        served = Served(folder, path, world, clock)
        try:
            yield served
        finally:
            served.close()


def end(process):
    """Take a program's exit status and what it said, whatever it was doing."""
    if process.poll() is None:
        process.kill()
    out, errors = process.communicate(timeout=60)
    return process.returncode, out, errors


def children_of(number):
    """Processes that a process has started, from the system's own table."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal():
            try:
                fields = (folder / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) == number:
                found.append(int(folder.name))
    return found


def ends(number, within_s=20.0):
    """Whether a process is gone before long."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        try:
            if (Path("/proc") / str(number) / "stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except OSError:
            return True
        time.sleep(0.05)
    return False
