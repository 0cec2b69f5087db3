"""Inversion of a ray map: the arrays of a correction map, filled view by view.

What the scene masks (``tracer.masked``) is no view: the next best of a node takes its place.

See ``correction.maps.correction_map`` for what is sought and ``docs/adr/0002-inverse-by-sheets.md`` for why it is
sought this way.  The direct view comes first, in closed form, or with one unknown a node through a window; then
every sheet, those with few events first.

Skipped, with the same result: a view through e spheres weighs at most 1/(1 + e), because the transmittance and
the share of the magnification that counts are at most 1.  A node whose last layer already weighs as much cannot
take it, so it is not solved: what is seen directly is not sought through glass unless several views are wanted.
Nor is a node sought with care where there is no hope (``kernels.views``): four of five that a bed's blocks leave.

A bed has tens of thousands of sheets: each core solves all of them for some rows of nodes, and verifies what it
finds in bundles (``kernels.bed_sheets``).
"""

from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.inversion.kernels.bed_sheets import (
    TILING,
    BedSheets,
    BundleScratch,
    solve_sheets,
)
from correction.inversion.kernels.behind_window import BLOCK_NUMBERS, BehindScratch, direct_rows_behind
from correction.inversion.kernels.direct import DirectScratch, DirectView, direct_rows
from correction.inversion.kernels.newton import GROUP, NEWTON_NUMBERS, BranchSequences, SheetPath
from correction.inversion.kernels.sheets import FIRST_ROW, LAST_ROW
from correction.inversion.kernels.views import InverseProblem, NodeScratch, ViewMaps, join_weights, solve_nodes
from correction.inversion.sheets import BranchPatch, Ordered, Sheets, Starts, start_scratch
from correction.masked import mask_branches, mask_pixels
from ground.rows import run_parts, run_rows, thread_count
from tracer.kernels.camera import CENTRE_U, FOCAL
from tracer.kernels.sphere import OPAQUE
from tracer.strategies.beds import Balls
from tracer.strategies.branches import chain_trip, event_numbers, key_of
from tracer.strategies.lockstep import block_scratch, sphere_discs
from tracer.strategies.ray_map import RayMap
from tracer.strategies.strategy import Kind, Strategy

PARTS, LEAST_ROWS = 3, 64  # parts of a bed's nodes for each core, and rows of the smallest


def solve_bed(problem: InverseProblem, maps: ViewMaps, sheets: Sheets, balls: Balls) -> None:
    """Solve all sheets, those with few events first.

    Parameters
    ----------
    problem, maps : InverseProblem, ViewMaps
        Scene, grid and limits, and the arrays of the map: a node whose last layer weighs enough takes no view.
    sheets : Sheets
        Those of the ray map, with the spheres of each branch.
    balls : Balls
        The spheres, as bundles take them.
    """
    every, threads = sheets.ordered(), thread_count()
    listed = _listed(every, sheets.sequences, balls, problem.every)
    top = np.minimum.reduceat(every.runs[:, FIRST_ROW], every.first[:-1])
    bottom = np.maximum.reduceat(every.runs[:, LAST_ROW], every.first[:-1])

    def work(first: int, last: int) -> None:
        some = np.nonzero((top < last) & (bottom >= first))[0]
        start = start_scratch(np.array([TILING, 0, 0, sheets.portion, 0]), *sheets.room_for_starts())
        room = start, np.zeros(1 << (2 * sheets.room).bit_length(), np.int64)
        scratch = BundleScratch(
            balls.bundle(),
            np.empty(GROUP, np.int64),
            np.empty(NEWTON_NUMBERS),
            np.empty(GROUP, np.int64),
            block_scratch()[1],
        )
        solve_sheets(problem, balls.bed, listed, (some, first, last), sheets.sensor, room, scratch, maps)

    # What may reach the nodes of two parts is measured twice, so that parts are few.
    height = len(sheets.taken)
    run_rows(work, height, max(LEAST_ROWS, height // (PARTS * threads)) if threads > 1 else height)


def _listed(every: Ordered, sequences: BranchSequences, balls: Balls, all_nodes: bool) -> BedSheets:
    """All sheets with their spheres, as kernels take them."""
    sizes = np.diff(sequences.begin)[every.branch]
    ends = np.cumsum(sizes)
    inside = np.arange(int(ends[-1]) if len(ends) else 0) - np.repeat(ends - sizes, sizes)
    events = sequences.events[np.repeat(sequences.begin[every.branch], sizes) + inside]
    place = np.empty(len(balls.order), np.int64)
    place[balls.order] = np.arange(len(balls.order))
    begin = np.concatenate(([0], ends))
    enough = (np.full(len(sizes), np.inf) if all_nodes else 1.0 / (1.0 + every.events)).astype(np.float32)
    own = events, place[events], begin
    return BedSheets(every.branch, every.sign, *own, every.runs, every.first, enough, sequences)


class Inversion:
    """The arrays of a correction map while it grows, sheet by sheet."""

    def __init__(
        self,
        way: Strategy,
        ray_map: RayMap,
        grid: PlaneGrid,
        layers: int,
        limits: tuple[float, float],
        out: Mapping[str, NDArray[Any]] | None,
        skip: bool,
    ) -> None:
        height, width = grid.shape
        scene = way.scene
        self.way, self.ray_map, self.grid = way, ray_map, grid
        self.skip = skip
        self.size = scene.camera.sensor_px
        self.tables, self.longest_mm = (way.camera, way.world), 2.0 * grid.pitch_mm / limits[0]
        self.events = event_numbers(scene)
        self.window = way.single_window
        self.problem = InverseProblem(
            self.tables,
            np.array([*grid.origin_mm, grid.pitch_mm]),
            way.windows,
            not skip,
            np.array([*limits, *self.size], dtype=np.float64),
        )
        lead, kind = (layers, height, width), ray_map.branch.dtype
        if out is None or out["pixel"].shape != (*lead, 2) or out["branch"].dtype != kind:
            out = {
                "status": np.empty((height, width), np.uint8),
                "pixel": np.empty((*lead, 2)),
                "jacobian": np.empty((*lead, 4), np.float32),
                "weight": np.empty(lead, np.float32),
                "transmittance": np.empty(lead, np.float32),
                "branch": np.empty(lead, kind),
            }
        self.arrays = out
        self.masked = np.zeros((1, 1), np.uint8), np.zeros(0, np.uint8)
        if scene.masked:
            self.masked = mask_pixels(scene), mask_branches(scene, ray_map.branches)
        self.status, self.pixel, self.jacobian = out["status"], out["pixel"], out["jacobian"]
        self.weight, self.transmittance, self.branch = out["weight"], out["transmittance"], out["branch"]

    @property
    def maps(self) -> ViewMaps:
        """The arrays as kernels take them, and what is masked."""
        pixels, branches = self.masked
        return ViewMaps(**self.arrays, masked_pixels=pixels, masked_branches=branches)

    def direct(self) -> None:
        """Project the nodes that are seen without glass, and write every other node for the first time."""
        if self.window is not None:
            self._direct_behind(self.window)
        else:
            self._direct_in_the_open()
        if self.way.scene.masked:
            self._mask_direct()

    def _mask_direct(self) -> None:
        """Leave masked nodes to the glass, with the reason they keep if no glass shows them."""
        seen = self.weight[0] > 0.0
        u, v = np.rint(self.pixel[0][seen]).astype(np.int64).T
        why = np.zeros(self.status.shape, np.uint8)
        why[seen] = self.masked[0][v, u]
        gone = why != 0
        self.status[gone] = why[gone]
        self.weight[0][gone], self.pixel[0][gone] = 0.0, np.nan

    def _direct_in_the_open(self) -> None:
        """As `direct`, where no window stands before all there is."""
        height, width = self.grid.shape
        place, discs = self._node_camera(), sphere_discs(self.tables[1].spheres)
        lens_free, world = self.way.scene.camera.lens.is_ideal, self.tables[1]
        only_spheres = not self.way.scene.others
        glass_only = only_spheres and not (world.shapes or world.spheres[:, OPAQUE].any())
        maps = self._flat_maps()
        lockstep = only_spheres and self.way.kind is Kind.LOCKSTEP
        view = DirectView(place, self.tables, discs, lockstep, only_spheres, glass_only, lens_free, self._frame())

        def work(first: int, last: int) -> None:
            x, y = (np.arange(width) - place[CENTRE_U]) / place[FOCAL], np.empty(width)
            spans, hidden = np.empty((3 * len(discs) + 1, 2), np.int64), np.empty(width, np.uint8)
            scratch = DirectScratch(x, y, spans, *block_scratch(), hidden, np.empty((6, width)))
            direct_rows(view, first, last, scratch, maps)

        run_rows(work, height)

    def _frame(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Grid (3,) and size (2,) of the sensor."""
        return self.problem.grid, np.array(self.size, np.float64)

    def _direct_behind(self, window: NDArray[np.float64]) -> None:
        """As `direct`, through the only window in front of a few spheres."""
        height, width = self.grid.shape
        maps, flat = self._flat_maps(), self.way.scene.camera.lens.is_ideal
        optics, frame = (self.tables[0], window, self.way.chain), self._frame()

        def work(first: int, last: int) -> None:
            lens = np.empty((6, width))
            scratch = BehindScratch(*block_scratch(), np.empty(width, np.uint8), lens, np.empty(BLOCK_NUMBERS))
            direct_rows_behind(optics, flat, frame, first, last, scratch, maps)

        run_rows(work, height)

    def _flat_maps(self) -> tuple[NDArray[Any], ...]:
        """The arrays with pixels (K, h, 2 w) and Jacobians (K, h, 4 w) as rows of numbers."""
        height, width = self.grid.shape
        pixel = self.pixel.reshape(len(self.pixel), height, 2 * width)
        others = self.weight, self.transmittance, self.branch
        return self.status, pixel, self.jacobian.reshape(len(pixel), height, 4 * width), *others

    def _node_camera(self) -> NDArray[np.float64]:
        """Camera in the pinhole, looking straight down, whose pixels are the nodes (20,)."""
        x, y, z = self.way.scene.camera.position_mm
        (x0, y0), pitch = self.grid.origin_mm, self.grid.pitch_mm
        straight = [1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0]
        return np.array([x, y, z, *straight, z / pitch, (x - x0) / pitch, (y0 - y) / pitch, *[0.0] * 5])

    def glass(self) -> None:
        """Cut the sensor into sheets and solve each that is worth it."""
        # Behind walls the direct view is sought as the others are, unless it was found.
        least = int(self.way.scene.arrangement.is_one_room or self.window is not None)
        sensor = self.ray_map, self.grid, self.problem, self.longest_mm, least
        if self.way.inverse_kind is Kind.BUNDLES:
            self._solve_many(Sheets(*sensor, self._sequences()))
            return
        sheets = Sheets(*sensor)
        for sheet in sheets:
            self._solve_one(sheet, sheets)

    def _solve_many(self, sheets: Sheets) -> None:
        """Solve the sheets of a bed."""
        solve_bed(self.problem, self.maps, sheets, self.way.balls)

    def _solve_one(self, sheet: BranchPatch, sheets: Sheets) -> None:
        """Solve a sheet on all cores."""
        enough = np.float32(1.0 / (1.0 + sheet.events) if self.skip else np.inf)
        self._solve(sheet, sheets.starts(sheet, self.weight[-1], enough))

    def _sequences(self) -> BranchSequences:
        """Spheres of every branch."""
        branches = self.ray_map.branches
        begin = np.cumsum([0, *map(len, branches)], dtype=np.int64)
        events = np.fromiter(map(self.events.__getitem__, chain.from_iterable(branches)), np.int64, int(begin[-1]))
        return BranchSequences(begin, events, self.way.windows)

    def _sequence(self, number: int) -> list[int]:
        """Events of a branch."""
        return [self.events[name] for name in self.ray_map.branches[number]]

    def _solve(self, sheet: BranchPatch, parts: Iterator[Starts]) -> None:
        """Solve the nodes of one sheet and keep the best views."""
        sequence = np.array(self._sequence(sheet.branch), np.int64)
        key = key_of(sequence)
        trip = chain_trip(self.way.scene, sequence) if self.way.inverse_kind is Kind.LOCKSTEP else -1
        world = self.tables[1]
        solid = self.way.in_blocks and not world.shapes and bool((sequence < len(world.spheres)).all())
        path = SheetPath(sequence, sequence, key, trip, sheet.branch, sheet.sign, trip >= 0 or solid)
        balls, maps = self.way.chain, self.maps

        def work(part: Starts) -> None:
            rays, trips = block_scratch()
            scratch = NodeScratch(
                np.empty(NEWTON_NUMBERS),
                np.empty(GROUP, np.int64),
                trips,
                np.empty(GROUP, np.int64),
                np.empty((2, GROUP)),
                np.empty((len(balls), 2), np.int64),
                np.empty(len(balls), np.int64),
                rays,
            )
            solve_nodes(self.problem, path, *part, balls, scratch, maps)

        run_parts(work, parts)

    def join(self) -> None:
        """Normalise the weights of each node."""
        run_rows(lambda first, last: join_weights(first, last, self.weight), self.grid.shape[0])
