"""Random sequences of verbs, faults and persons over a laser, before a judge who counts its pulses.

    python -m tests.fuzz.benches.laser --sequences 20000 --seed 1

The judge hangs on the Q-switch outputs of the emulated box and knows the state of the laser at the moment of
every pulse. A pulse is allowed while it is FIRING or ALIGNING, at most as many for each Q-switch as were asked
for; and in UNKNOWN only while no open port leads to the box: nobody can stop that but the box, or a person at it.

**A person ends the light.** The key STOP, an off of another program, `rtpiv laser off`, an open door and `stop`
end it: no pulse rises more than `LATE_S` after any of them until a person releases it, by `safe` or the key RUN.
What reaches the box by no word is not meant (a pulled cable, a line that is lost on its way). A STOP that falls
into the lines by which a box that loses them is started is counted as `unseen` (ADR 42).

A box that loses lines, or refuses off, is told off every `AGAIN_S`; what leaves until the next is its own. It is
told until it reads back as off: by the verb that it has refused, or by the thread that watches a burst.
Whoever leaves the bench opens it again, also one whose cable is put back meanwhile; nothing is on after that.

**Somebody turns a knob.** Whether that makes light is judged by the box itself, never by what the program
believes. While T0 of the box does not run, a knob gives no light, and whatever comes of it later is the program's.
While T0 runs, what leaves by the knob is for whoever has turned it to answer, until the program next hears of it:

==============  ===============================================================================================
cable in        a burst that is made endless ends with the time of its chunk: `LATE_S` after that it is found
cable out       until the cable is in again and a port is open: the first word over it is off
between bursts  an output that is mixed with a lamp gives its pulses until the box is asked for what it holds
==============  ===============================================================================================
"""

import argparse
import math
import random
import sys
import time
from collections import Counter
from contextlib import suppress
from typing import ClassVar

from daq.errors import DaqError
from daq.timing.conditions import Conditions, Rules
from daq.timing.drivers.pivlab_synchroniser import OltSyncBox
from daq.timing.drivers.quantum_composers import QuantumComposersBox
from daq.timing.laser import Laser
from daq.timing.low_energy import LowEnergyRules
from daq.timing.pulses import Q_SWITCHES, LaserHead, PairExposures, PulseTiming, Role
from daq.timing.states import EMITS, LaserState
from daq.timing.switches import OFF
from sim.emulators.faults import KINDS, Fault
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.mechanics.clock import VirtualClock
from sim.timing_boxes.pivlab_synchroniser import OltSyncEmulator
from sim.timing_boxes.quantum_composers import LETTERS, MODELS, QuantumComposersEmulator, Variant
from stages.errors import StageError

BETWEEN = (LaserState.WARM, LaserState.READY, LaserState.ARMED)  # lamps run, and the box is not asked
GOOD = Conditions(True, True, True, 5.0, 10_000)
LAMPS = {Role.LAMP_1: "A", Role.Q_SWITCH_1: "B", Role.LAMP_2: "C", Role.Q_SWITCH_2: "D", Role.CAMERA: "E"}
PUMPED = {Role.Q_SWITCH_1: "A", Role.Q_SWITCH_2: "B", Role.CAMERA: "C", Role.MARKER: "D"}
DIODE = {Role.Q_SWITCH_1: "2", Role.CAMERA: "1"}
RULES = Rules(warmup_s=5.0, uncounted=True, align=LowEnergyRules(q_switch_delay_us=300.0, pulse_us=5.0))
FIELDS = {
    "camera_armed": False, "at_rest": False, "sheet_clearance_mm": 1.0, "frames_fit": -1,
}  # fmt: skip
LOOKS = ("wait", "look")  # verbs that end a chunk whose time is over
LATE_S = 0.3  # after the time of a chunk, or after somebody begins to look: until a box in reach is dark
PERSON_AS_IT_FIRES = 0.4  # of the bursts, between two of their first words
AGAIN_S = 0.051  # from one "off" to the next, for a box that loses what comes sooner (docs/laser.md)
NUDGES = (("PER", "0.05"), ("CMOD", "NORM"), ("BCO", "77"), ("MUX", "3"), ("POL", "COMP"), ("DEL", "0.001"))


class Asked:
    """A switch that a story opens; `rtpiv laser off` among them."""

    def __init__(self):
        self.closed = True

    def is_closed(self):
        return self.closed

    def is_confirmed(self):
        return False

    def confirm(self):
        pass

    def close(self):
        self.closed = True


class WatchedClock(VirtualClock):
    """Lets the box live while time passes."""

    lives = staticmethod(lambda: None)

    def sleep_s(self, duration_s):
        super().sleep_s(duration_s)
        self.lives()

    def advance_to(self, time_s):
        super().advance_to(time_s)
        self.lives()


class Story:
    """One laser, and what happens to it."""

    def __init__(self, seed, clock=None):
        self.rng = random.Random(seed)
        self.clock = clock or WatchedClock()
        self.kind = self.rng.choice(("lamps", "lamps", "pumped", "pumped", "oltSync"))
        wiring = {"lamps": LAMPS, "pumped": PUMPED, "oltSync": DIODE}[self.kind]
        driver = OltSyncBox if self.kind == "oltSync" else QuantumComposersBox
        if self.kind == "oltSync":
            self.emulator = OltSyncEmulator(self.clock)
        else:
            variant = Variant(
                outputs=8 if self.kind == "lamps" else 4,
                echo=self.rng.random() < 0.2,
                model=self.rng.choice(list(MODELS.values())),
                arms=self.rng.choice(("run", "run all", "state")),
                needs_s=self.rng.choice((0.0, 0.0, 0.005, 0.04)),
            )
            self.emulator = QuantumComposersEmulator(self.clock, variant)
        self.line = Line(self.emulator, self.clock)
        self.address = f"fuzz-{id(self):x}"
        LINES[self.address] = self.line
        self.clock.lives = self.lives
        pumped_us = (180.0, 182.0) if self.kind == "lamps" else None
        head = LaserHead(15.0 if pumped_us else 200.0, lamp_to_q_switch_us=pumped_us)
        self.laser = Laser("laser", driver("laser", wiring, self.clock), head, RULES, self.clock)
        self.q_switches = {wiring[role] for role in Q_SWITCHES if role in wiring}
        self.emulator.outputs.listen(self.judge)
        self.left = Counter()
        self.turned = set()  # (output, keyword) of outputs that may give more because of a knob; see above
        for name in ("load", "confirm", "silence"):
            self.note_what_was_heard(name)
        self.put_back_s = math.inf  # when somebody puts the cable back while the bench is left
        self.log, self.found = [], []
        self.pulses = self.firings = self.by_knobs = 0
        self.stopped_s = math.inf  # when a person ended the light and nobody has released it since
        self.foreign_off_s = -math.inf  # when that was last by another program
        self.ends, self.has_run_key = 0, False
        self.unseen = 0  # stops that nothing of the box tells of
        self.asked = 0  # pairs of the burst that was asked for last
        self.asks_off, self.door_is_closed = Asked(), Asked()
        self.laser.off_request = self.asks_off
        self.laser.switches.add(OFF, self.asks_off)
        self.laser.switches.add("door", self.door_is_closed)
        for name in (OFF, "door"):
            self.laser.switches.look(name)
        self.looks_s = None  # since when somebody looks whether the time of a chunk is over

    def note_what_was_heard(self, name):
        """When the box was asked for all that it holds, and it was well, no knob is an excuse any more."""
        ask = getattr(self.laser.box, name)

        def asks(*values, **named):
            answer = ask(*values, **named)
            self.turned.clear()
            return answer

        setattr(self.laser.box, name, asks)

    def lives(self):
        """Time has passed: the timing unit does what is due, and so does a person."""
        self.emulator.advance()
        if self.clock.now_s() >= self.put_back_s:
            self.put_back_s = math.inf
            self.line.plug_in()

    def judge(self, pulse):
        if pulse.output not in self.q_switches:
            return
        self.pulses += 1
        state = self.laser._states._state  # without its clock
        self.left[pulse.output] -= 1
        if pulse.rises_s > self.stopped_s + LATE_S and not self.is_refused(pulse, state):
            after_s = pulse.rises_s - self.stopped_s
            self.found.append(f"a pulse on {pulse.output} {after_s:.3f} s after a person has ended the light")
        knobs = {keyword for output, keyword in self.turned if output == pulse.output}
        if self.left[pulse.output] < 0 and self.kind != "oltSync":  # which does not count
            self.by_knobs += bool(knobs)
            if not knobs:
                self.found.append(f"one pulse too many on {pulse.output} at {pulse.rises_s:.4f} s")
        if state in EMITS:
            self.judge_end(pulse, knobs)
        elif "RUN" in knobs:
            self.by_knobs += 1
        elif not (self.is_out_of_reach(state) or self.is_refused(pulse, state) or self.is_mixed_by_keys(pulse)):
            self.found.append(f"a pulse on {pulse.output} at {pulse.rises_s:.4f} s while {state.value}")

    def judge_end(self, pulse, knobs):
        """Of a box in reach at which somebody looks whether the time of its chunk is over."""
        if self.looks_s is None or not self.line.reached or "MUX" in knobs:
            return
        late_s = pulse.rises_s - max(self.laser._ends_s, self.looks_s)
        if late_s > LATE_S:
            self.found.append(f"a pulse on {pulse.output} {late_s:.3f} s after the time of its chunk")

    def is_mixed_by_keys(self, pulse):
        """Whether somebody has mixed the output with a lamp that runs, and the box was not asked since."""
        return self.laser._states._state in BETWEEN and (pulse.output, "MUX") in self.turned

    def is_out_of_reach(self, state):
        """Whether the program knows that light may leave, and no word of it can reach the box."""
        return state is LaserState.UNKNOWN and not self.line.reached

    # ---- what may happen -----------------------------------------------------------------------------

    def is_refused(self, pulse, state):
        """Whether the program knows, has said off, and the box has just refused it."""
        if state is not LaserState.UNKNOWN or self.kind == "oltSync":
            return False
        return pulse.rises_s - self.emulator.refused_off_s <= AGAIN_S

    def is_refused_since(self, time_s):
        """Whether the box has refused an off since then."""
        return self.kind != "oltSync" and self.emulator.refused_off_s >= time_s

    def asked_for(self, pairs):
        self.asked = pairs
        for output in self.q_switches:
            self.left[output] = pairs
        self.firings += 1

    def fire(self):
        pairs = self.rng.choice((1, 3, 20, 50))
        if self.laser.state is LaserState.ARMED:
            self.asked_for(pairs)
            if PERSON_AS_IT_FIRES and self.rng.random() < PERSON_AS_IT_FIRES:
                self.person_at_any_byte(50)
        self.laser.fire(pairs)

    def align(self):
        if self.laser.state is LaserState.SAFE:
            self.asked_for(20)
        word = self.laser.challenge if self.rng.random() < 0.8 else "1"
        self.laser.align(word, self.rng.choice((2.0, 10.0, 11.0)), self.rng.choice((1.0, 2.0)))

    def set(self):
        timing = PulseTiming(self.rng.choice((20.0, 30.0, 1e6)), self.rng.choice((10.0, 10.0, 12.0, 500.0)))
        self.laser.set(timing, PairExposures(100.0, 20_000.0, 2.0))

    def arm(self):
        word = self.laser.challenge if self.rng.random() < 0.9 else "word"
        self.laser.arm(self.conditions(), word)

    def conditions(self):
        if self.rng.random() < 0.85:
            return GOOD
        name = self.rng.choice(list(FIELDS))
        values = {field: getattr(GOOD, field) for field in GOOD.__dataclass_fields__}
        return Conditions(**{**values, name: FIELDS[name]})

    def sleep(self):
        for _ in range(self.rng.choice((1, 5, 30, 110))):
            self.clock.sleep_s(0.05)

    def fault(self):
        self.line.faults.strike(Fault(self.rng.choice(KINDS[:-1]), 0, delay_s=self.rng.choice((0.01, 0.7, 2.0))))

    def later_fault(self):
        number = self.line.faults._count + self.rng.randrange(40)
        self.line.faults._by_answer[number] = Fault(self.rng.choice(KINDS[:-1]), number, delay_s=1.5)

    def refuse(self):
        if self.kind == "oltSync":
            return
        self.emulator.refuse = self.rng.choice((1, 1, 2, 5))

    def later_refuse(self):
        if self.kind == "oltSync":
            return
        self.line.hooks.after(self.rng.randrange(1, 25), "write", lambda: setattr(self.emulator, "refuse", 1))

    def unplug(self):
        self.emulator.advance()
        self.line.unplug()

    def later_unplug(self):
        self.line.hooks.after(self.rng.randrange(1, 30), "answer", self.unplug)

    def plug_in(self):
        """Put the plug back; what a diode box answered to an off just now, which alone tells of it, is gone."""
        if self.kind == "oltSync" and self.foreign_off_s == self.stopped_s == self.clock.now_s():
            self.stopped_s = math.inf
            self.unseen += 1
        self.line.plug_in()

    def power(self):
        self.line.power_cycle(self.rng.choice((0.05, 0.5)))

    def keys(self):
        if self.kind == "oltSync":
            return
        number = self.rng.randrange(len(self.emulator._all))
        words = [each for each in NUDGES if each[0] in self.emulator._all[number].words]
        keyword, value = self.rng.choice(words)
        self.turn(number, keyword, value)

    def endless(self):
        """A person makes a burst that goes on endless, or longer."""
        if self.kind != "oltSync":
            number = 1 + LETTERS.index(self.rng.choice(sorted(self.q_switches)))
            self.turn(number, *self.rng.choice((("CMOD", "NORM"), ("BCO", "5000"))))

    def turn(self, number, keyword, value):
        """Somebody turns a knob at the box, whatever the program believes."""
        self.emulator.advance()
        self.emulator.set_inside(number, keyword, value)
        if self.emulator.is_on_at(0) and number > 0:
            self.turned |= {(output, keyword) for output in self.emulator.fed_by(number)}

    def refuse_off(self):
        """One output, or T0, is not switched off when it is told to, a few times."""
        if self.kind != "oltSync":
            self.emulator.refuses_off[self.rng.randrange(5)] = self.rng.choice((1, 2, 3, 5, 99))

    def stop_key(self):
        """The key STOP of the box, or the key of a diode laser."""
        self.emulator.advance()
        was_running = self.runs
        self.emulator.person_stops()
        if was_running and self.is_in_a_slow_start:
            self.unseen += 1
        elif was_running:
            self.ended()

    def run_key(self):
        """The key RUN, or that of a diode laser: whatever is on begins anew, and a person has released it."""
        self.stopped_s, self.has_run_key = math.inf, True
        for output in self.q_switches:
            self.left[output] = max(0, self.left[output]) + self.asked
            self.turned.add((output, "RUN"))
        self.emulator.person_runs()

    @property
    def runs(self):
        """Whether there is something that a person can stop."""
        if self.kind == "oltSync":
            return self.laser._states._state in (*EMITS, *BETWEEN)
        if self.laser._states._state is LaserState.SAFE:  # T0 runs by the key RUN; stopped, all is as after `safe`
            return False
        return self.emulator.is_on_at(0) or self.begins

    @property
    def begins(self):
        """Whether the program is about to begin a burst, for which it may have stopped T0."""
        return self.laser._states._state in EMITS and self.laser._ends_s == math.inf

    @property
    def is_in_a_slow_start(self):
        """Whether a burst is being started line by line."""
        is_slow = self.kind != "oltSync" and (
            self.laser.box._pause_s > 0.0 or self.emulator._variant.needs_s > 0.0
        )
        return is_slow and self.begins

    def ended(self):
        """A person has ended the light, now."""
        self.ends += 1
        self.stopped_s = min(self.stopped_s, self.clock.now_s())

    def foreign_off(self):
        """Another program writes off to the box; of a diode box it can be known by its answer alone."""
        if (
            self.line.dead
            or not self.emulator.is_on
            or (self.kind == "oltSync" and (not self.line.reached or self.line.faults._by_answer))
        ):
            return
        self.emulator.advance()
        was_running = self.runs
        for data in self.laser.box.off_bytes():
            self.emulator.feed(data)
        is_off = self.kind == "oltSync" or not self.emulator.is_on_at(0)
        if was_running and is_off and self.is_in_a_slow_start:
            self.unseen += 1
        elif was_running and is_off:
            self.ended()
            self.foreign_off_s = self.clock.now_s()

    def laser_off(self):
        """`rtpiv laser off`: the program is asked, and the box is written to."""
        self.asks_off.closed = False
        self.foreign_off()
        self.opens(OFF)

    def door(self):
        """The door opens, perhaps for a moment."""
        self.door_is_closed.closed = False
        self.opens("door")
        if self.rng.random() < 0.7:
            self.door_is_closed.closed = True
            self.laser.switches.look("door")

    def opens(self, name):
        """What the thread does that reads a switch."""
        was_on = self.laser._states._state in (*EMITS, *BETWEEN)
        self.laser.switch_opened(self.laser.switches.look(name))
        if was_on and self.line.reached:
            self.ended()

    def shut_door(self):
        self.door_is_closed.closed = True
        self.laser.switches.look("door")

    def person_at_any_byte(self, words=90):
        """A person ends the light between two words of what comes next."""
        number, what = self.rng.randrange(1, words), self.rng.choice(("write", "answer"))
        act = self.rng.choice((self.stop_key, self.foreign_off, self.laser_off, self.door))
        if act in (self.laser_off, self.door):
            self.line.hooks.press(number, what, act, lambda: False)
        else:
            self.line.hooks.after(number, what, act)

    def stop_at_any_byte(self):
        """Another thread stops it at some byte of what comes next."""

        def stop():
            with suppress(StageError):
                self.laser.stop("another thread")

        what = self.rng.choice(("write", "answer"))
        self.line.hooks.press(self.rng.randrange(1, 30), what, stop, lambda: False)

    def safe(self):
        self.laser.safe()
        self.stopped_s = math.inf  # a person has released it

    def warm(self):
        self.laser.warm(self.rng.choice((10.0, 10.0, 16.0)))

    def wait(self):
        self.laser.wait()

    def look(self):
        self.laser.look()

    def watch(self):
        self.laser.watch(self.conditions())

    def stop(self):
        self.laser.stop("asked")
        if self.line.reached:
            self.ended()

    def confirm(self):
        self.laser.confirm_off()

    def disarm(self):
        self.laser.disarm()

    VERBS: ClassVar = {
        "safe": 4, "warm": 8, "sleep": 6, "set": 8, "arm": 8, "fire": 10, "wait": 4, "look": 3, "watch": 3,
        "stop": 2, "align": 2, "confirm": 2, "disarm": 1, "fault": 3, "later_fault": 3, "refuse": 2,
        "refuse_off": 2, "later_refuse": 2, "unplug": 1, "later_unplug": 1, "plug_in": 3, "power": 1,
        "keys": 2, "endless": 1, "stop_key": 2, "run_key": 1, "foreign_off": 2, "laser_off": 2, "door": 1,
        "shut_door": 2, "stop_at_any_byte": 2, "person_at_any_byte": 6,
    }  # fmt: skip
    USUAL: ClassVar = {  # what a person does next, so that sequences get as far as light
        LaserState.SAFE: ("warm", "warm", "shut_door"), LaserState.WARM: ("sleep",), LaserState.ARMED: ("fire",),
        LaserState.FAULT: ("safe",), LaserState.UNKNOWN: ("safe", "sleep", "confirm"),
        LaserState.FIRING: ("wait", "sleep", "stop", "watch", "later_fault", "endless"),
        LaserState.ALIGNING: ("wait", "sleep"),
    }  # fmt: skip

    def next_verb(self):
        state = self.laser.state
        if self.rng.random() < 0.5:
            return self.rng.choice(self.USUAL.get(state, ("set" if self.laser.schedule is None else "arm",)))
        return self.rng.choices(list(self.VERBS), list(self.VERBS.values()))[0]

    def tell(self, length):
        """Play; what was found is in `found`."""
        try:
            self.begin()
            for _ in range(length):
                self.do(self.next_verb())
                if self.found:
                    return
            self.end()
        finally:
            LINES.pop(self.address)

    def begin(self):
        with suppress(DaqError, StageError):
            self.laser.open(f"sim://{self.address}")

    def do(self, name):
        self.log.append(f"{self.clock.now_s():9.3f} {self.laser.state.value:9s} {name}")
        begun_s = self.clock.now_s()
        self.looks_s = begun_s if name in LOOKS else None
        try:
            getattr(self, name)()
        except (DaqError, StageError) as error:
            self.log[-1] += f" -> {type(error).__name__}: {error}"
        if self.laser._states._state is LaserState.UNKNOWN and self.is_refused_since(begun_s):
            self.laser.confirm_off()  # as the supervisor of a burst does, at once
        is_over = self.laser._states._state in EMITS and self.clock.now_s() > self.laser._ends_s
        if name in LOOKS and self.line.reached and is_over:
            self.found.append("it goes on although its time is over, and was looked at")

    def end(self):
        self.line.hooks.clear()
        if self.line.dead and self.rng.random() < 0.5:
            self.put_back_s = self.clock.now_s() + self.rng.uniform(0.0, 8.0)
        with suppress(DaqError, StageError):
            self.laser.close()
        if math.isfinite(self.put_back_s):
            self.clock.sleep_s(8.0)
        if not self.line.dead and not self.line.faults.met and self.emulator.is_on:
            on = self.kind == "oltSync" and self.emulator.is_running
            if self.kind != "oltSync":
                first = 1 if self.has_run_key else 0  # T0 alone, which a person has started, gives nothing
                on = on or any(channel.on for channel in self.emulator._all[first:])
            if on:
                self.found.append("something is on after the end")


def play(sequences, seed, length=14, until_s=None):
    """Tell stories; return their books, and the log of the first in which something was found."""
    books = Counter()
    for number in range(sequences):
        story = Story(f"{seed}-{number}")
        story.tell(length)
        books["sequences"] += 1
        books["pulses"] += story.pulses
        books["bursts"] += story.firings
        books["pulses by knobs"] += story.by_knobs
        books["ended by a person"] += story.ends
        books["unseen"] += story.unseen
        if story.found:
            return books, [f"seed {seed}-{number}", *story.log, *story.found]
        if until_s is not None and time.monotonic() > until_s:
            break
    return books, []


def main():
    """Run from the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--sequences", type=int, default=20_000)
    parser.add_argument("--seed", default="1")
    parser.add_argument("--length", type=int, default=14)
    options = parser.parse_args()
    begun_s = time.monotonic()
    books, found = play(options.sequences, options.seed, options.length)
    print(dict(books), f"{time.monotonic() - begun_s:.0f} s")
    print("\n".join(found) or "nothing found")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
