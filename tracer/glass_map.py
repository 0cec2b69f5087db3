"""The ray map of what lies behind glass, and nothing else.

Most pixels of a scene of a few spheres meet no glass.  What they see is the pinhole's line, a formula, and to
store it is most of the time and memory of a ray map.  A glass map holds the rows' spans in which glass can be met,
one after the other in flat arrays, and where each begins.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.errors import SceneError
from tracer.kernels.chain import UNKNOWN
from tracer.kernels.glass import list_spans, trace_runs
from tracer.lockstep import by_march, chain_branches, find_mirrors, fits_lockstep, pack_chain, row_scratch
from tracer.ray_map import RayMap, build_ray_map
from tracer.rows import run_rows
from tracer.scene import Scene, SceneBound
from tracer.trace import Branch, pack_camera

RUNS_PER_CALL = 64


@dataclass(frozen=True)
class GlassMap(SceneBound):
    """Pixel -> plane point, stored where glass can be met.

    Parameters
    ----------
    runs : (R, 4) int64
        Row, first column, column after the last, index of the first pixel in the arrays below; by row.
    plane_mm : (P, 2) float64
        Plane points [mm]; NaN unless the status is RECOVERED.
    status : (P,) uint8
        RayStatus.
    branch : (P,) uint16
        Index into `branches`.
    branches : tuple of tuple of str
        Names of the spheres crossed, in order; number 0 is the direct view, ().
    scene_hash : str
        Content hash of the scene.
    """

    runs: NDArray[np.int64]
    plane_mm: NDArray[np.float64]
    status: NDArray[np.uint8]
    branch: NDArray[np.uint16]
    branches: tuple[Branch, ...]
    scene_hash: str

    @property
    def pixels(self) -> NDArray[np.int64]:
        """Pixels u, v (P, 2) of the arrays."""
        row, low, high, at = self.runs.T
        which = np.repeat(np.arange(len(self.runs)), high - low)
        column = low[which] + np.arange(len(self.status)) - at[which]
        return np.stack((column, row[which]), axis=-1)

    def full(self, scene: Scene) -> RayMap:
        """Ray map of the whole sensor: the same bits as `build_ray_map`, with the direct view from its formula.

        Raises
        ------
        StaleMap
            The map was traced from a scene with other numbers.
        """
        self.check(scene)
        clear = build_ray_map(scene.with_bodies(()))
        u, v = self.pixels.T
        clear.plane_mm[v, u], clear.status[v, u], clear.branch[v, u] = self.plane_mm, self.status, self.branch
        return RayMap(clear.plane_mm, clear.status, clear.branch, self.branches, self.scene_hash)


def build_glass_map(scene: Scene) -> GlassMap:
    """Trace the pixels that can meet glass.

    Parameters
    ----------
    scene : Scene
        A scene of a few transparent spheres, as `fits_lockstep`.

    Raises
    ------
    SceneError
        The scene is too rich: its glass is all over the sensor, or not known row by row.
    """
    if not fits_lockstep(scene):
        raise SceneError(
            "a glass map is for up to eight solid transparent spheres; trace the whole ray map instead"
        )
    height, width = scene.camera.shape
    camera, balls, flat = pack_camera(scene.camera), pack_chain(scene), scene.camera.lens.is_ideal
    mirrors = find_mirrors(scene)
    paired = len(mirrors.swap_x) + len(mirrors.swap_y) > 0
    found, counts = np.empty((height, 2 * len(balls) + 1, 2), np.int64), np.empty(height, np.int64)

    def look(first: int, last: int) -> None:
        x, y, *_ = row_scratch(width, len(balls))
        list_spans(camera, balls, flat, first, last, x, y[:1] if flat else y, found, counts)

    run_rows(look, height)
    row, which = np.nonzero(np.arange(len(balls)) < counts[:, None])
    spans = found[row, len(balls) + which]
    ends = np.cumsum(spans[:, 1] - spans[:, 0])
    runs = np.column_stack((row, spans, ends - (spans[:, 1] - spans[:, 0])))
    count = int(ends[-1]) if len(ends) else 0
    plane, status, branch = np.empty((count, 2)), np.empty(count, np.uint8), np.empty(count, np.uint16)
    point, unknown = plane.reshape(-1), np.zeros(len(runs), np.int64)
    twins, done_with = _twins(runs, height) if mirrors.in_y else (np.full(len(runs), -1), len(runs))

    def work(first: int, last: int) -> None:
        arrays = [*row_scratch(width, len(balls)), unknown, point, status, branch]
        swaps = mirrors.in_x, mirrors.swap_x, mirrors.swap_y
        trace_runs(camera, balls, flat, paired, *swaps, width, runs, twins, first, last, *arrays)

    run_rows(work, done_with, block=RUNS_PER_CALL)
    branches = chain_branches(scene)
    made = GlassMap(runs, plane, status, branch, tuple(branches), scene.content_hash())
    if not unknown.any():
        return made
    lost = np.nonzero(branch == UNKNOWN)[0]
    which = np.searchsorted(ends, lost, side="right")
    pixels = np.stack((runs[which, 1] + lost - runs[which, 3], runs[which, 0]), axis=-1)
    plane[lost], status[lost], branch[lost] = by_march(scene, pixels, branches)
    return GlassMap(runs, plane, status, branch, tuple(branches), made.scene_hash)


def _twins(runs: NDArray[np.int64], height: int) -> tuple[NDArray[np.int64], int]:
    """For each run its mirror image in y or -1, and how many runs must be traced: those down to the middle."""
    rows = runs[:, 0]
    begin = np.searchsorted(rows, np.arange(height + 1))
    twins = begin[height - 1 - rows] + np.arange(len(runs)) - begin[rows]
    middle = int(begin[(height + 1) // 2])
    twins[rows == height - 1 - rows] = -1
    assert np.array_equal(runs[twins[:middle], 1:3][twins[:middle] >= 0], runs[:middle, 1:3][twins[:middle] >= 0])
    return twins, middle
