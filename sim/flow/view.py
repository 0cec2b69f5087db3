"""Images of point particles at any depth of a light sheet, through glass, by the renderer's own optics.

A point of light at P is seen in pixel (u, v) if a ray of that pixel runs through P behind the last glass.  For
each of K points of the entrance pupil the rays of a grid of pixels are traced once; at P's height their places
form a grid of cells in the plane, and every cell near P is searched with rays of its own for an image of it: one
beside the glass, one or several behind it, two that meet at a fold, none behind a rod.

How bright is it?  The beam between a patch dA_p of the pupil and the pixel's solid angle dW at the lens keeps its
throughput through glass (etendue), so the patch gathers from P the solid angle

    dW_P = dA_p cos_c dW / (cos_P |d(x, y)/d(u, v)|)

with cos_P the angle of the ray at P and the determinant taken in P's own plane.  Light is counted against a point
seen without glass in the same pixel: transmittance times (cos |det|)_bare / (cos |det|).  So images behind glass
are bright where the lens magnifies, blurred where pupil points disagree, and dim by what Fresnel takes.  At a fold
the determinant is zero and geometrical optics gives infinite light; it is cut at `BRIGHTEST` times the bare view.

A spot is a Gaussian (diffraction) integrated over the pixel.  Nothing here comes from the tracer's kernels or the
correction: the same room that renders the bench's targets traces these rays.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from ground.memory import require_memory
from ground.rows import run_rows
from sim.flow.kernels.splat import count_bands, order_by_band, splat
from sim.flow.kernels.views import NUMBERS, ROUGH, Cells, Patches, cell_bins, find_images, judge_cells, trace_nodes
from sim.renderer.patterns import Pose
from sim.renderer.render import Aperture, tables_of
from tracer.camera import Camera
from tracer.errors import SceneError
from tracer.scene.scene import Scene

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]

STEP_PX = 2.0
FINER = 4  # cells along an edge of a rough cell
MARGINS = 0.25, 0.5  # of a cell, by which the linear place of an image may lie outside; of one that is cut
DIMMEST = 0.02  # light of an image that is looked for, against the bare view
LAYERS = 1, 4  # of bins: rays that are steep behind glass move far over the depth; of cells that are cut
BYTES_PER_NODE = 60.0  # of a grid of rays with its bins
BRIGHTEST = 50.0
BLOCK_POINTS = 4096
BAND_ROWS = 64
PHASES = 64
REACH_SIGMAS = 4.0
MARGIN_PX = 12.0  # images whose middle lies beside the sensor still reach into it
BIN_CELLS = 2.0


def pupil_points(count: int) -> Float64:
    """Points (K, 2) of equal weight in the unit disc: 1, or a middle and rings of 6, 12, ... points: 7, 19, 37.

    Rings lie so that their shares of the area, and the second moment of the disc, are right.

    Raises
    ------
    SceneError
        `count` is not one of these numbers.
    """
    points, ring = [(0.0, 0.0)], 0
    while len(points) < count:
        ring += 1
        radius2 = (len(points) + 3 * ring) / count
        for k in range(6 * ring):
            angle = 2.0 * np.pi * (k + 0.5 * (ring % 2)) / (6 * ring)
            points.append((float(np.sqrt(radius2) * np.cos(angle)), float(np.sqrt(radius2) * np.sin(angle))))
    if len(points) != count:
        raise SceneError(f"a pupil has 1, 7, 19, 37 ... points, not {count}")
    out = np.array(points)
    if count > 1:
        out *= np.sqrt(0.5 / np.mean(np.sum(np.square(out), axis=1)))
    return out


@dataclass(frozen=True)
class _Grid:
    """The rays of one point of the pupil: one patch, the sensor, or many: cells of it, cut finer."""

    patches: Patches
    margin: float
    ways: Float32
    tops: Float32
    chains: NDArray[np.int64]
    cells: NDArray[np.uint8]


@dataclass(frozen=True)
class _Table:
    """A grid, and the bins that find its cells."""

    grid: _Grid
    corner: Float64
    starts: NDArray[np.int64]
    entries: NDArray[np.int32]


class ParticleView:
    """Images in a camera of points of light between two heights.

    Parameters
    ----------
    scene : Scene
        Camera and glass.
    heights_mm : (float, float)
        Lowest and highest z of the points; the plane lies between them.
    plane_mm : float
        Height of the plane: a ray that is in glass there shows no point, and none shows what glass hides behind.
    aperture : Aperture, optional
        A finite pupil; None is a pinhole.
    points_of_pupil : int
        K: 7, 19, ... with an aperture; a pinhole has one.
    step_px : float
        Edge of a cell of the ray grid.
    spot_px : float
        Diameter (e^-2) of a point's image by diffraction.

    Raises
    ------
    SceneError
        A body other than a ball or a wall crosses the plane, or is of a kind that the renderer has no optics for.
    MemoryShort
        The rays of all points of the pupil do not fit into memory.
    """

    def __init__(
        self,
        scene: Scene,
        heights_mm: tuple[float, float],
        *,
        plane_mm: float = 0.0,
        aperture: Aperture | None = None,
        points_of_pupil: int = 7,
        step_px: float = STEP_PX,
        spot_px: float = 2.4,
    ) -> None:
        low_mm, high_mm = heights_mm
        if not low_mm < high_mm or not step_px > 0.0 or not spot_px > 0.0:
            raise SceneError("a view needs two heights that differ, and positive step_px and spot_px")
        self.shape = scene.camera.shape
        self.heights_mm = heights_mm
        self._step_px = step_px
        self._tables = tables_of(scene, Pose((0.0, 0.0, plane_mm)), aperture, is_light=True)
        self._spots = _spot_table(0.25 * spot_px)
        radius_mm = aperture.pupil_radius_mm if aperture is not None else 0.0
        places = radius_mm * pupil_points(points_of_pupil if aperture is not None else 1)
        self._points = len(places)
        rows, columns = (int(np.ceil((side + 2.0 * MARGIN_PX) / step_px)) + 1 for side in self.shape)
        require_memory(
            BYTES_PER_NODE * rows * columns * len(places),
            f"a view of {columns} x {rows} nodes from {len(places)} points of the pupil",
        )
        self._whole = [
            self._trace_grid(place, np.full((1, 2), -MARGIN_PX), (rows, columns), False)
            for place in places.tolist()
        ]
        fine = [
            self._trace_grid(whole.patches[3:], _rough(whole), (FINER + 1, FINER + 1), True)
            for whole in self._whole
        ]
        self.corners_mm = _extent(self._whole, _bare_mm(scene.camera), heights_mm)
        self._edge_mm = BIN_CELLS * step_px * self._tables.px_mm
        (x0, y0), (x1, y1) = self.corners_mm
        counts = [max(1.0, np.ceil((high - low) / self._edge_mm)) for low, high in ((y0, y1), (x0, x1))]
        self._bins = np.array([x0, y0, *counts])
        self._found_by = [self._bin_cells(grid) for grid in [*self._whole, *fine] if len(grid.patches.corners)]

    def images(self, points_mm: Float64, shine: Float64) -> Float32:
        """All images (M, 3) of points (N, 3): u, v [px], light; `shine` (N,) is that of each without glass."""
        points, weights = np.ascontiguousarray(points_mm, np.float64), np.ascontiguousarray(shine, np.float64)
        share = weights / self._points
        blocks = -(-len(points) // BLOCK_POINTS)
        found: list[list[Float32]] = [[] for _ in range(blocks)]

        def block(first: int, last: int) -> None:
            for index in range(first, last):
                part = slice(index * BLOCK_POINTS, (index + 1) * BLOCK_POINTS)
                found[index] = [self._images_by(view, points[part], share[part]) for view in self._found_by]

        run_rows(block, blocks, 1)
        return np.concatenate([part for parts in found for part in parts] or [np.empty((0, 3), np.float32)])

    def light(self, points_mm: Float64, shine: Float64) -> Float32:
        """Light of points (N, 3) on the pixels, float32 (H, W): a point of shine 1 gives 1 in all, seen bare."""
        images = self.images(points_mm, shine)
        height, width = self.shape
        bands = -(-height // BAND_ROWS)
        counts = np.zeros(bands + 2, np.int64)
        count_bands(images, BAND_ROWS, counts)
        ends = np.cumsum(counts)
        ordered = np.empty_like(images)
        order_by_band(images, BAND_ROWS, ends - counts, ordered)
        out = np.zeros((height, width), np.float32)

        def band(first: int, last: int) -> None:
            across = np.empty(self._spots.shape[1])
            for index in range(first, last):
                rows = slice(index * BAND_ROWS, min((index + 1) * BAND_ROWS, height))
                near = ordered[ends[index] - counts[index] : ends[index + 2]]  # the bands above and below, too
                splat(near, rows.start, rows.stop, self._spots, across, out)

        run_rows(band, bands, 1)
        return out

    def slopes(self, pixels: Float64) -> Float64:
        """Slopes dx/dz, dy/dz (N, 2) at z = 0 of the rays of pixels (N, 2), u, v; NaN where none arrives.

        They are those of the pupil's middle and of the nearest node of the ray grid.  A point that rises by dz
        seems to move by -dz times the slope within the plane.
        """
        ways, tops = self._whole[0].ways, self._whole[0].tops
        place = (np.nan_to_num(pixels, nan=-1e9) + MARGIN_PX) / self._step_px
        column, row = np.rint(place).astype(np.int64).T
        inside = (row >= 0) & (row < ways.shape[0]) & (column >= 0) & (column < ways.shape[1])
        row, column = np.where(inside, row, 0), np.where(inside, column, 0)
        found = ways[row, column, 2:4].astype(np.float64)
        return np.where((inside & (tops[row, column] > 0.0))[:, None], found, np.nan)

    def peak(self) -> float:
        """Light on the brightest pixel of a point of shine 1 that is seen bare, in the middle of a pixel."""
        return float(self._spots[0].max() ** 2)

    def _images_by(self, table: _Table, points: Float64, shine: Float64) -> Float32:
        room, grid = 2 * len(points) + 16, table.grid
        bins = (table.starts, table.entries, table.corner, self._edge_mm, grid.margin)
        cells = Cells(grid.ways, grid.tops, grid.chains, *bins)
        while True:
            out = np.empty((room, 3), np.float32)
            found = find_images(points, shine, cells, grid.patches, self._tables.world, BRIGHTEST, out)
            if found <= room:
                return out[:found]
            room = found

    def _trace_grid(
        self, lens_mm: tuple[float, float], corners_px: Float64, patch: tuple[int, int], is_fine: bool
    ) -> _Grid:
        rows, columns = len(corners_px) * patch[0], patch[1]
        step_px = self._step_px / FINER if is_fine else self._step_px
        patches = Patches(corners_px, patch[0], step_px, *lens_mm)
        ways = np.empty((rows, columns, NUMBERS), np.float32)
        tops = np.empty((rows, columns), np.float32)
        chains = np.empty((rows, columns), np.int64)

        def block(first: int, last: int) -> None:
            trace_nodes(first, last, patches, self._tables.world, ways, tops, chains)

        run_rows(block, rows, 8)
        widest = (step_px * self._tables.px_mm) ** 2 / DIMMEST if is_fine else np.inf
        cells = np.zeros((max(rows - 1, 0), columns - 1), np.uint8)
        judge_cells(chains, ways, max(self.heights_mm, key=abs), patch[0], widest, cells)
        return _Grid(patches, MARGINS[is_fine], ways, tops, chains, cells)

    def _bin_cells(self, grid: _Grid) -> _Table:
        low, high = self.heights_mm
        layers = LAYERS[grid.patches.step_px < self._step_px]
        corner = np.array([*self._bins, low, (high - low) / layers, layers])
        counts = np.zeros(int(corner[2] * corner[3] * layers), np.int64)
        about = (grid.ways, grid.cells, grid.margin, corner, self._edge_mm)
        cell_bins(*about, counts, np.empty(0, np.int32))
        starts = np.concatenate(([0], np.cumsum(counts)))
        entries = np.empty(int(starts[-1]), np.int32)
        cell_bins(*about, starts[:-1].copy(), entries)
        return _Table(grid, corner, starts, entries)


def _bare_mm(camera: Camera) -> Float64:
    """Corners of the view without glass at z = 0: (2, 2), low and high, x and y."""
    height, width = camera.shape
    position, rotation = np.array(camera.position_mm), camera.rotation_matrix
    corners = np.array([[u, v] for u in (-0.5, width - 0.5) for v in (-0.5, height - 0.5)])
    rays = np.column_stack(((corners - camera.principal_px) / camera.focal_px, np.ones(4))) @ rotation
    places = position[:2] - rays[:, :2] / rays[:, 2:] * position[2]
    return np.array([places.min(axis=0), places.max(axis=0)])


def _rough(grid: _Grid) -> Float64:
    """Pixels (K, 2) of the first nodes of cells that must be cut finer."""
    row, column = np.nonzero(grid.cells == ROUGH)
    return np.ascontiguousarray(np.column_stack((column, row)) * grid.patches.step_px - MARGIN_PX)


def _extent(grids: list[_Grid], bare_mm: Float64, heights_mm: tuple[float, float]) -> Float64:
    """Corners (2, 2) of what is seen between two heights, at most an eighth beyond the bare view."""
    room = 0.125 * (bare_mm[1] - bare_mm[0])
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for grid in grids:
        seen = grid.ways[grid.tops > max(heights_mm)]
        for z in heights_mm:
            places = seen[:, :2] + np.float32(z) * seen[:, 2:4]
            if len(places):
                low, high = np.minimum(low, places.min(axis=0)), np.maximum(high, places.max(axis=0))
    return np.array([np.maximum(low, bare_mm[0] - room), np.minimum(high, bare_mm[1] + room)])


def _spot_table(sigma_px: float) -> Float64:
    """Light on pixels k - r (phases + 1, 2 r + 2) of a Gaussian that lies a phase beyond the middle of pixel 0."""
    reach = int(np.ceil(REACH_SIGMAS * sigma_px + 0.5))
    place = np.arange(PHASES + 1)[:, None] / PHASES
    edges = np.arange(-reach, reach + 3)[None, :] - 0.5
    parts = np.diff(scipy.special.ndtr((edges - place) / sigma_px), axis=1)
    return np.asarray(parts / parts.sum(axis=1, keepdims=True))
