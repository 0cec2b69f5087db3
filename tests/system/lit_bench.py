"""A simulated bench with lamps as a process of its own, in real time: python -m tests.system.lit_bench FOLDER.

Reads FOLDER/bench.yaml.  Puts links for every device into FOLDER/links, ``ready`` when everything stands, and
writes every pulse of the timing unit with the system's clock into FOLDER/pulses.txt, until it is killed.
"""

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

from daq.bench.bench_file import load_bench
from daq.bench.opened import start_simulation
from sim import world
from tests.daq.flow_bench import ToldLight


def main(folder):
    world.LitFlow = ToldLight
    bench = load_bench(folder / "bench.yaml")
    section = {**(bench.table.simulation or {}), "transport": "pty"}
    bench = replace(bench, table=bench.table.model_copy(update={"simulation": section}))
    simulation = start_simulation(bench, world.FLOW)
    with (folder / "pulses.txt").open("w", buffering=1) as lines:
        (unit,) = simulation.world.timing
        unit.outputs.listen(lambda pulse: lines.write(f"{time.monotonic():.6f} {pulse.output}\n"))
        places = {name: table.port for name, table in simulation.sections["stages"].controllers.items()}
        places["laser"] = simulation.sections["laser"].port
        places["camera.cti"] = simulation.sections["camera"].options["cti"]
        for name, place in places.items():
            (folder / "links" / name).symlink_to(place)
        (folder / "links" / "ready").touch()
        parent = os.getppid()
        while os.getppid() == parent:  # a test that is ended takes it along
            time.sleep(0.1)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
