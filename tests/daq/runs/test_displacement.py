"""Displacements of a shift run: which way the target went, from the reference to the step."""

import pytest
import yaml

from daq.bench.bench_file import load_bench
from daq.plans.plan import load_plan
from daq.runs.displacement import displacements
from tests.daq.hand_bench import write_hand_bench
from tests.daq.small_bench import load


def test_a_displacement_goes_from_the_reference_to_the_step_in_world_directions(tmp_path):
    """The target carried 0.3 mm to the right, 0.2 down and 0.1 away from the camera; each column by its own."""
    bench, plan = load(tmp_path)
    steps = [step for step in plan.steps if step.reference is not None]
    step = steps[0]
    axes = {axis.along: name for name, axis in bench.table.stages.axes.items() if axis.carries == "target"}
    home = dict(bench.home_mm)
    went = {"x": 0.3, "y": -0.2, "z": -0.1}
    entries = []
    for index, share in ((step.reference, 0.0), (step.index, 1.0)):
        places = {
            name: {**home, **{axes[along]: home[axes[along]] + share * mm * part for along, mm in went.items()}}
            for name, part in (("planned_mm", 1.0), ("measured_mm", 1.1), ("true_mm", 1.2))
        }
        entries.append({"kind": "step", "step": index, **places})
    (found,) = displacements(bench, plan.steps, entries)
    for moved, part in ((found["commanded_mm"], 1.0), (found["measured_mm"], 1.1), (found["true_mm"], 1.2)):
        assert moved == pytest.approx([part * mm for mm in went.values()])


def test_a_plan_to_the_right_and_up_is_a_displacement_to_the_right_and_up(tmp_path):
    """By the targets of the plan itself: `along: [1, 1, 0]`."""
    bench, plan = load(tmp_path)
    step = next(step for step in plan.steps if step.reference is not None)
    entries = [
        {"kind": "step", "step": index, "planned_mm": places, "measured_mm": places}
        for index, places in (
            (step.reference, plan.steps[step.reference].targets_mm),
            (step.index, step.targets_mm),
        )
    ]
    (found,) = displacements(bench, plan.steps, entries)
    assert found["commanded_mm"][0] == pytest.approx(found["commanded_mm"][1])
    assert found["commanded_mm"][0] > 0.0
    assert found["true_mm"] is None
    assert "sigma_mm" not in found


def test_a_way_that_hands_have_read_is_as_unsure_as_its_two_readings(tmp_path):
    """Along x it was turned; y was not touched; along z it was read anew, which is a reading too."""
    path, plan = write_hand_bench(tmp_path)
    bench = load_bench(path)
    steps = load_plan(plan, bench).steps
    here = {**bench.home_mm}
    before = {"kind": "step", "step": 0, "planned_mm": here, "measured_mm": here}
    there = {**here, "target_x": 1.0}
    after = {"kind": "step", "step": 1, "planned_mm": there, "measured_mm": {**there, "target_z": 0.01}}
    (found,) = displacements(bench, steps, [before, after])
    turned_mm = 2**0.5 * 0.0042
    assert found["sigma_mm"] == pytest.approx((turned_mm, 0.0, turned_mm))


def test_beside_a_motor_only_the_hand_says_how_well_it_reads(tmp_path):
    path, plan = write_hand_bench(tmp_path)
    tree = yaml.safe_load(path.read_text())
    tree["stages"]["controllers"]["rail"] = {"driver": "pi_gcs2", "port": "/dev/ttyUSB0"}
    tree["stages"]["axes"]["target_x"] |= {"controller": "rail", "channel": "1"}
    del tree["stages"]["axes"]["target_x"]["reading_um"]
    path.write_text(yaml.safe_dump(tree))
    bench = load_bench(path)
    entries = [
        {"kind": "step", "step": step.index, "planned_mm": step.targets_mm, "measured_mm": step.targets_mm}
        for step in load_plan(plan, bench).steps
    ]
    (found,) = displacements(bench, load_plan(plan, bench).steps, entries)
    assert found["sigma_mm"] == (None, 0.0, 0.0)
