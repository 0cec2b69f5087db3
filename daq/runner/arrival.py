"""The way to a step, and the proof of being there, before the first frame and after the last one.

A frame is filed under the positions of its step, so these have to be true while it is exposed. The controllers
are asked twice, each time with their word that they have not restarted since: once when the axes have settled,
and again when the frames are in. An axis that stands farther from its plan than its own tolerance has slipped,
was moved by hand, or was never moved: the step fails by its name, and planned and measured positions go into the
journal.

What an axis is believed to have been sent to stands in for what it reads only within that tolerance: the
micrometre that a reading differs from its target is no reason to drive there again, a millimetre is. A run begins
by driving every motor to its place, from its own side; a hand is not asked to turn what reads right already: glass
that has not been touched since it was calibrated stays so.
"""

from collections.abc import Mapping

from daq.bench.opened import OpenBench, require_positions
from daq.plans.steps import route
from stages.axis_settings import ROUNDING_UM
from stages.errors import NotInPosition

NAP_S = 0.1  # a resting bench looks at the latch this often


def go_to(
    hardware: OpenBench,
    targets_mm: Mapping[str, float],
    rests_at_mm: Mapping[str, float],
    here_mm: Mapping[str, float] | None = None,
) -> None:
    """Bring every axis to its position along the safe route.

    Parameters
    ----------
    hardware : OpenBench
        Open.
    targets_mm : mapping
        Position of every axis.
    rests_at_mm : mapping
        Where this run has sent axes before; what reads so within its tolerance is not moved again.
    here_mm : mapping, optional
        Where every axis was found last; read anew if not given. It only says which axes have to move: each move is
        judged by positions of its own moment.

    Raises
    ------
    StageError
        A move was refused, or something came between; everything has been halted.
    """
    found_mm = dict(here_mm or require_positions(hardware.stage.where_mm()))
    believed_mm = {name: targets_mm[name] for name in hardware.bench.table.stages.by_hand} | dict(rests_at_mm)
    away = off_by_mm(hardware, believed_mm, found_mm)
    found_mm |= {name: mm for name, mm in believed_mm.items() if name not in away}
    for move in route(hardware.bench, found_mm, targets_mm):
        hardware.stage.move(move)


def rest(hardware: OpenBench, settle_s: float, token: int) -> None:
    """Let everything come to rest; a stop ends it.

    Parameters
    ----------
    hardware : OpenBench
        Open.
    settle_s : float
        For how long.
    token : int
        Of the latch, from the beginning of the step.
    """
    clock, latch = hardware.clock, hardware.stage.latch
    end_s = clock.now_s() + settle_s
    latch.check(token)
    while (left_s := end_s - clock.now_s()) > 0.0:
        clock.sleep_s(min(NAP_S, left_s))
        latch.check(token)


def off_by_mm(
    hardware: OpenBench, planned_mm: Mapping[str, float], measured_mm: Mapping[str, float]
) -> dict[str, float]:
    """Return the axes that stand outside their tolerance, and by how much (measured - planned)."""
    tolerance_um = {name: axis.settings.in_position_um for name, axis in hardware.stage.axes.items()}
    away_mm = {name: measured_mm[name] - mm for name, mm in planned_mm.items()}
    return {name: mm for name, mm in away_mm.items() if abs(mm) * 1e3 > tolerance_um[name] + ROUNDING_UM}


def require_arrived(
    hardware: OpenBench, planned_mm: Mapping[str, float], measured_mm: Mapping[str, float]
) -> None:
    """Refuse to believe in a step whose axes are not where they were sent.

    Raises
    ------
    NotInPosition
        Some are not; the message names them and how far off they are.
    """
    if away := off_by_mm(hardware, planned_mm, measured_mm):
        offsets = ", ".join(f"{name} is {mm:+.3f} mm off its plan" for name, mm in away.items())
        raise NotInPosition(f"{offsets}; has it slipped, or was it moved by hand? Home it, then resume the run")
