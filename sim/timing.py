"""A simulated timing unit on a bench: firmware with a clock of its own behind a port, and plugs at its back.

Simulations of devices connected to it find it in `world.timing` and listens:

    for unit in world.timing:
        unit.listen(Role.CAMERA, lambda pulse: ...)     # pulse.rises_s, pulse.falls_s on the world's clock
    unit.is_high(Role.MARKER, time_s)                   # what a line status would say

A listener is called when the pulse rises, in a thread that holds the line, in the order of rising edges: it puts
what it hears into a queue and returns, or the box hears its own next command late.

Its switches of door, shutter and key are closed until a test, or a person at the simulated bench, opens one:

    CLOSED[unit.switches["door"]] = False
"""

import threading
import time
from collections.abc import Callable
from itertools import count
from typing import Any

from daq.timing.drivers_by_name import driver_class
from daq.timing.pulses import Role
from daq.timing.timing_table import TimingTable
from sim.emulators.device import Clock
from sim.emulators.line import Line
from sim.timing_boxes.pivlab_synchroniser import OltSyncEmulator, XmSyncEmulator
from sim.timing_boxes.pulsing import Outputs, Pulse
from sim.timing_boxes.quantum_composers import QuantumComposersEmulator
from sim.timing_boxes.srs_dg645 import Dg645Emulator

TICK_S = 0.001  # of the wall's clock, between two looks of the box at its own
CLOSED: dict[str, bool] = {}  # whether a switch is closed, by its address
Firmware = QuantumComposersEmulator | OltSyncEmulator | Dg645Emulator
SYNCHRONISERS: dict[str, type[OltSyncEmulator]] = {
    "pivlab_oltsync": OltSyncEmulator,
    "pivlab_xmsync": XmSyncEmulator,
}
_numbers = count()


def emulator_of(box: str) -> type[Firmware]:
    """Firmware of the box that a bench file names; all others are of one family."""
    if box == "srs_dg645":
        return Dg645Emulator
    return SYNCHRONISERS.get(box, QuantumComposersEmulator)


def new_switch(name: str) -> str:
    """Put a closed switch up; return its address."""
    address = f"{name}-{next(_numbers)}"
    CLOSED[address] = True
    return address


class SimulatedSwitch:
    """A switch, as a bench file's `by` names it."""

    def __init__(self, address: str) -> None:
        self._address = address

    def is_closed(self) -> bool:
        """Return whether no program has opened it."""
        return CLOSED[self._address]

    def close(self) -> None:
        """Nothing to give back."""


class SimulatedTiming:
    """One timing unit.

    Parameters
    ----------
    table : TimingTable
        What hangs where.
    clock : Clock
        Time of the world.
    """

    def __init__(self, table: TimingTable, clock: Clock) -> None:
        self.wiring = table.wiring
        self.trigger_cable = self.wiring.get(Role.CAMERA)  # output wired to the camera's trigger
        self._light_delays_us = table.head.q_switch_to_light_us
        made = emulator_of(table.box)
        options: dict[str, Any] = {"name": table.identity}
        if made is Dg645Emulator:
            options = made.individual(table.port)
        elif issubclass(made, QuantumComposersEmulator):
            options = made.individual(table.port) | made.model_of(table.box)
        self.firmware: Firmware = made(clock, **options)
        self._box = table.box
        self.line = Line(self.firmware, clock)
        self.switches = {name: new_switch(name) for name in table.switches}  # addresses
        self.outputs: Outputs = self.firmware.outputs
        self._clock = clock
        self._hears_time: list[Callable[[float], object]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="timing unit", daemon=True)

    def hear_foreign_off(self) -> None:
        """Hear off as `rtpiv laser off` writes it to the port, past the program that has it open."""
        box = driver_class(self._box)("another program", self.wiring)
        box.address = getattr(self.firmware, "name", "")
        for data in box.off_bytes() if not self.line.dead else ():
            self.firmware.feed(data)

    def light_delay_s(self, pulse: int) -> float:
        """From a Q-switch, 0 or 1, to its light."""
        return 1e-6 * self._light_delays_us[pulse]

    def listen(self, role: Role, hear: Callable[[Pulse], object]) -> None:
        """Hang something on an output; a role that is not wired is never heard."""
        output = self.wiring.get(role)
        self.outputs.listen(lambda pulse: hear(pulse) if pulse.output == output else None)

    def listen_at_cable(self, hear: Callable[[Pulse], object]) -> None:
        """Hang the camera's trigger input on wherever its cable is."""
        self.outputs.listen(lambda pulse: hear(pulse) if pulse.output == self.trigger_cable else None)

    def listen_to_time(self, hear: Callable[[float], object]) -> None:
        """Call with a time [s] up to which every pulse has been given, again and again."""
        self._hears_time.append(hear)

    def is_high(self, role: Role, time_s: float) -> bool:
        """Return whether an output was high at a moment that is not too long ago."""
        return role in self.wiring and self.outputs.is_high(self.wiring[role], time_s)

    @property
    def triggers_camera(self) -> bool:
        """Return whether the output of the camera is on, so that frames are to be expected."""
        if not isinstance(self.firmware, QuantumComposersEmulator):
            return self.firmware.is_running
        output = self.wiring.get(Role.CAMERA)
        return output is not None and self.firmware.is_on_at(1 + ord(output) - ord("A"))

    def pulses(self, role: Role) -> int:
        """Pulses so far."""
        return self.outputs.count[self.wiring[role]] if role in self.wiring else 0

    def start(self) -> None:
        """Give power."""
        self._thread.start()

    def close(self) -> None:
        """Take power away."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.is_set():
            with self.line.lock:
                now_s = self._clock.now_s()
                self.line.emulator.advance()
            for hear in self._hears_time:
                hear(now_s)
            time.sleep(TICK_S)
