"""A laser that is open, and everything that switches it off.

    end of the process                   switched off by
    -----------------------------------  --------------------------------------------------------------------------
    end of the block, exception          `Laser.close`
    SIGINT, SIGTERM, SIGHUP, SIGQUIT     this file: a thread of its own, at the first one and at every further one
    kill -9, segfault, no memory         the watchdog (`stages.watchdog`), a process of its own; and the box,
                                         which has counted to the end of the chunk
    SIGSTOP, power failure               the box itself
    the cable                            the box itself; as soon as it is plugged in again `Laser.confirm_off`

A run may take a first Ctrl-C as a wish to end after its step; a laser goes off at the first one all the same. So
what switches it off hears of signals from the system (`stages.wake_up`), in whatever handler.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from daq.timing.drivers_by_name import driver_class
from daq.timing.errors import WrongBox
from daq.timing.in_use import register_laser
from daq.timing.laser import Laser
from daq.timing.switches import OFF, Switches
from daq.timing.timing_table import TimingTable
from stages.clock import SYSTEM_CLOCK, Clock
from stages.stop_signals import StopSignals, StopThread
from stages.wake_up import WakeUp
from stages.watchdog import Watchdog, needs_watchdog

ENDS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name))


class _Signals(StopSignals):
    """Those of a bench, with a Ctrl-Z that counts as Ctrl-C while light leaves."""

    def __init__(self, laser: Laser) -> None:
        super().__init__(laser.stop)
        self._laser = laser

    @property
    def moves(self) -> bool:
        """True if it must not be suspended now."""
        return self._laser.emits


@contextmanager
def open_laser(table: TimingTable, clock: Clock = SYSTEM_CLOCK) -> Iterator[Laser]:
    """Open a timing unit and switch off everything connected to it; nothing is switched on.

    Parameters
    ----------
    table : TimingTable
        What the bench file says.
    clock : Clock
        Clock of warm-up and bursts.

    Yields
    ------
    Laser
        SAFE, or UNKNOWN if it cannot be read.

    Raises
    ------
    PortError, WrongBox
        Box or switch is not there, or must not be used.
    """
    box = driver_class(table.box)(f"laser on {table.port}", table.wiring, clock)
    box.address, box.gate = table.identity or "", table.gate
    laser = Laser(box.name, box, table.head, table.rules(), clock)
    watchdog = Watchdog(laser.switch_opened) if needs_watchdog([table.port]) else None
    try:
        laser.switches = Switches.open(table.switches)
        laser.open(table.port, table.baud)
        if table.identity is not None and table.identity not in box.identity:
            raise WrongBox(
                f"{box.name}: {box.identity!r} answers, the bench file says {table.identity!r}; check the cables"
            )
        if watchdog is not None:
            watchdog.know(box.name, table.port, table.baud or box.default_baud, False, box.off_bytes())
            box.watchdog = watchdog
        with register_laser(table) as request:
            laser.switches.add(OFF, request)
            laser.off_request = request
            laser.switches.watch(laser.switch_opened)
            with _heard_by(laser):
                yield laser
    finally:
        try:
            laser.close()
        finally:
            laser.switches.close()
            if watchdog is not None:
                watchdog.close()


@contextmanager
def _heard_by(laser: Laser) -> Iterator[None]:
    """Switch off at any signal that ends programs, from another thread."""
    signals = _Signals(laser)
    why = ["a signal"]
    says = StopThread(lambda: laser.stop(why[0]))

    def hear(number: int) -> None:
        if number in ENDS:
            why[0] = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
            says.press()

    signals.enter()
    wake_up = WakeUp(hear) if threading.current_thread() is threading.main_thread() else None
    if wake_up is not None:
        wake_up.open()
    try:
        yield
    finally:
        with signals.leaving(stop=False):
            if wake_up is not None:
                wake_up.close()
            says.end()
            laser.close()
