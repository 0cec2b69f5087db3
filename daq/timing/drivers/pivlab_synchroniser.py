"""Drivers for the synchronisers of PIVlab: oltSync and xmSync, which trigger modulated diodes and cameras.

**Neither box counts.** A chunk is ended by us, by the clock, and after our death by the watchdog, some tenths of
a second later; if that is gone too, the box goes on until its key is turned. So `pairs` is a wish here, a
few more may leave, and a bench file has to say ``uncounted: true`` before such a box is armed at all.

**Neither box can be read.** An oltSync takes a sequence as a whole or refuses it, and says what its laser is
when it is started and stopped; an xmSync says the latter after every line. So what is confirmed is that it is
off, and that it has taken the numbers; they are sent again before it is armed, because they cannot be asked for.
Times are whole microseconds.

**An off of another program** is found by its answer, which comes to the program that holds the port: an answer
"off" to nothing that was sent here, before a burst or in it, ends the run. The key of the laser is not seen by the
box.

Off is said to the box by its name (`address`, the bench file's `identity`): a box that has not said who it is
would not take it from a stranger.
"""

import itertools
from abc import abstractmethod
from collections.abc import Callable
from collections.abc import Sequence as Several
from typing import ClassVar

from daq.timing.box import TimingBox
from daq.timing.errors import LaserDoubt, PulsesRefused, WrongBox
from daq.timing.protocols.pivlab_synchroniser import (
    Answer,
    AnswerStream,
    Identity,
    LaserIs,
    Question,
    Report,
    Sequence,
    Settings,
    Switch,
    Verdict,
)
from daq.timing.pulses import LAMPS, Pulse, Role, Schedule
from stages.errors import CommandRejected, ProtocolViolation

SPOILS = b"!\r\n"  # ends a line that was left half written, and makes it one that no box obeys
PINS = ("1", "2", "3", "4")
MARK = "oltSync:"
START_REPLY_S = 0.2  # a start that is not answered by then is followed by off: light ends 0.3 s after any off


class _Synchroniser(TimingBox):
    """Common part of both."""

    default_baud = 9600
    counts = False
    least_step_us = 1.0
    reply_timeout_s = 1.5  # PIVlab waits 0.3 s, and asks three times

    is_new: ClassVar[bool]

    _offs_due = 0  # answers to our own off that have not come
    _start_line = b""  # starts what was loaded; empty while nothing is
    _was_stopped = False  # by another program, since `stand_by`

    def drop(self) -> None:
        """Write off, twice, and expect an answer to each."""
        self._offs_due += 2
        super().drop()

    def stand_by(self) -> None:
        """Begin to listen for an off of another program."""
        self._was_stopped = False

    def off_bytes(self) -> Several[bytes]:
        """Off by name, twice; nothing to say to a box whose name is not known."""
        return [SPOILS + 2 * self._off_line()] if self.address else []

    def silence(self) -> None:
        """Say off until the box says that it is."""
        with self._lock:
            self.drop()
            if self._ask_again(lambda: self._switch(self._off_line())):
                raise LaserDoubt(f"{self.name} reports that its laser is still on")

    def start_lamps(self) -> None:
        """There are none."""
        raise WrongBox(f"{self.name} has no outputs for lamps")

    def confirm(self, schedule: Schedule, lamps: bool) -> None:
        """Send everything again, laser off: it cannot be asked for."""
        with self._lock:
            self.load(schedule)
            self._require_untouched()

    def begin(self, pairs: int, camera: bool = True) -> None:
        """Start what was loaded; for alignment the camera has no pulses in it."""
        with self._lock:
            if not self._start_line:
                raise LaserDoubt(f"{self.name} has no sequence to start")
            self._require_untouched()
            if not self._switch(self._start_line, moves=True):
                self._require_untouched()
                raise LaserDoubt(f"{self.name} does not start")

    def end(self) -> None:
        """Off, and confirmed; LaserDoubt if another program has switched it off before."""
        with self._lock:
            self._hear(self.port.pending())
            self.silence()
            self._require_untouched()

    # ---- inside ------------------------------------------------------------------------------------

    @abstractmethod
    def _off_line(self) -> bytes: ...

    def _identify(self) -> str:
        def accept(answer: object) -> str | None:
            match answer:  # others are older answers; and any line of another box would be a name
                case Identity(text) if "sync" in text.lower() or text == self.address:
                    return text
            return None

        return self._transact(Question("WhoAreYou?").to_bytes(), accept)

    def _set_up(self) -> None:
        if (MARK in self.identity) is not self.is_new:
            other = "pivlab_oltsync" if MARK in self.identity else "pivlab_xmsync"
            raise WrongBox(f"{self.name}: {self.identity!r} is a {other}; say that in the bench file")
        if self.gate is not None:
            raise WrongBox(f"{self.name} has no gate input that this driver could set; leave out `gate`")
        if wrong := [role for role, pin in self.wiring.items() if role in LAMPS or pin not in PINS]:
            raise WrongBox(f"{self.name}: {wrong[0]} cannot be on a synchroniser's pin")
        self.address = self.identity
        self._offs_due = 0

    def _require_untouched(self) -> None:
        """Raise if another program has switched off since `stand_by`."""
        self._hear(self.port.pending())
        if self._was_stopped:
            raise LaserDoubt(f"{self.name} was switched off by another program; look at the laser, then safe()")

    def _hear(self, data: bytes) -> None:
        """Count answers in bytes that came while nothing was asked."""
        if data:
            self._suspect = True
            self._stream().feed(data)

    def _count(self, answer: object) -> None:
        """Count the answers "off"; one to nothing that was sent here is another program's."""
        if isinstance(answer, LaserIs | Report) and not answer.on:
            self._offs_due -= 1
            self._was_stopped |= self._offs_due < 0

    def _take_unsolicited(self, data: bytes) -> None:
        self._hear(data)

    def _take_drained(self, data: bytes) -> None:
        self._hear(data)
        self._offs_due = 0

    def _switch(self, line: bytes, moves: bool = False) -> bool:
        """Send what is answered by the state of the laser; return it."""

        def accept(answer: object) -> bool | None:
            if isinstance(answer, LaserIs | Report):
                return answer.on
            raise ProtocolViolation(f"{self.name}: {answer!r} does not report whether the laser is on")

        self._clear_line()  # first: answers that are drained are no longer due
        self._offs_due += not moves
        return self._transact(line, accept, START_REPLY_S if moves else None, moves=moves)

    def _stream(self) -> AnswerStream:
        return _CountedAnswers(self._count)


class _CountedAnswers(AnswerStream):
    """Answers, each of which is counted as well."""

    def __init__(self, count: Callable[[object], None]) -> None:
        super().__init__()
        self._count = count

    def feed(self, chunk: bytes) -> list[Answer | ProtocolViolation]:
        """Add bytes; return what is complete."""
        answers = super().feed(chunk)
        for answer in answers:
            self._count(answer)
        return answers


class OltSyncBox(_Synchroniser):
    """An oltSync: pulses on its pins at any moments of a cycle."""

    is_new = True

    def load(self, schedule: Schedule) -> Schedule:
        """Round to microseconds, send, and believe the verdict."""
        with self._lock:
            self._start_line = b""
            self.silence()
            rounded = _round_schedule(schedule)
            pins = {pin: self._moments(rounded, pin) for pin in PINS}
            last = max((number for number, pin in enumerate(PINS, 1) if pins[pin]), default=0)
            for pin in PINS[:last]:  # a pin has to have something; who is not armed takes no notice
                pins[pin] = pins[pin] or (0, 1)
            cycle_us = round(rounded.period_us)
            sequence = Sequence(self.address, cycle_us, tuple(pins[pin] for pin in PINS[:last]))

            def accept(answer: object) -> bool | None:
                if isinstance(answer, Verdict):
                    return answer.accepted
                raise ProtocolViolation(f"{self.name}: {answer!r} does not answer a sequence")

            if not self._ask_again(lambda: self._transact(sequence.to_bytes(), accept)):
                raise CommandRejected(f"{self.name} refused the sequence as a whole", "Sequence:Error")
            self._start_line = Switch(self.address, True).to_bytes()
            return rounded

    def _moments(self, schedule: Schedule, pin: str) -> tuple[int, ...]:
        """Switching times of a pin, in order; pulses of a role without a pin of its own join its partner's."""
        partners = {Role.Q_SWITCH_2: Role.Q_SWITCH_1, Role.CAMERA_B: Role.CAMERA}
        pulses = []
        for role, pulse in schedule.pulses.items():
            home = role if role in self.wiring else partners.get(role, role)
            if self.wiring.get(home) == pin:
                pulses.append((round(pulse.delay_us), round(pulse.end_us)))
        pulses.sort()
        if any(late[0] <= soon[1] for soon, late in itertools.pairwise(pulses)):
            raise PulsesRefused(f"{self.name}: pulses on pin {pin} run into each other")
        return tuple(moment for pulse in pulses for moment in pulse)

    def _off_line(self) -> bytes:
        return Switch(self.address, False).to_bytes()


class XmSyncBox(_Synchroniser):
    """An xmSync with a camera that straddles frames: the box places the pulses itself, from dt and frame rate."""

    is_new = False

    def load(self, schedule: Schedule) -> Schedule:
        """Send dt, frame rate and energy, laser off."""
        with self._lock:
            self._start_line = b""
            if Role.CAMERA_B not in schedule.pulses:
                raise PulsesRefused(f"{self.name}: an xmSync is driven here for cameras with two triggers a pair")
            frames_hz = 2.0 * schedule.rate_hz
            if abs(frames_hz - round(frames_hz)) > 1e-6:
                raise PulsesRefused(f"{self.name} supports whole frames/s only, not {frames_hz:g}")
            dt_us = round(schedule.dt_us)
            energy = round(100.0 * schedule.pulses[Role.Q_SWITCH_1].width_us / dt_us)
            if not 1 <= energy <= 100:
                raise PulsesRefused(f"{self.name}: light must last 1 to 100 % of dt, not {energy} %")
            words = (round(frames_hz), 0, 0, energy, 0, dt_us, 0, 0)
            dark, lit = (Settings(self.address, *words, laser).to_bytes() for laser in (False, True))
            if self._ask_again(lambda: self._switch(dark)):
                raise LaserDoubt(f"{self.name} reports that its laser is on")
            self._start_line = lit
            return _round_schedule(schedule)

    def _off_line(self) -> bytes:
        return Settings(self.address, 1, 1, 0, 0, 100, 1234, -1, 0, False).to_bytes()


def _round_schedule(schedule: Schedule) -> Schedule:
    """Whole microseconds; dt is kept to its nearest one, whatever the pulses before it are rounded to."""
    pulses = {
        role: Pulse(float(round(pulse.delay_us)), float(max(1, round(pulse.width_us))))
        for role, pulse in schedule.pulses.items()
    }
    if Role.Q_SWITCH_2 in pulses:
        early_us = schedule.light_delay_us[0] - schedule.light_delay_us[1]
        second_us = pulses[Role.Q_SWITCH_1].delay_us + round(schedule.dt_us) + early_us
        if second_us != round(second_us):
            raise PulsesRefused(f"the delays from trigger to light differ by {early_us:g} us, not by whole ones")
        pulses[Role.Q_SWITCH_2] = Pulse(second_us, pulses[Role.Q_SWITCH_2].width_us)
    return Schedule(float(round(schedule.period_us)), pulses, schedule.light_delay_us)
