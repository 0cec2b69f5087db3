"""What a plan may ask and hardly ever does: questions about it, each with its line; see `tracer.unusual`."""

from daq.acquisition.bench.bench_table import Bench
from daq.acquisition.plans.experiments.focus import FocusPlan
from daq.acquisition.plans.experiments.shift import ShiftPlan
from daq.acquisition.plans.plan import Plan
from daq.acquisition.plans.plan_table import px_per_mm
from ground.errors import Problem
from ground.usual import Usual, question, unusual

DISPLACED_PX = Usual(0.1, 64.0)  # of the bare view: two windows


def plan_questions(plan: Plan, bench: Bench) -> list[str]:
    """Ask about what is unusual in a plan file on its bench: questions with file and line."""
    asked, table = unusual(plan.document, plan.table), plan.table
    if isinstance(table, ShiftPlan):
        for number, displacement in enumerate(table.displacements):
            *sideways, _ = displacement.vector_mm(px_per_mm(bench))
            moved_px = max(map(abs, sideways)) * px_per_mm(bench)
            if moved_px and (said := question("moved_px", moved_px, DISPLACED_PX)):
                text = f"displacements.{number + 1}: in px of the picture: {said}"
                asked.append(Problem(plan.document.line(("displacements", number)), text))
    reach_mm = 0.3 * bench.scene.camera.position_mm[2]
    far = [
        step for step in plan.steps if any(abs(mm - bench.home_mm[n]) > reach_mm for n, mm in step.positions_mm)
    ]
    if isinstance(table, FocusPlan) and far:
        text = f"z_mm: does {far[0].tag} go so far, more than {reach_mm:.3g} mm from the place in the scene?"
        asked.append(Problem(plan.document.line(("z_mm",)), text))
    return [f"{plan.path}:{one.line}: {one.text}" for one in sorted(asked, key=lambda one: one.line)]
