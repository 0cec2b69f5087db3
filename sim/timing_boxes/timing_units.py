"""Firmware of every timing unit by the name that a bench file gives it."""

from sim.timing_boxes.pivlab_synchroniser import OltSyncEmulator, XmSyncEmulator
from sim.timing_boxes.quantum_composers import QuantumComposersEmulator

Firmware = QuantumComposersEmulator | OltSyncEmulator
SYNCHRONISERS = {"pivlab_oltsync": OltSyncEmulator, "pivlab_xmsync": XmSyncEmulator}


def emulator_of(box: str) -> type[Firmware]:
    """Firmware of the box that a bench file names; all others are of one family."""
    return SYNCHRONISERS.get(box, QuantumComposersEmulator)
