"""Driver for the pulse generators of Quantum Composers and Berkeley Nucleonics.

Lamps are channels in normal mode; Q-switches, camera and marker are channels in burst mode, so that the box itself
counts the pulses of a chunk and inhibits their outputs at its end.

**RUN begins a burst.** Channels in burst mode are armed by the button RUN (9530 manual p. 14, 525 manual 5.1),
which is the state of T0. Whether RUN arms an output that is off, and whether it restarts T0 while T0 runs, no
manual says. So T0 is stopped, the outputs are switched on, and T0 is started: on every kind of box everything
begins together in the first period, and so many pulses leave as were asked for. Lamps miss the beats of that
pause.

**RUN undoes a STOP** (ADR 42). T0 runs from `start_lamps` or `stand_by` until everything is off, between bursts
too: the key STOP, and every off of another program, clear it. The string that begins a burst therefore asks for
T0 before it stops and starts it. If T0 did not run, off is sent at once, and a person has to release the laser.

**The end of a burst is not reported.** STAT stays 1 on a box that arms by RUN, and nothing else can be asked. A
burst is over when its time is over; then its outputs are written off and read back, so that another RUN, at its
keys, gives nothing.

**Damaged answers.** The protocol has no checksum. What is believed is read twice, numbers must have all their
digits, booleans are 0 or 1 and nothing else, and every number that is written is read back. Lines that are
echoed are skipped. What was refused is refused for good: nothing that switches on is said twice.

**Lines that get lost.** Every line is answered, and the next one is to wait for that answer (9500 Plus manual,
p. 38, which advises against several in one string). No manual asks for a pause; but a program for the 575 makes
one of 50 ms besides. As a rule that would stretch a chunk's arming from 0.1 to 3.6 s, so it is for boxes that
need it: those that do not answer every line of a string when they are opened, or later a question. Off and the
start of a burst are written in one string. A box that takes one line at a time may hear the first line of off
alone: that stops everything, and it is said again. Such a box is started line by line.
"""

import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeVar

from daq.timing.box import TimingBox
from daq.timing.errors import LaserDoubt, PulsesRefused, WrongBox
from daq.timing.protocols.quantum_composers import REASONS, AnswerStream, Command, Done, Echo, Refused, Value
from daq.timing.pulses import LAMPS, Q_SWITCHES, Pulse, Role, Schedule
from stages.errors import CommandRejected, NoReply, ProtocolViolation

T0 = 0
OUTPUTS = "ABCDEFGH"
LARGEST_COUNT = 9_999_999
PAUSE_S = 0.05  # between lines to a box that loses those that come sooner
# without an answer to the first off of a burst, until off is written to all its outputs
FIRST_OFF_ANSWER_S = 0.1
ROUNDS_AT_END = 3  # of off to Q-switches whose first may have been refused, before anything is asked
INSISTS = 6  # how often off is said again to such a box, before anything is asked: 0.3 s
# in which off is said again to outputs that read back as on, before the box is called deaf to it
MORE_ROUNDS = 3
NEWER_CLOCKS = ("953", "853", "577")  # models, by their beginning, that have a mode of the clock; asked first
UNKNOWN_WORD = (2, 3)  # refusals
STOPPED = "was stopped at its keys or by another program, or lost power (T0 is off): see the laser, then safe()"
_CLOCKS = re.compile(r"INT|EXT|XPL|SYS|EXT\d{2,3}")  # a mode, or one word; XPL? is a loop that is not locked
_SECONDS = re.compile(r"-?\d+\.\d{9,12}")
_WHOLE = re.compile(r"\d{1,8}")
_BOOLEAN = re.compile(r"[01]")
T = TypeVar("T")
_MAKERS = ("QC", "QUANTUM", "BNC", "BERKELEY")


class QuantumComposersBox(TimingBox):
    """A box with four or eight outputs, A to H."""

    default_baud = 38_400
    counts = True
    least_step_us = 0.01
    decoder = AnswerStream
    reply_timeout_s = 1.0  # a burst is ended by a missing answer, and a busy computer is late too

    _outputs = 8

    def off_bytes(self) -> Sequence[bytes]:
        """T0 and with it everything, then Q-switches, lamps, the rest; all of it twice, in one write.

        A line may be damaged on its way, be the rest of another one, or refused because the box is busy.
        """
        return [self._off_string()]

    def _off_string(self, first: int = 0) -> bytes:
        """Off to everything twice, beginning with the `first` of T0 and the Q-switches."""
        order = [T0, *self._numbers(*Q_SWITCHES), *self._numbers(*LAMPS)]
        order += [number for number in self._numbers(*self.wiring) if number not in order]
        return 2 * b"".join(Command(f":PULSE{n}:STAT", "0").to_bytes() for n in order[first:] + order[:first])

    def drop(self) -> None:
        """Write everything off now; again and again, pauses apart, to a box that is known to lose lines.

        Of each write such a box hears its first line at most: every second time that is a Q-switch's, for a box
        that refuses T0; a refusal ends in a reset.
        """
        super().drop()
        if self._pause_s > 0.0:
            for again in range(1, INSISTS + 1):
                self.clock.sleep_s(self._pause_s)
                first = 0 if again % 2 else again // 2 % (1 + len(self._numbers(*Q_SWITCHES)))
                self._write_off([self._off_string(first)])
            if b"?8" in self.port.pending():  # refused: it may go on to refuse for longer than this
                self.clock.sleep_s(self._pause_s)
                self._write_off([Command("*RST").to_bytes()])

    def silence(self) -> None:
        """Every output there is, wired or not, off and read back; what reads back is what counts.

        One that refuses, or whose answer does not come, keeps none of the others from being switched off; a box
        that goes on refusing is reset, which ends everything.
        """
        with self._lock:
            self.drop()
            wired = [*self._numbers(*Q_SWITCHES), *self._numbers(*LAMPS)]
            others = [number for number in range(1, self._outputs + 1) if number not in wired]
            order = [T0, *wired, *others]
            troubles = [trouble for number in order if (trouble := self._try_off(number)) is not None]
            on = [number for number in order if self._flag(number, "STAT")]
            for _ in range(MORE_ROUNDS):
                troubles += [trouble for number in on if (trouble := self._try_off(number)) is not None]
                on = [number for number in on if self._flag(number, "STAT")]
            if on:  # the last word that a box which refuses these may know: every setting is lost with it
                with suppress(CommandRejected):
                    self._tell(Command("*RST"))
                troubles += [trouble for number in order if (trouble := self._try_off(number)) is not None]
                on = [number for number in on if self._flag(number, "STAT")]
            if on:
                names, why = ", ".join(map(_name, on)), f" ({troubles[0]})" if troubles else ""
                raise LaserDoubt(f"{self.name}: {names} of the box cannot be switched off{why}")

    def load(self, schedule: Schedule) -> Schedule:
        """Write and read back; the period only if it is another one, so that lamps do not miss a beat."""
        with self._lock:
            on_outputs = self._with_output(schedule)
            self._require_dark()
            for keyword, value in (("MOD", "NORM"), ("TRIG:MOD", "DIS"), *self._gate_settings()):
                self._keep(T0, keyword, value)
            for role in self.wiring:  # all: a mixed output gives the pulses of another one
                for word, value in self._settings(role):
                    self._keep(self._number(role), word, value)
            period_us = 1e6 * self._put_seconds(T0, "PER", schedule.period_us * 1e-6, 9)
            pulses = {role: self._load_pulse(role, pulse) for role, pulse in on_outputs.items()}
            return Schedule(period_us, pulses, schedule.light_delay_us)

    def start_lamps(self) -> None:
        """Switch the lamps' outputs on, then T0."""
        with self._lock:
            for number in [*self._numbers(*LAMPS), T0]:
                self._set(number, "STAT", "1", moves=True)

    def stand_by(self) -> None:
        """Switch T0 on, and no output."""
        with self._lock:
            self._set(T0, "STAT", "1", moves=True)

    def confirm(self, schedule: Schedule, lamps: bool) -> None:
        """Read everything again that has been loaded."""
        with self._lock:
            self._require_dark()
            self._require_steady_clock()
            self.require_lamps(lamps)
            self._require_seconds(T0, "PER", schedule.period_us * 1e-6)
            for keyword, value in self._gate_settings():
                self._require(T0, keyword, value)
            for role, pulse in schedule.pulses.items():
                number = self._number(role)
                for word, value in self._settings(role):
                    self._require(number, word, value)
                self._require_seconds(number, "DEL", pulse.delay_us * 1e-6)
                self._require_seconds(number, "WIDT", pulse.width_us * 1e-6)

    def require_lamps(self, on: bool) -> None:
        """Ask for the states of T0, which runs in any case, and of the lamps' outputs."""
        with self._lock:
            for number in self._numbers(*LAMPS):
                self._require(number, "STAT", "1" if on else "0")
            if not self._flag(T0, "STAT"):  # last: what follows may restart T0
                raise LaserDoubt(f"{self.name} {STOPPED}")

    def begin(self, pairs: int, camera: bool = True) -> None:
        """Counts first, then in one string: T0 asked and off, outputs on, T0 on: RUN, with which all begin."""
        with self._lock:
            self._require_dark()
            seen = self._numbers(Role.CAMERA, Role.CAMERA_B, Role.MARKER) if camera else []
            burst = [*seen, *self._numbers(*reversed(Q_SWITCHES))]
            if not 1 <= pairs <= LARGEST_COUNT:
                raise PulsesRefused(f"{self.name} counts to {LARGEST_COUNT}, not to {pairs}")
            for number in burst:
                self._ask_again(lambda n=number: self._set(n, "BCO", str(pairs)))  # type: ignore[misc]
                if self._whole(number, "BCO") != pairs:
                    raise LaserDoubt(f"{self.name}: {_name(number)} does not accept its count")
            for role in self.wiring:
                for word, value in self._settings(role)[:3]:  # the last look at what would give other pulses
                    self._require(self._number(role), word, value)
            self.require_lamps(True)
            if self._pause_s > 0.0:
                self._start_slowly(burst)
            else:
                self._start(burst)

    def end(self) -> None:
        """Every output of the burst off and read back.

        Q-switches before anything is asked: a knob may have made the burst endless, and an answer may stay away.
        T0 runs on behind a burst: if it does not, it was stopped at its keys, or the box was restarted.
        """
        with self._lock:
            numbers = self._numbers(*Q_SWITCHES, Role.CAMERA, Role.CAMERA_B, Role.MARKER)
            self._end_outputs(numbers)
            if any(self._flag(number, "STAT") for number in numbers):
                raise LaserDoubt(f"{self.name} does not end its burst")
            # At the end: T0 of an alignment is stopped next, and a STOP shows no more.
            if not self._flag(T0, "STAT"):
                raise LaserDoubt(f"{self.name} has not run to the end of its burst: it {STOPPED}")

    _clock_word = "ICL:MOD"
    _pause_s = 0.0  # between lines; longer for a box that loses them
    _wrote_s = -math.inf

    def _identify(self) -> str:
        def accept(answer: object) -> str | None:
            match answer:
                case Value(text) if text.count(",") >= 2 and text.upper().startswith(_MAKERS):
                    return text
            return None

        return self._transact(Command("*IDN", asks=True).to_bytes(), accept)

    def _set_up(self) -> None:
        catalogue = self._ask_until_equal(lambda: self._ask(":INST:CAT"))
        self._outputs = sum(1 for word in catalogue.split(",") if word.strip().upper().startswith("CH"))
        if not 1 <= self._outputs <= len(OUTPUTS):
            raise WrongBox(f"{self.name}: no pulse generator has the outputs {catalogue!r}")
        for role, output in self.wiring.items():
            if output not in OUTPUTS[: self._outputs]:
                raise WrongBox(f"{self.name}: {role} is on output {output}, and the box has {catalogue}")
        try:
            runs_by_itself = self._ask_until_equal(lambda: self._ask(":SYST:AUT"))
        except CommandRejected as refused:
            if refused.code not in UNKNOWN_WORD:  # a box that does not know the word does not do it
                raise
            runs_by_itself = "0"
        if runs_by_itself != "0":
            raise WrongBox(
                f"{self.name} is set to run by itself when it gets power (autorun); switch that off at its front "
                "panel, because a power dip would fire the laser"
            )
        self._find_clock_word()
        self._require_steady_clock()
        self._learn_whether_lines_get_lost()

    def _learn_whether_lines_get_lost(self) -> None:
        """Send off in one string, and expect an answer to every line of it."""
        (off,) = self.off_bytes()
        unanswered = off.count(b"\n")

        def accept(answer: object) -> bool | None:
            nonlocal unanswered
            unanswered -= isinstance(answer, Done | Refused)
            return True if unanswered == 0 else None

        try:
            self._transact(off, accept)
        except (NoReply, ProtocolViolation):
            self._pause_s = PAUSE_S

    def _find_clock_word(self) -> None:
        """Learn which of the two words of the clock this box knows, the likelier one first."""
        words = ["ICL", "ICL:MOD"]
        if self.identity.partition(",")[2].startswith(NEWER_CLOCKS):
            words.reverse()
        for word in words:
            try:
                self._text(T0, word)
            except CommandRejected as refused:
                if refused.code not in UNKNOWN_WORD:
                    raise
                continue
            self._clock_word = word
            return
        raise WrongBox(f"{self.name} ({self.identity}) does not report its clock; it supports neither {words}")

    def _require_steady_clock(self) -> None:
        said = self._text(T0, self._clock_word)
        if not _CLOCKS.fullmatch(said):
            raise WrongBox(f"{self.name}: its clock says {said!r}, so dt is undefined; lock it, or use its own")

    def _require_dark(self) -> None:
        for number in self._numbers(*Q_SWITCHES):
            if self._flag(number, "STAT"):
                raise LaserDoubt(f"{self.name}: the Q-switch on {_name(number)} is on")

    def _load_pulse(self, role: Role, pulse: Pulse) -> Pulse:
        number = self._number(role)
        width_us = 1e6 * self._put_seconds(number, "WIDT", pulse.width_us * 1e-6, 11)
        delay_us = 1e6 * self._put_seconds(number, "DEL", pulse.delay_us * 1e-6, 11)
        return Pulse(delay_us, width_us)

    def _settings(self, role: Role) -> list[tuple[str, str]]:
        """Required settings of a channel besides its numbers; each could make light where none is asked for."""
        number = self._number(role)
        mux = 1 << (number - 1)
        if role is Role.CAMERA and Role.CAMERA_B in self.wiring:
            mux |= 1 << (self._number(Role.CAMERA_B) - 1)
        mode = "NORM" if role in LAMPS else "BURS"
        return [("CMOD", mode), ("MUX", str(mux)), ("POL", "NORM"), ("SYNC", "T0"), ("CGAT", "DIS"), ("WCO", "0")]

    def _gate_settings(self) -> tuple[tuple[str, str], ...]:
        """The box's own gate: not used, or its outputs are inhibited while its input is not at that level."""
        if self.gate is None:
            return (("GATE:MOD", "DIS"),)
        return (("GATE:MOD", "OUTP"), ("GATE:LOG", self.gate.upper()))

    def _try_off(self, number: int) -> Exception | None:
        """Say off, and once more after a pause to a box that refuses it; what became of that if it was no "ok"."""
        for pause_s in (PAUSE_S, 0.0):
            try:
                self._off(number)
                return None
            except CommandRejected as refused:
                trouble: Exception = refused
                self.clock.sleep_s(pause_s)
            except (NoReply, ProtocolViolation) as unheard:
                return unheard
        return trouble

    def _end_outputs(self, numbers: Sequence[int]) -> None:
        """Off, each answered; written to all of them as soon as one is not, before that is waited for."""
        sent: list[int] = []
        with suppress(NoReply, ProtocolViolation):
            while not self._suspect and len(sent) < len(numbers):
                sent.append(numbers[len(sent)])
                self._set(sent[-1], "STAT", "0", timeout_s=FIRST_OFF_ANSWER_S)
        if not self._suspect:
            return
        lights = self._numbers(*Q_SWITCHES)
        for number in [*lights[len(sent) :], *ROUNDS_AT_END * lights, *numbers[len(lights) :]]:
            self.clock.sleep_s(self._pause_s)
            self.port.write(Command(f":PULSE{number}:STAT", "0").to_bytes())
        self._suspect = True
        for number in numbers:
            self._off(number)

    def _start(self, burst: Sequence[int]) -> None:
        """Begin a burst in one string, of which the first line asks whether T0 was stopped.

        An exchange more would be time in which a STOP is undone.  A box that refuses to stop T0 is reset at once.
        """
        lines = [(T0, "0"), *((number, "1") for number in [*burst, T0])]
        words = [Command(f":PULSE{T0}:STAT", asks=True), *(Command(f":PULSE{n}:STAT", v) for n, v in lines)]
        unanswered = list(words)

        def accept(answer: object) -> bool | None:
            word = unanswered[0]
            if word.asks and isinstance(answer, Value):
                if answer.text != "1":
                    raise LaserDoubt(f"{self.name} {STOPPED}")
            elif word.asks or not isinstance(answer, Done):
                self._judge(answer, f"{word.keyword} {word.value}")
                return None
            unanswered.pop(0)
            return None if unanswered else True

        try:
            self._transact(b"".join(word.to_bytes() for word in words), accept, moves=True)
        except CommandRejected:  # T0 may run on with the outputs on: a reset is the quickest end
            self.drop()
            self.port.write(Command("*RST").to_bytes())
            raise

    def _start_slowly(self, burst: Sequence[int]) -> None:
        """Begin a burst line by line, and see before and after RUN that no other program has switched off."""
        witness = [*self._numbers(*LAMPS), *burst][0]
        self._off(T0)
        for number in burst:
            self._set(number, "STAT", "1", moves=True)
        self._require(witness, "STAT", "1")
        self._set(T0, "STAT", "1", moves=True)
        self._require(witness, "STAT", "1")

    def _off(self, number: int) -> None:
        self._ask_again(lambda: self._set(number, "STAT", "0"))

    def _require(self, number: int, keyword: str, value: str) -> None:
        """Raise if something has not (any more) the value that it must have."""
        if self._ask_again(lambda: self._ask(f":PULSE{number}:{keyword}")) == value:
            return
        if (found := self._text(number, keyword)) != value:
            what = f"{_name(number)} {keyword} is {found}, not {value}"
            raise LaserDoubt(f"{self.name} no longer holds what it was loaded with ({what}); was it restarted?")

    def _require_seconds(self, number: int, keyword: str, seconds: float) -> None:
        if abs(self._seconds(number, keyword) - seconds) > 1e-12:
            what = f"{_name(number)} {keyword} is not {seconds} s"
            raise LaserDoubt(f"{self.name} no longer holds what it was loaded with ({what})")

    def _keep(self, number: int, keyword: str, value: str) -> None:
        """See that something has a value, and write it only if it has not."""
        if self._text(number, keyword) == value:
            return
        self._ask_again(lambda: self._set(number, keyword, value))
        if (found := self._text(number, keyword)) != value:
            raise LaserDoubt(f"{self.name}: {_name(number)} {keyword} was set to {value} and reads {found}")

    def _put_seconds(self, number: int, keyword: str, seconds: float, digits: int) -> float:
        """Write a number if the box has another one; return what it has then."""
        step_s = max(1.01 * self.least_step_us * 1e-6, 10.0**-digits)
        before_s = self._seconds(number, keyword)
        if abs(before_s - seconds) > 10.0**-digits:
            self._ask_again(lambda: self._set(number, keyword, f"{seconds:.{digits}f}"))
            before_s = self._seconds(number, keyword)
            if abs(before_s - seconds) > step_s:
                was = f"was set to {seconds} s and reads {before_s} s"
                raise LaserDoubt(f"{self.name}: {_name(number)} {keyword} {was}")
        return before_s

    def _flag(self, number: int, keyword: str) -> bool:
        """A boolean that two answers agree on."""
        return self._read_checked(number, keyword, _BOOLEAN, "is neither 0 nor 1") == "1"

    def _seconds(self, number: int, keyword: str) -> float:
        """A time that two answers agree on, with all its digits."""
        return float(self._read_checked(number, keyword, _SECONDS, "has not all the digits of a time"))

    def _whole(self, number: int, keyword: str) -> int:
        """A count that two answers agree on."""
        return int(self._read_checked(number, keyword, _WHOLE, "is no count"))

    def _read_checked(self, number: int, keyword: str, form: re.Pattern[str], wrong: str) -> str:
        text = self._text(number, keyword)
        if not form.fullmatch(text):
            self._suspect = True
            raise ProtocolViolation(f"{self.name}: {keyword} {wrong}", text.encode())
        return text

    def _text(self, number: int, keyword: str) -> str:
        """A value that two answers agree on."""
        return self._ask_until_equal(lambda: self._ask(f":PULSE{number}:{keyword}"))

    def _ask(self, keyword: str) -> str:
        def accept(answer: object) -> str | None:
            match answer:
                case Value(text):
                    return text
            self._judge(answer, keyword)
            return None

        return self._transact(Command(keyword, asks=True).to_bytes(), accept)

    def _set(
        self, number: int, keyword: str, value: str, moves: bool = False, timeout_s: float | None = None
    ) -> bool:
        return self._tell(Command(f":PULSE{number}:{keyword}", value), moves, timeout_s)

    def _tell(self, command: Command, moves: bool = False, timeout_s: float | None = None) -> bool:
        def accept(answer: object) -> bool | None:
            if isinstance(answer, Done):
                return True
            self._judge(answer, f"{command.keyword} {command.value or ''}".rstrip())
            return None

        return self._transact(command.to_bytes(), accept, timeout_s, moves=moves)

    def _judge(self, answer: object, what: str) -> None:
        """Skip an echo; raise what is not an answer to this."""
        if isinstance(answer, Refused):
            reason = REASONS.get(answer.code, "an unknown reason")
            raise CommandRejected(f"{self.name} refused {what!r}: {reason} (?{answer.code})", answer.code)
        if not isinstance(answer, Echo):
            raise ProtocolViolation(f"{self.name}: {answer!r} is not an answer to {what!r}")

    def _clear_line(self) -> None:
        super()._clear_line()
        self.clock.sleep_s(max(0.0, self._wrote_s + self._pause_s - self.clock.now_s()))
        self._wrote_s = self.clock.now_s()

    def _ask_again(self, ask: Callable[[], T]) -> T:
        """Ask again, and slower from then on if no answer came."""
        try:
            return ask()
        except NoReply:
            self._pause_s = PAUSE_S
        except ProtocolViolation:
            pass
        return super()._ask_again(ask)

    def _number(self, role: Role) -> int:
        return OUTPUTS.index(self.wiring[role]) + 1

    def _numbers(self, *roles: Role) -> list[int]:
        return [self._number(role) for role in roles if role in self.wiring]


def _name(number: int) -> str:
    return "T0" if number == T0 else f"output {OUTPUTS[number - 1]}"
