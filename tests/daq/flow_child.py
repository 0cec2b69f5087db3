"""Acquire a flow in a process of its own, to be killed: python -m tests.daq.flow_child BENCH PLAN OUT."""

import sys
from pathlib import Path

from sim import world
from tests.daq.flow_bench import ToldLight, acquire_simulated


def main() -> None:
    """Acquire."""
    bench, plan, out = (Path(argument) for argument in sys.argv[1:])
    world.LitFlow = ToldLight  # type: ignore[misc]
    acquire_simulated(plan, bench, out)


if __name__ == "__main__":
    main()
