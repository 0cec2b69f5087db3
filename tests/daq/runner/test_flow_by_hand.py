"""A flow on a bench without a motor: a hand puts target and glass in place, and light falls only when it is out.

The simulated bench is rehearsed, so it says when which light fell; the hand's own turns are noted beside them, by
the same clock.
"""

import tifffile

from daq.bench.rehearsal import Rehearsal
from daq.runs.pairs import pairs_of
from daq.runs.run_folder import RunFolder
from rtpiv.verbs.acquire import LiveFrames, acquire
from sim import world
from sim.event_log import read_event_log
from sim.stages import SimulatedStages
from tests.daq.flow_bench import ToldLight, told
from tests.daq.hand_bench import write_hand_flow

PAIRS, BACKGROUND = 10, 2


def test_ten_pairs_by_hand_are_lit_by_two_lights_each_and_none_while_a_hand_is_in(tmp_path, monkeypatch):
    turned_s, turns = [], SimulatedStages.turns

    def noted(stages, question, given_up):
        begins_s = stages.clock.now_s()
        typed = turns(stages, question, given_up)
        turned_s.append((begins_s, stages.clock.now_s()))
        return typed

    monkeypatch.setattr(SimulatedStages, "turns", noted)
    monkeypatch.setattr(world, "LitFlow", ToldLight)
    bench, plan = write_hand_flow(tmp_path, PAIRS, f"background: {{pairs: {BACKGROUND}}}\n")
    run = acquire(
        plan, bench, tmp_path / "runs", simulate=Rehearsal(seed=3), home=True,
        frames=LiveFrames(correct=False), operator="test",
    )  # fmt: skip
    found = pairs_of(run)
    assert (len(found.pairs), found.alone) == (PAIRS + BACKGROUND, ())
    for pair in found.pairs:
        first, second = (told(tifffile.imread(frame)) for frame in pair.frames)
        assert (first[0], first[2], second[0], second[2]) == (1, 0, 1, 1), "each frame shows one pulse, A then B"
        assert first[1] == second[1]
    happened = read_event_log(run)
    lights = happened.of_kind("light")
    assert not happened.violations
    assert [light.said["pulse"] for light in lights] == [0, 1] * (len(lights) // 2)
    assert len(lights) >= 2 * len(found.pairs)
    assert turned_s
    for begins_s, ends_s in turned_s:
        assert not [light for light in lights if begins_s <= light.time_s <= ends_s]
    steps = [entry for entry in RunFolder.open(run).entries() if entry["kind"] == "step"]
    assert all(step["reading_um"]["target_z"] > 0.0 for step in steps)
    assert all(abs(step["measured_mm"]["target_z"] + 20.0) < 0.1 for step in steps)
