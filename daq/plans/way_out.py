"""From the homed place to where a plan begins, judged before anything moves.

Homing itself cannot be judged, because nobody knows yet where anything is. Where it ends is known only if the
bench file says so (`homed_at_mm` of each axis); then the moves of `after_home` are judged here as they will be
when they are driven, and the plan is forecast from where they end. An axis that `after_home` moves is known from
then on.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from daq.bench.bench_table import Bench
from daq.plans.forecast import Forecast, Violation, forecast
from daq.plans.steps import Step
from stages.errors import StageUsageError
from stages.stage import Stage


@dataclass(frozen=True)
class WayOut:
    """What is known about the way out of the homed place.

    Parameters
    ----------
    start_mm : dict or None
        Where every axis stands after it; None if that is not known.
    problems : tuple of (int, str)
        Moves of `after_home` (counted from 1) that must not be made, and why.
    sentence : str
        What a person should know about it.
    """

    start_mm: dict[str, float] | None
    problems: tuple[tuple[int, str], ...]
    sentence: str


def way_out(bench: Bench, stage: Stage) -> WayOut:
    """Go through `after_home` without sending anything.

    Parameters
    ----------
    bench : Bench
        Says where homing ends and what follows it.
    stage : Stage
        Its stage, open or not.
    """
    stages = bench.table.stages
    here = {name: axis.homed_at_mm for name, axis in stages.axes.items() if axis.homed_at_mm is not None}
    unknown = [name for name in stages.axes if name not in here]
    problems = []
    for number, move in enumerate(stages.after_home, start=1):
        if len(here) == len(stages.axes):
            try:
                stage.check(here, move)
            except StageUsageError as error:
                problems.append((number, str(error)))
        here |= move
    known = len(here) == len(stages.axes)
    if unknown:
        text = (
            f"where homing leaves {', '.join(unknown)} is not stated (homed_at_mm), so the way out of the homed "
            "place is judged only when it is driven"
        )
    elif problems:
        text = f"after_home does not lead out of the homed place: move {problems[0][0]}: {problems[0][1]}"
    else:
        text = "the plan is judged from the homed place" + (", left by after_home" if stages.after_home else "")
    return WayOut(here if known else None, tuple(problems), text)


def forecast_from_home(bench: Bench, stage: Stage, steps: Sequence[Step]) -> tuple[Forecast, str]:
    """Forecast a plan that begins with homing every axis; with a sentence about the way out of the homed place.

    Where that way is not known, the plan is forecast from the place at which the scene file holds.
    """
    out = way_out(bench, stage)
    said = forecast(bench, stage, steps, out.start_mm)
    first = steps[0].index if steps else 0
    more = [Violation(first, f"move {number} of after_home", text) for number, text in out.problems]
    return replace(said, violations=(*more, *said.violations)), out.sentence
