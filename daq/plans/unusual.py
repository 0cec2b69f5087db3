"""What a plan may ask and hardly ever does: questions about it, each with its line; see `tracer.scene.unusual`."""

from daq.bench.bench_table import Bench
from daq.plans.plan import Plan
from ground.errors import Problem
from ground.usual import unusual


def plan_questions(plan: Plan, bench: Bench) -> list[str]:
    """Ask about what is unusual in a plan file on its bench: questions with file and line."""
    asked = unusual(plan.document, plan.table)
    asked += [Problem(plan.document.line(place), text) for place, text in plan.table.questions(bench, plan.steps)]
    return [f"{plan.path}:{one.line}: {one.text}" for one in sorted(asked, key=lambda one: one.line)]
