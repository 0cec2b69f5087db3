"""Drivers of timing units by the name that a bench file gives them; "package.module:Class" works as well."""

from importlib import import_module
from typing import cast

from daq.timing.box import TimingBox
from daq.timing.errors import TimingUsageError
from ground.named_program import named_program

_QC = "daq.timing.drivers.quantum_composers:QuantumComposersBox"
DRIVERS = {
    "qc9510": _QC,
    "qc9520": _QC,
    "qc9530": _QC,
    "bnc575": _QC,
    "bnc577": _QC,
    "pivlab_oltsync": "daq.timing.drivers.pivlab_synchroniser:OltSyncBox",
    "pivlab_xmsync": "daq.timing.drivers.pivlab_synchroniser:XmSyncBox",
}


def driver_class(name: str) -> type[TimingBox]:
    """Class of the driver of that name.

    Raises
    ------
    TimingUsageError
        There is none.
    """
    module, colon, attribute = DRIVERS.get(name, name).partition(":")
    if not colon:
        raise TimingUsageError(f"there is no timing unit {name!r}; there are {', '.join(DRIVERS)}")
    try:
        found = getattr(import_module(module), attribute) if name in DRIVERS else named_program(name)
    except (ImportError, AttributeError) as error:
        raise TimingUsageError(f"the timing unit {name!r} cannot be loaded: {error}") from error
    return cast("type[TimingBox]", found)
