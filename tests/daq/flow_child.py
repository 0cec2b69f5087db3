"""Acquire a flow in a process of its own, to be killed: python -m tests.daq.flow_child BENCH PLAN OUT."""

import sys
from pathlib import Path

from rtpiv.verbs.acquire import LiveFrames, acquire
from sim import world
from tests.daq.flow_bench import ToldLight


def main() -> None:
    """Acquire."""
    bench, plan, out = (Path(argument) for argument in sys.argv[1:])
    world.LitFlow = ToldLight  # type: ignore[misc]
    acquire(plan, bench, out, simulate=True, home=True, frames=LiveFrames(correct=False), operator="test")


if __name__ == "__main__":
    main()
