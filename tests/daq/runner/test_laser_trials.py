"""A box is proven by what a camera sees of it, a box that is not right is found, and who arms is told."""

from types import SimpleNamespace

import pytest

from daq.runner.laser_session import what_is_proven
from daq.runner.laser_trials import BURSTS, trials
from daq.runs.laser_proof import Proof, Trial, proof_path, proof_sentence, read_proof, write_proof
from daq.runs.seal import SealBroken
from daq.timing.errors import NotArmed
from daq.timing.pulses import PulseTiming, Role
from daq.timing.states import LaserState
from rtpiv.command_line.cli import DONE, main
from tests.daq.cameras.rigs import need_harvesters
from tests.daq.flow_bench import write_flow
from tests.daq.timing.test_quantum_composers import EXPOSURES, PUMPED, LaserHead, desk

TIMING = PulseTiming(20.0, 10.0)


class SeesPulses:
    """What a camera would tell, without one: when the box has given each of its triggers."""

    def __init__(self, desk):
        self._desk, self._times = desk, []
        output = desk.box.wiring[Role.CAMERA]
        desk.emulator.outputs.listen(
            lambda pulse: self._times.append(pulse.rises_s) if pulse.output == output else None
        )

    def count(self, burst):
        self._times.clear()
        burst()
        self._desk.clock.sleep_s(2.0)
        self._desk.emulator.advance()
        return list(self._times)


class Hands:
    def __init__(self, desk, code=None, late=False):
        self._desk, self._code, self._late = desk, code, late

    def promise_dark(self, challenge):
        return self._code or challenge

    def pull_cable(self):
        if self._late:
            self._desk.clock.sleep_s(30.0)
        self._desk.line.unplug()

    def put_back(self):
        self._desk.line.plug_in()


def tried(d, **hands):
    d.laser.open("sim://desk")
    return list(trials(d.laser, TIMING, EXPOSURES, SeesPulses(d), Hands(d, **hands), d.clock))


@pytest.mark.parametrize("arms", ["run", "run all", "state"])
@pytest.mark.parametrize("has_lamps", [True, False])
def test_a_box_that_keeps_to_its_manual_is_proven(arms, has_lamps):
    wired = {role: output for role, output in PUMPED.items() if role is not Role.CAMERA_B}
    head = {} if has_lamps else {"wiring": wired, "head": LaserHead(max_rate_hz=100.0)}
    with desk(arms=arms, **head) as d:
        found = tried(d)
        assert [trial.what for trial in found[:3]] == [f"a burst of {pairs}" for pairs in BURSTS]
        assert all(trial.is_right for trial in found), found
        assert "without the cable 50 of 50" in found[-1].said
        assert d.laser.state is LaserState.SAFE


def one_too_many(d):
    tick = type(d.emulator._channels[0]).tick

    def one_more(channel, mode):
        words = channel.words
        channel.words = words | {"BCO": str(int(words["BCO"]) + 1)}
        try:
            return tick(channel, mode)
        finally:
            channel.words = words

    for channel in d.emulator._channels:
        channel.tick = one_more.__get__(channel)


def does_not_count(d):
    for channel in d.emulator._channels:
        channel.tick = lambda mode, channel=channel: channel.on


def is_deaf_to_stop(d):
    """Off by the word of the laser alone, without a conversation, is not heard."""
    d.box.drop = lambda: None
    d.laser.confirm_off = lambda: True


def hears_off_late(d):
    """What is said last before the light ends takes a second to get there."""
    stop = d.laser.stop

    def stop_later(why):
        d.clock.sleep_s(1.0)
        stop(why)

    d.laser.stop = stop_later


def needs_a_computer(d):
    """A box that ends by itself as soon as its cable is out has not shown that it counts."""
    d.line.on_cut = d.emulator.person_stops


@pytest.mark.parametrize(("spoil", "wrong"), [
    (one_too_many, {"a burst of 1", "a burst of 7", "a burst of 20", "the cable pulled in a burst"}),
    (does_not_count, {"the cable pulled in a burst"}), (is_deaf_to_stop, {"off in a burst"}),
    (hears_off_late, {"off in a burst"}), (needs_a_computer, {"the cable pulled in a burst"}),
])  # fmt: skip
def test_a_box_that_does_not_keep_to_it_is_found(spoil, wrong):
    with desk() as d:
        spoil(d)
        found = tried(d)
        assert wrong <= {trial.what for trial in found if not trial.is_right}, found


def test_without_the_code_nothing_leaves():
    with desk() as d:
        with pytest.raises(NotArmed, match="type the code"):
            tried(d, code="1")
        assert d.pulses(Role.CAMERA) == 0


def test_a_cable_that_was_pulled_too_late_has_shown_nothing():
    with desk() as d:
        found = tried(d, late=True)
        assert found[-1].is_right is None
        assert "prove again" in found[-1].said


RIGHT = (Trial("a burst of 7", True, "7 of 7"), Trial("off in a burst", True, "off: 10 of 50"))
CHANNELS = {"q_switch_1": "B", "camera": "E"}


def test_a_proof_is_kept_with_the_bench_and_said_to_who_arms(tmp_path):
    bench = tmp_path / "bench.yaml"

    def said(identity="QC,9528,1", channels=CHANNELS, simulated=False):
        return proof_sentence(bench, "laser", identity, channels, simulated)

    assert "it was never proven on this bench (rtpiv laser prove)" in said()
    path = proof_path(bench, "laser")
    proof = Proof("QC,9528,1", CHANNELS, False, "me on a desk", "2027-01-02T03:04:05Z", RIGHT)
    write_proof(path, proof)
    assert read_proof(path) == proof
    assert said() == "proven 2027-01-02 by me on a desk: 7 of 7; off: 10 of 50"
    assert "another box, or other wiring" in said(identity="QC,9528,2")
    assert "another box, or other wiring" in said(channels=CHANNELS | {"lamp_1": "A"})
    write_proof(path, Proof("QC,9528,1", CHANNELS, True, "me", "2027-01-02", RIGHT))
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
        proof = Proof(d.laser.box.identity, wired(d), False, "me", "2027-01-02", RIGHT)
        write_proof(proof_path(hardware.bench.path, "laser"), proof)
        assert "proven 2027-01-02 by me: 7 of 7" in what_is_proven(hardware, "laser", d.laser)


@pytest.mark.slow
def test_the_verb_proves_a_simulated_box_by_its_camera(tmp_path, capsys):
    need_harvesters()
    bench, _ = write_flow(tmp_path)
    assert main(["laser", "prove", "--bench", str(bench), "--simulate", "--rate-hz", "10"]) == DONE
    said = " ".join(capsys.readouterr().out.split())
    assert "a burst of 20: ok (20 of 20)" in said
    assert "without the cable 50 of 50" in said
    proof = read_proof(proof_path(bench, "laser"))
    assert proof is not None
    assert proof.holds
    assert proof.simulated
