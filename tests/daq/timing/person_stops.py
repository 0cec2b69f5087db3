"""A person ends the light at any exchange of a run of three chunks: what leaves the Q-switches after that.

    python -m tests.daq.timing.person_stops                 # a table of box and moment, every exchange
    python -m tests.daq.timing.person_stops --by byte       # every byte

The person presses STOP at the box, has another program write the bytes of `off` to it, says `rtpiv laser off`,
opens the door for a moment, presses Ctrl-C, or kills the program, after which only the watchdog writes to the box,
if it was told by then that something may be on.  Nobody releases anything afterwards, so no pulse may rise later
than `LATE_S` after it, and the run has to end with an error; of a program that has ended nothing may be left on.
Of the watchdog's string a box that loses lines hears the first, T0, which ends everything.  The one exception is
`start`: RUN undoes a STOP that falls between the question for T0 and RUN, which are in one string, or in six lines
of a box that loses lines (ADR 42).
"""

import argparse
import math
from collections import Counter
from contextlib import contextmanager, suppress
from functools import cache, partial

from daq.errors import DaqError
from daq.timing.conditions import Conditions, Rules
from daq.timing.drivers.pivlab_synchroniser import OltSyncBox, XmSyncBox
from daq.timing.drivers.quantum_composers import QuantumComposersBox
from daq.timing.drivers.srs_dg645 import Dg645Box
from daq.timing.laser import Laser
from daq.timing.pulses import Q_SWITCHES, LaserHead, PairExposures, PulseTiming, Role
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.mechanics.clock import VirtualClock
from sim.timing_boxes.pivlab_synchroniser import OltSyncEmulator, XmSyncEmulator
from sim.timing_boxes.quantum_composers import QuantumComposersEmulator, Variant
from sim.timing_boxes.srs_dg645 import Dg645Emulator
from stages.errors import StageError
from tests.stages.killed import Killed, ToldWatchdog

LATE_S = 0.3
T0_OFF = b":PULSE0:STAT 0\r\n"
CHUNKS, PAIRS, RATE_HZ = 3, 20, 10.0
GOOD = Conditions(True, True, True, 5.0, 1000)
LAMPS = {Role.LAMP_1: "A", Role.Q_SWITCH_1: "B", Role.LAMP_2: "C", Role.Q_SWITCH_2: "D", Role.CAMERA: "E"}
PUMPED = {Role.Q_SWITCH_1: "A", Role.Q_SWITCH_2: "B", Role.CAMERA: "C", Role.MARKER: "D"}
DG645 = {Role.Q_SWITCH_1: "AB", Role.Q_SWITCH_2: "CD", Role.CAMERA: "EF"}
DIODE = {Role.CAMERA: "1", Role.Q_SWITCH_1: "2"}
HEADS = {"lamps": LaserHead(max_rate_hz=15.0, lamp_to_q_switch_us=[180.0, 185.0]),
         "diodes": LaserHead(max_rate_hz=100.0, pulse_us=50.0)}  # fmt: skip
FIRMWARE = {
    f"{wiring} {arms}{' slow' if needs_s else ''}": (wiring, {"arms": arms, "needs_s": needs_s})
    for wiring in ("lamps", "diodes")
    for arms in ("run", "run all", "state")
    for needs_s in (0.0, 0.04)
}
OTHERS = {
    "oltSync": (OltSyncBox, OltSyncEmulator, DIODE), "xmSync": (XmSyncBox, XmSyncEmulator, DIODE),
    "dg645": (Dg645Box, Dg645Emulator, DG645),
    "dg645 2": (Dg645Box, partial(Dg645Emulator, ends="nothing"), DG645),
}  # fmt: skip
BOXES = (*FIRMWARE, *OTHERS)
ENDS = ("Ctrl-C", "kill")  # of the program
HOWS = ("STOP", "foreign off", "door", *ENDS)
DARKENS = {  # a DG645, beside these
    "power": lambda run: run.line.power_cycle(0.05),
    "source": lambda run: (run.emulator.set_inside("TSRC", 1), run.emulator._end_periods()),
}
WATCHDOG_S = (0.05, 0.08, 0.13, 0.25)  # after a kill, when it writes off
SAYS_NOTHING = {("oltSync", "STOP"), ("xmSync", "STOP")}  # the key of a diode laser, which no line reports


class Door:
    """A switch that a test opens."""

    def __init__(self):
        self.closed = True

    def is_closed(self):
        return self.closed

    def close(self):
        pass


class Run:
    """Three chunks, as a run fires them, on one box."""

    def __init__(self, box, how):
        self.clock = VirtualClock()
        self.how, self.moment, self.is_slow = how, "open", box.endswith("slow")
        self.stopped_s, self.when, self.is_at_this_write, self.error = math.inf, "", False, None
        if box in OTHERS:
            driver, firmware, wiring = OTHERS[box]
            head = HEADS["diodes"]
            self.emulator = firmware(self.clock)
        else:
            lit, options = FIRMWARE[box]
            driver, wiring, head = QuantumComposersBox, LAMPS if lit == "lamps" else PUMPED, HEADS[lit]
            self.emulator = QuantumComposersEmulator(self.clock, Variant(**options))
        self.line = Line(self.emulator, self.clock)
        self.line.on_told = self.told
        self.box = driver("laser", wiring, self.clock)
        self.box.address = getattr(self.emulator, "name", "")
        self.box.watchdog = self.watchdog = ToldWatchdog()
        self.door = Door()
        self.laser = Laser("laser", self.box, head, Rules(warmup_s=0.5, uncounted=True), self.clock)
        self.lit = {wiring[role] for role in Q_SWITCHES if role in wiring}
        self.late = Counter()
        self.emulator.outputs.listen(self.judge)

    def judge(self, pulse):
        if pulse.output in self.lit and pulse.rises_s > self.stopped_s + LATE_S:
            self.late[pulse.output] += 1

    def stop(self):
        """The person acts, now."""
        self.emulator.advance()
        self.stopped_s, self.when, self.is_at_this_write = self.clock.now_s(), self.moment, True
        if self.how == "STOP":
            self.emulator.person_stops()
        elif self.how == "foreign off":
            self.send_off()
        elif self.how == "Ctrl-C":
            raise KeyboardInterrupt
        elif self.how == "kill":
            self.line.send = lambda data: None
            for after_s in WATCHDOG_S if self.watchdog.is_told else ():
                self.clock.at(self.clock.now_s() + after_s, self.feed_off)
            raise Killed
        elif self.how in DARKENS:
            DARKENS[self.how](self)
        else:
            self.door.closed = False
            self.laser.switch_opened("the switch of the door is open")  # as the thread does that reads it
            self.door.closed = True

    def feed_off(self):
        for data in self.box.off_bytes():
            self.emulator.feed(data)

    def send_off(self, again_s=(0.03, 0.05, 0.12, 0.3)):
        """Another program writes off, as the watchdog does; a box that is busy loses some of it, or all."""
        self.feed_off()
        if isinstance(self.emulator, QuantumComposersEmulator) and self.emulator.is_on_at(0):
            self.stopped_s, self.when = math.inf, ""
            if again_s:
                self.clock.at(self.clock.now_s() + again_s[0], lambda: self.send_off(again_s[1:]))
        else:
            self.stopped_s, self.when = self.clock.now_s(), self.moment

    def told(self, data):
        """Call the moment `start` within what begins a burst: a STOP is undone there, and nothing tells of it."""
        if self.moment == "begin" and (data == T0_OFF or data.startswith(b":PULSE0:STAT?\r\n:")):
            self.moment = "start"
            if self.is_at_this_write and data == T0_OFF:
                self.when = "start"  # the last question came before it
        self.is_at_this_write = False

    def play(self, at, by="write"):
        """Fire; the person acts before exchange (or after byte) `at` since the laser is warm, or at a time."""
        with suppress(DaqError, StageError, KeyboardInterrupt, Killed):
            try:
                self.begin()
                if at is not None and by in ("write", "byte") and self.how == "door":
                    self.line.hooks.press(at, by, self.stop, lambda: False)  # another thread of the program
                elif at is not None and by in ("write", "byte"):
                    self.line.hooks.after(at, by, self.stop)
                elif at is not None:
                    self.clock.at(self.clock.now_s() + at, self.stop)
                for number in range(CHUNKS):
                    self.chunk(number)
            except BaseException as error:
                self.error = error
                raise
            finally:
                self.line.hooks.clear()
                if self.how == "Ctrl-C":
                    self.laser.close()
        self.moment = "after"
        self.clock.sleep_s(5.0)
        self.emulator.advance()
        return self

    @property
    def is_on(self):
        """Whether the box goes on by itself, or has an output on."""
        outputs = () if self.is_slow else getattr(self.emulator, "_all", ())
        return self.emulator.is_running or any(channel.on for channel in outputs)

    def begin(self):
        self.laser.open("sim://person")
        self.laser.warm(RATE_HZ)
        self.clock.sleep_s(0.6)
        two = isinstance(self.emulator, OltSyncEmulator)
        exposures = (
            PairExposures(9_900.0, 9_900.0, 100.0, two_triggers=True)
            if two
            else PairExposures(100.0, 20_000.0, 2.0)
        )
        self.moment = "set"
        self.laser.set(PulseTiming(250.0, RATE_HZ), exposures)

    def chunk(self, number):
        self.moment = "arm"
        self.laser.arm(GOOD, self.laser.challenge)
        self.moment = "armed"
        self.clock.sleep_s(0.3)
        self.moment = "begin"
        self.laser.renew(GOOD)
        self.laser.fire(PAIRS)
        self.moment = "burst"
        while self.clock.now_s() < self.laser._ends_s and self.laser.look():
            self.clock.sleep_s(0.02)
        self.moment = "end" if number + 1 < CHUNKS else "last end"
        self.laser.wait()
        if number + 1 < CHUNKS:
            self.moment = "pause"
            self.clock.sleep_s(0.4)


@contextmanager
def on_a_line(run):
    LINES["person"] = run.line
    try:
        yield run
    finally:
        LINES.pop("person")


def play(box, how, at=None, by="write"):
    with on_a_line(Run(box, how)) as run:
        return run.play(at, by)


@cache
def passed(box, by):
    """Exchanges, bytes or seconds of a run that nobody disturbs, once it is warm."""
    with on_a_line(Run(box, "STOP")) as run:
        run.begin()
        before, begun_s = dict(run.line.hooks.passed), run.clock.now_s()
        for number in range(CHUNKS):
            run.chunk(number)
        if by == "time":
            return run.clock.now_s() - begun_s
        return run.line.hooks.passed[by] - before[by]


def moments(box, by, count=None):
    """All exchanges or bytes of a run, or `count` of them or of its time, evenly."""
    last = passed(box, by)
    if by == "time":
        return [last * (number + 0.5) / count for number in range(count)]
    return range(1, last + 1, max(1, last // (count or last)))


def listing(box, how, by="write", count=None):
    """(moment -> (played, with late pulses, most late pulses of one plug, ended without an error))."""
    table = {}
    for at in moments(box, by, count):
        run = play(box, how, at, by)
        row = table.setdefault(run.when or "never", [0, 0, 0, 0])
        most = max(run.late.values(), default=0)
        row[0] += 1
        row[1] += most > 0
        row[2] = max(row[2], most)
        row[3] += how in ENDS and run.is_on
        row[3] += run.error is None and run.when not in ("", "last end") and (box, how) not in SAYS_NOTHING
    return table


def main():
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--by", default="write", choices=("write", "byte", "time"))
    parser.add_argument("--count", type=int)
    parser.add_argument("--box", choices=BOXES, action="append")
    options = parser.parse_args()
    print(
        f"box, how, moment: stops at one {options.by} each; with pulses after {LATE_S} s; most; without an error"
    )
    for box in options.box or BOXES:
        for how in HOWS:
            for moment, row in listing(
                box, how, options.by, options.count or (60 if options.by == "time" else None)
            ).items():
                print(
                    f"{box:18s} {how:12s} {moment:7s} {row[0]:6d} {row[1]:6d} {row[2]:4d} {row[3]:6d}", flush=True
                )


if __name__ == "__main__":
    main()
