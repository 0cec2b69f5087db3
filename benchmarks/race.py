"""Let contenders run in turn, one round after the other, each in its own process."""

import contextlib
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.child import child


@dataclass
class Racer:
    """One contender's process and its times [s]: wall clock and processor time of each round."""

    name: str
    process: subprocess.Popen[str]
    about: dict[str, Any]
    wall: dict[str, list[float]] = field(default_factory=dict)
    cpu: dict[str, list[float]] = field(default_factory=dict)

    def ask(self, line: str) -> str:
        """Send a line, wait for the answer."""
        assert self.process.stdin
        assert self.process.stdout
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline()

    def run(self, task: str) -> None:
        """Time one task once."""
        wall, cpu = map(float, self.ask(task).split())
        self.wall.setdefault(task, []).append(wall)
        self.cpu.setdefault(task, []).append(cpu)

    def ray_map(self) -> NDArray[np.float64]:
        """Its ray map (H, W, 2) [mm]."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "map.npy"
            self.ask(f"save {path}")
            return np.asarray(np.load(path))


def start(name: str, scene: str) -> Racer | None:
    """Start a contender and wait until it is warm; None, and a line that says why, if it is not installed."""
    command, environment = child("benchmarks.contenders", name, scene)
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, env=environment, text=True, **pipes)
    assert process.stdout
    word, _, rest = process.stdout.readline().partition(" ")
    if word != "ready":
        process.wait()
        print(f"{name} is left out: {rest.strip() or 'it stopped'}", file=sys.stderr)
        return None
    return Racer(name, process, json.loads(rest))


def race(racers: list[Racer], rounds: int) -> None:
    """Run every task of every contender `rounds` times, in turn A B C, A B C, ..."""
    for _ in range(rounds):
        for racer in racers:
            for task in racer.about["tasks"]:
                racer.run(task)


def stop(racers: list[Racer]) -> None:
    """Let the processes end."""
    for racer in racers:
        with contextlib.suppress(BrokenPipeError):
            assert racer.process.stdin
            racer.process.stdin.close()
        racer.process.wait()
