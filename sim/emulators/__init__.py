"""Controllers as firmware: bytes in, bytes out, over the physics of `sim.motion`; one line each.

An emulator knows nothing of the drivers; it shares with them the grammar in ``stages.protocols`` and no
arithmetic.
"""

import importlib

from sim.emulators.device import Emulator

EMULATORS = {
    "zaber_ascii": "sim.emulators.zaber_ascii:ZaberEmulator",
    "isel_dnc": "sim.emulators.isel_dnc:IselEmulator",
    "pi_gcs2": "sim.emulators.pi_gcs2:PiEmulator",
    "grbl": "sim.emulators.grbl:GrblEmulator",
}


def emulator_class(driver: str) -> type[Emulator]:
    """Class of the emulator that speaks the protocol of a driver."""
    module, _, name = EMULATORS[driver].partition(":")
    found: type[Emulator] = getattr(importlib.import_module(module), name)
    return found
