"""Random sequences of verbs, faults and persons over a laser, before the judge of `laser_judge`.

A seed and a number of it play a story again: `Story("1-17").tell(14)`.
"""

import math
from collections import Counter
from contextlib import suppress
from typing import ClassVar

from daq.errors import DaqError
from daq.timing.conditions import Conditions
from daq.timing.pulses import PairExposures, PulseTiming
from daq.timing.states import EMITS, LaserState
from daq.timing.switches import OFF
from sim.emulators.faults import KINDS, Fault
from sim.emulators.protocol_sim import LINES
from sim.timing_boxes.quantum_composers import LETTERS
from stages.errors import StageError
from tests.fuzz.benches.laser_judge import BETWEEN, JudgedLaser

GOOD = Conditions(True, True, True, 5.0, 10_000)
FIELDS = {
    "camera_armed": False, "at_rest": False, "sheet_clearance_mm": 1.0, "frames_fit": -1,
}  # fmt: skip
LOOKS = ("wait", "look")  # verbs that end a chunk whose time is over
PERSON_AS_IT_FIRES = 0.4  # of the bursts, between two of their first words
NUDGES = (("PER", "0.05"), ("CMOD", "NORM"), ("BCO", "77"), ("MUX", "3"), ("POL", "COMP"), ("DEL", "0.001"))


class Story(JudgedLaser):
    """What happens to one laser."""

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
        self.answers_are_lost()
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
        """Put the plug back."""
        self.answers_are_lost()
        self.line.plug_in()

    def power(self):
        self.answers_are_lost()
        self.line.power_cycle(self.rng.choice((0.05, 0.5)))

    def answers_are_lost(self):
        """What a diode box answered to an off, which alone tells of it, is gone if it was not read yet."""
        is_unread = bool(self.line._coming) or self.emulator.has_answers
        if self.kind == "oltSync" and self.foreign_off_s == self.stopped_s and is_unread:
            self.stopped_s = math.inf
            self.unseen += 1

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
            self.turned |= {(output, keyword) for output in self.emulator.sources_of(number)}

    def refuse_off(self):
        """One output, or T0, is not switched off when it is told to, a few times."""
        if self.kind != "oltSync":
            self.emulator.refuses_off[self.rng.randrange(5)] = self.rng.choice((1, 2, 3, 5, 99))

    def stop_key(self):
        """The key STOP of the box, or the key of a diode laser."""
        self.emulator.advance()
        was_running = self.runs
        self.emulator.person_stops()
        if was_running and self.is_in_a_start:
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
            return self.laser._state in (*EMITS, *BETWEEN)
        if self.laser._state is LaserState.SAFE:  # T0 runs by the key RUN; stopped, all is as after `safe`
            return False
        return self.emulator.is_on_at(0) or self.begins

    @property
    def begins(self):
        """Whether the program is about to begin a burst, for which it may have stopped T0."""
        return self.laser._state in EMITS and self.laser._ends_s == math.inf

    @property
    def is_in_a_start(self):
        """Whether a burst is being started line by line, or what a person has started is taken over by `warm`."""
        if self.warms and self.has_run_key:
            return True
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
            or (self.kind == "oltSync" and (not self.line.is_reached or self.line.faults._by_answer))
        ):
            return
        self.emulator.advance()
        was_running = self.runs
        for data in self.laser.box.off_bytes():
            self.emulator.feed(data)
        is_off = self.kind == "oltSync" or not self.emulator.is_on_at(0)
        if was_running and is_off and self.is_in_a_start:
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
        was_on = self.laser._state in (*EMITS, *BETWEEN)
        self.laser.switch_opened(self.laser.switches.look(name))
        if was_on and self.line.is_reached:
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
        self.warms = True
        try:
            self.laser.warm(self.rng.choice((10.0, 10.0, 16.0)))
        finally:
            self.warms = False

    def wait(self):
        self.laser.wait()

    def look(self):
        self.laser.look()

    def watch(self):
        self.laser.watch(self.conditions())

    def stop(self):
        self.laser.stop("asked")
        if self.line.is_reached:
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
        if self.laser._state is LaserState.UNKNOWN and self.is_refused_since(begun_s):
            self.laser.confirm_off()  # as the supervisor of a burst does, at once
        is_over = self.laser._state in EMITS and self.clock.now_s() > self.laser._ends_s
        if name in LOOKS and self.line.is_reached and is_over:
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


def play(sequences, seed, length=14):
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
    return books, []
