"""A bench that hands move: simulated, refused where nobody can be asked, and dark while somebody reaches in."""

import io
import json

import numpy as np
import pytest
import yaml

from daq import open_session
from daq.bench.bench_file import load_bench
from daq.bench.opened import keep_apart, open_bench
from daq.runner.arrival import go_to
from daq.timing.states import Event, LaserState
from rtpiv.command_line.cli import DONE, USAGE, main
from stages.errors import MotionBarred
from stages.scale_question import ScaleQuestion
from stages.stage import Stage
from tests.daq.hand_bench import EXAMPLES, write_hand_bench, write_real_hand_bench
from tests.daq.small_bench import SIDE_PX
from tests.daq.timing.armed_laser import laser_on
from tests.stages.benches import stages_table


def words(bench, plan, out):
    return ["acquire", str(plan), "--bench", str(bench), "--home", "--no-correct", "-o", str(out)]


@pytest.mark.slow
def test_a_simulated_hand_takes_a_run_whose_errors_only_the_truth_knows(tmp_path, monkeypatch):
    """And needs no terminal."""
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    (tmp_path / "ring").mkdir()
    np.save(tmp_path / "ring" / "0.npy", np.full((SIDE_PX, SIDE_PX), 7, np.uint16))
    bench, plan = write_hand_bench(tmp_path, ring="ring", hand={"reads_um": 30.0, "division_um": 10.0})
    assert main([*words(bench, plan, tmp_path / "runs"), "--simulate"]) == DONE
    (run,) = (tmp_path / "runs").iterdir()
    (moved,) = json.loads((run / "displacements.json").read_text())
    assert moved["commanded_mm"] == [1.0, 0.0, 0.0]
    assert abs(moved["measured_mm"][0] - 1.0) <= 0.02 + 1e-9
    assert 0.001 < abs(moved["true_mm"][0] - moved["measured_mm"][0]) < 0.2


@pytest.mark.parametrize("more", [[], ["--operator", "me"]])
def test_nobody_at_a_terminal_is_said_before_anything_is_begun(tmp_path, monkeypatch, capsys, more):
    monkeypatch.setattr("sys.stdin", io.StringIO("0.0\n0.0\n"))
    bench, plan = write_real_hand_bench(tmp_path)
    assert main([*words(bench, plan, tmp_path / "runs"), *more]) == USAGE
    said = capsys.readouterr().err
    assert ("glass_y, target_x, target_y, target_z are moved by hand" in said) == (not more)
    assert not (tmp_path / "runs").exists()


def test_lamps_are_off_while_somebody_reaches_in():
    """A motor may move while lamps run; a hand may not be there."""
    laser, box, clock = laser_on()
    stage = Stage.open(stages_table("by_hand", approach=None), clock)
    asked = []

    def reads(question: ScaleQuestion, given_up):
        asked.append((question.axis, laser.state, bool(box.lamps)))
        return "20.0"

    stage.set_operator(reads)
    keep_apart(laser, stage)
    laser.warm(10.0)
    assert (laser.state, bool(box.lamps)) == (LaserState.WARM, True)
    code = laser.challenge
    stage.home()
    assert asked == [("b", LaserState.SAFE, False), ("a", LaserState.SAFE, False)]
    assert laser.challenge != code  # whoever wants light again is asked anew
    box.unreadable = True
    laser._enter(Event.BAD)
    with pytest.raises(MotionBarred):
        stage.move({"a": 30.0})
    assert len(asked) == 2


def test_a_laser_that_a_script_opens_later_is_off_as_well_before_a_hand_reaches_in(tmp_path):
    bench, _ = write_hand_bench(tmp_path)
    tree, flow = (yaml.safe_load(path.read_text()) for path in (bench, EXAMPLES / "bench-flow.yaml"))
    bench.write_text(yaml.safe_dump(tree | {name: flow[name] for name in ("camera", "devices")}))
    with open_session(bench, simulate=True) as session:
        laser = session.device("laser")
        laser.warm(10.0)
        assert laser.state is LaserState.WARM
        session.home()
        assert laser.state is LaserState.SAFE


def test_the_hand_of_a_simulated_bench_turns_for_whoever_opens_it(tmp_path):
    bench = load_bench(write_hand_bench(tmp_path)[0])
    with open_bench(bench, simulate=True, only={"stages"}) as opened:
        opened.stage.home()
        opened.stage.move({"target_x": 3.0})
        where = opened.stage.where_mm()
        truth = opened.simulation.true_mm()
    assert where["target_x"] == pytest.approx(3.0, abs=0.011)
    assert all(abs(where[name] - truth[name]) < 0.05 for name in truth)
    assert where != truth


def test_a_hand_is_not_asked_to_turn_what_reads_right_already(tmp_path):
    """Glass that was not touched since it was calibrated stays so; a known way is turned however short it is."""
    bench = load_bench(write_hand_bench(tmp_path)[0])
    asked = []
    with open_bench(bench, simulate=True, only={"stages"}) as opened:
        reads = {"glass_y": 140.05, "target_x": 12.5, "target_y": 12.49, "target_z": 20.0}

        def person(question: ScaleQuestion, given_up):
            if question.target_mm is not None:
                asked.append(question.axis)
                reads[question.axis] = question.target_mm
            return f"{reads[question.axis]:.3f}"

        opened.stage.set_operator(person)
        opened.stage.home()
        home = bench.home_mm
        go_to(opened, home, {})
        assert asked == ["target_z"]
        where = opened.stage.where_mm()
        assert where["glass_y"] == pytest.approx(0.05)
        assert where["target_y"] == pytest.approx(-0.01)
        go_to(opened, home | {"target_y": -0.005}, home)
        assert asked == ["target_z", "target_y"]
