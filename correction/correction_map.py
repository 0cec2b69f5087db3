"""The correction map: for every node of the plane, the camera pixel that shows it.

The ray map answers "what does this pixel see"; correcting a frame needs the inverse.  Through glass the
inverse has several values: one plane point can be seen directly, through one chain of spheres, through
another, and twice through the same chain, once on each side of a fold.  So the sensor is cut into SHEETS:
connected regions of one branch (sequence of spheres) in which the determinant of d plane / d pixel keeps
its sign.  On a sheet the map is one-to-one and smooth, and the inverse is found exactly:

1. direct view: projected in closed form, no glass asked beyond "is the line of sight free";
2. per sheet: starting points from the traced pixels and their analytic derivatives, then Newton on traced
   rays until the last step is below 1e-6 px (and is still taken, leaving about its square);
3. a node seen on several sheets keeps the `layers` best of them, by weight

       w = T min(1, |det d pixel / d node|) / (1 + events)

   T the transmittance: what little light comes counts little; the magnification up to one sensor pixel a
   node: more resolution than the corrected image holds is worth nothing; fewer events: each surface adds
   its own error.  The direct view has w near 1 and beats every view through glass.  Weights of a node sum
   to 1.  One layer (the default) takes the best view only.

Limits: where the view shrinks below `min_magnification` sensor pixels a node in any direction the picture
is not worth correcting (LOW_MAGNIFICATION); where it is stretched beyond `max_magnification` two images
are about to merge (FOLD).
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from correction.grid import PlaneGrid, grid_of
from correction.kernels.inverse import direct_rows, pixel_tangents, scatter_starts, solve_rows
from correction.node_status import NodeStatus
from tracer.errors import MapFileError, StaleMap
from tracer.kernels.march import KEY_MASK, next_key
from tracer.map_file import load_arrays, save_arrays
from tracer.ray_map import RayMap
from tracer.rows import run_rows
from tracer.scene import Scene
from tracer.trace import DIRECT, Branch, pack_camera

KIND = "correction map"
MIN_MAGNIFICATION = 0.5  # one sensor pixel may cover two corrected pixels, not more
MAX_MAGNIFICATION = 16.0  # within 0.2 corrected pixels of the fold behind a 100 mm ball at L = 250 mm


@dataclass(frozen=True)
class CorrectionMap:
    """Plane node -> camera pixel(s).

    Parameters
    ----------
    grid : PlaneGrid
        The nodes (h, w).
    status : (h, w) uint8
        NodeStatus.
    pixel : (K, h, w, 2) float64
        Acquired pixel u, v of each layer, best first; NaN where there is none.
    jacobian : (K, h, w, 4) float32
        d pixel / d node: du/dcolumn, du/drow, dv/dcolumn, dv/drow.
    weight : (K, h, w) float32
        Weights, summing to 1 over the layers of a recovered node.
    transmittance : (K, h, w) float32
        Share of the light that passes the glass.
    branch : (K, h, w) uint16
        Index into `branches`.
    branches : tuple of tuple of str
        Names of the spheres crossed; number 0 is the direct view.
    sensor_px : (int, int)
        Width and height of the frames that the map corrects.
    scene_hash : str
        Content hash of the scene.
    """

    grid: PlaneGrid
    status: NDArray[np.uint8]
    pixel: NDArray[np.float64]
    jacobian: NDArray[np.float32]
    weight: NDArray[np.float32]
    transmittance: NDArray[np.float32]
    branch: NDArray[np.uint16]
    branches: tuple[Branch, ...]
    sensor_px: tuple[int, int]
    scene_hash: str

    @property
    def layers(self) -> int:
        """Views kept a node."""
        return int(self.pixel.shape[0])

    @property
    def recovered(self) -> NDArray[np.bool_]:
        """Nodes that can be recovered (h, w)."""
        return np.asarray(self.status == NodeStatus.RECOVERED)

    @property
    def behind_glass(self) -> NDArray[np.bool_]:
        """Recovered nodes whose best view goes through glass (h, w)."""
        return np.asarray(self.recovered & (self.branch[0] != 0))

    def magnification(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Smallest and largest local magnification of the best view (h, w), sensor px per corrected px.

        Their product is the areal magnification, their ratio the anisotropy.
        """
        uc, ur, vc, vr = np.moveaxis(self.jacobian[0], -1, 0)
        p = np.hypot(uc + vr, vc - ur) / 2
        q = np.hypot(uc - vr, vc + ur) / 2
        return np.abs(p - q), p + q

    def check(self, scene: Scene) -> None:
        """Refuse to serve another scene.

        Raises
        ------
        StaleMap
            The map was made from a scene with other numbers.
        """
        wanted = scene.content_hash()
        if self.scene_hash != wanted:
            raise StaleMap(f"the map belongs to scene {self.scene_hash}, not to {wanted}; trace the scene again")

    def save(self, path: Path | str) -> None:
        """Write the map to a file, atomically."""
        header = {
            "scene_hash": self.scene_hash,
            "branches": [list(names) for names in self.branches],
            "origin_mm": list(self.grid.origin_mm),
            "pitch_mm": self.grid.pitch_mm,
            "sensor_px": list(self.sensor_px),
        }
        save_arrays(path, KIND, header, {name: getattr(self, name) for name in _LAYOUT})

    @classmethod
    def load(cls, path: Path | str) -> "CorrectionMap":
        """Read a map.

        Raises
        ------
        MapFileError
            The file is damaged or holds something else.
        """
        header, arrays = load_arrays(path, KIND)
        if set(arrays) != set(_LAYOUT) or arrays["pixel"].ndim != 4:
            raise MapFileError(f"{path}: arrays are missing; make the map again")
        layers, height, width, _ = arrays["pixel"].shape
        for name, (kind, trailing) in _LAYOUT.items():
            lead = (height, width) if name == "status" else (layers, height, width)
            if arrays[name].dtype.str != kind or arrays[name].shape != lead + trailing:
                raise MapFileError(f"{path}: array {name!r} does not fit; make the map again")
        try:
            x0, y0 = header["origin_mm"]
            grid = PlaneGrid((float(x0), float(y0)), float(header["pitch_mm"]), (height, width))
            branches = tuple(tuple(str(name) for name in names) for names in header["branches"])
            columns, rows = header["sensor_px"]
            size, scene_hash = (int(columns), int(rows)), str(header["scene_hash"])
            return cls(grid, **arrays, branches=branches, sensor_px=size, scene_hash=scene_hash)
        except (KeyError, TypeError, ValueError):
            raise MapFileError(f"{path}: the header is damaged; make the map again") from None


_LAYOUT: dict[str, tuple[str, tuple[int, ...]]] = {
    "status": ("|u1", ()),
    "pixel": ("<f8", (2,)),
    "jacobian": ("<f4", (4,)),
    "weight": ("<f4", ()),
    "transmittance": ("<f4", ()),
    "branch": ("<u2", ()),
}


def build_correction_map(
    scene: Scene,
    ray_map: RayMap,
    grid: PlaneGrid | None = None,
    *,
    layers: int = 1,
    min_magnification: float = MIN_MAGNIFICATION,
    max_magnification: float = MAX_MAGNIFICATION,
) -> CorrectionMap:
    """Invert the ray map exactly.

    Parameters
    ----------
    scene : Scene
        The scene.
    ray_map : RayMap
        Its ray map.
    grid : PlaneGrid, optional
        Nodes wanted; default `grid_of` the camera.
    layers : int
        Views kept a node, best first; 1 is the best view only.
    min_magnification, max_magnification : float
        Limits of the local magnification, sensor px per corrected px.

    Raises
    ------
    StaleMap
        The ray map belongs to another scene.
    """
    ray_map.check(scene)
    grid = grid or grid_of(scene.camera)
    work = _Inversion(scene, ray_map, grid, layers, min_magnification, max_magnification)
    work.direct()
    work.glass()
    return work.result()


class _Inversion:
    """The arrays of a correction map while it grows, sheet by sheet."""

    def __init__(
        self, scene: Scene, ray_map: RayMap, grid: PlaneGrid, layers: int, least: float, most: float
    ) -> None:
        height, width = grid.shape
        self.ray_map, self.grid, self.limits = ray_map, grid, (least, most)
        self.size = scene.camera.sensor_px
        self.tables = (pack_camera(scene.camera), scene.sphere_table(), scene.rod_table())
        self.numbers = {sphere.name: index for index, sphere in enumerate(scene.spheres)}
        self.grid_numbers = np.array([*grid.origin_mm, grid.pitch_mm])
        self.status = np.zeros((height, width), np.uint8)
        self.pixel = np.full((layers, height, width, 2), np.nan)
        self.jacobian = np.full((layers, height, width, 4), np.nan, np.float32)
        self.weight = np.zeros((layers, height, width), np.float32)
        self.transmittance = np.zeros((layers, height, width), np.float32)
        self.branch = np.zeros((layers, height, width), np.uint16)

    def direct(self) -> None:
        """Project the nodes that are seen without glass."""
        width, height = self.size

        def work(first: int, last: int) -> None:
            direct_rows(
                *self.tables,
                self.grid_numbers,
                first,
                last,
                width,
                height,
                self.pixel[0],
                self.jacobian[0],
                self.status,
            )

        run_rows(work, self.grid.shape[0])
        seen = self.status == NodeStatus.RECOVERED
        j = self.jacobian[0]
        area = np.abs(j[..., 0] * j[..., 3] - j[..., 1] * j[..., 2])
        self.weight[0] = np.where(seen, np.minimum(1.0, area), 0.0)
        self.transmittance[0] = seen

    def glass(self) -> None:
        """Solve every branch that some pixel sees."""
        rows, columns = np.nonzero((self.ray_map.branch != 0) & self.ray_map.recovered)
        number = self.ray_map.branch[rows, columns]
        for taken in np.unique(number):
            chosen = number == taken
            self.branch_sheets(int(taken), rows[chosen], columns[chosen])

    def branch_sheets(self, number: int, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> None:
        """Cut the pixels of one branch into sheets and solve each."""
        pixels = np.stack((columns, rows), axis=-1)
        tangents = np.empty((len(pixels), 6))

        def work(first: int, last: int) -> None:
            pixel_tangents(*self.tables, pixels, first, last, tangents)

        run_rows(work, len(pixels), block=8192)
        det = tangents[:, 2] * tangents[:, 5] - tangents[:, 3] * tangents[:, 4]
        top, left = rows.min(), columns.min()
        box = np.zeros((rows.max() - top + 1, columns.max() - left + 1), bool)
        for sign in (-1.0, 1.0):
            chosen = det * sign > 0.0
            box[:] = False
            box[rows[chosen] - top, columns[chosen] - left] = True
            labels, _ = ndimage.label(box, np.ones((3, 3)))
            of_pixel = np.where(chosen, labels[rows - top, columns - left], 0)
            order = np.argsort(of_pixel, kind="stable")
            cuts = np.searchsorted(of_pixel[order], np.arange(1, of_pixel.max(initial=0) + 2))
            for first, last in pairwise(cuts):
                members = order[first:last]
                self.sheet(number, sign, pixels[members], tangents[members])

    def sheet(self, number: int, sign: float, pixels: NDArray[np.int64], tangents: NDArray[np.float64]) -> None:
        """Solve the nodes that one sheet may show and keep the best views."""
        low, high = self._node_box(tangents)
        if np.any(high <= low):
            return
        shape = (int(high[0] - low[0]), int(high[1] - low[1]))
        start, away = np.empty((*shape, 2)), np.full(shape, np.inf)
        least, most = self.limits
        row0, column0 = int(low[0]), int(low[1])
        scatter_starts(pixels, tangents, self.grid_numbers, row0, column0, 0.5 * least, start, away)
        pixel, jacobian = np.empty((*shape, 2)), np.empty((*shape, 4), np.float32)
        quality = np.zeros((*shape, 2), np.float32)
        status = np.full(shape, NodeStatus.RIM, np.uint8)
        key = self._key(number)
        width, height = self.size

        def work(first: int, last: int) -> None:
            solve_rows(
                *self.tables,
                self.grid_numbers,
                row0,
                column0,
                first,
                last,
                width,
                height,
                key,
                sign,
                least,
                most,
                start,
                away,
                pixel,
                jacobian,
                quality,
                status,
            )

        run_rows(work, shape[0])
        window = (slice(row0, row0 + shape[0]), slice(column0, column0 + shape[1]))
        self._keep(window, number, pixel, jacobian, quality, status)

    def _key(self, number: int) -> int:
        """Branch key that the kernels compute for a branch of the ray map."""
        key = DIRECT
        for name in self.ray_map.branches[number]:
            key = next_key(key, self.numbers[name]) & KEY_MASK
        return key

    def _node_box(self, tangents: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First and last + 1 node (row, column) within reach of a sheet's pixels."""
        pitch = self.grid.pitch_mm
        centre = self.grid.to_px(tangents[:, :2])[:, ::-1]
        reach = np.abs(tangents[:, 2:]).reshape(-1, 2, 2).sum(axis=2)[:, ::-1] / pitch
        least = 0.5 * self.limits[0]
        close = reach.max(axis=1) < 4.0 / least  # others see the plane too small to start from
        if not close.any():
            return np.zeros(2, np.int64), np.zeros(2, np.int64)
        low = np.floor((centre - reach)[close].min(axis=0))
        high = np.ceil((centre + reach)[close].max(axis=0)) + 1
        limit = np.array(self.grid.shape)
        return np.clip(low, 0, limit).astype(np.int64), np.clip(high, 0, limit).astype(np.int64)

    def _keep(
        self,
        window: tuple[slice, slice],
        number: int,
        pixel: NDArray[np.float64],
        jacobian: NDArray[np.float32],
        quality: NDArray[np.float32],
        status: NDArray[np.uint8],
    ) -> None:
        """Insert a sheet's views into the layers, best first, and note why the others failed."""
        view: dict[str, NDArray[Any]] = {
            "pixel": pixel,
            "jacobian": jacobian,
            "transmittance": quality[..., 0],
            "weight": quality[..., 1],
            "branch": np.full(status.shape, number, np.uint16),
        }
        good = status == NodeStatus.RECOVERED
        for layer in range(self.pixel.shape[0]):
            better = good & (view["weight"] > self.weight[layer][window])
            for name, values in view.items():
                kept = getattr(self, name)[layer][window]
                kept[better], values[better] = values[better], kept[better].copy()
            good = better | (good & (view["weight"] > 0.0))
        overall = self.status[window]
        seen = np.isfinite(self.pixel[0][window][..., 0])
        tried = ~seen & (status != NodeStatus.RIM)
        overall[tried] = status[tried]
        overall[seen] = NodeStatus.RECOVERED

    def result(self) -> CorrectionMap:
        """Return the finished map: weights normalised, nothing finite where there is no view."""
        total = self.weight.sum(axis=0)
        self.weight /= np.where(total > 0.0, total, 1.0)
        return CorrectionMap(
            self.grid,
            self.status,
            self.pixel,
            self.jacobian,
            self.weight,
            self.transmittance,
            self.branch,
            self.ray_map.branches,
            self.size,
            self.ray_map.scene_hash,
        )
