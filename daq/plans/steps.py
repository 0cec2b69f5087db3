"""Steps: what a plan expands to before anything moves, and the way from one step to the next.

A step is idempotent: it names the position of EVERY axis, so it can be carried out from anywhere, again, or
first after a crash.  The list is a value: it can be drawn, checked, timed, hashed and compared.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

from daq.bench.bench_table import Bench, digest
from daq.bench.elements import GLASS
from daq.plans.pulse_order import PulseOrder

CLEAR, BEHIND_GLASS = "clear", "glass"


@dataclass(frozen=True, slots=True)
class Step:
    """One stop of a plan.

    Parameters
    ----------
    index : int
        Place in the list, 0 first.
    tag : str
        What is photographed, e.g. ``target_glass_z-10``; for people and for evaluations.
    positions_mm : tuple of (str, float)
        Position of every axis.
    settle_s : float
        Rest before the first frame, beside the axes' own settling.
    first_frame, frames : int
        Number of the first frame within the run, and how many.
    view : str
        ``clear`` or ``glass``.
    shows : str
        Object on the target's stage: ``chessboard`` or ``particles``.
    on_plane : bool
        Whether the target lies in the investigation plane, so that the frame can be corrected.
    reference : int or None
        Step that this one is displaced from.
    group : int
        Frames that belong together, counted from the first one; what is gone on with begins with such a group.
    gaps_at_most : float
        Share of the frames that may be lost in one go, 0 to 1.  Above 0 the step keeps every frame that it has; at
        0 it is whole or taken again.
    pulses : PulseOrder or None
        Pairs of light pulses that the frames are taken by; such a step keeps the pairs that it has.
    """

    index: int
    tag: str
    positions_mm: tuple[tuple[str, float], ...]
    settle_s: float
    first_frame: int
    frames: int
    view: str
    shows: str
    on_plane: bool
    reference: int | None = None
    group: int = 1
    gaps_at_most: float = 0.0
    pulses: PulseOrder | None = None

    @property
    def may_have_gaps(self) -> bool:
        """True if the step keeps what it has, and goes on behind what it lost."""
        return self.gaps_at_most > 0.0 or self.pulses is not None

    @property
    def shows_light_sheet(self) -> bool:
        """True if its frames show particles in a light sheet, and no print on the target's stage."""
        return self.pulses is not None or self.group > 1

    @property
    def is_lit_from_outside(self) -> bool:
        """True if another program's synchroniser triggers laser and camera."""
        return self.pulses is not None and self.pulses.laser is None

    @property
    def targets_mm(self) -> dict[str, float]:
        """Position of every axis as a dict."""
        return dict(self.positions_mm)

    @property
    def numbers(self) -> range:
        """Numbers of its frames."""
        return range(self.first_frame, self.first_frame + self.frames)


def steps_hash(steps: Sequence[Step]) -> str:
    """Hex digest (16 characters) of a list of steps; what a step does not say leaves no trace in it."""
    trees = [asdict(step) for step in steps]
    for tree in trees:
        for name in ("group", "gaps_at_most", "pulses"):  # an older version did not know them
            if tree[name] == Step.__dataclass_fields__[name].default:
                del tree[name]
    return digest(trees)


def frame_count(steps: Sequence[Step]) -> int:
    """Frames of all steps."""
    return sum(step.frames for step in steps)


def route(bench: Bench, start_mm: Mapping[str, float], end_mm: Mapping[str, float]) -> list[dict[str, float]]:
    """Return the moves from one set of positions to another, in the order in which they are made.

    The glass may touch the target.  If it has to travel sideways it first goes back to `glass.retract_mm`, then
    everything else moves, and only then it comes forward again.

    Parameters
    ----------
    bench : Bench
        Says which axes carry the glass, and where it retracts to.
    start_mm, end_mm : mapping
        Position of every axis.

    Returns
    -------
    list of dict
        Targets [mm] of one `Stage.move` each; axes that stay are not named.
    """
    changed = {name: mm for name, mm in end_mm.items() if start_mm[name] != mm}
    glass = bench.table.glass
    retract_mm = glass.retract_mm if glass is not None else {}
    sideways = any(name in bench.table.axes_of(GLASS) and name not in retract_mm for name in changed)
    if not sideways or not retract_mm:
        return [changed] if changed else []
    here, moves = dict(start_mm), []
    between = {name: mm for name, mm in changed.items() if name not in retract_mm}
    for targets in (retract_mm, between, {name: end_mm[name] for name in retract_mm}):
        move = {name: mm for name, mm in targets.items() if here[name] != mm}
        here |= move
        if move:
            moves.append(move)
    return moves
