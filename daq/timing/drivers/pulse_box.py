"""Driver of a counter for 30 euro: the pulse generator of Micro-Manager, which waits for its input.

The board sends a pulse for every rising edge at its input, and says at `stop` how many it has sent; its own output
is left open. For that the firmware has to be built with ``inputStateDeviceIsBusy = LOW``; a board that is built
otherwise sends pulses while nothing comes, which is found when counting begins.

**When an edge counts.** The firmware has a timer that runs on from the first edge after `start`. An edge counts if
the timer has ticked since the last one, and a tick while the input is high counts as well. So the interval is half
of a period and `d` more: ticks fall 2 d, 4 d, 6 d .. behind the edges, where the input is low again, for
period / 4 d periods. `d` is longer than a pulse, and longer than what two quartz clocks drift apart in a period.
"""

from collections.abc import Callable

from daq.errors import RunUsageError
from daq.timing.protocols.pulse_box import (
    INTERVAL_US,
    LENGTH_US,
    PULSES,
    START,
    STOP,
    VERSION,
    WAITS,
    AnswerStream,
    Command,
    Question,
    Reply,
)
from daq.timing.pulses import Pulse
from stages.errors import NoReply, ProtocolViolation, WrongDevice
from stages.link import QUIET_S, Link

BAUD = 115_200
KNOWN_VERSION = 1
OUTPUT_US = 5  # length of the pulses of its own output, to which nothing is connected
DRIFT = 2e-4  # of two quartz clocks, with room
LEAST_COUNT = 21  # pulses in a row that it has to be able to count
IDLE_S = 0.2  # in which nothing may be counted while nothing comes


class PulseBox(Link):
    """A board that counts the rising edges at its input."""

    first_day = "A Teensy needs the firmware TeensyPulseGenerator of Micro-Manager."
    decoder = AnswerStream
    most = 0  # pulses that one count may have

    def connect(self, url: str) -> None:
        """Open the port; WrongDevice unless a pulse box of the known version answers."""
        with self._lock:
            self.close()
            self._open_port(url, BAUD)
            try:
                self._suspect = False
                self.port.drain(QUIET_S)
                try:
                    self.identity = self._ask_until_equal(self._identify)
                except (NoReply, ProtocolViolation) as error:
                    raise NoReply(self._unheard()) from error
                if self.identity != str(KNOWN_VERSION):
                    raise WrongDevice(
                        f"{self.name}: its firmware has version {self.identity}, not {KNOWN_VERSION}"
                    )
                self._tell(STOP)
            except BaseException:
                self.close()
                raise

    def expect(self, period_us: float, pulse: Pulse) -> None:
        """Make ready to count pulses of that width, one a period; RunUsageError if it cannot count those."""
        later_us = 1.5 * pulse.width_us + DRIFT * period_us
        self.most = int(period_us / (4.0 * later_us))
        if self.most < LEAST_COUNT:
            raise RunUsageError(
                f"{self.name} cannot count pulses of {pulse.width_us:g} us every {period_us:g} us: they are too "
                "long; count this output by the camera"
            )
        self._tell(STOP)
        for code, number in (
            (INTERVAL_US, round(period_us / 2.0 + later_us)), (LENGTH_US, OUTPUT_US), (WAITS, 1), (PULSES, 0),
        ):  # fmt: skip
            if self._tell(code, number) != number:
                raise WrongDevice(f"{self.name} rejects {number} for its setting {code}")
        self._tell(START)
        self.clock.sleep_s(IDLE_S)
        if found := self.restart():
            raise WrongDevice(
                f"{self.name} has counted {found} pulses where there were none; build its firmware with "
                "inputStateDeviceIsBusy = LOW, and check that its input is connected to an output of the box"
            )

    def restart(self) -> int:
        """Return the pulses since the count began, and begin another one."""
        with self._lock:
            found = self._tell(STOP)
            self._tell(START)
            return found

    def stop(self) -> int:
        """Return the pulses since the count began, and end it."""
        return self._tell(STOP)

    def _tell(self, code: int, number: int = 0) -> int:
        # never said twice: a second stop or start would end the count that it asks for
        return self._transact(Command(code, number).to_bytes(), _answer_of(code))

    def _identify(self) -> str:
        return str(self._transact(Question(VERSION).to_bytes(), _answer_of(VERSION)))


def _answer_of(code: int) -> Callable[[object], int | None]:
    def accept(answer: object) -> int | None:
        if isinstance(answer, Reply) and answer.code == code:
            return answer.number
        raise ProtocolViolation(f"{answer!r} is not an answer to command {code}")

    return accept
