"""A DG645: counted bursts, dark between them whatever key is pressed, and off at every byte."""

import os
import random
from contextlib import contextmanager, suppress

import pytest

from daq.bench.opened import open_bench
from daq.errors import DaqError
from daq.runner.laser_trials import BoxTrials
from daq.timing.conditions import Conditions, Rules
from daq.timing.drivers.srs_dg645 import Dg645Box
from daq.timing.errors import LaserDoubt, PulsesRefused, WrongBox
from daq.timing.laser import Laser
from daq.timing.low_energy import LowEnergyRules
from daq.timing.pulses import LaserHead, PairExposures, PulseTiming, Role
from daq.timing.states import EMITS, LaserState
from sim.emulators.faults import KINDS, Fault, FaultSchedule
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.mechanics.clock import VirtualClock
from sim.timing_boxes.srs_dg645 import Dg645Emulator
from stages.errors import StageError
from tests.daq.bench.test_timing_kind import bench_with
from tests.daq.runner.test_laser_trials import AtPlug, Hands
from tests.daq.timing.person_stops import DARKENS

WIRING = {Role.Q_SWITCH_1: "AB", Role.Q_SWITCH_2: "CD", Role.CAMERA: "EF", Role.MARKER: "GH"}
LIGHT = ("AB", "CD")
EXPOSURES = PairExposures(100.0, 20_000.0, 2.0)
TIMING = PulseTiming(20.0, 10.0)
GOOD = Conditions(True, True, True, 5.0, 1000)
RULES = Rules(warmup_s=0.0, align=LowEnergyRules(pulse_us=2.0))


class Desk:
    """A box on a line in memory, and a laser without lamps."""

    def __init__(self, faults=(), wiring=WIRING, **firmware):
        self.clock = VirtualClock()
        self.emulator = Dg645Emulator(self.clock, **firmware)
        self.line = Line(self.emulator, self.clock, FaultSchedule(faults))
        self.box = Dg645Box("laser", wiring, self.clock)
        self.laser = Laser("laser", self.box, LaserHead(max_rate_hz=100.0), RULES, self.clock)
        self.light_s = []
        self.emulator.outputs.listen(
            lambda pulse: self.light_s.append(pulse.rises_s) if pulse.output in LIGHT else None
        )

    def to_armed(self, timing=TIMING):
        self.laser.open("sim://desk")
        if self.laser.state is LaserState.UNKNOWN:
            self.laser.safe()
        self.laser.warm(timing.rate_hz)
        self.laser.set(timing, EXPOSURES)
        self.laser.arm(GOOD, self.laser.challenge)

    def burst(self, pairs=5):
        self.laser.fire(pairs)
        self.laser.wait()

    def pulses(self, role):
        self.emulator.advance()
        return self.emulator.outputs.count[WIRING[role]]


@contextmanager
def desk(**options):
    LINES["desk"] = (made := Desk(**options)).line
    try:
        yield made
    finally:
        LINES.pop("desk")


@pytest.mark.parametrize("ends", ["mode", "nothing"])
def test_a_burst_of_n_is_n_and_lies_where_it_was_placed(ends):
    with desk(ends=ends) as d:
        d.to_armed()
        for pairs in (20, 1, 7):
            before = d.pulses(Role.Q_SWITCH_1)
            d.burst(pairs)
            d.clock.sleep_s(3.0)
            assert d.pulses(Role.Q_SWITCH_1) - before == pairs
            d.laser.arm(GOOD, d.laser.challenge)
        assert {d.pulses(role) for role in WIRING} == {28}
        last_s = {pulse.output: pulse.rises_s for pulse in d.emulator.outputs.recent}
        assert (last_s["CD"] - last_s["AB"]) * 1e6 == pytest.approx(20.0, abs=1e-4)
        assert d.laser.dt_us == pytest.approx(20.0, abs=1e-5)
        d.laser.safe()


@pytest.mark.parametrize("ends", ["mode", "nothing"])
def test_off_in_a_burst_is_dark_at_once_and_it_goes_on_from_there(ends):
    with desk(ends=ends) as d:
        d.to_armed()
        d.laser.fire(90)
        d.clock.sleep_s(1.0)
        d.laser.stop("now")
        stopped_s = d.clock.now_s()
        d.clock.sleep_s(1.0)
        d.emulator.advance()
        assert d.light_s[-1] < stopped_s + 0.3
        assert d.laser.confirm_off()
        d.laser.safe()
        d.to_armed()
        before = d.pulses(Role.Q_SWITCH_1)
        d.burst(5)
        d.clock.sleep_s(20.0)
        assert d.pulses(Role.Q_SWITCH_1) - before == 5


def off_from_elsewhere(d):
    """Another program writes off past the one that holds the port."""
    for data in d.box.off_bytes():
        d.emulator.feed(data)


ENDS = {
    "keys": lambda d: d.emulator.person_stops(), "laser off": off_from_elsewhere, **DARKENS,
}  # fmt: skip


def test_an_off_between_two_chunks_holds_though_dt_is_set_anew():
    with desk() as d:
        d.to_armed()
        d.burst(3)
        off_from_elsewhere(d)
        with pytest.raises(LaserDoubt, match="switched off, or restarted"):
            d.laser.set(PulseTiming(30.0, 10.0), EXPOSURES)


@pytest.mark.parametrize("state", ["safe", "armed", "after a burst"])
def test_the_key_that_triggers_gives_no_light(state):
    with desk() as d:
        d.laser.open("sim://desk")
        if state != "safe":
            d.to_armed()
        if state == "after a burst":
            d.burst(3)
        before = len(d.light_s)
        d.emulator.person_runs()
        d.clock.sleep_s(20.0)
        d.emulator.advance()
        assert len(d.light_s) == before


@pytest.mark.parametrize(("word", "value"), [
    ("TSRC", 0), ("BURM", 0), ("BURP", 0.05), ("BURD", 0.01), ("ADVT", 1), ("INHB", 1), ("BURT", 1),
])  # fmt: skip
def test_somebody_at_its_keys_is_found_before_it_is_armed(word, value):
    with desk() as d:
        d.laser.open("sim://desk")
        d.laser.warm(10.0)
        d.laser.set(TIMING, EXPOSURES)
        d.emulator.set_inside(word, value)
        with pytest.raises(LaserDoubt):
            d.laser.arm(GOOD, d.laser.challenge)
        assert not d.light_s


def test_an_inverted_output_is_set_right_or_found():
    with desk() as d:
        d.emulator._polarities[1] = 0
        d.to_armed()
        assert d.emulator._polarities[1] == 1
        d.laser.disarm()
        d.emulator._polarities[2] = 0
        with pytest.raises(LaserDoubt, match="is inverted"):
            d.laser.arm(GOOD, d.laser.challenge)


def test_what_ran_before_us_is_off():
    with desk() as d:
        d.emulator.set_inside("TRAT", 10.0)
        d.emulator.set_inside("TSRC", 0)
        d.clock.sleep_s(1.0)
        d.emulator.advance()
        before = len(d.light_s)
        assert before
        d.laser.open("sim://desk")
        d.clock.sleep_s(2.0)
        d.emulator.advance()
        assert d.laser.state is LaserState.SAFE
        assert len(d.light_s) <= before + 2


@pytest.mark.parametrize(("role", "output", "words"), [
    (Role.LAMP_1, "GH", "lamps run on"), (Role.CAMERA_B, "GH", "no outputs"), (Role.MARKER, "T0", "on one of"),
])  # fmt: skip
def test_what_cannot_hang_on_it(role, output, words):
    wiring = {Role.Q_SWITCH_1: "AB", Role.CAMERA: "EF", role: output}
    with desk(wiring=wiring) as d, pytest.raises(WrongBox, match=words):
        d.laser.open("sim://desk")


def test_a_clock_that_is_not_locked_is_refused():
    with desk() as d:
        d.emulator.unlocked = 1 << 6
        with pytest.raises(WrongBox, match="not locked"):
            d.laser.open("sim://desk")


def test_a_bench_simulates_it_by_its_name(tmp_path):
    channels = "q_switch_1: AB, q_switch_2: CD, camera: EF, marker: GH"
    bench = bench_with(tmp_path, channels=channels, head="max_rate_hz: 15.0", box="srs_dg645")
    with open_bench(bench, True, only={"laser"}) as hardware:
        laser = hardware.devices["laser"]
        (unit,) = hardware.simulation.world.timing
        laser.warm(10.0)
        laser.set(TIMING, EXPOSURES)
        laser.arm(GOOD, laser.challenge)
        laser.fire(5)
        laser.wait()
        assert {unit.pulses(role) for role in WIRING} == {5}


def test_two_q_switches_are_needed_for_pairs():
    with desk(wiring={Role.Q_SWITCH_1: "AB", Role.CAMERA: "EF"}) as d:
        d.laser.open("sim://desk")
        d.laser.warm(10.0)
        with pytest.raises(PulsesRefused, match="no output for q_switch_2"):
            d.laser.set(TIMING, EXPOSURES)


def test_alignment_is_short_pulses_without_the_camera():
    with desk() as d:
        d.laser.open("sim://desk")
        d.laser.align(d.laser.challenge, 5.0, 2.0)
        d.laser.wait()
        d.emulator.advance()
        assert d.laser.state is LaserState.SAFE
        assert d.pulses(Role.Q_SWITCH_1) == 10
        assert d.pulses(Role.CAMERA) == 0


@pytest.mark.parametrize("every", [len(KINDS) + 1, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_one_fault_at_any_answer(kind, every):
    for answer in range(KINDS.index(kind) % every, 220, every):
        with desk(faults=[Fault(kind, answer, delay_s=2.0)]) as d:
            try:
                d.to_armed()
                d.burst(3)
                assert d.pulses(Role.Q_SWITCH_1) == d.pulses(Role.Q_SWITCH_2) == 3
            except (DaqError, StageError):
                assert d.laser.state is LaserState.UNKNOWN
                d.clock.sleep_s(2.0)
                assert d.pulses(Role.Q_SWITCH_1) <= 3
                if not d.line.dead:
                    d.laser.safe()
                    assert d.laser.state is LaserState.SAFE


@pytest.mark.parametrize("ends", ["mode", "nothing"])
def test_it_is_proven_at_every_plug(ends):
    with desk(ends=ends) as d:
        d.laser.open("sim://desk")
        counter = AtPlug(d)
        found = list(BoxTrials(d.laser, TIMING, EXPOSURES, counter, Hands(d, counter), d.clock).run())
        assert all(trial.is_right for trial in found), [trial for trial in found if not trial.is_right]
        assert sum("a burst of 20" in trial.what for trial in found) == 4


@pytest.mark.parametrize("by", [-1, 1])
def test_one_that_miscounts_is_not(by):
    with desk() as d:
        trigger = d.emulator._trigger

        def miscounted(time_s):
            trigger(time_s)
            d.emulator._left = max(1, d.emulator._left + by)

        d.emulator._trigger = miscounted
        d.laser.open("sim://desk")
        counter = AtPlug(d)
        try:
            found = list(BoxTrials(d.laser, TIMING, EXPOSURES, counter, Hands(d, counter), d.clock).run())
        except (DaqError, StageError):
            return
        assert not all(trial.is_right for trial in found)


VERBS = {
    "safe": lambda d: d.laser.safe(), "warm": lambda d: d.laser.warm(10.0),
    "set": lambda d: d.laser.set(TIMING, EXPOSURES), "arm": lambda d: d.laser.arm(GOOD, d.laser.challenge),
    "fire": lambda d: d.laser.fire(d.rng.randint(1, 40)), "wait": lambda d: d.laser.wait(),
    "align": lambda d: d.laser.align(d.laser.challenge, 5.0, 2.0), "stop": lambda d: d.laser.stop("now"),
    "look": lambda d: d.laser.look(), "disarm": lambda d: d.laser.disarm(),
    "confirm": lambda d: d.laser.confirm_off(), "time": lambda d: d.clock.sleep_s(d.rng.random() * 3.0),
}  # fmt: skip
WAY = ("safe", "warm", "set", "arm", "fire", "wait", "arm", "fire", "wait")  # which random verbs rarely find
PERSONS = (*ENDS.values(), lambda d: d.emulator.person_runs(), lambda d: d.line.unplug())


def fuzzed(seed):
    """One random story with a person; what a judge at the Q-switch outputs has found."""
    found = []
    with desk(ends=random.Random(seed).choice(("mode", "nothing"))) as d:
        d.rng, d.off_s, d.left = random.Random(seed), None, 0
        begin = d.box.begin

        def begin_counted(pairs, camera=True):
            d.left += 2 * pairs
            begin(pairs, camera)

        def judge(pulse):
            is_factory = pulse.falls_s - pulse.rises_s < 1e-7  # a key, behind a loss of power: 10 ns
            if pulse.output in LIGHT and not is_factory:
                d.left -= 1
                if d.left < 0 or d.laser.state not in (*EMITS, LaserState.UNKNOWN):
                    found.append(f"{seed}: a pulse while {d.laser.state.value}, {d.left} left")
                if d.off_s is not None and pulse.rises_s > d.off_s + 0.3 and not d.line.dead:
                    found.append(f"{seed}: a pulse {pulse.rises_s - d.off_s:.2f} s after an off that is not ours")

        def act(person):
            is_off = person in ENDS.values()
            if person is PERSONS[-2] and d.laser.state in EMITS:
                d.left += 2 * d.laser.pairs  # the key, before the lengths are taken away: once more as many
            person(d)
            if is_off and d.box._loaded is not None and d.off_s is None:
                d.off_s = d.clock.now_s()  # one before it was loaded is the same as ours, and is not known

        d.box.begin = begin_counted
        d.emulator.outputs.listen(judge)
        d.laser.open("sim://desk")
        verbs = [d.rng.choice(WAY if d.rng.random() < 0.5 else tuple(VERBS)) for _ in range(12)]
        for verb in (*WAY, *verbs) if d.rng.random() < 0.7 else verbs:
            if d.rng.random() < 0.25:
                person, byte = d.rng.choice(PERSONS), d.rng.randint(1, 400)
                d.line.hooks.after(byte, "byte", lambda person=person: act(person))
            if verb == "safe" and d.line.dead:
                d.line.plug_in()
            with suppress(DaqError, StageError):
                VERBS[verb](d)
            if verb == "safe" or d.laser.state is LaserState.SAFE:
                d.off_s = None  # a person has released it, or the off fell into ours: off was read back
            d.emulator.advance()
        d.line.hooks.clear()
        if d.line.dead:
            d.line.plug_in()
        with suppress(DaqError, StageError):
            d.laser.close()
        d.emulator.advance()
        ended = len(d.light_s)
        d.clock.sleep_s(20.0)
        d.emulator.advance()
        if len(d.light_s) > ended:
            found.append(f"{seed}: pulses after the bench was left")
        return found, len(d.light_s)


@pytest.mark.slow
def test_random_verbs_and_persons_give_no_light_after_an_off():
    stories = [fuzzed(seed) for seed in range(int(os.environ.get("RTPIV_DG645_STORIES", "60")))]
    assert [said for found, _ in stories for said in found] == []
    assert sum(pulses for _, pulses in stories) > 500
