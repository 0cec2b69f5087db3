"""The controllers that can be driven: one line each.

DRIVERS speak bytes on a port; FOREIGN are libraries of others (`stages.foreign`); HANDS are a person.
A bench file names a driver by its key here, or an own one as ``package.module:Class``. The class is imported
only when it is asked for. Contract tests run on every line.
"""

from ground.named_program import UnknownName, is_installed, is_trusted, program_of
from stages.controller import Controller
from stages.errors import StageUsageError
from stages.motion_controller import MotionController

DRIVERS = {
    "zaber_ascii": "stages.drivers.zaber_ascii:ZaberController",
    "isel_dnc": "stages.drivers.isel_dnc:IselController",
    "pi_gcs2": "stages.drivers.pi_gcs2:PiController",
    "grbl": "stages.drivers.grbl:GrblController",
    "thorlabs_apt": "stages.drivers.thorlabs_apt:AptController",
}

FOREIGN = {
    "micromanager": "stages.foreign.micromanager:MicroManager",
    "positioners": "stages.foreign.positioners:Positioners",
}

HANDS = {
    "by_hand": "stages.by_hand:ByHand",
}

WITHOUT_PORT = {**FOREIGN, **HANDS}


def controller_class(name: str) -> type[MotionController]:
    """Class of what a bench file names as `driver`, serial or not.

    Raises
    ------
    StageUsageError
        There is none of that name.
    """
    if name not in WITHOUT_PORT:
        return driver_class(name)
    found: type[MotionController] = program_of(name, WITHOUT_PORT)
    return found


def check_driver(name: str) -> None:
    """Refuse a driver that is not there; one of another project is imported only if it is trusted.

    Raises
    ------
    StageUsageError
        There is none of that name.
    """
    if name in WITHOUT_PORT or ":" not in name or is_trusted(name):
        controller_class(name)
    elif not is_installed(name):
        raise StageUsageError(f"driver {name!r} cannot be imported: its package is not installed here")


def driver_class(name: str) -> type[Controller]:
    """Class of a serial driver.

    Raises
    ------
    StageUsageError
        There is no such driver.
    UntrustedProgram
        It is a driver of another project, and not trusted.
    """
    try:
        found = program_of(name, DRIVERS)
    except UnknownName:
        known = ", ".join([*DRIVERS, *WITHOUT_PORT])
        raise StageUsageError(f"driver {name!r} is unknown; known are {known}, or give module:Class") from None
    except (ImportError, AttributeError) as error:
        raise StageUsageError(f"driver {name!r} cannot be imported: {error}") from error
    if not (isinstance(found, type) and issubclass(found, Controller)):
        raise StageUsageError(f"driver {name!r} is not a Controller")
    return found
