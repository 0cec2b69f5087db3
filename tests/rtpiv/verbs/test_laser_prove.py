"""No old proof stands while a new one is made, nor after one that failed."""

from types import SimpleNamespace

import pytest

from daq.bench.pairs_section import PairsSection
from daq.runs.laser_proof import Proof, Trial, proof_path, proof_sentence, read_proof, write_proof
from daq.timing.errors import LaserDoubt, NotArmed
from daq.timing.pulses import Role
from rtpiv.verbs import laser_prove
from tests.daq.runner.test_laser_trials import WRONG, AtPlug, Hands, wired
from tests.daq.timing.quantum_desk import desk
from tests.slow_cases import slow

SECTION = SimpleNamespace(
    pairs=PairsSection(shape="two_blocks", marker="spacing", dead_us=2.0, second_exposure_us=20_000.0)
)
RIGHT = (Trial("output B (q_switch_1): a burst of 7", True, "7 of 7"),)


def said(d):
    return proof_sentence(d.bench, "laser", d.box.identity, wired(d), simulated=False)


def prove(d):
    laser_prove.prove_box(d.hardware, "laser", d.laser, 10.0)


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A desk as a bench whose laser has a proof that holds, and a way to prove it again."""
    with desk() as d:
        d.laser.open("sim://desk")
        d.bench = tmp_path / "bench.yaml"
        d.path = proof_path(d.bench, "laser")
        counted = tuple(wired(d).values())
        write_proof(d.path, Proof(d.box.identity, wired(d), False, "me", "2026-01-01", RIGHT, counted))
        assert said(d).startswith("proven 2026-01-01")
        counter = AtPlug(d)
        counter.settings = {"ExposureTime": 100.0}
        d.hands = Hands(d, counter)
        monkeypatch.setattr(laser_prove, "CameraCounter", lambda camera, section: counter)
        monkeypatch.setattr(laser_prove, "_Person", lambda: d.hands)
        d.hardware = SimpleNamespace(
            bench=SimpleNamespace(path=d.bench),
            camera=None,
            devices={},
            camera_section=SECTION,
            clock=d.clock,
            simulation=None,
        )
        yield d


def test_a_right_box_is_proven_anew(lab, capsys):
    prove(lab)
    assert said(lab).startswith("proven")
    assert "2026-01-01" not in said(lab)
    assert sorted(read_proof(lab.path).counted) == sorted(wired(lab).values())
    out = " ".join(capsys.readouterr().out.split())
    assert "output D (q_switch_2): the cable pulled in a burst: ok (100 of 100)" in out


def test_no_proof_stands_while_pulses_are_given(lab):
    seen = []
    lab.emulator.outputs.listen(lambda pulse: seen.append(lab.path.exists()))
    prove(lab)
    assert seen
    assert not any(seen)


@pytest.mark.parametrize("wrong", ["Q-switch 2 never counts", "lamps run on", "ends when the cable is out"])
def test_a_wrong_box_has_no_proof_that_holds(lab, wrong):
    WRONG[wrong](lab)
    with pytest.raises(LaserDoubt):
        prove(lab)
    assert "has NOT held" in said(lab)


@pytest.mark.parametrize("error", [LaserDoubt("the box is another one"), KeyboardInterrupt(), MemoryError()])
@pytest.mark.parametrize("output", [slow("B"), "F"])
def test_trials_that_end_by_an_error_leave_no_proof_that_holds(lab, error, output):
    locate = lab.hands.move_counter

    def move(asked, roles):
        locate(asked, roles)
        if asked == output:
            lab.box.begin = fail

    def fail(pairs, camera=True):
        raise error

    lab.hands.move_counter = move
    with pytest.raises(type(error)):
        prove(lab)
    assert "has NOT held" in said(lab)


def test_an_interrupt_in_the_last_trials_of_the_last_plug_leaves_none(lab):
    lab.box.wiring = {role: output for role, output in lab.box.wiring.items() if role is not Role.MARKER}
    firing, fire = [], lab.laser.fire

    def fire_and_leave(pairs):
        firing.append(lab.hands.asked[-1])
        if firing.count("E") == 5:
            raise KeyboardInterrupt
        fire(pairs)

    lab.laser.fire = fire_and_leave
    with pytest.raises(KeyboardInterrupt):
        prove(lab)
    assert "output E was not counted" in said(lab)


def test_without_the_code_nothing_is_tried_and_the_proof_stays(lab):
    lab.hands._code = "1"
    with pytest.raises(NotArmed):
        prove(lab)
    assert said(lab).startswith("proven 2026-01-01")
