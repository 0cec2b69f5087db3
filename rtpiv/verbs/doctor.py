"""`rtpiv doctor`: check software, serial ports and cameras, and what a bench file still lacks."""

import importlib.util
import json
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from daq.bench.bench_file import load_bench
from daq.bench.bench_table import Bench, CameraSection
from daq.bench.elements import CAMERA
from daq.bench.kinds import KINDS
from daq.bench.surroundings import (
    GENTL_PATH,
    INSTALLED,
    SerialPort,
    UsbCamera,
    missing_for,
    producers,
    serial_ports,
    usb_cameras,
    why_not,
)
from daq.cameras import BACKENDS
from daq.errors import BenchLacks
from daq.runs.run_folder import versions
from daq.timing.drivers_by_name import DRIVERS as TIMING_UNITS
from daq.timing.timing_table import TimingTable
from ground.terminal import console
from rtpiv.analysis.report.table import ALL_COLUMNS, Table
from rtpiv.example_files import examples
from rtpiv.verbs.paths import Named
from stages.controller_tables import ControllerTable, HandTable
from stages.drivers_by_name import DRIVERS
from stages.identities import confusable

PACKAGES = ("rtpiv", "ground", "piv", "tracer", "correction", "stages", "daq", "sim")
EXAMPLE_ADDRESS = "192.168.10.8"
EXAMPLE_PRODUCER = "/the/vendors/producer.cti"
NO_DRIVER = "YOURS"  # `rtpiv check` lists the drivers when it finds this one
STATES = {True: "ok", False: "missing", None: ""}

Finding = tuple[str, bool | None, str]  # item; present, missing or a mere fact; text


def doctor(bench: Named | None = None) -> list[Finding]:
    """Check this computer without opening any device, and print lines of a bench file for what is connected.

    Nothing is sent, on no network either: cameras with an address are opened by it.

    Parameters
    ----------
    bench : path, optional
        Bench file whose ports, libraries and producers are checked as well.

    Returns
    -------
    list of (str, bool or None, str)
        Each item that was checked, whether it is present (None: a mere fact), and a text.

    Raises
    ------
    BenchLacks
        Something that the bench needs is missing; its `findings` are all that was checked.
    """
    ports, cameras, files = serial_ports(), usb_cameras(), producers()
    here = [*_software(), *_devices_here(ports, cameras, files), *_drivers(), *_disk()]
    needed = [] if bench is None else list(_bench(load_bench(bench)))
    found = [*here, *needed]
    screen, rows = console(), [(what, STATES[fine], words) for what, fine, words in found]
    screen.print(Table("", ("item", "", "found"), rows, left=ALL_COLUMNS))
    if bench is None:
        screen.print("Lines for a bench file (docs/add-a-device.md); use those whose device you recognise:\n")
        screen.print(bench_lines(ports, cameras, files), soft_wrap=True)
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


def _devices_here(ports: list[SerialPort], cameras: list[UsbCamera], files: list[Path]) -> Iterator[Finding]:
    """Serial ports, cameras on USB and GenTL producers."""
    if not ports:
        yield "serial ports", None, "none (pseudo-terminals and network ports are not listed)"
    for port in ports:
        yield f"port {port.path}", port.trouble is None, port.trouble or port.words or "no description"
    for camera in cameras:
        words = f"{camera.vendor} {camera.model}, serial {camera.serial}"
        yield "USB3 Vision camera", camera.trouble is None, camera.trouble or words
    yield "cameras on a network", None, "not searched, as discovery is a broadcast; give their address"
    none = f"none in {GENTL_PATH} or below {INSTALLED}; a bench file may name one by its path"
    yield "GenTL producers", None, ", ".join(map(str, files)) or none


def _drivers() -> Iterator[Finding]:
    """Drivers of each kind of device, and whether their libraries are installed."""
    yield "stage drivers", True, ", ".join(DRIVERS)
    lacks = missing_for("micromanager")  # the same core as of cameras
    yield "stage driver micromanager", lacks is None, lacks or "installed"
    yield "stage driver positioners", True, "your own objects with set, stop and position"
    for backend in BACKENDS:
        lacks = missing_for(backend)
        yield f"camera backend {backend}", lacks is None, lacks or "installed"
    yield "timing units", True, f"box: {', '.join(TIMING_UNITS)}"
    for kind, dotted in KINDS.items():
        if kind not in ("stage", "camera", "timing"):
            yield f"kind {kind}", None, dotted


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
    """Missing parts of a camera's backend, and of its producer at the path in the bench file."""
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


def bench_lines(ports: list[SerialPort], cameras: list[UsbCamera], files: list[Path]) -> str:
    """Return the lines of a bench file that open these devices."""
    return "\n".join(_lines(ports, cameras, files))


def _lines(ports: list[SerialPort], cameras: list[UsbCamera], files: list[Path]) -> Iterator[str]:
    yield "stages:"
    yield "  controllers:"
    for number, port in enumerate(ports, 1):
        name = f"{port.driver or 'box'}_{number}"
        remark = "" if port.driver else f"  # one of {', '.join(DRIVERS)}"
        yield f"    {name}: {{driver: {port.driver or NO_DRIVER}, port: {_as_text(port.path)}}}{remark}"
    if not ports:
        yield f"    box_1: {{driver: {NO_DRIVER}, port: /dev/serial/by-id/...}}  # one of {', '.join(DRIVERS)}"
    yield "# a timing unit may be connected to such a port too: docs/laser.md"
    yield "camera:"
    if files or cameras:
        producer = str(files[0]) if files else EXAMPLE_PRODUCER
        serial = cameras[0].serial if cameras else "..."
        yield "  backend: harvesters"
        yield f"  options: {{cti: {_as_text(producer)}, serial: {_as_text(serial, alfiles=True)}}}"
        yield from (f"  # or cti: {_as_text(str(file))}" for file in files[1:])
        yield from (f"  # or serial: {_as_text(camera.serial, alfiles=True)}" for camera in cameras[1:])
        yield "  # USB3 also by backend aravis, options {device_id: ...}; arv-tool-0.8 lists the ids"
    else:
        yield "  backend: aravis"
        yield f"  options: {{address: {EXAMPLE_ADDRESS}}}  # of the camera; or backend: harvesters and its cti"


def _as_text(text: str, alfiles: bool = False) -> str:
    """Return text that YAML reads as a string."""
    return text if not alfiles and re.fullmatch(r"[/\w.+-]+", text) else json.dumps(text)
