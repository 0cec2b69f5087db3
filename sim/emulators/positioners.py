"""A positioner in the manner of Bluesky's world, over a channel of a simulated box."""

from sim.emulators.foreign_box import ForeignBox, Wire


class SimulatedStatus:
    """Done when the box says so."""

    def __init__(self, wire: Wire, channel: str) -> None:
        self._wire, self._channel = wire, channel

    @property
    def done(self) -> bool:
        """Asked anew each time."""
        with self._wire.call("busy") as box:
            return not box.busy(self._channel)

    success = True

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """It knows of no failure."""
        return None


class SimulatedPositioner:
    """One axis.

    Parameters
    ----------
    address : str
        The box.
    channel : str
        Which of its motors.
    """

    _wires: dict[str, Wire] = {}  # noqa: RUF012 - objects of one box share what leads to it

    def __init__(self, address: str, channel: str) -> None:
        self.name, self._address, self._channel = channel, address, channel
        if address not in self._wires:
            self._wires[address] = Wire(address)
        self._wire = self._wires[address]

    @property
    def position(self) -> float:
        """In mm."""
        with self._wire.call("read") as box:
            return box.position_mm(self._channel)

    def set(self, value: float) -> SimulatedStatus:
        """Go."""
        with self._wire.call("send") as box:
            box.send(self._channel, value)
        return SimulatedStatus(self._wire, self._channel)

    def home(self) -> SimulatedStatus:
        """Look for the reference."""
        with self._wire.call("home") as box:
            box.seek(self._channel)
        return SimulatedStatus(self._wire, self._channel)

    def stop(self, success: bool = False) -> None:
        """Brake."""
        with self._wire.call("stop") as box:
            box.stop(self._channel)

    def close(self) -> None:
        """Let go of the box."""
        wire = self._wires.pop(self._address, None)
        if wire is not None:
            wire.close()


EMULATOR = ForeignBox
