"""The correction map: for every node of the plane, the camera pixel that shows it.

The ray map answers "what does this pixel see"; correcting a frame needs the inverse.  Through glass the
inverse has several values: one plane point can be seen directly, through one chain of spheres, through
another, and twice through the same chain, once on each side of a fold.  So the sensor is cut into SHEETS:
connected regions of one branch (sequence of spheres) in which the determinant of d plane / d pixel keeps
its sign.  On a sheet the map is one-to-one and smooth, and the inverse is found exactly:

1. direct view: projected in closed form, no glass asked beyond "is the line of sight free";
2. per sheet: starting points from the traced pixels and their differences, then Newton on traced rays until
   a step changes the derivatives by less than float32 shows (it is still taken, leaving about its square);
3. a node seen on several sheets keeps the `layers` best of them, by weight

       w = T min(1, |det d pixel / d node|) / (1 + events)

   T the transmittance: what little light comes counts little; the magnification up to one sensor pixel a
   node: more resolution than the corrected image holds is worth nothing; fewer events: each surface adds
   its own error.  The direct view has w near 1 and beats every view through glass.  Weights of a node sum
   to 1.  One layer (the default) takes the best view only.

Limits: where the view shrinks below `min_magnification` sensor pixels a node in any direction the picture
is not worth correcting (LOW_MAGNIFICATION); where it is stretched beyond `max_magnification` two images
are about to merge (FOLD).

Where the plane runs through a body nothing flows: these nodes are IN_GLASS.  A ball that touches the target's
plane is cut by a sheet that lies a little before it: 0.3 mm before the plane, a ball of 25 mm radius fills a disc
of 3.9 mm radius of the sheet.  The glass of a tube's wall is given by the rays that end in it.
"""

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from correction.errors import MapUsageError
from correction.grid import PlaneGrid, grid_of
from correction.inversion.invert import Inversion
from correction.maps.packed import deflate, inflate, pack, round_to_step, unpack
from correction.masked import STATUS, nodes_in
from correction.node_status import NodeStatus
from ground.config import Pair
from ground.errors import MapFileError
from ground.map_file import check_header, load_arrays, save_arrays
from ground.memory import require_memory
from ground.program_code import code_digest
from ground.rows import run_rows
from ground.short_repr import short_repr
from tracer.bodies import CONTACT_TOL_MM, Block, Capsule, Sphere
from tracer.scene.scene import Scene, SceneBound
from tracer.strategies.branches import Branch, Numbers
from tracer.strategies.ray_map import RayHeader, RayMap
from tracer.strategies.strategy import choose

KIND = "correction map"
MIN_MAGNIFICATION = 0.5  # one sensor pixel may cover two corrected pixels, not more
MAX_LAYERS = 16
BYTES_PER_VIEW, BYTES_PER_NODE = 43, 6  # measured: 46 with one view, 128 with three
LIGHT = 1.0 + 1e-5  # rounding above a transmittance of 1
MAX_MAGNIFICATION = 16.0  # within 0.2 corrected pixels of the fold behind a 100 mm ball at L = 250 mm
ARRAYS = ("status", "pixel", "jacobian", "weight", "transmittance", "branch")
# Steps of stored fields, each good to half of it: 8e-6 px (sigmas are 3e-4 px and more), 5e-7 of a derivative.
STEPS = {"pixel": 2.0**-16, "jacobian": 2.0**-20, "weight": 2.0**-24, "transmittance": 2.0**-20}
FIELDS: dict[str, tuple[str, tuple[int, ...], float]] = {  # kind, components, and what is where nothing is seen
    "pixel": ("<f8", (2,), np.nan),
    "jacobian": ("<f4", (4,), 0.0),
    "weight": ("<f4", (), 0.0),
    "transmittance": ("<f4", (), 0.0),
}
STORED_BYTES = 3.0  # on the disk, a node and view: 1.6 to 1.9 of sensors of 1008 px
# Sensors whose pixels a step of 2^-16 holds in 32 bits; those of wider ones are coarser
FINE_STEP_WIDTH_PX = 32000


def storage_steps(sensor_px: Sequence[int]) -> dict[str, float]:
    """Return the step of each stored field of a sensor."""
    wider = 2.0 ** np.ceil(np.log2(max(max(sensor_px) / FINE_STEP_WIDTH_PX, 1.0)))
    return STEPS | {"pixel": float(STEPS["pixel"] * wider)}


def code_here() -> str:
    """Digest of the code that makes maps in this program."""
    return code_digest("ground", "tracer", "correction")


class CorrectionHeader(RayHeader):
    """Header of a stored correction map."""

    origin_mm: Pair
    pitch_mm: Annotated[float, Field(gt=0.0)]
    sensor_px: Annotated[list[Annotated[int, Field(ge=2)]], Field(min_length=2, max_length=2)]
    layers: Annotated[int, Field(ge=1, le=MAX_LAYERS)]
    branch_kind: Literal["<u2", "<u4"]
    made_by: str = ""


@short_repr
@dataclass(frozen=True)
class CorrectionMap(SceneBound):
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
    branches : sequence of tuple of str
        Names of the spheres crossed; number 0 is the direct view.
    sensor_px : (int, int)
        Width and height of the frames that the map corrects.
    scene_hash : str
        Content hash of the scene.
    made_by : str
        Of one that was read: digest of the code that made it (`code_here`).
    """

    grid: PlaneGrid
    status: NDArray[np.uint8]
    pixel: NDArray[np.float64]
    jacobian: NDArray[np.float32]
    weight: NDArray[np.float32]
    transmittance: NDArray[np.float32]
    branch: Numbers
    branches: Sequence[Branch]
    sensor_px: tuple[int, int]
    scene_hash: str
    made_by: str = ""

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

    def magnification(self, step: int = 1) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Smallest and largest local magnification of the best view (h, w), sensor px per corrected px.

        Their product is the areal magnification, their ratio the anisotropy; of every `step`-th node a side.
        """
        uc, ur, vc, vr = np.moveaxis(self.jacobian[0, ::step, ::step], -1, 0)
        p = np.hypot(uc + vr, vc - ur) / 2
        q = np.hypot(uc - vr, vc + ur) / 2
        return np.abs(p - q), p + q

    def without(self, gone: NDArray[np.bool_], why: NodeStatus) -> "CorrectionMap":
        """Return the map with nothing shown at some of its nodes (h, w), for a reason."""
        return replace(
            self,
            status=np.where(gone, np.uint8(why), self.status),
            pixel=np.where(gone[..., None], np.nan, self.pixel),
            weight=np.where(gone, np.float32(0.0), self.weight),
        )

    def of_view(self, number: int) -> "CorrectionMap":
        """Return the map of one view of each node alone, 0 the best; a node that has no such view is LEFT_OUT."""
        part = slice(number, number + 1)
        seen = self.weight[part] > 0.0
        lost = self.recovered & ~seen[0]
        found = replace(
            self,
            status=np.where(lost, np.uint8(NodeStatus.LEFT_OUT), self.status),
            weight=np.where(seen, np.float32(1.0), np.float32(0.0)),
            **{name: getattr(self, name)[part] for name in ("pixel", "jacobian", "transmittance", "branch")},
        )
        return found

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Its arrays by name, in the order in which kernels take them."""
        return {name: getattr(self, name) for name in ARRAYS}

    def as_stored(self) -> "CorrectionMap":
        """Return the map with the bits that it has once stored."""
        seen, steps = self.weight > 0.0, storage_steps(self.sensor_px)
        fields: dict[str, Any] = {
            name: np.empty(getattr(self, name).shape, kind) for name, (kind, _, _) in FIELDS.items()
        }

        def work(first: int, last: int) -> None:
            for layer, (name, (_, _, hidden)) in product(range(self.layers), FIELDS.items()):
                part = layer, slice(first, last)
                round_to_step(getattr(self, name)[part], seen[part], steps[name], hidden, fields[name][part])

        run_rows(work, self.status.shape[0], block=16)  # few rows stay in a core's cache
        return replace(self, **fields)

    def save(self, path: Path | str) -> None:
        """Write the map to a file, atomically."""
        header = {
            "scene_hash": self.scene_hash,
            "branches": [list(names) for names in self.branches],
            "origin_mm": list(self.grid.origin_mm),
            "pitch_mm": self.grid.pitch_mm,
            "sensor_px": list(self.sensor_px),
            "layers": self.layers,
            "branch_kind": self.branch.dtype.str,
            "made_by": code_here(),
        }
        seen, steps = self.weight > 0.0, storage_steps(self.sensor_px)
        arrays = {"status": self.status, "seen": deflate(np.packbits(seen)), "branch": deflate(self.branch)}
        for name, (_, trailing, _) in FIELDS.items():
            arrays[name] = pack(_first(getattr(self, name)), _each(seen, trailing), steps[name])
        save_arrays(path, KIND, header, arrays)

    @classmethod
    def load(cls, path: Path | str) -> "CorrectionMap":
        """Read a map, to half of `storage_steps`.

        Raises
        ------
        MapFileError
            The file is damaged or holds something else.
        """
        header, arrays = load_arrays(path, KIND)
        said, status = check_header(path, header, CorrectionHeader), arrays.get("status", np.zeros(0))
        bytes_alone = all(array.dtype == np.uint8 for array in arrays.values())
        if set(arrays) != {*ARRAYS, "seen"} or not bytes_alone or status.ndim != 2:
            raise MapFileError(f"{path}: arrays are missing; make the map again")
        (x0, y0), (columns, rows), shape = said.origin_mm, said.sensor_px, (said.layers, *status.shape)
        branches, count = tuple(map(tuple, said.branches)), int(np.prod(shape))
        number = np.dtype(said.branch_kind)
        require_memory(float(BYTES_PER_VIEW * count), f"a correction map of {count} nodes and views")
        try:
            bits = inflate(arrays["seen"], -(-count // 8))
            seen = np.unpackbits(bits, count=count).astype(bool).reshape(shape)
            steps = storage_steps(said.sensor_px)
            branch = inflate(arrays["branch"], count * number.itemsize).view(number).reshape(shape)
            fields = {
                name: _last(unpack(arrays[name], _each(seen, trailing), steps[name], hidden), kind)
                for name, (kind, trailing, hidden) in FIELDS.items()
            }
        except (ValueError, zlib.error):
            raise MapFileError(f"{path}: arrays do not fit together; make the map again") from None
        made = cls(
            PlaneGrid((x0, y0), said.pitch_mm, status.shape),
            status,
            **fields,
            branch=branch,
            branches=branches,
            sensor_px=(columns, rows),
            scene_hash=said.scene_hash,
            made_by=said.made_by,
        )
        if not made._sound():
            raise MapFileError(f"{path}: holds values that no map has; make the map again")
        return made

    def _sound(self) -> bool:
        """Return whether all numbers are such as `build_correction_map` makes: no look-up leaves its range."""
        seen, shares = self.weight > 0.0, self.weight.sum(axis=0)
        right, bottom = self.sensor_px[0] - 1, self.sensor_px[1] - 1
        u, v = self.pixel[..., 0][seen], self.pixel[..., 1][seen]
        light = self.transmittance[seen]
        return bool(
            1 <= self.layers <= MAX_LAYERS
            and min(*self.grid.shape, right, bottom) >= 1
            and np.isfinite(self.grid.origin_mm).all()
            and 0.0 < self.grid.pitch_mm < np.inf
            and int(self.status.max()) <= max(NodeStatus)
            and int(self.branch.max()) < len(self.branches)
            and (self.weight >= 0.0).all()
            and np.abs(shares - self.recovered).max() <= 1e-5
            and ((u >= 0.0) & (u <= right) & (v >= 0.0) & (v <= bottom)).all()
            and np.isfinite(self.jacobian[seen]).all()
            and ((light > 0.0) & (light <= LIGHT)).all()
        )


def _first(field: NDArray[Any]) -> NDArray[Any]:
    """Fields (K, h, w, ...) with their components first."""
    return np.moveaxis(field, -1, 0) if field.ndim == 4 else field


def _last(field: NDArray[np.float64], kind: str) -> NDArray[Any]:
    """The same back again."""
    return np.ascontiguousarray(np.moveaxis(field, 0, -1) if field.ndim == 4 else field, kind)


def _each(seen: NDArray[np.bool_], trailing: tuple[int, ...]) -> NDArray[np.bool_]:
    """Mask of fields of so many components, the first axis, that are seen."""
    return np.broadcast_to(seen, (*trailing, *seen.shape))


def build_correction_map(
    scene: Scene,
    ray_map: RayMap,
    grid: PlaneGrid | None = None,
    *,
    layers: int = 1,
    min_magnification: float = MIN_MAGNIFICATION,
    max_magnification: float = MAX_MAGNIFICATION,
    out: CorrectionMap | None = None,
    skip: bool = True,
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
    skip : bool
        Whether views are left out that cannot be among the best; the map has the same bits.

    Raises
    ------
    StaleMap
        The ray map belongs to another scene.
    MapUsageError
        `layers` is not 1 to MAX_LAYERS.
    MemoryShort
        Such a map does not fit into memory.
    """
    ray_map.check(scene)
    grid = grid or grid_of(scene.camera)
    if not 1 <= layers <= MAX_LAYERS:
        raise MapUsageError(f"a node can join 1 to {MAX_LAYERS} views, not {layers}")
    (height, width), needed = (
        grid.shape,
        (BYTES_PER_VIEW * layers + BYTES_PER_NODE) * np.prod(grid.shape, dtype=float),
    )
    require_memory(float(needed), f"a correction map of {width} x {height} nodes with {layers} views each")
    arrays = None if out is None else out.arrays()
    work = Inversion(choose(scene), ray_map, grid, layers, (min_magnification, max_magnification), arrays, skip)
    work.direct()
    work.glass()
    work.join()
    found = CorrectionMap(
        grid,
        **work.arrays,
        branches=ray_map.branches,
        sensor_px=scene.camera.sensor_px,
        scene_hash=ray_map.scene_hash,
        made_by="",
    )
    return _outside_outlines(_beside_edges(_outside_glass(found, scene), scene), scene)


def _outside_glass(found: CorrectionMap, scene: Scene) -> CorrectionMap:
    """Return a fresh map with its nodes inside bodies IN_GLASS, written in place."""
    inside = nodes_in_glass(scene, found.grid)
    if inside is not None:
        found.status[inside] = NodeStatus.IN_GLASS
        np.copyto(found.pixel, np.nan, where=inside[..., None])
        np.copyto(found.weight, np.float32(0.0), where=inside)
    return found


def nodes_in_glass(scene: Scene, grid: PlaneGrid) -> NDArray[np.bool_] | None:
    """Mask of the nodes (h, w) inside bodies that reach through the plane, walls aside; None without any."""
    cut = [body for body in scene.seen if body.lowest_mm < -CONTACT_TOL_MM and body.room is None]
    if not cut:
        return None
    inside = np.zeros(grid.shape, np.bool_)
    y, x = (np.arange(count) * grid.pitch_mm for count in grid.shape)
    x, y = grid.origin_mm[0] + x, grid.origin_mm[1] - y
    for body in cut:
        part = rows, columns = _window_of(body.capsule, grid)
        if isinstance(body, Sphere) and not body.shape_um:  # a disc, without all nodes' places in memory
            cx, cy, cz = body.centre_mm
            square = np.square(y[rows] - cy)[:, None] + np.square(x[columns] - cx)
            inside[part] |= square < body.radius_mm**2 - cz**2
        else:
            places = np.stack((*np.meshgrid(x[columns], y[rows]), np.zeros(inside[part].shape)), axis=-1)
            inside[part] |= body.distance_mm(places) < 0.0
    return inside


def _beside_edges(found: CorrectionMap, scene: Scene) -> CorrectionMap:
    """Return the map with nodes that no pixel shows behind blocks as hidden by their edges; the same map without.

    Flat faces have no folds: where nothing round stands, a node whose solution leaves its faces is at an edge too.
    """
    blocks = Block.among(scene.seen)
    reasons = [NodeStatus.RIM] + [NodeStatus.FOLD] * (len(blocks) == len(scene.seen))
    for block in blocks:
        lost = np.isin(found.status, reasons)
        nodes_mm = np.column_stack((found.grid.nodes_mm()[lost], np.zeros(np.count_nonzero(lost))))
        lost[lost] = block.stands_before(scene.camera.position_mm, nodes_mm)
        found = replace(found, status=np.where(lost, np.uint8(NodeStatus.EDGE), found.status))
    return found


def _outside_outlines(found: CorrectionMap, scene: Scene) -> CorrectionMap:
    """Return the map without what the scene masks in the plane; the same map where it masks nothing there."""
    for part in scene.masked:
        if part.outline_mm:
            found = found.without(nodes_in(part, found.grid.nodes_mm()), STATUS[part.why])
    return found


def _window_of(capsule: Capsule, grid: PlaneGrid) -> tuple[slice, slice]:
    """Rows and columns of the nodes that a capsule can hold."""
    ends = np.array([capsule.start_mm, capsule.end_mm])[:, :2]
    low, high = ends.min(axis=0) - capsule.radius_mm, ends.max(axis=0) + capsule.radius_mm
    (left, bottom), (right, top) = grid.to_px(low), grid.to_px(high)
    rows, columns = (
        slice(*np.clip((math.floor(first), math.ceil(last) + 1), 0, size).tolist())
        for first, last, size in zip((top, left), (bottom, right), grid.shape, strict=True)
    )
    return rows, columns
