"""A box is proven by what a camera sees of it, a box that is not right is found, and who arms is told."""

from dataclasses import replace
from itertools import pairwise
from math import inf
from types import SimpleNamespace

import pytest

from daq.errors import DaqError
from daq.runner.laser_session import what_is_proven
from daq.runner.laser_trials import BoxTrials
from daq.runner.pulse_counters import Counted, Stretch
from daq.runs.laser_proof import Proof, Trial, proof_path, proof_sentence, read_proof, write_proof
from daq.runs.seal import SealBroken
from daq.timing.errors import NotArmed
from daq.timing.pulses import PulseTiming, Role
from daq.timing.states import LaserState
from rtpiv.command_line.cli import DONE, main
from stages.errors import StageError
from tests.daq.cameras.rigs import need_harvesters
from tests.daq.flow_bench import write_flow
from tests.daq.runner.wrong_boxes import WRONG
from tests.daq.timing.quantum_desk import EXPOSURES, PUMPED, WIRING, LaserHead, desk
from tests.slow_cases import one_in_three, slow, slow_but

TIMING = PulseTiming(20.0, 10.0)


class AtPlug:
    """A counter without a camera: every pulse of the output where its cable hangs, on the clock of the desk."""

    def __init__(self, desk):
        self.desk, self.output, self._times, self._marks = desk, None, [], []
        desk.emulator.outputs.listen(self._hear)

    def _hear(self, pulse):
        if pulse.output == self.output:
            self._times.append(pulse.rises_s)

    def begin(self, roles, period_us, pulse):
        self.desk.emulator.advance()
        self._times, self._marks = [], []

    def mark(self):
        self.desk.emulator.advance()
        self._marks.append(self.desk.clock.now_s())
        return self._marks[-1]

    def end(self):
        self.desk.clock.sleep_s(2.0)
        self.desk.emulator.advance()
        edges = [-inf, *self._marks, inf]
        between = [[at_s for at_s in self._times if low <= at_s < high] for low, high in pairwise(edges)]
        return Counted(tuple(Stretch(len(times), tuple(times)) for times in between))

    def close(self):
        pass


class Hands:
    """A person; `careless` ones do not do some of what they are asked for."""

    def __init__(self, desk, counter, code=None, careless=(), after_s=0.0):
        self._desk, self._counter, self._code, self._after_s = desk, counter, code, after_s
        self._careless, self.asked = careless, []

    def promise_dark(self, challenge):
        return self._code or challenge

    def move_counter(self, output, roles):
        self.asked.append(output)
        if "counter" not in self._careless or self._counter.output is None:
            self._counter.output = output

    def pull_cable(self):
        if "cable" not in self._careless:
            self._desk.clock.at(self._desk.clock.now_s() + self._after_s, self._desk.line.unplug)
            self._desk.clock.sleep_s(0.0)

    def put_back(self):
        self._desk.clock.forget()
        self._desk.line.plug_in()


def tried(d, **hands):
    d.laser.open("sim://desk")
    counter = AtPlug(d)
    return list(BoxTrials(d.laser, TIMING, EXPOSURES, counter, Hands(d, counter, **hands), d.clock).run())


def is_certified(d, **hands):
    """Whether a proof of these trials would hold; a trial that ends by an error is none."""
    d.laser.open("sim://desk")
    counter = AtPlug(d)
    trials = BoxTrials(d.laser, TIMING, EXPOSURES, counter, Hands(d, counter, **hands), d.clock)
    seen = []
    try:
        for trial in trials.run():
            seen.append(trial)
            if not trial.is_right:  # no later trial makes up for it
                break
    except (DaqError, StageError):
        return False
    return Proof("it", wired(d), True, "me", "now", tuple(seen), trials.counted).holds


FIRMWARE = [{}, {"arms": "run all"}, {"arms": "state"}, {"echo": True}, {"needs_s": 0.03}, {"model": "BNC,575-8"}]


@pytest.mark.parametrize(("firmware", "has_lamps"), one_in_three(FIRMWARE, (True, False)))
def test_a_box_that_keeps_to_its_manual_is_proven_at_every_plug(firmware, has_lamps):
    wires = {role: output for role, output in PUMPED.items() if role is not Role.CAMERA_B}
    head = {} if has_lamps else {"wiring": wires, "head": LaserHead(max_rate_hz=100.0)}
    with desk(**firmware, **head) as d:
        found = tried(d)
        assert all(trial.is_right for trial in found), [trial for trial in found if not trial.is_right]
        whats = [trial.what for trial in found]
        for role, output in d.box.wiring.items():
            assert f"output {output} ({role}): the counter's cable" in whats
            if "lamp" in role:
                assert f"output {output} ({role}): lamps off" in whats
            elif role is not Role.MARKER:
                assert f"output {output} ({role}): the cable pulled in a burst" in whats
                assert f"output {output} ({role}): a burst of 20" in whats
        assert d.laser.state is LaserState.SAFE
        assert d.box.wiring == (wires if not has_lamps else WIRING)


# Beside each third, those that alone show a box that gives more than it was asked for, and another count than due.
@pytest.mark.parametrize(
    "wrong", slow_but(WRONG, *[*WRONG][::3], "forgets its count then", "lamp 1 at half its rate")
)
def test_no_box_that_is_wrong_in_one_way_is_certified(wrong):
    with desk() as d:
        WRONG[wrong](d)
        assert not is_certified(d)


def test_without_the_code_nothing_leaves():
    with desk() as d:
        with pytest.raises(NotArmed, match="type the code"):
            tried(d, code="1")
        assert d.pulses(Role.CAMERA) == 0


@pytest.mark.parametrize(("hands", "unseen"), [
    ({"careless": ("cable",)}, "went on answering"),  # Enter, or the end of input, is no proof
    ({"after_s": 9.8}, "went on answering"),
    ({"careless": ("counter",)}, "is the counter's cable there?"),
])  # fmt: skip
def test_what_a_person_did_not_do_is_not_observed_and_certifies_nothing(hands, unseen):
    with desk() as d:
        found = tried(d, **hands)
        (said, *_) = [trial.said for trial in found if trial.is_right is None]
        assert unseen in said
        assert not Proof("it", wired(d), True, "me", "now", tuple(found), tuple(wired(d).values())).holds


def test_a_link_that_comes_back_before_the_end_is_not_out():
    """As a converter that hangs for some seconds does, or a person who is too quick."""
    with desk() as d:
        answers, asked_s = d.box.answers, []

        def silent_for_a_while():
            if d.laser.state is LaserState.FIRING and d.hands.asked_at is not None:
                asked_s.append(d.clock.now_s())
                return d.clock.now_s() - d.hands.asked_at > 4.0
            return answers()

        d.box.answers = silent_for_a_while
        d.laser.open("sim://desk")
        counter = AtPlug(d)
        d.hands = Hands(d, counter, careless=("cable",))
        d.hands.asked_at, pull = None, d.hands.pull_cable

        def asked():
            d.hands.asked_at = d.clock.now_s()
            pull()

        d.hands.pull_cable = asked
        found = list(BoxTrials(d.laser, TIMING, EXPOSURES, counter, d.hands, d.clock).run())
        assert asked_s
        said = {trial.said for trial in found if "cable pulled" in trial.what}
        assert said
        assert all("answered again too soon" in words or "would not be noticed" in words for words in said), said


def test_a_bench_whose_chunks_are_too_short_for_a_hand_is_told_what_to_set():
    with desk() as d:
        d.laser.rules = replace(d.laser.rules, chunk_s=2.0)
        with pytest.raises(NotArmed, match=r"set chunk_s to 10"):
            tried(d)
        d.laser.rules = replace(d.laser.rules, chunk_s=10.0)
        assert all(trial.is_right for trial in tried(d))


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [0.6, slow(1.0), 15.0])
def test_a_right_box_is_proven_at_slow_and_fast_rates(rate_hz):
    with desk() as d:
        d.laser.open("sim://desk")
        counter = AtPlug(d)
        timing = PulseTiming(20.0, rate_hz)
        found = list(BoxTrials(d.laser, timing, EXPOSURES, counter, Hands(d, counter), d.clock).run())
        assert all(trial.is_right for trial in found), [trial for trial in found if not trial.is_right]


def test_a_box_that_is_silent_while_it_fires_shows_no_lost_link():
    with desk() as d:
        answers = d.box.answers
        d.box.answers = lambda: d.laser.state is not LaserState.FIRING and answers()
        assert any("would not be noticed" in trial.said for trial in tried(d) if trial.is_right is None)


def test_a_box_that_does_not_count_is_not_tried():
    with desk() as d:
        d.box.counts = False
        with pytest.raises(NotArmed, match="does not count pulses"):
            tried(d)


RIGHT = (Trial("a burst of 7", True, "7 of 7"), Trial("off in a burst", True, "off: 10 of 50"))
CHANNELS = {"q_switch_1": "B", "camera": "E"}


def test_a_proof_is_kept_with_the_bench_and_said_to_who_arms(tmp_path):
    bench = tmp_path / "bench.yaml"

    def said(identity="QC,9528,1", channels=CHANNELS, simulated=False):
        return proof_sentence(bench, "laser", identity, channels, simulated)

    assert "it was never proven on this bench (rtpiv laser prove)" in said()
    path = proof_path(bench, "laser")
    proof = Proof("QC,9528,1", CHANNELS, False, "me on a desk", "2027-01-02T03:04:05Z", RIGHT, ("B", "E"))
    write_proof(path, proof)
    assert read_proof(path) == proof
    assert said() == "proven 2027-01-02 by me on a desk: 2 trials, each of the outputs B, E counted"
    assert "another box, or other wiring" in said(identity="QC,9528,2")
    assert "another box, or other wiring" in said(channels=CHANNELS | {"lamp_1": "A"})
    write_proof(path, Proof("QC,9528,1", CHANNELS, False, "me", "2027-01-02", RIGHT, ("E",)))
    assert "has NOT held: output B was not counted" in said()  # as before outputs were counted one by one
    write_proof(path, Proof("QC,9528,1", CHANNELS, True, "me", "2027-01-02", RIGHT, ("B", "E")))
    assert "only a simulation" in said()
    assert said(simulated=True).startswith("proven")
    failed = Trial("a burst of 20", False, "21 of 20")
    write_proof(path, Proof("QC,9528,1", CHANNELS, False, "me", "2027-01-02", (*RIGHT, failed)))
    assert "has NOT held: a burst of 20: 21 of 20" in said()
    path.write_text(path.read_text().replace("21 of 20", "20 of 20"))
    assert "does not agree with its seal" in said()
    path.write_text("{}")
    with pytest.raises(SealBroken):
        read_proof(path)


def wired(d):
    return {role.value: output for role, output in d.box.wiring.items()}


def test_who_is_asked_for_the_code_is_told_whether_the_box_is_proven(tmp_path):
    hardware = SimpleNamespace(bench=SimpleNamespace(path=tmp_path / "bench.yaml"), simulation=None)
    with desk() as d:
        d.laser.open("sim://desk")
        assert "it was never proven on this bench" in what_is_proven(hardware, "laser", d.laser)
        counted = tuple(wired(d).values())
        proof = Proof(d.laser.box.identity, wired(d), False, "me", "2027-01-02", RIGHT, counted)
        write_proof(proof_path(hardware.bench.path, "laser"), proof)
        assert "proven 2027-01-02 by me: 2 trials" in what_is_proven(hardware, "laser", d.laser)


@pytest.mark.slow
@pytest.mark.parametrize("counter", ["camera", "pulse box"])
def test_the_verb_proves_a_simulated_box_plug_by_plug(tmp_path, capsys, counter):
    need_harvesters()
    bench, _ = write_flow(tmp_path)
    if counter == "pulse box":  # the marker is too long for it
        text = (
            bench.read_text().replace(", marker: F", "").replace("marker: line_status, line: 2", "marker: spacing")
        )
        bench.write_text(f"{text}  counter: {{kind: counter, port: /dev/counter}}\n")
    assert main(["laser", "prove", "--bench", str(bench), "--simulate", "--rate-hz", "10"]) == DONE
    said = " ".join(capsys.readouterr().out.split())
    for plug in ("B (q_switch_1)", "D (q_switch_2)", "E (camera)"):
        assert f"output {plug}: a burst of 20: ok (20 of 20)" in said
        assert f"output {plug}: the cable pulled in a burst: ok (100 of 100)" in said
    proof = read_proof(proof_path(bench, "laser"))
    assert proof is not None
    assert proof.holds
    assert proof.simulated
    assert set(proof.counted) == set(proof.channels.values())
