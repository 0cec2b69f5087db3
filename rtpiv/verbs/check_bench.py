"""Summaries of benches and of plans on them, for `check`; checking a scene imports none of this."""

from collections.abc import Iterable
from pathlib import Path

from daq.bench.bench_file import load_bench
from daq.bench.bench_table import Bench
from daq.bench.guards import idle_stage
from daq.bench.opened import check_devices, check_simulation
from daq.bench.plausibility import bench_questions
from daq.errors import PlanError
from daq.plans.forecast import forecast_from_home, time_said
from daq.plans.plan import Plan, load_plan, plan_questions, read_plan
from daq.plans.plan_table import px_per_mm
from daq.runs.frame_accounting import UNCHECKED
from ground.plain_words import quantity
from rtpiv.verbs.check import WRONG

Summary = tuple[str, list[str]]  # of a file, and questions about it


class Benches:
    """Benches on which plans are tried; each file is read once, however many plans there are."""

    def __init__(self) -> None:
        self._read: dict[Path, Bench] = {}

    def bench(self, path: Path) -> Bench:
        """Return a bench."""
        if path not in self._read:
            self._read[path] = load_bench(path)
        return self._read[path]

    def describe(self, path: Path) -> Summary:
        """Return the summary of a bench."""
        bench = self.bench(path)
        return _describe_bench(bench), bench_questions(bench)

    def describe_plan(self, path: Path, benches: Iterable[Path]) -> Summary:
        """Return the summary of a plan on each bench that can execute it, at least one."""
        fitting, reasons, questions = [], [], []
        for named in benches:
            try:
                bench = self.bench(named)
                plan = load_plan(path, bench)
                fitting.append(f"{_describe_plan(path, plan, bench)} on {named.name}")
                questions += plan_questions(plan, bench)
                questions += [UNCHECKED] if any(step.is_lit_from_outside for step in plan.steps) else []
            except WRONG as error:
                reasons.append(error)
        if fitting:
            return "; ".join(fitting), list(dict.fromkeys(questions))
        _, table = read_plan(path)  # errors of the plan itself come first
        if reasons:
            raise reasons[0]
        return f"{table.experiment}; no bench is given, so its steps are not checked (--bench)", []


def _describe_bench(bench: Bench) -> str:
    check_devices(bench)
    stages = bench.table.stages
    more = ", ".join(name for name in bench.more)
    simulated = "can be simulated" if check_simulation(bench) else "has no simulation"
    return (
        f"{quantity(len(stages.axes), 'axis', 'axes')} on {quantity(len(stages.controllers), 'controller')},"
        f" camera by {bench.table.camera.backend}"
        f"{', ' + more if more else ''}; {px_per_mm(bench):.1f} px/mm; {simulated}"
    )


def _describe_plan(path: Path, plan: Plan, bench: Bench) -> str:
    said, _ = forecast_from_home(bench, idle_stage(bench), plan.steps, plan.table.further_cameras)
    if said.violations:
        lines = [
            f"{path}: step {v.step + 1} ({v.tag}) is not allowed on {bench.path.name}: {v.text}"
            for v in said.violations
        ]
        raise PlanError("\n".join(lines))
    size = f"{quantity(len(plan.steps), 'step')}, {quantity(said.frames, 'frame')}"
    steps = f"{plan.table.experiment}, {size}, about {time_said(bench, plan.steps, said)}"
    return "; ".join((steps, *said.link.splitlines()))
