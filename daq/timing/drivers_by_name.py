"""Drivers of timing units by the name that a bench file gives them; "package.module:Class" works as well."""

from typing import cast

from daq.timing.box import TimingBox
from daq.timing.errors import TimingUsageError
from ground.named_program import UnknownName, program_of

_QC = "daq.timing.drivers.quantum_composers:QuantumComposersBox"
DRIVERS = {
    "qc9510": _QC,
    "qc9520": _QC,
    "qc9530": _QC,
    "bnc575": _QC,
    "bnc577": _QC,
    "pivlab_oltsync": "daq.timing.drivers.pivlab_synchroniser:OltSyncBox",
    "srs_dg645": "daq.timing.drivers.srs_dg645:Dg645Box",
    "pivlab_xmsync": "daq.timing.drivers.pivlab_synchroniser:XmSyncBox",
}


def driver_class(name: str) -> type[TimingBox]:
    """Class of the driver of that name.

    Raises
    ------
    TimingUsageError
        There is none.
    """
    try:
        return cast("type[TimingBox]", program_of(name, DRIVERS))
    except UnknownName:
        raise TimingUsageError(f"there is no timing unit {name!r}; there are {', '.join(DRIVERS)}") from None
    except (ImportError, AttributeError) as error:
        raise TimingUsageError(f"the timing unit {name!r} cannot be loaded: {error}") from error
