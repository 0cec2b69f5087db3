"""Experiments: one file each, one line here.

A plan file names one; `plan_table` imports it only then.  An experiment is a `PlanTable`: its keys in the plan
file, and `poses`, a pure function of bench and file that says what is to be photographed.
"""

from importlib import import_module

from daq.plans.plan_table import PlanTable

EXPERIMENTS = {
    "target": "daq.plans.experiments.target:TargetPlan",
    "shift": "daq.plans.experiments.shift:ShiftPlan",
    "stream": "daq.plans.experiments.stream:StreamPlan",
    "focus": "daq.plans.experiments.focus:FocusPlan",
    "align": "daq.plans.experiments.align:AlignPlan",
    "flow": "daq.plans.experiments.flow:FlowPlan",
}


def plan_table(experiment: str) -> type[PlanTable]:
    """Class of an experiment; KeyError if there is no line for it."""
    module, _, name = EXPERIMENTS[experiment].partition(":")
    found: type[PlanTable] = getattr(import_module(module), name)
    return found
