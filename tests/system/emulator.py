"""A simulated bench in a process of its own, on device files and a camera with fixed names, until it is killed.

    python -m tests.system.emulator BENCH FOLDER SHOWS SPEED EXPOSURES_BEFORE

FOLDER gets a link for every controller and for the camera's producer, so that a bench file which names these finds
the bench again after it was killed and started anew; ``ready`` appears in it when everything stands.
"""

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

from daq.bench.bench_file import load_bench
from daq.bench.opened import start_simulation


def main(bench_path: str, folder: str, shows: str, speed: str, exposures_before: str) -> None:
    bench = load_bench(Path(bench_path))
    section = {**(bench.table.simulation or {}), "transport": "pty", "speed": float(speed)}
    bench = replace(bench, table=bench.table.model_copy(update={"simulation": section}))
    simulation = start_simulation(bench, shows, int(exposures_before))
    places = {name: table.port for name, table in simulation.sections["stages"].controllers.items()}
    places["camera.cti"] = str(simulation.sections["camera"].options["cti"])
    for name, place in places.items():
        link = Path(folder) / name
        link.unlink(missing_ok=True)
        link.symlink_to(place)
    (Path(folder) / "ready").touch()
    parent = os.getppid()
    while os.getppid() == parent:  # a test that is ended takes it along
        time.sleep(0.1)


if __name__ == "__main__":
    main(*sys.argv[1:])
