"""Driver for the DG645 of Stanford Research Systems, in burst mode: the box itself counts the pulses of a chunk.

One trigger starts a burst of BURC cycles, in each of which every output is high from its first channel to its
second. So lamps, which run on between bursts, cannot hang on it, and neither can a second trigger of the camera:
the box adds no outputs.

**Off is three things.** Outputs of no length (each second channel 0 behind its first), which gives no pulse
whatever triggers the box; single shot as the trigger source, so that nothing triggers it but a word or a key; and
burst mode off. No text at hand says whether burst mode off ends a burst that runs; no length makes the rest of one
dark, and nothing is loaded before it is over. All are written in one string, Q-switches first, and read back.

**On.** Lengths stay zero until a burst begins, so that a key that triggers gives no pulse. They are written and
read back, and burst mode is asked for directly before the trigger: off by another program, or at the keys, between
the look and the trigger has also taken the lengths away. Behind a loss of power outputs have the lengths of the
factory, 10 ns, until they are asked for, and the key that triggers gives one such pulse.

**Nothing that is set is answered**, and there is no checksum: everything is read back, twice.
"""

import re
from collections.abc import Sequence

from daq.timing.box import TimingBox
from daq.timing.errors import LaserDoubt, PulsesRefused, WrongBox
from daq.timing.protocols.srs_dg645 import (
    ENDED_BURST,
    IS_BUSY,
    IS_IN_BURST,
    SINGLE_SHOT,
    UNLOCKED,
    WAS_TRIGGERED,
    AnswerStream,
    Command,
    Value,
)
from daq.timing.pulses import LAMPS, Q_SWITCHES, Pulse, Role, Schedule
from stages.errors import ProtocolViolation

OUTPUTS = ("AB", "CD", "EF", "GH")
T0 = 0
LARGEST_COUNT = 2**31 - 1
STEP_S = 5e-12
GATE_ANSWER_S = 0.15  # for the answer that says whether outputs may have a length
LONGEST_BURST_S, IDLE_POLL_S = 12.0, 0.05  # a chunk lasts 10 s at most
_NUMBER = re.compile(r"[+-]?\d+(\.\d+)?([eE][+-]?\d+)?")
_DELAY = re.compile(r"(\d),([+-]?\d+\.\d{12})")
FIXED = {"ADVT": "0", "INHB": "0", "BURT": "0", "BURD": "0"}  # nothing but the trigger says when cycles come


class Dg645Box(TimingBox):
    """A DG645."""

    default_baud = 9600
    counts = True
    least_step_us = 1e-5
    reply_timeout_s = 1.0
    decoder = AnswerStream

    _loaded: Schedule | None = None
    _happened = 0  # bits of INSR that were asked for since the trigger

    def off_bytes(self) -> Sequence[bytes]:
        """No length, Q-switches first; then nothing triggers, and no burst. Twice, behind the end of any line."""
        order = [self.wiring[role] for role in Q_SWITCHES if role in self.wiring]
        order += [output for output in OUTPUTS if output not in order]
        lines = b"".join(_length(output, 0.0) for output in order)
        return [
            b"\n" + 2 * (lines + Command("TSRC", str(SINGLE_SHOT)).to_bytes() + Command("BURM", "0").to_bytes())
        ]

    def silence(self) -> None:
        """Write everything off and read it back, every output there is."""
        with self._lock:
            self.drop()
            self._loaded = None
            for word, off in (("TSRC", SINGLE_SHOT), ("BURM", 0)):
                if (found := self._whole(word)) != off:
                    raise LaserDoubt(f"{self.name} does not switch off: {word} is {found}, not {off}")
            self._require_no_lengths()

    def load(self, schedule: Schedule) -> Schedule:
        """Write period and delays, with outputs of no length."""
        with self._lock:
            on_outputs = self._with_output(schedule)
            self._wait_until_idle()
            self._require_dark()
            for word, value in FIXED.items():
                self._keep(word, value)
            period_s = self._keep("BURP", f"{schedule.period_us * 1e-6:.12f}")
            pulses = {role: self._place(self.wiring[role], pulse) for role, pulse in on_outputs.items()}
            if self._loaded is None:
                self._keep("BURM", "1")
            self._require_burst_mode()  # an off since it was loaded first holds until `silence`
            self._loaded = Schedule(1e6 * period_s, pulses, schedule.light_delay_us)
            return self._loaded

    def start_lamps(self) -> None:
        """There are none."""
        raise WrongBox(f"{self.name} has no outputs that lamps could run on")

    def confirm(self, schedule: Schedule, lamps: bool) -> None:
        """Read everything again that has been loaded."""
        with self._lock:
            self._require_dark()
            self._require_burst_mode()
            for word, value in (*FIXED.items(), ("BURP", f"{schedule.period_us * 1e-6:.12f}")):
                if abs((found := self._number(word)) - float(value)) > STEP_S:
                    raise LaserDoubt(f"{self.name} no longer holds what it was loaded with ({word} is {found:g})")
            for role, pulse in schedule.pulses.items():
                start = _channels(self.wiring[role])[0]
                if self._delay(start) != (T0, _seconds(pulse.delay_us)):
                    raise LaserDoubt(f"{self.name} no longer holds what it was loaded with (delay of {role})")
            for output in self.wiring.values():
                self._require_positive(output)

    def begin(self, pairs: int, camera: bool = True) -> None:
        """Write the count, give the outputs their lengths, and trigger."""
        with self._lock:
            if self._loaded is None:
                raise LaserDoubt(f"{self.name} has no burst to start")
            if not 1 <= pairs <= LARGEST_COUNT:
                raise PulsesRefused(f"{self.name} counts to {LARGEST_COUNT}, not to {pairs}")
            self._keep("BURC", str(pairs))
            self._require_dark()
            self._registers("INSR")  # asking clears it
            self._require_not_off()
            given = [*Q_SWITCHES, *((Role.CAMERA, Role.MARKER) if camera else ())]
            lengths = {self.wiring[role]: p.width_us for role, p in self._loaded.pulses.items() if role in given}
            for output, width_us in lengths.items():
                self._send(_length(output, _seconds(width_us)), moves=True)
            self._require_not_off()  # an off between the lengths has left those that came behind it
            for output in OUTPUTS:
                start, end = _channels(output)
                if self._delay(end) != (start, _seconds(lengths.get(output, 0.0))):
                    raise LaserDoubt(f"{self.name}: output {output} rejects its length, or was switched off")
            self._require_burst_mode()  # last of all: an off in between has cleared it
            self._send(Command("*TRG").to_bytes(), moves=True)
            self._happened = self._registers("INSR")
            if not self._happened & WAS_TRIGGERED:
                raise LaserDoubt(f"{self.name} was not triggered; was it switched off, or is it used by hand?")

    def end(self) -> None:
        """Take the lengths away, and ask whether the burst has come to its end by itself."""
        with self._lock:
            for output in OUTPUTS:
                self._send(_length(output, 0.0))
            self._require_no_lengths()
            self._require_idle()
            if not (self._happened | self._registers("INSR")) & ENDED_BURST:
                raise LaserDoubt(f"{self.name} has not run to the end of its burst; was it stopped by hand?")
            self._require_burst_mode()

    # ---- inside ------------------------------------------------------------------------------------

    def _identify(self) -> str:
        def accept(answer: object) -> str | None:
            match answer:
                case Value(text) if ",DG645," in text:
                    return text
            return None

        return self._transact(Command("*IDN", asks=True).to_bytes(), accept)

    def _set_up(self) -> None:
        if self.gate is not None:
            raise WrongBox(f"{self.name} has no gate input that this driver could set; leave out `gate`")
        for role, output in self.wiring.items():
            if role in LAMPS or role is Role.CAMERA_B:
                why = "lamps run on between bursts" if role in LAMPS else "the box adds no outputs"
                raise WrongBox(f"{self.name}: {role} cannot hang on a DG645, because {why}")
            if output not in OUTPUTS:
                raise WrongBox(f"{self.name}: {role} is on output {output!r}, not on one of {', '.join(OUTPUTS)}")
        self._registers("INSR")
        if self._registers("INSR") & UNLOCKED:
            raise WrongBox(f"{self.name}: its clock is not locked, so dt is undefined; lock it, or use its own")

    def _require_dark(self) -> None:
        if (source := self._whole("TSRC")) != SINGLE_SHOT:
            raise LaserDoubt(f"{self.name}: its trigger source is {source}, so it fires by itself")
        self._require_no_lengths()
        self._require_idle()

    def _require_no_lengths(self) -> None:
        for output in OUTPUTS:
            start, end = _channels(output)
            if self._delay(end) != (start, 0.0):
                raise LaserDoubt(f"{self.name}: output {output} is on")

    def _wait_until_idle(self) -> None:
        """Let a burst that was switched off come to its end, which gives no pulses."""
        end_s = self.clock.now_s() + LONGEST_BURST_S
        while self._is_busy() and self.clock.now_s() < end_s:
            self.clock.sleep_s(IDLE_POLL_S)

    def _is_busy(self) -> bool:
        return bool(self._ask_until_equal(lambda: self._registers("*STB") & (IS_BUSY | IS_IN_BURST)))

    def _require_idle(self) -> None:
        if self._is_busy():
            raise LaserDoubt(f"{self.name} is still in a burst")

    def _require_burst_mode(self) -> None:
        if self._whole("BURM") != 1:
            raise LaserDoubt(f"{self.name} is not in burst mode any more; it was switched off, or restarted")

    def _require_not_off(self) -> None:
        """Ask once, and not for long: while outputs may have a length, the key that triggers gives light."""
        if self._ask("BURM", timeout_s=GATE_ANSWER_S) != "1":
            raise LaserDoubt(f"{self.name} was switched off while its burst began")

    def _require_positive(self, output: str) -> None:
        if self._whole("LPOL", str(1 + OUTPUTS.index(output))) != 1:
            raise LaserDoubt(f"{self.name}: output {output} is inverted, so it is high while it is off")

    def _place(self, output: str, pulse: Pulse) -> Pulse:
        """Write when an output rises; how long it is high is written when a burst begins."""
        start, _ = _channels(output)
        number = str(1 + OUTPUTS.index(output))
        if self._whole("LPOL", number) != 1:
            self._send(Command("LPOL", f"{number},1").to_bytes())
            self._require_positive(output)
        wanted = (T0, _seconds(pulse.delay_us))
        if self._delay(start) != wanted:
            self._send(Command("DLAY", f"{start},{T0},{wanted[1]:.12f}").to_bytes())
            if (found := self._delay(start)) != wanted:
                raise LaserDoubt(f"{self.name}: output {output} was set to {wanted} and reads {found}")
        return Pulse(1e6 * wanted[1], 1e6 * _seconds(pulse.width_us))

    def _keep(self, word: str, value: str) -> float:
        """See that a setting has a value, and write it only if it has not; return it."""
        if abs(self._number(word) - float(value)) > STEP_S:
            self._send(Command(word, value).to_bytes())
            if abs((found := self._number(word)) - float(value)) > STEP_S:
                raise LaserDoubt(f"{self.name}: {word} was set to {value} and reads {found:g}")
        return float(value)

    # ---- words -------------------------------------------------------------------------------------

    def _delay(self, channel: int) -> tuple[int, float]:
        """Reference and delay [s] of a channel, that two answers agree on."""
        match = _DELAY.fullmatch(text := self._ask_until_equal(lambda: self._ask("DLAY", str(channel))))
        if match is None:
            raise self._unreadable(f"DLAY? {channel}", text)
        return int(match[1]), float(match[2])

    def _number(self, word: str) -> float:
        text = self._ask_until_equal(lambda: self._ask(word))
        if not _NUMBER.fullmatch(text):
            raise self._unreadable(f"{word}?", text)
        return float(text)

    def _whole(self, word: str, values: str = "") -> int:
        text = self._ask_until_equal(lambda: self._ask(word, values))
        if not text.isdecimal():
            raise self._unreadable(f"{word}?", text)
        return int(text)

    def _registers(self, word: str) -> int:
        """Ask for a sum of bits, once: asking may clear them."""
        if not (text := self._ask(word)).isdecimal():
            raise self._unreadable(f"{word}?", text)
        return int(text)

    def _unreadable(self, asked: str, text: str) -> ProtocolViolation:
        self._suspect = True
        return ProtocolViolation(f"{self.name}: {text!r} is not an answer to {asked}", text.encode())

    def _ask(self, word: str, values: str = "", timeout_s: float | None = None) -> str:
        def accept(answer: object) -> str | None:
            return answer.text if isinstance(answer, Value) else None

        return self._transact(Command(word, values, asks=True).to_bytes(), accept, timeout_s)


def _channels(output: str) -> tuple[int, int]:
    first = 2 + 2 * OUTPUTS.index(output)
    return first, first + 1


def _length(output: str, seconds: float) -> bytes:
    start, end = _channels(output)
    return Command("DLAY", f"{end},{start},{seconds:.12f}").to_bytes()


def _seconds(us: float) -> float:
    """Round to the step of the box, as its answers have it: 12 digits."""
    return float(f"{round(us * 1e-6 / STEP_S) * STEP_S:.12f}")
