"""`rtpiv devices`: what can be opened from here, and the lines of a bench file that do it."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from daq.bench.kinds import KINDS
from daq.bench.surroundings import (
    SerialPort,
    UsbCamera,
    missing_for,
    producers,
    serial_ports,
    usb_cameras,
)
from daq.cameras import BACKENDS
from daq.timing.drivers_by_name import DRIVERS as TIMING_UNITS
from ground.terminal import console
from stages.drivers_by_name import DRIVERS

ADDRESS = "192.168.10.8"  # of an example
PRODUCER = "/the/vendors/producer.cti"
NOBODY = "YOURS"  # a driver that there is not: `rtpiv check` names those there are


@dataclass(frozen=True, slots=True)
class Devices:
    """What was found, without opening any of it."""

    ports: list[SerialPort]
    cameras: list[UsbCamera]
    producers: list[Path]
    lines: str  # of a bench file


def devices() -> Devices:
    """Look for what can be opened: serial ports, cameras on USB, GenTL producers, and who could drive them.

    Nothing is opened and nothing is sent, on no network either: cameras with an address are opened by it.

    Returns
    -------
    Devices
        What is there, and the lines to paste into a bench file.
    """
    ports, cameras, ways = serial_ports(), usb_cameras(), producers()
    found = Devices(ports, cameras, ways, "\n".join(_lines(ports, cameras, ways)))
    screen = console()
    screen.print(_plugged_in(found))
    screen.print(_drivers())
    screen.print("Lines for a bench file (docs/add-a-device.md); take those that you know the names of:\n")
    screen.print(found.lines, soft_wrap=True)
    return found


def _plugged_in(found: Devices) -> Table:
    table = Table(title="plugged in")
    for column in ("what", "", "found"):
        table.add_column(column, overflow="fold")
    for port in found.ports:
        words = port.words or "tells nothing of itself"
        table.add_row(f"port {port.path}", _word(port.trouble), port.trouble or words)
    for camera in found.cameras:
        words = f"{camera.vendor} {camera.model}, serial {camera.serial}"
        table.add_row("USB3 Vision camera", _word(camera.trouble), camera.trouble or words)
    for producer in found.producers:
        table.add_row("GenTL producer", "ok", str(producer))
    if not found.ports:
        table.add_row("ports", "", "none (pseudo-terminals and network ports are not listed)")
    table.add_row("cameras on a network", "", "not looked for: discovery is a broadcast; give their address")
    return table


def _drivers() -> Table:
    """Who could drive what, and whether what they need is installed."""
    table = Table(title="kinds of devices")
    for column in ("kind", "by", "", "needs"):
        table.add_column(column, overflow="fold")
    table.add_row("stage", f"driver: {', '.join(DRIVERS)}", "ok", "")
    lacks = missing_for("micromanager")  # the same core as of cameras
    table.add_row("stage", "driver: micromanager", _word(lacks), lacks or "")
    table.add_row("stage", "driver: positioners", "ok", "your own objects with set, stop and position")
    for backend in BACKENDS:
        missing = missing_for(backend)
        table.add_row("camera", f"backend: {backend}", _word(missing), missing or "")
    table.add_row("reading", "file or port", "ok", "")
    table.add_row("timing", f"box: {', '.join(TIMING_UNITS)}", "ok", "")
    for kind, dotted in KINDS.items():
        if kind not in ("stage", "camera", "timing", "reading"):
            table.add_row(kind, dotted, "", "")
    return table


def _word(trouble: str | None) -> str:
    return "ok" if trouble is None else "missing"


def _lines(ports: list[SerialPort], cameras: list[UsbCamera], ways: list[Path]) -> Iterator[str]:
    yield "stages:"
    yield "  controllers:"
    for number, port in enumerate(ports, 1):
        name = f"{port.driver or 'box'}_{number}"
        remark = "" if port.driver else f"  # one of {', '.join(DRIVERS)}"
        yield f"    {name}: {{driver: {port.driver or NOBODY}, port: {_quoted(port.path)}}}{remark}"
    if not ports:
        yield f"    box_1: {{driver: {NOBODY}, port: /dev/serial/by-id/...}}  # one of {', '.join(DRIVERS)}"
    yield "# a timing unit hangs on such a port too: docs/laser.md"
    yield "camera:"
    if ways or cameras:
        way = str(ways[0]) if ways else PRODUCER
        serial = cameras[0].serial if cameras else "..."
        yield "  backend: harvesters"
        yield f"  options: {{cti: {_quoted(way)}, serial: {_quoted(serial, always=True)}}}"
        yield from (f"  # or cti: {_quoted(str(way))}" for way in ways[1:])
        yield from (f"  # or serial: {_quoted(camera.serial, always=True)}" for camera in cameras[1:])
        yield "  # USB3 also by backend aravis, options {device_id: ...}; arv-tool-0.8 lists the ids"
    else:
        yield "  backend: aravis"
        yield f"  options: {{address: {ADDRESS}}}  # of the camera; or backend harvesters with the vendor's cti"


def _quoted(text: str, always: bool = False) -> str:
    """Text as YAML takes it for text, whatever stands in it."""
    return text if not always and re.fullmatch(r"[/\w.+-]+", text) else json.dumps(text)
