"""A laser of the fuzz, and the judge who counts its pulses.

The judge hangs on the Q-switch outputs of the emulated box and knows the state of the laser at the moment of
every pulse. A pulse is allowed while it is FIRING or ALIGNING, at most as many for each Q-switch as were asked
for; and in UNKNOWN only while no open port leads to the box: nobody can stop that but the box, or a person at it.

**A person ends the light.** The key STOP, an off of another program, `rtpiv laser off`, an open door and `stop`
end it: no pulse rises more than `LATE_S` after any of them until a person releases it, by `safe` or the key RUN.
What reaches the box by no word is not meant (a pulled cable, a line that is lost on its way). A STOP that falls
into the lines by which a box that loses them is started, or before that by which `warm` starts what the key RUN
had started already, is counted as `unseen` (ADR 42); so is an off whose answer, which alone tells of it, is lost.

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

import math
import random
from collections import Counter

from daq.timing.conditions import Rules
from daq.timing.drivers.pivlab_synchroniser import OltSyncBox
from daq.timing.drivers.quantum_composers import QuantumComposersBox
from daq.timing.laser import Laser
from daq.timing.low_energy import LowEnergyRules
from daq.timing.pulses import Q_SWITCHES, LaserHead, Role
from daq.timing.states import EMITS, LaserState
from daq.timing.switches import OFF
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.mechanics.clock import VirtualClock
from sim.timing_boxes.pivlab_synchroniser import OltSyncEmulator
from sim.timing_boxes.quantum_composers import MODELS, QuantumComposersEmulator, Variant

BETWEEN = (LaserState.WARM, LaserState.READY, LaserState.ARMED)  # lamps run, and the box is not asked
LAMPS = {Role.LAMP_1: "A", Role.Q_SWITCH_1: "B", Role.LAMP_2: "C", Role.Q_SWITCH_2: "D", Role.CAMERA: "E"}
PUMPED = {Role.Q_SWITCH_1: "A", Role.Q_SWITCH_2: "B", Role.CAMERA: "C", Role.MARKER: "D"}
DIODE = {Role.Q_SWITCH_1: "2", Role.CAMERA: "1"}
RULES = Rules(warmup_s=5.0, uncounted=True, align=LowEnergyRules(q_switch_delay_us=300.0, pulse_us=5.0))
LATE_S = 0.3  # after the time of a chunk, or after somebody begins to look: until a box in reach is dark
AGAIN_S = 0.051  # from one "off" to the next, for a box that loses what comes sooner (docs/laser.md)


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


class JudgedLaser:
    """One laser on an emulated box, with what is known of the persons around it."""

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
        pumped_us = [180.0, 182.0] if self.kind == "lamps" else None
        head = LaserHead(max_rate_hz=15.0 if pumped_us else 200.0, lamp_to_q_switch_us=pumped_us)
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
        self.ends, self.has_run_key, self.warms = 0, False, False
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
        state = self.laser._state  # without its clock
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
        elif not (
            self.is_out_of_reach(state)
            or self.is_refused(pulse, state)
            or self.is_lost(pulse, state)
            or self.is_mixed_by_keys(pulse)
        ):
            self.found.append(f"a pulse on {pulse.output} at {pulse.rises_s:.4f} s while {state.value}")

    def judge_end(self, pulse, knobs):
        """Of a box in reach at which somebody looks whether the time of its chunk is over."""
        if self.looks_s is None or not self.line.is_reached or "MUX" in knobs:
            return
        late_s = pulse.rises_s - max(self.laser._ends_s, self.looks_s)
        # What leaves until the next off is its own; two Q-switches are told in turn.
        is_just_refused = self.is_refused_since(pulse.rises_s - 2 * AGAIN_S)
        if late_s > LATE_S and not is_just_refused:
            self.found.append(f"a pulse on {pulse.output} {late_s:.3f} s after the time of its chunk")

    def is_mixed_by_keys(self, pulse):
        """Whether somebody has mixed the output with a lamp that runs, and the box was not asked since."""
        return self.laser._state in BETWEEN and (pulse.output, "MUX") in self.turned

    def is_out_of_reach(self, state):
        """Whether the program knows that light may leave, and no word of it can reach the box."""
        return state is LaserState.UNKNOWN and not self.line.is_reached

    def is_refused(self, pulse, state):
        """Whether the program knows, has said off, and the box has just refused it."""
        if state is not LaserState.UNKNOWN or self.kind == "oltSync":
            return False
        return pulse.rises_s - self.emulator.refused_off_s <= AGAIN_S

    def is_lost(self, pulse, state):
        """Whether the program knows, has said off, and the box was too busy with another line to hear it."""
        if state is not LaserState.UNKNOWN or self.kind == "oltSync":
            return False
        return pulse.rises_s - self.emulator.lost_off_s <= AGAIN_S

    def is_refused_since(self, time_s):
        """Whether the box has refused an off since then."""
        return self.kind != "oltSync" and self.emulator.refused_off_s >= time_s
