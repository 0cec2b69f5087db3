"""Devices of a bench that could be opened from this computer, found without opening any or asking the network.

Serial ports are listed by the system, with what their USB plug says of itself. Cameras with USB3 Vision are
recognised by the class of their interface, as any driver does. Cameras on a network answer to discovery only, a
broadcast that disturbs those that work already; they are opened by address, so here they are not looked for.
"""

import ctypes.util
import os
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from serial.tools import list_ports

from daq.cameras import LIBRARIES

BY_ID = Path("/dev/serial/by-id")
USB = Path("/sys/bus/usb/devices")
GENTL_PATH = "GENICAM_GENTL64_PATH"
INSTALLED = Path("/opt")  # where vendors' packages put theirs, whether or not this shell knows it
DEEPEST = 5  # folders below it
# class, subclass and protocol of the control interface (USB3 Vision 1.0, 2.1)
USB3_VISION = ("ef", "05", "00")
NEEDS = {"harvesters": (LIBRARIES["harvesters"], "camera"), "micromanager": (("pymmcore",), "micromanager")}
TELLING = {  # what a plug says of itself, and the driver of what is behind it
    "0403:faf0": "thorlabs_apt",  # FTDI with Thorlabs' own product id
    "thorlabs": "thorlabs_apt",
    "zaber": "zaber_ascii",
    "1a72:": "pi_gcs2",  # Physik Instrumente
    "grbl": "grbl",
}


@dataclass(frozen=True, slots=True)
class SerialPort:
    """A serial port of this computer.

    Attributes
    ----------
    path : str
        Its name, and where there is one that stays with the plug, that.
    words : str
        What its USB plug says of itself.
    driver : str or None
        Driver of what such a plug usually belongs to.
    trouble : str or None
        Why this user cannot open it, with the cure.
    """

    path: str
    words: str
    driver: str | None
    trouble: str | None


@dataclass(frozen=True, slots=True)
class UsbCamera:
    """A USB3 Vision camera that is plugged in; `trouble` is None if this user may open it."""

    vendor: str
    model: str
    serial: str
    trouble: str | None


def serial_ports() -> list[SerialPort]:
    """Every serial port; pseudo-terminals and network ports are not listed by systems."""
    lasting = {str(link.resolve()): str(link) for link in sorted(BY_ID.glob("*"))}
    found = []
    for port in sorted(list_ports.comports(), key=lambda port: port.device):
        said = [port.manufacturer, port.product or port.description]
        if port.serial_number:
            said.append(f"serial {port.serial_number}")
        plug = "" if port.vid is None else f"{port.vid:04x}:{port.pid:04x}"
        words = " ".join(dict.fromkeys(word for word in said if word and word != "n/a"))
        found.append(
            SerialPort(
                path=lasting.get(str(Path(port.device).resolve()), port.device),
                words=" ".join(part for part in (words, f"({plug})" if plug else "") if part),
                driver=next((name for sign, name in TELLING.items() if sign in f"{plug} {words.lower()}"), None),
                trouble=why_not(Path(port.device)),
            )
        )
    return found


def usb_cameras(root: Path = USB) -> list[UsbCamera]:
    """Every USB3 Vision camera that is plugged in, as the system's tree of USB tells it."""
    found = {}
    for interface in sorted(root.glob("*:*")):
        kind = tuple(_text(interface / f"bInterface{part}") for part in ("Class", "SubClass", "Protocol"))
        if kind != USB3_VISION:
            continue
        device = root / interface.name.split(":")[0]
        said = (_text(device / name) for name in ("manufacturer", "product", "serial", "busnum", "devnum"))
        vendor, model, serial, bus, number = said
        node = Path(f"/dev/bus/usb/{bus:0>3}/{number:0>3}")
        trouble = why_not(node) if node.exists() else None
        found[device] = UsbCamera(vendor, model, serial, trouble)
    return list(found.values())


def producers(installed: Path = INSTALLED) -> list[Path]:
    """GenTL producers in the folders that vendors' installers name, and below the usual one."""
    folders = [Path(part) for part in os.environ.get(GENTL_PATH, "").split(os.pathsep) if part]
    named = [path for folder in folders for path in sorted(folder.glob("*.cti"))]
    below = [path for depth in range(DEEPEST) for path in sorted(installed.glob("*/" * depth + "*.cti"))]
    return list(dict.fromkeys(named + below))


def missing_for(backend: str) -> str | None:
    """Return what a camera backend lacks on this computer, with the cure; None if nothing, or not known."""
    libraries, extra = NEEDS.get(backend, ((), ""))
    absent = [name for name in libraries if find_spec(name) is None]
    if absent:
        return f"{' and '.join(absent)} not installed; install the extra rtpiv[{extra}]"
    if backend == "aravis" and ctypes.util.find_library("aravis-0.8") is None:
        return "libaravis is not installed; apt-get install libaravis-0.8-0"
    return None


def why_not(path: Path) -> str | None:
    """Return why this user cannot open a device file, with the cure; None if it can be opened.

    Parameters
    ----------
    path : Path
        The file, or a link to it.
    """
    if os.name != "posix":  # ports are no files there
        return None
    if path.is_symlink() and not path.exists():
        return f"{path} leads to nothing; is it plugged in and switched on?"
    if not path.exists():
        return f"there is no {path}; is it plugged in and switched on? rtpiv doctor lists what is"
    if os.access(path, os.R_OK | os.W_OK):
        return None
    about = path.stat()
    group = _group(about.st_gid)
    if not about.st_mode & 0o060 or group is None:
        return f"{path} may not be opened by this user; a udev rule can give it to a group"
    if about.st_gid in os.getgroups():
        return f"{path} may not be opened though this user is in {group}; something else forbids it"
    if _is_member(group):
        return f"{path} belongs to {group}, which this user has joined since; log out and in again"
    return f"{path} belongs to {group}; sudo usermod -aG {group} $USER, then log out and in again"


def _group(number: int) -> str | None:
    import grp  # not every system has it

    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return None


def _is_member(group: str) -> bool:
    """Return whether the list of groups names this user, whatever this session knows of it."""
    import grp
    import pwd

    try:
        return pwd.getpwuid(os.getuid()).pw_name in grp.getgrnam(group).gr_mem
    except KeyError:
        return False


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
