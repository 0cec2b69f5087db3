"""Displacements of a shift run: which way the target went, from the reference to the step."""

import pytest

from daq.runs.displacement import displacements
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
    for moved, part in ((found.commanded_mm, 1.0), (found.measured_mm, 1.1), (found.true_mm, 1.2)):
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
    assert found.commanded_mm[0] == pytest.approx(found.commanded_mm[1])
    assert found.commanded_mm[0] > 0.0
    assert found.true_mm is None
