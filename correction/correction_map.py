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
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.errors import MapUsageError
from correction.grid import PlaneGrid, grid_of
from correction.kernels.inverse import direct_rows
from correction.kernels.newton import GROUP, NEWTON_NUMBERS, solve_nodes
from correction.kernels.sheets import RUN, code_rows, count_useful, join_runs, list_runs, scatter_sheet
from correction.node_status import NodeStatus
from tracer.errors import MapFileError, StaleMap
from tracer.kernels.chain import BALL
from tracer.kernels.march import KEY_MASK, next_key
from tracer.lockstep import block_scratch, chain_trip, fits_lockstep, pack_chain, sphere_discs
from tracer.map_file import load_arrays, save_arrays
from tracer.ray_map import RayMap
from tracer.rows import run_rows
from tracer.scene import Scene
from tracer.trace import DIRECT, Branch, Numbers, pack_camera

KIND = "correction map"
NODES_PER_CALL = 4096  # whole groups, so that threads change no group
NO_BALLS = np.empty((0, BALL))
MIN_MAGNIFICATION = 0.5  # one sensor pixel may cover two corrected pixels, not more
MAX_LAYERS = 16
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
    branch : (K, h, w) uint16 or uint32, as in the ray map
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
    branch: Numbers
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
            if arrays[name].dtype.str not in kind or arrays[name].shape != lead + trailing:
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


_LAYOUT: dict[str, tuple[tuple[str, ...], tuple[int, ...]]] = {
    "status": (("|u1",), ()),
    "pixel": (("<f8",), (2,)),
    "jacobian": (("<f4",), (4,)),
    "weight": (("<f4",), ()),
    "transmittance": (("<f4",), ()),
    "branch": (("<u2", "<u4"), ()),
}


def build_correction_map(
    scene: Scene,
    ray_map: RayMap,
    grid: PlaneGrid | None = None,
    *,
    layers: int = 1,
    min_magnification: float = MIN_MAGNIFICATION,
    max_magnification: float = MAX_MAGNIFICATION,
    out: CorrectionMap | None = None,
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
    out : CorrectionMap, optional
        An earlier map of this size whose arrays are written again, so that `out` is worth nothing afterwards.

    Raises
    ------
    StaleMap
        The ray map belongs to another scene.
    MapUsageError
        `layers` is not 1 to MAX_LAYERS.
    """
    ray_map.check(scene)
    grid = grid or grid_of(scene.camera)
    if not 1 <= layers <= MAX_LAYERS:
        raise MapUsageError(f"a node can join 1 to {MAX_LAYERS} views, not {layers}")
    work = _Inversion(scene, ray_map, grid, layers, (min_magnification, max_magnification), out)
    work.direct()
    work.glass()
    return work.result()


class _Inversion:
    """The arrays of a correction map while it grows, sheet by sheet."""

    def __init__(
        self,
        scene: Scene,
        ray_map: RayMap,
        grid: PlaneGrid,
        layers: int,
        limits: tuple[float, float],
        out: CorrectionMap | None,
    ) -> None:
        height, width = grid.shape
        self.scene, self.ray_map, self.grid, self.least = scene, ray_map, grid, limits[0]
        self.size = scene.camera.sensor_px
        self.tables = (pack_camera(scene.camera), scene.sphere_table(), scene.rod_table())
        self.lockstep = fits_lockstep(scene)
        self.grid_numbers = np.array([*grid.origin_mm, grid.pitch_mm])
        self.limits = np.array([*limits, *self.size], dtype=np.float64)
        fits = out is not None and out.pixel.shape == (layers, height, width, 2)
        if out is not None and fits and out.branch.dtype == ray_map.branch.dtype:
            self.status, self.pixel, self.jacobian = out.status, out.pixel, out.jacobian
            self.weight, self.transmittance, self.branch = out.weight, out.transmittance, out.branch
            return
        self.status = np.empty((height, width), np.uint8)
        self.pixel = np.empty((layers, height, width, 2))
        self.jacobian = np.empty((layers, height, width, 4), np.float32)
        self.weight = np.empty((layers, height, width), np.float32)
        self.transmittance = np.empty((layers, height, width), np.float32)
        self.branch = np.empty((layers, height, width), ray_map.branch.dtype)

    def direct(self) -> None:
        """Project the nodes that are seen without glass, and write every other node for the first time."""
        height, width = self.grid.shape
        place, discs = self._node_camera(), sphere_discs(self.tables[1])
        lens_free = self.scene.camera.lens.is_ideal
        size = np.array(self.size, dtype=np.float64)
        maps: tuple[NDArray[Any], ...] = (
            self.status,
            self.pixel.reshape(len(self.pixel), height, 2 * width),
            self.jacobian.reshape(len(self.pixel), height, 4 * width),
            *self._rest(),
        )

        def work(first: int, last: int) -> None:
            x, y = np.arange(width, dtype=np.float64), np.empty(width)
            x = (x - place[13]) / place[12]
            spans, hidden = np.empty((2 * len(discs) + 1, 2), np.int64), np.empty(width, np.uint8)
            scratch = (x, y, spans, *block_scratch(), hidden, np.empty((6, width)))
            direct_rows(
                place,
                self.tables,
                discs,
                self.lockstep,
                lens_free,
                self.grid_numbers,
                size,
                first,
                last,
                *scratch,
                maps,
            )

        run_rows(work, height)

    def _rest(self) -> tuple[NDArray[Any], ...]:
        return self.weight, self.transmittance, self.branch

    def _node_camera(self) -> NDArray[np.float64]:
        """Camera in the pinhole, looking straight down, whose pixels are the nodes (20,)."""
        x, y, z = self.scene.camera.position_mm
        (x0, y0), pitch = self.grid.origin_mm, self.grid.pitch_mm
        straight = [1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0]
        return np.array([x, y, z, *straight, z / pitch, (x - x0) / pitch, (y0 - y) / pitch, *[0.0] * 5])

    def glass(self) -> None:
        """Cut the sensor into sheets and solve each that is worth it."""
        height, width = self.ray_map.status.shape
        plane = self.ray_map.plane_mm.reshape(height, 2 * width)
        branch, status = self.ray_map.branch, self.ray_map.status
        code, counts = np.empty((height, width), np.uint32), np.empty(height, np.int64)
        longest = 2.0 * self.grid.pitch_mm / self.least

        def work(first: int, last: int) -> None:
            code_rows(*self.tables, longest, first, last, plane, branch, status, code, counts)

        run_rows(work, height)
        begin = np.concatenate(([0], np.cumsum(counts)))
        runs = np.empty((int(begin[-1]), RUN), np.int64)
        run_rows(lambda first, last: list_runs(code, first, last, begin, runs), height)
        parent, useful = np.empty(len(runs), np.int64), np.zeros(len(runs), np.int64)
        join_runs(begin, runs, parent)
        count_useful(code, runs, parent, useful)
        order = np.argsort(parent, kind="stable")
        heads = np.nonzero(useful)[0]
        firsts = np.searchsorted(parent[order], heads)
        lasts = np.searchsorted(parent[order], heads, side="right")
        shape = self.grid.shape
        stamps, away, start = np.zeros(shape, np.int32), np.empty(shape), np.empty((*shape, 2))
        nodes = np.empty(shape[0] * shape[1], np.int32)
        # As the branches are numbered, not as the sensor meets them: of equal views the same one is kept.
        for stamp, sheet in enumerate(np.lexsort((heads, runs[heads, 3])), start=1):
            members = runs[order[firsts[sheet] : lasts[sheet]]]
            found = scatter_sheet(
                plane,
                branch,
                code,
                members,
                self.tables,
                self.grid_numbers,
                stamp,
                stamps,
                away,
                start,
                nodes,
            )
            if found:
                self._solve(int(members[0, 3]), start, nodes[:found])

    def _solve(self, code: int, start: NDArray[np.float64], nodes: NDArray[np.int32]) -> None:
        """Solve the nodes of one sheet and keep the best views."""
        number, sign = code >> 1, -1.0 if code & 1 else 1.0
        numbers = {sphere.name: index for index, sphere in enumerate(self.scene.spheres)}
        sequence = np.array([numbers[name] for name in self.ray_map.branches[number]], np.int64)
        key = DIRECT
        for body in sequence.tolist():
            key = next_key(key, body) & KEY_MASK
        balls, trip = (
            (pack_chain(self.scene), chain_trip(self.scene, sequence)) if self.lockstep else (NO_BALLS, -1)
        )
        maps: tuple[NDArray[Any], ...] = (self.status, self.pixel, self.jacobian, *self._rest())

        def work(first: int, last: int) -> None:
            scratch = (
                np.empty(NEWTON_NUMBERS),
                np.empty(GROUP, np.int64),
                np.empty((2, GROUP)),
                np.empty((len(balls), 2), np.int64),
                np.empty(len(balls), np.int64),
                *block_scratch(),
            )
            solve_nodes(
                self.tables,
                self.grid_numbers,
                balls,
                sequence,
                trip,
                key,
                number,
                sign,
                self.limits,
                start,
                nodes,
                first,
                last,
                *scratch,
                maps,
            )

        run_rows(work, len(nodes), block=NODES_PER_CALL)

    def result(self) -> CorrectionMap:
        """Return the finished map: weights normalised, nothing finite where there is no view."""

        def work(first: int, last: int) -> None:
            total = self.weight[:, first:last].sum(axis=0)
            self.weight[:, first:last] /= np.where(total > 0.0, total, np.float32(1.0))

        run_rows(work, self.grid.shape[0])
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
