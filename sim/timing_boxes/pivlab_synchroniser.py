"""PIVlab's synchronisers as firmware: oltSync and xmSync.

A started sequence repeats on the world's clock until it is stopped, with or without a
listener and a living host; nothing is counted. A line for another box is not answered. A sequence is taken whole
or refused: moments must rise, come in pairs, and end within the cycle. The pins are the outputs 1, 2, 3, 4.
"""

import itertools
from typing import Any

from daq.timing.protocols.pivlab_synchroniser import (
    Command,
    CommandStream,
    Identity,
    LaserIs,
    Question,
    Report,
    Sequence,
    Settings,
    Switch,
    Verdict,
)
from sim.emulators.device import Clock, serial_number
from sim.timing_boxes.pulsing import Pulse, PulsingEmulator
from stages.errors import ProtocolViolation

FIRMWARE = "1.4"


class OltSyncEmulator(PulsingEmulator):
    """An oltSync.

    Parameters
    ----------
    clock : Clock
        Time of the world.
    name : str
        What it says of itself.
    """

    decoder = CommandStream

    def __init__(self, clock: Clock, name: str = "oltSync:0012") -> None:
        super().__init__(clock)
        self.name = name
        self._pins: tuple[tuple[int, ...], ...] = ()
        self._cycle_s = 0.0
        self._key_is_on = True

    @classmethod
    def individual(cls, name: str) -> dict[str, Any]:
        """Options that distinguish this box from another of its kind."""
        return {"name": f"oltSync:{serial_number(name)}"}

    def person_stops(self) -> None:
        """The key of the laser is turned off: the box goes on, and nothing that it gives makes light."""
        self.advance()
        self._key_is_on = False

    def person_runs(self) -> None:
        """The key of the laser is turned on again."""
        self.advance()
        self._key_is_on = True

    def _lets_out(self) -> bool:
        return self._key_is_on

    def _power_up(self) -> None:
        self._pins = ()

    def _begin_period(self, time_s: float) -> None:
        for number, moments in enumerate(self._pins, start=1):
            for on_us, off_us in _twos(moments):
                pulse = Pulse(str(number), time_s + on_us * 1e-6, time_s + off_us * 1e-6)
                self._send(pulse.rises_s, number, pulse)
        self._period_begins_s = time_s + self._cycle_s

    def _hear(self, command: Command | ProtocolViolation) -> None:
        if isinstance(command, ProtocolViolation):
            return
        if isinstance(command, Question):
            self._introduce(command)
        elif command.device == self.name:
            self._obey(command)

    def _introduce(self, question: Question) -> None:
        if question.text == "WhoAreYou?":
            self.say(Identity(self.name).to_bytes())
        elif question.text == "WhichFirmWare?":
            self.say(Identity(f"oltSync:{FIRMWARE}").to_bytes())

    def _obey(self, command: Sequence | Switch | Settings) -> None:
        if isinstance(command, Sequence):
            good = _fits(command) and command.mode == 0
            if good:
                self._end_periods()
                self._pins, self._cycle_s = command.pins, command.cycle_us * 1e-6
            self.say(Verdict(good).to_bytes())
        elif isinstance(command, Switch):
            self._end_periods()
            if command.starts and self._pins:
                self._period_begins_s = self.event_s
            self.say(LaserIs(self.is_running).to_bytes())


class XmSyncEmulator(OltSyncEmulator):
    """An xmSync: it places the pulses of a straddling camera itself."""

    def __init__(self, clock: Clock, name: str = "SYNC_UOA1") -> None:
        super().__init__(clock, name)

    @classmethod
    def individual(cls, name: str) -> dict[str, Any]:
        """Options that distinguish this box from another of its kind."""
        return {"name": f"SYNC_{serial_number(name)}"}

    def _introduce(self, question: Question) -> None:
        if question.text == "WhoAreYou?":
            self.say(Identity(self.name).to_bytes())

    def _obey(self, command: Sequence | Switch | Settings) -> None:
        if not isinstance(command, Settings):
            return
        self._end_periods()
        if command.laser and command.frequency_hz > 0:
            frame_us = 1_000_000 // command.frequency_hz
            half_us, lit_us = command.interframe_us // 2, command.interframe_us * command.energy_percent // 100
            first_us = frame_us - half_us - lit_us // 2
            second_us = first_us + command.interframe_us
            self._pins = (
                (0, 10, frame_us, frame_us + 10),
                (first_us, first_us + lit_us, second_us, second_us + lit_us),
            )
            self._cycle_s = 2e-6 * frame_us
            self._period_begins_s = self.event_s
        numbers = (
            command.frequency_hz, command.camera_divider, command.energy_us, command.energy_percent,
            command.first_exposure_us, command.interframe_us, command.external_delay_us,
        )  # fmt: skip
        self.say(Report((*map(str, numbers), str(int(self.is_running)))).to_bytes())


def _fits(sequence: Sequence) -> bool:
    for moments in sequence.pins:
        rises = all(soon < late for soon, late in itertools.pairwise(moments))
        if len(moments) % 2 or not moments or not rises or moments[-1] >= sequence.cycle_us:
            return False
    return True


def _twos(moments: tuple[int, ...]) -> list[tuple[int, int]]:
    return list(zip(moments[::2], moments[1::2], strict=True))


EMULATOR = OltSyncEmulator
