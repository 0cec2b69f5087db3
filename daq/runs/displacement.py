"""What a shift experiment really did: commanded, measured and (simulated bench only) true displacement, apart.

The displacement is that of the target between a step and its reference step, in world coordinates:

    commanded   from the planned positions
    measured    from what the controllers reported at rest
    true        from where the carriages of the simulated bench really stood

Evaluations must use `measured`; `true` is there to score them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from daq.bench.bench_file import TARGET, Bench, Vector
from daq.plans.steps import Step
from daq.runs.journal import Entry


@dataclass(frozen=True, slots=True)
class Displacement:
    """Displacement of one step from its reference [mm]."""

    tag: str
    frames: tuple[int, int]  # first frame of the reference, first frame of the step
    commanded_mm: Vector
    measured_mm: Vector
    true_mm: Vector | None

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def displacements(bench: Bench, steps: Sequence[Step], entries: Sequence[Entry]) -> list[Displacement]:
    """Return the displacement of every finished step that has a reference.

    Parameters
    ----------
    bench : Bench
        Says which axes carry the target.
    steps : sequence of Step
        The plan.
    entries : sequence of dict
        The journal.
    """
    done = {int(entry["step"]): entry for entry in entries if entry["kind"] == "step"}
    found = []
    for step in steps:
        if step.reference is None or step.index not in done or step.reference not in done:
            continue
        before, after = done[step.reference], done[step.index]
        has_truth = "true_mm" in before and "true_mm" in after
        found.append(
            Displacement(
                step.tag,
                (steps[step.reference].first_frame, step.first_frame),
                _between(bench, before["planned_mm"], after["planned_mm"]),
                _between(bench, before["measured_mm"], after["measured_mm"]),
                _between(bench, before["true_mm"], after["true_mm"]) if has_truth else None,
            )
        )
    return found


def _between(bench: Bench, before_mm: Mapping[str, float], after_mm: Mapping[str, float]) -> Vector:
    before, after = bench.offset_mm(TARGET, before_mm), bench.offset_mm(TARGET, after_mm)
    x, y, z = (b - a for a, b in zip(before, after, strict=True))
    return (x, y, z)
