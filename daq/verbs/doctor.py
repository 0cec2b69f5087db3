"""`rtpiv doctor`: what this computer has, and what a bench still lacks."""

import ctypes.util
import importlib.util
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from rich.table import Table
from serial.tools import list_ports

from daq.acquisition.bench.bench_file import load_bench
from daq.acquisition.bench.bench_table import Bench
from daq.acquisition.cameras import LIBRARIES
from daq.acquisition.runs.run_folder import versions
from daq.example_files import examples
from daq.terminal import console
from daq.timing.timing_table import TimingTable
from daq.verbs.paths import Named
from stages.identities import confusable

PACKAGES = ("rtpiv", "ground", "tracer", "correction", "stages", "daq", "sim", "benchmarks")
GENTL_PATH = "GENICAM_GENTL64_PATH"

Finding = tuple[str, bool | None, str]  # what, fine / not fine / just so, words


def doctor(bench: Named | None = None) -> list[Finding]:
    """Look around without opening any device.

    Parameters
    ----------
    bench : path, optional
        A bench file whose ports and producer are looked for as well.

    Returns
    -------
    list of (str, bool or None, str)
        What was looked at, whether it is fine (None: a mere fact), and words.
    """
    found = [*_software(), *_serial_ports(), *_cameras(), *_disk()]
    if bench is not None:
        found += _bench(load_bench(bench))
    table = Table()
    for column in ("what", "", "found"):
        table.add_column(column)
    for what, fine, words in found:
        table.add_row(what, {True: "ok", False: "missing", None: ""}[fine], words)
    console().print(table)
    return found


def _software() -> Iterator[Finding]:
    for name, version in versions().items():
        yield name, None, version
    for name in PACKAGES:
        spec = importlib.util.find_spec(name)
        origin = Path(spec.origin).parent if spec and spec.origin else None
        own = Path(__file__).resolve().parents[2]
        places = [] if spec is None else list(spec.submodule_search_locations or ())
        fine = str(own / name) in places
        hidden = f"{origin} hides ours; start the program by `rtpiv`, or `import rtpiv` first"
        words = (
            (f"{own / name}" + (f", beside {spec.origin}" if spec and origin != own / name else ""))
            if fine
            else hidden
        )
        yield f"package {name}", fine, words


def _serial_ports() -> Iterator[Finding]:
    ports = list_ports.comports()
    if not ports:
        yield "serial ports", None, "none (ptys and network ports are not listed)"
    for port in ports:
        usable = os.access(port.device, os.R_OK | os.W_OK)
        cure = "" if usable else "; add the user to the group that owns it (often dialout)"
        what = (
            port.description if port.serial_number is None else f"{port.description}, serial {port.serial_number}"
        )
        yield f"port {port.device}", usable, f"{what}{cure}"


def _cameras() -> Iterator[Finding]:
    for name in LIBRARIES["harvesters"]:
        there = importlib.util.find_spec(name) is not None
        yield f"library {name}", there, "installed" if there else "install the extra rtpiv[camera]"
    folders = [Path(part) for part in os.environ.get(GENTL_PATH, "").split(os.pathsep) if part]
    producers = [path for folder in folders if folder.is_dir() for path in sorted(folder.glob("*.cti"))]
    words = ", ".join(map(str, producers)) or f"none in {GENTL_PATH}; a bench file may name one by its path"
    yield "GenTL producers", None, words
    library = ctypes.util.find_library("aravis-0.8")
    yield (
        "libaravis",
        library is not None,
        library or "for the aravis backend only: apt-get install libaravis-0.8-0",
    )


def _disk() -> Iterator[Finding]:
    usage = shutil.disk_usage(Path.cwd())
    yield "disk here", None, f"{usage.free / 1e9:.0f} GB free"
    yield "runs in", None, sys.prefix
    yield "examples in", None, str(examples())


def _bench(bench: Bench) -> Iterator[Finding]:
    for name, controller in bench.table.stages.controllers.items():
        yield _port(f"controller {name}", controller.driver, controller.port)
    for name, device in bench.more.items():
        if isinstance(device.section, TimingTable):
            yield _port(f"timing unit {name}", device.section.box, device.section.port)
    for words in confusable(bench.table.stages):
        yield "identity of the boxes", False, words
    producer = bench.table.camera.options.get("cti")
    if isinstance(producer, str):
        yield "camera's producer", Path(producer).is_file(), producer


def _port(what: str, driver: str, port: str) -> Finding:
    if "://" in port:
        return what, None, f"{driver} on {port}"
    there = Path(port).exists() and os.access(port, os.R_OK | os.W_OK)
    return what, there, f"{driver} on {port}" + ("" if there else ": not there, or no permission")
