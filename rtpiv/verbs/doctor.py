"""`rtpiv doctor`: what this computer has, and what a bench still lacks."""

import importlib.util
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from rich.table import Table

from daq.bench.bench_file import load_bench
from daq.bench.bench_table import Bench, CameraSection
from daq.bench.elements import CAMERA
from daq.bench.surroundings import (
    GENTL_PATH,
    INSTALLED,
    missing_for,
    producers,
    serial_ports,
    usb_cameras,
    why_not,
)
from daq.cameras import BACKENDS
from daq.errors import BenchLacks
from daq.runs.run_folder import versions
from daq.timing.timing_table import TimingTable
from ground.terminal import console
from rtpiv.example_files import examples
from rtpiv.verbs.paths import Named
from stages.controller_tables import ControllerTable, HandTable
from stages.identities import confusable

PACKAGES = ("rtpiv", "ground", "piv", "tracer", "correction", "stages", "daq", "sim")

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

    Raises
    ------
    BenchLacks
        Something that the bench needs is missing; its `findings` are all that was looked at.
    """
    here = [*_software(), *_serial_ports(), *_cameras(), *_disk()]
    needed = [] if bench is None else list(_bench(load_bench(bench)))
    found = [*here, *needed]
    table = Table()
    for column in ("what", "", "found"):
        table.add_column(column)
    for what, fine, words in found:
        table.add_row(what, {True: "ok", False: "missing", None: ""}[fine], words)
    console().print(table)
    lacking = [what for what, fine, _ in needed if fine is False]
    if lacking:
        raise BenchLacks(f"{bench} needs what is missing here: {', '.join(lacking)}; see above", found)
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
    ports = serial_ports()
    if not ports:
        yield "serial ports", None, "none (ptys and network ports are not listed)"
    for port in ports:
        yield f"port {port.path}", port.trouble is None, port.trouble or port.words


def _cameras() -> Iterator[Finding]:
    for backend in BACKENDS:
        missing = missing_for(backend)
        yield f"camera backend {backend}", missing is None, missing or "installed"
    words = (
        ", ".join(map(str, producers()))
        or f"none in {GENTL_PATH} or below {INSTALLED}; a bench file may name one by its path"
    )
    yield "GenTL producers", None, words
    for camera in usb_cameras():
        words = f"{camera.vendor} {camera.model}, serial {camera.serial}"
        yield "USB3 Vision camera", camera.trouble is None, camera.trouble or words


def _disk() -> Iterator[Finding]:
    usage = shutil.disk_usage(Path.cwd())
    yield "disk here", None, f"{usage.free / 1e9:.0f} GB free"
    yield "runs in", None, sys.prefix
    yield "examples in", None, str(examples())


def _bench(bench: Bench) -> Iterator[Finding]:
    for name, controller in bench.table.stages.controllers.items():
        if isinstance(controller, ControllerTable):
            yield _port(f"controller {name}", controller.driver, controller.port)
        elif isinstance(controller, HandTable):
            yield f"controller {name}", None, f"{controller.driver}: {controller.place}"
        else:
            lacks = controller.beside(bench.path.parent).lacks()
            yield f"controller {name}", lacks is None, lacks or f"{controller.driver}: {controller.place}"
    sections = {CAMERA: bench.table.camera} | {name: device.section for name, device in bench.more.items()}
    for name, section in sections.items():
        if isinstance(section, TimingTable):
            yield _port(f"timing unit {name}", section.box, section.port)
            for what, switch in section.switches.items():
                if switch.port is not None:
                    yield _port(f"switch {what} of {name}", str(switch.line), switch.port)
        elif isinstance(section, CameraSection):
            yield from _camera(name, section)
    for words in confusable(bench.table.stages):
        yield "identity of the boxes", False, words


def _port(what: str, driver: str, port: str) -> Finding:
    if "://" in port:
        return what, None, f"{driver} on {port}"
    trouble = why_not(Path(port))
    return what, trouble is None, trouble or f"{driver} on {port}"


def _camera(name: str, section: CameraSection) -> Iterator[Finding]:
    """What its backend lacks, and whether its producer is where the bench file says."""
    what = "camera" if name == CAMERA else f"camera {name}"
    missing = None if "core" in section.options else missing_for(section.backend)
    yield what, missing is None, missing or f"by {section.backend}"
    adapters = section.options.get("adapters")
    if isinstance(adapters, str):
        there = Path(adapters).is_dir()
        yield f"{what}'s adapters", there, adapters if there else f"there is no folder {adapters}"
    producer = section.options.get("cti")
    if isinstance(producer, str):
        there = Path(producer).is_file()
        cure = f"there is no {producer}; install the vendor's, or give the path of one in {GENTL_PATH}"
        yield f"{what}'s producer", there, producer if there else cure
