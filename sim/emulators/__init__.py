"""Controllers as firmware: bytes in, bytes out, over the physics of `sim.mechanics.motion`.

An emulator knows nothing of the drivers; it shares with them the grammar in ``stages.protocols``, no arithmetic.
The emulator for the driver ``x`` is the class that ``sim/emulators/x.py`` calls EMULATOR.
"""

import importlib

from sim.emulators.device import Emulator


def emulator_class(driver: str) -> type[Emulator]:
    """Class of the emulator that speaks the protocol of a driver.

    Raises
    ------
    ModuleNotFoundError
        There is none for this driver.
    """
    found: type[Emulator] = importlib.import_module(f"sim.emulators.{driver}").EMULATOR
    return found
