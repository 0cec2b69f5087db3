"""Names tied to boxes: what answers on a port must be the box that the bench file means.

Ports are numbered by the order in which they were plugged in, and cables look alike. Two controllers of the same
kind on swapped cables answer every question as expected, and then the glass moves where the target was meant. So a
bench file may say words that only the right box says of itself (its serial number, a name in its user string), and
every connect asks for them before anything moves.

A box that tells nothing of its own (isel and C142 know their model only, a Grbl board what was written with
``$I=name``) is tied by its converter: ``/dev/serial/by-id/...`` carries the converter's serial number.
"""

from stages.config import StagesTable
from stages.controller_tables import HandTable
from stages.errors import WrongDevice

BY_ID = "/dev/serial/by-id/"


def require_identity(name: str, wanted: str | None, said: str, port: str) -> None:
    """Raise if a box is not the one that the bench file means.

    Parameters
    ----------
    name, port : str
        What the bench file calls the controller, and where it looks for it.
    wanted : str or None
        Words that it must say; None for any box.
    said : str
        What it says of itself.

    Raises
    ------
    WrongDevice
        It does not say them.
    """
    if wanted is not None and wanted not in said:
        raise WrongDevice(
            f"{name}: {said!r} answers on {port}, the bench file says {wanted!r}; check the cables, "
            "or the controller's identity in the bench file"
        )


def confusable(config: StagesTable) -> list[str]:
    """Name the controllers that would be taken for each other on swapped cables, a sentence for each kind.

    Two boxes of one kind are distinguished if each has a port by its converter's serial number, or if each has an
    identity that the other one does not say.
    """
    found = []
    boxes = {name: table for name, table in config.controllers.items() if not isinstance(table, HandTable)}
    for driver in dict.fromkeys(table.driver for table in boxes.values()):
        twins = {name: table for name, table in boxes.items() if table.driver == driver}
        loose = []
        for name, table in twins.items():
            others = [other.identity for other_name, other in twins.items() if other_name != name]
            words = table.identity
            tied = words is not None and not any(other and (words in other or other in words) for other in others)
            if not (tied or table.place.startswith(BY_ID)):
                loose.append(name)
        if len(twins) > 1 and loose:
            found.append(
                f"{' and '.join(loose)} ({driver}) would be taken for another box on a swapped cable; "
                "give each an identity (save in rtpiv bench stage writes it), or a port in /dev/serial/by-id"
            )
    return found
