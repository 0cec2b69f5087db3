"""`rtpiv bench emulate`: run the simulated bench for other programs."""

import time
from dataclasses import replace
from typing import Literal

from daq.bench.bench_file import load_bench
from daq.bench.bench_table import Bench
from daq.bench.kinds import kind_of
from daq.bench.opened import start_simulation
from ground.terminal import console
from rtpiv.options.numbers import Positive
from rtpiv.verbs.paths import Named


def emulate(
    bench: Named,
    /,
    shows: Literal["chessboard", "particles", "flow"] = "chessboard",
    for_s: Positive | None = None,
) -> None:
    """Put the simulated bench up on device files and a GenTL producer, until Ctrl-C.

    Parameters
    ----------
    bench : path
        bench.yaml with a simulation section.
    shows : str
        Object on the stage of the target, or the flow.
    for_s : float, optional
        Stop after this time.
    """
    screen = console()
    loaded = _in_real_time(load_bench(bench))
    simulation = start_simulation(loaded, shows)
    try:
        for name, device in loaded.devices.items():
            for place in kind_of(device.kind).places(simulation.sections[name]):
                screen.print(place, soft_wrap=True)
        screen.print("Ctrl-C ends it")
        end_s = None if for_s is None else time.monotonic() + for_s
        while end_s is None or time.monotonic() < end_s:
            time.sleep(0.1)
    except KeyboardInterrupt:
        screen.print("ended")
    finally:
        simulation.close()


def _in_real_time(bench: Bench) -> Bench:
    """Other programs need device files, and know no clock but the wall's."""
    section = {**(bench.table.simulation or {}), "transport": "pty", "speed": 1.0}
    return replace(bench, table=bench.table.model_copy(update={"simulation": section}))
