"""Programs that hold a simulated bench over device files; the world lives on in the test when they are killed."""

import json
import os
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

from sim.mechanics.clock import ScaledClock
from sim.stages import SimulatedStages
from tests.stages.benches import screws, stages_table

HASTE = 100.0  # speed of the world while a child homes
FAR_MM = 110.0  # five seconds away
MOVE = f"stage.move({{'a': {FAR_MM}}})"
CHILD = """
import json, sys, time
from stages.config import StagesTable
from stages.stage import Stage

def said(word):
    print(word, flush=True)

table = StagesTable.model_validate(json.loads(sys.argv[1]))
with Stage.open(table) as stage:
    stage.home()
    stage.move({"a": 10.0, "b": 10.0})
    said("ready")
    sys.stdin.readline()
    exec(sys.argv[2])
"""


class World:
    """The stages of a driver behind a device file, and the truth about them."""

    def __init__(self, driver, table, world, offered):
        self.driver, self.table, self.world, self.offered = driver, table, world, offered

    def true_mm(self, axis="a"):
        return self.world.true_mm(axis)

    def running(self):
        self.true_mm()
        return any(motor.running for motor in self.world.motors.values())

    def wait_until(self, what, patience_s=60.0):
        end_s = time.monotonic() + patience_s
        while not what():
            assert time.monotonic() < end_s, "it did not happen"
            time.sleep(0.002)

    def rest_mm(self, axis="a"):
        """Wait until nothing has moved for a while; where the axis is then."""
        since_s, last_mm = time.monotonic(), self.true_mm(axis)
        end_s = since_s + 60.0
        while time.monotonic() - since_s < 0.4:
            assert time.monotonic() < end_s, "it does not come to rest"
            time.sleep(0.01)
            here_mm = self.true_mm(axis)
            if self.running() or here_mm != last_mm:
                since_s, last_mm = time.monotonic(), here_mm
        return last_mm

    def start(self, code, **options):
        """Start a program that homes in haste and then waits for a line; the world goes on in real time."""
        command = [sys.executable, "-c", CHILD, json.dumps(self.offered.model_dump(exclude_unset=True)), code]
        self.world.clock.set_speed(HASTE)
        child = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env=os.environ | {"PYTHONFAULTHANDLER": ""}, **options,
        )  # fmt: skip
        assert read_line(child) == "ready\n"
        self.world.clock.set_speed(1.0)
        return child

    def start_motion(self, code=MOVE, **options):
        """Start a program, and return it when its axis has gone 3 mm."""
        child = self.start(code, **options)
        begun_mm = self.true_mm()
        go(child)
        self.wait_until(lambda: abs(self.true_mm() - begun_mm) > 3.0)
        return child


@contextmanager
def served(driver, **changes):
    """Serve two axes of a driver on a device file."""
    table = stages_table(driver, **changes)
    world = SimulatedStages(table, ScaledClock(1.0), screws(table))
    with world.serve() as offered:
        yield World(driver, table, world, offered)


def go(child):
    """Let a child do what it was started for."""
    child.stdin.write("\n")
    child.stdin.flush()


def read_line(child, patience_s=60.0):
    """Return the next line that a child prints; a child that prints none in time is killed, and the test fails."""
    late = threading.Timer(patience_s, child.kill)
    late.start()
    try:
        line = child.stdout.readline()
    finally:
        late.cancel()
    assert line, f"the child printed no line within {patience_s:g} s, or ended: {end(child)[2]}"
    return line


def end(child):
    """Take a child's exit status and what it said, whatever it was doing."""
    if child.poll() is None:
        child.kill()
    out, errors = child.communicate(timeout=60)
    return child.returncode, out, errors
