"""Simulated switches of door, shutter and key: closed until a test, or a person at the simulated bench, opens one.

CLOSED[unit.switches["door"]] = False
"""

from itertools import count

CLOSED: dict[str, bool] = {}  # by address
_numbers = count()


def put_up(name: str) -> str:
    """Put a closed switch up; return its address."""
    address = f"{name}-{next(_numbers)}"
    CLOSED[address] = True
    return address


class SimulatedSwitch:
    """One of them, as a bench file's `by` names it."""

    def __init__(self, address: str) -> None:
        self._address = address

    def is_closed(self) -> bool:
        """Whether nobody has opened it."""
        return CLOSED[self._address]

    def close(self) -> None:
        """Nothing to give back."""
