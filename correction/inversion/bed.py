"""The sheets of a bed, tens of thousands: small ones in one call, each large one on all cores.

Both verify what they find in bundles (``kernels.bed_sheets``).
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from correction.inversion.kernels.bed_sheets import (
    Sensor,
    Small,
    StartScratch,
    solve_in_bundle,
    solve_small_sheets,
)
from correction.inversion.kernels.inverse import Tables
from correction.inversion.kernels.lonely import Ways
from correction.inversion.kernels.newton import GROUP, NEWTON_NUMBERS
from correction.inversion.kernels.starts import LANES, MEASURES
from correction.inversion.sheets import Ordered, Sheet, Sheets, Starts
from ground.rows import run_parts
from tracer.kernels.lanes import Bundle
from tracer.strategies.beds import Balls
from tracer.strategies.lockstep import block_scratch


class Sought(NamedTuple):
    """What is sought: scene and grid as kernels take them, whether `every` node is, limits, the map's arrays."""

    tables: Tables
    grid: NDArray[np.float64]
    windows: NDArray[np.float64]
    every: bool
    limits: NDArray[np.float64]
    maps: tuple[NDArray[Any], ...]


def solve_bed(sought: Sought, sheets: Sheets, ways: Ways, balls: Balls, weight: NDArray[np.float32]) -> None:
    """Solve all sheets, those with few events first.

    Parameters
    ----------
    sought : Sought
        Scene, grid, limits and maps.
    sheets : Sheets
        Those of the ray map.
    ways : Ways
        Spheres of each branch.
    balls : Balls
        The spheres, as bundles take them.
    weight : (h, w) array
        Last layer of the weights: who has enough takes no view any more.
    """
    every = sheets.ordered()
    small = _listed(every, ways, balls, sought.every)
    start = StartScratch(
        np.zeros(3, np.int64),
        np.empty(LANES, np.int64),
        np.empty(MEASURES),
        *sheets.room_for_starts(),
        np.zeros(1 << (2 * sheets.room).bit_length(), np.int64),
    )
    sensor = Sensor(sheets.plane, sheets.branch, sheets.flags, sheets.taken)
    scratch, progress = _bundle_scratch(balls), np.zeros(2, np.int64)
    while progress[0] < len(every.branch):
        progress[1] = sheets.stamp
        solve_small_sheets(
            sought.tables,
            ways,
            sought.grid,
            sought.windows,
            balls.balls,
            balls.bed,
            sought.every,
            small,
            sensor,
            progress,
            sought.limits,
            start,
            *scratch,
            sought.maps,
        )
        sheets.stamp = int(progress[1])
        if progress[0] < len(every.branch):
            k = int(progress[0])
            sheet, way = every.sheet(k), slice(small.begin[k], small.begin[k + 1])
            parts = sheets.starts(sheet, weight, small.enough[k])
            _solve_large(sought, sheet, parts, balls, small.events[way], small.balls[way])
            progress[0] += 1


def _listed(every: Ordered, ways: Ways, balls: Balls, all_nodes: bool) -> Small:
    """All sheets with their spheres, as kernels take them."""
    sizes = np.diff(ways.begin)[every.branch]
    ends = np.cumsum(sizes)
    inside = np.arange(int(ends[-1]) if len(ends) else 0) - np.repeat(ends - sizes, sizes)
    events = ways.events[np.repeat(ways.begin[every.branch], sizes) + inside]
    place = np.empty(len(balls.order), np.int64)
    place[balls.order] = np.arange(len(balls.order))
    begin = np.concatenate(([0], ends))
    enough = (np.full(len(sizes), np.inf) if all_nodes else 1.0 / (1.0 + every.events)).astype(np.float32)
    return Small(every.branch, every.sign, events, place[events], begin, every.runs, every.first, enough)


def _solve_large(
    sought: Sought,
    sheet: Sheet,
    parts: Iterator[Starts],
    balls: Balls,
    sequence: NDArray[np.int64],
    way: NDArray[np.int64],
) -> None:
    """Solve a large sheet on all cores."""

    def work(part: Starts) -> None:
        starts, nodes = part
        solve_in_bundle(
            sought.tables,
            sought.grid,
            sought.windows,
            balls.balls,
            balls.bed,
            sought.every,
            sequence,
            way,
            sheet.branch,
            sheet.sign,
            sought.limits,
            starts,
            nodes,
            *_bundle_scratch(balls),
            sought.maps,
        )

    run_parts(work, parts)


def _bundle_scratch(balls: Balls) -> tuple[Bundle, NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Memory of one thread of `solve_in_bundle`, from the bundle on."""
    passed, block, state = np.empty(GROUP, np.int64), np.empty(NEWTON_NUMBERS), np.empty(GROUP, np.int64)
    return balls.bundle(), passed, block, state, block_scratch()[1]
