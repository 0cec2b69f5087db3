"""The sheets (branch patches) of a ray map, and the starts of the nodes that each may show.

In memory are one byte per pixel (flags, ``kernels.sheets``) and one per node (the sheet that claimed it); starts
are made some thousand at a time, so that a map needs little more memory than its arrays.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.inversion.kernels.bed_sheets import (
    DONE,
    ENOUGH_NODES,
    LANES,
    MEASURES,
    TILING,
    StartScratch,
    Wanted,
    scatter_sheet,
)
from correction.inversion.kernels.newton import NEWTON_NUMBERS, NO_SEQUENCES, BranchSequences
from correction.inversion.kernels.sheets import (
    RUN,
    NodeScale,
    Sensor,
    count_useful,
    flag_edges,
    flag_rows,
    join_runs,
    list_runs,
)
from correction.inversion.kernels.views import InverseProblem
from ground.rows import run_rows
from tracer.strategies.branches import lengths_of
from tracer.strategies.ray_map import RayMap

Starts = tuple[NDArray[np.float64], NDArray[np.int32]]  # (N, 4) and (N, 2), see `scatter_sheet`
LAST_STAMP = np.iinfo(np.uint8).max


class BranchPatch(NamedTuple):
    """A connected part of a branch in which the determinant keeps its sign."""

    branch: int
    sign: float
    events: int
    runs: NDArray[np.int64]


class Ordered(NamedTuple):
    """All sheets: branch, sign and events (S,) of each; its runs are runs[first[k] : first[k + 1]]."""

    branch: NDArray[np.int64]
    sign: NDArray[np.float64]
    events: NDArray[np.int64]
    runs: NDArray[np.int64]
    first: NDArray[np.int64]

    def sheet(self, k: int) -> BranchPatch:
        """Patch k."""
        runs = self.runs[self.first[k] : self.first[k + 1]]
        return BranchPatch(int(self.branch[k]), float(self.sign[k]), int(self.events[k]), runs)


class Sheets:
    """The sheets of a ray map.

    Parameters
    ----------
    ray_map : RayMap
        The ray map.
    grid : PlaneGrid
        The nodes.
    problem : InverseProblem
        Camera, bodies and grid as kernels take them.
    longest_mm : float
        Largest singular value of d plane / d pixel of a pixel that is worth a start.
    least : int
        First branch that is sought: 0 where the direct view is not known otherwise, else 1.
    sequences : BranchSequences
        Spheres of each branch, where there are only spheres behind windows.
    """

    def __init__(
        self,
        ray_map: RayMap,
        grid: PlaneGrid,
        problem: InverseProblem,
        longest_mm: float,
        least: int,
        sequences: BranchSequences = NO_SEQUENCES,
    ) -> None:
        height, width = ray_map.status.shape
        self.problem, self.sequences, self.stamp = problem, sequences, 0
        self.events = lengths_of(ray_map.branches)
        self.flags, self.taken = np.empty((height, width), np.uint8), np.zeros(grid.shape, np.uint8)
        plane = ray_map.plane_mm.reshape(height, 2 * width)
        self.sensor = Sensor(plane, ray_map.branch, self.flags, self.taken)
        # A pixel's largest square, two wide, is sqrt(8) of its longest side across.
        across = math.sqrt(8.0) * longest_mm / grid.pitch_mm
        self.portion = max(ENOUGH_NODES, 2 * grid.shape[1])  # more than a row of nodes
        self.room = self.portion + min(math.prod(grid.shape), (int(across) + 3) ** 2)
        self.spare: list[Starts] = []
        counts, box = np.empty(height, np.int64), np.array(grid.shape[::-1]) - 1.0
        scale = NodeScale(problem.grid, box, longest_mm, least)

        def flag(first: int, last: int) -> None:
            scratch = np.empty(NEWTON_NUMBERS), counts
            flag_rows(problem.tables, scale, first, last, self.sensor, ray_map.status, sequences, scratch)

        run_rows(flag, height)
        self.begin = np.concatenate(([0], np.cumsum(counts)))
        self.runs = np.empty((int(self.begin[-1]), RUN), np.int64)

        def cut(first: int, last: int) -> None:
            ends, edges = np.empty(width, np.int64), np.empty(width, np.uint8)
            list_runs(self.sensor, scale, first, last, self.begin, ends, self.runs)
            flag_edges(self.flags, ray_map.branch, first, last, self.begin, edges)

        run_rows(cut, height)

    def ordered(self) -> Ordered:
        """Sheets worth a start, those with few events first."""
        runs = self.runs
        parent, useful = np.empty(len(runs), np.int64), np.zeros(len(runs), np.int64)
        join_runs(self.begin, runs, parent)
        count_useful(self.flags, runs, parent, useful)
        order = np.argsort(parent, kind="stable")
        heads = np.nonzero(useful)[0]
        firsts = np.searchsorted(parent[order], heads)
        lasts = np.searchsorted(parent[order], heads, side="right")
        events = self.events[runs[heads, 3] >> 1]
        # As the branches are numbered, not as the sensor meets them: of equal views the same one is kept.
        best = np.lexsort((heads, runs[heads, 3], events))
        firsts, lasts, code = firsts[best], lasts[best], runs[heads[best], 3]
        first = np.concatenate(([0], np.cumsum(lasts - firsts)))
        places = np.repeat(firsts - first[:-1], lasts - firsts) + np.arange(first[-1])
        return Ordered(code >> 1, np.where(code & 1, -1.0, 1.0), events[best], runs[order[places]], first)

    def __iter__(self) -> Iterator[BranchPatch]:
        """Sheets as `ordered`, one by one."""
        every = self.ordered()
        for k in range(len(every.branch)):
            yield every.sheet(k)

    def starts(self, sheet: BranchPatch, weight: NDArray[np.float32], enough: np.float32) -> Iterator[Starts]:
        """Starts of a sheet and their nodes, but for nodes whose weight (h, w) is `enough`."""
        if self.stamp == LAST_STAMP:
            self.taken[...], self.stamp = 0, 0
        self.stamp += 1
        cursor, rows = np.array([TILING, 0, 0, self.portion, 0]), (0, len(weight))
        tiles: list[Starts] = []
        edges: list[Starts] = []
        # The kernel fills what memory it is given and says by `cursor` where to go on.
        while cursor[0] < DONE:
            starts, nodes = self.spare.pop() if self.spare else self.room_for_starts()
            wanted, start = Wanted(weight, enough, self.stamp, *rows), start_scratch(cursor, starts, nodes)
            tiled, found = scatter_sheet(self.problem, self.sensor, sheet.runs, self.sequences, wanted, 0, start)
            if found == 0:
                self.spare.append((starts, nodes))
            elif cursor[0] == TILING:
                yield starts[:found], nodes[:found]
            else:
                # At the edge several pixels offer a node a start: once all are known the nearest is taken.
                tiles.append((starts[:tiled], nodes[:tiled]))
                edges.append((starts[tiled:found], nodes[tiled:found]))
        if tiles:
            starts, nodes = _joined([*tiles, _nearest(*_joined(edges))])
            for low in range(0, len(starts), ENOUGH_NODES):
                yield starts[low : low + ENOUGH_NODES], nodes[low : low + ENOUGH_NODES]

    def room_for_starts(self) -> Starts:
        """Fresh memory for what one call of `scatter_sheet` gives."""
        return np.empty((self.room, 4)), np.empty((self.room, 2), np.int32)


def start_scratch(cursor: NDArray[np.int64], *room: NDArray[Any]) -> StartScratch:
    """Return the memory of `scatter_sheet` with `room` for starts and nodes."""
    return StartScratch(cursor, np.empty(LANES, np.int64), np.empty(MEASURES), np.empty(NEWTON_NUMBERS), *room)


def _joined(parts: list[Starts]) -> Starts:
    """All parts in one."""
    return np.concatenate([starts for starts, _ in parts]), np.concatenate([nodes for _, nodes in parts])


def _nearest(starts: NDArray[np.float64], nodes: NDArray[np.int32]) -> Starts:
    """Of the starts of each node the one from the nearest pixel."""
    number = nodes[:, 0].astype(np.int64) << 32 | nodes[:, 1]
    order = np.lexsort((starts[:, 2], number))
    number = number[order]
    first = order[np.append(True, number[1:] != number[:-1])[: len(order)]]
    return starts[first], nodes[first]
