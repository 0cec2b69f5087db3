"""The ray map: for every pixel of the sensor, the plane point it sees, exactly traced.

    scene.yaml -> Scene -> RayMap -> correction map -> corrected frames

The ray map is computed once for a scene and can be stored; the content hash of the scene goes with it, and
a map that belongs to another scene is refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ground.config import Table
from ground.errors import MapFileError
from ground.map_file import Hash, check_header, load_arrays, save_arrays
from ground.memory import require_memory
from ground.short_repr import short_repr
from tracer.errors import RayMapUsageError
from tracer.kernels.rays import MAX_EVENTS
from tracer.scene.scene import Scene, SceneBound
from tracer.strategies.branches import Branch, Numbers, lengths_of
from tracer.strategies.strategy import choose
from tracer.strategies.trace import RayStatus

KIND = "ray map"
BYTES_PER_PX = 27  # of a map, and of the keys of its branches while it is made


class RayHeader(Table):
    """Header of a stored ray map."""

    scene_hash: Hash
    branches: list[list[str]]


@short_repr
@dataclass(frozen=True)
class RayMap(SceneBound):
    """Pixel -> plane point over the whole sensor.

    Parameters
    ----------
    plane_mm : (H, W, 2) float64, or float32 if asked for
        Plane point of each pixel centre [mm]; NaN unless the status is RECOVERED.
    status : (H, W) uint8
        RayStatus.
    branch : (H, W) uint16, or uint32 where there are more than 65536 branches
        Index into `branches`.
    branches : sequence of tuple of str
        Names of the spheres crossed, in order; number 0 is the direct view, ().
    scene_hash : str
        Content hash of the scene.
    most_bodies : int or None
        Rays through more bodies than these were left out; None: all are there.
    """

    plane_mm: NDArray[np.float64 | np.float32]
    status: NDArray[np.uint8]
    branch: Numbers
    branches: Sequence[Branch]
    scene_hash: str
    most_bodies: int | None = None

    @property
    def recovered(self) -> NDArray[np.bool_]:
        """Pixels whose ray reaches the plane (H, W)."""
        return np.asarray(self.status == RayStatus.RECOVERED)

    def save(self, path: Path | str) -> None:
        """Write the map to a file, atomically.

        Raises
        ------
        RayMapUsageError
            Ways were left out: who reads the file would take what it lacks for lost.
        """
        if self.most_bodies is not None:
            raise RayMapUsageError("a map with most_bodies is not stored; trace the scene without that limit")
        header = {"scene_hash": self.scene_hash, "branches": [list(names) for names in self.branches]}
        save_arrays(path, KIND, header, {"plane_mm": self.plane_mm, "status": self.status, "branch": self.branch})

    @classmethod
    def load(cls, path: Path | str) -> "RayMap":
        """Read a map.

        Raises
        ------
        MapFileError
            The file is damaged or holds something else.
        """
        header, arrays = load_arrays(path, KIND)
        try:
            plane, status, branch = arrays["plane_mm"], arrays["status"], arrays["branch"]
        except KeyError as error:
            raise MapFileError(f"{path}: lacks {error}; trace the scene again") from None
        said = check_header(path, header, RayHeader)
        branches = tuple(map(tuple, said.branches))
        fits = plane.shape == (*status.shape, 2) and branch.shape == status.shape and status.ndim == 2
        kinds = plane.dtype.str in ("<f8", "<f4") and branch.dtype.str in ("<u2", "<u4")
        kinds &= status.dtype.str == "|u1"
        if not (
            fits
            and kinds
            and status.dtype.str == "|u1"
            and branches
            and int(branch.max(initial=0)) < len(branches)
        ):
            raise MapFileError(f"{path}: arrays do not fit together; trace the scene again")
        points = plane[status == RayStatus.RECOVERED]
        if int(status.max(initial=0)) > max(RayStatus) or not np.isfinite(points).all():
            raise MapFileError(f"{path}: holds values that no ray has; trace the scene again")
        return cls(plane, status, branch, branches, said.scene_hash)


def build_ray_map(
    scene: Scene, out: RayMap | None = None, *, single: bool = False, most_bodies: int | None = None
) -> RayMap:
    """Trace every pixel of the sensor to the investigation plane.

    Parameters
    ----------
    scene : Scene
        The scene.
    out : RayMap, optional
        An earlier map of a sensor of this size whose arrays are written again, so that `out` is worth nothing
        afterwards.  Fresh memory costs more than the rays: the system clears every page first.
    single : bool
        Whether the points, traced in float64 like any other, are stored as float32: 11 instead of 19 bytes a
        pixel, each coordinate rounded by at most 6e-8 of itself (4 nm at 80 mm).
    most_bodies : int, optional
        Follow no ray through more bodies than these, 0 to MAX_EVENTS: who would go on is TOO_MANY_EVENTS.  Every
        other pixel has the bits that it has without.  Through many balls little light comes, and each adds its own
        error; a bed is done sooner.  Default: no such limit.

    Returns
    -------
    RayMap
        The same bits for any number of threads.

    Raises
    ------
    MemoryShort
        The map of such a sensor does not fit into memory.
    RayMapUsageError
        `most_bodies` is not 0 to MAX_EVENTS.
    """
    if most_bodies is not None and not 0 <= most_bodies <= MAX_EVENTS:
        raise RayMapUsageError(f"most_bodies is 0 to {MAX_EVENTS}, not {most_bodies}")
    height, width = scene.camera.shape
    kind = np.dtype(np.float32 if single else np.float64)
    if (
        out is not None
        and out.status.shape == (height, width)
        and out.plane_mm.dtype == kind
        and out.branch.dtype == np.uint16
    ):
        plane, status, branch = out.plane_mm, out.status, out.branch
    else:
        require_memory(BYTES_PER_PX * height * width, f"the ray map of a sensor of {width} x {height} px")
        plane, status = np.empty((height, width, 2), kind), np.empty((height, width), np.uint8)
        branch = np.empty((height, width), np.uint16)
    most = MAX_EVENTS if most_bodies is None else most_bodies
    numbers, branches = choose(scene).trace(plane, status, branch, most)
    return _without_longer(RayMap(plane, status, numbers, branches, scene.content_hash()), most_bodies)


def _without_longer(made: RayMap, most_bodies: int | None) -> RayMap:
    """Drop the pixels that go through more than `most_bodies`, in place."""
    if most_bodies is None:
        return made
    too_long = lengths_of(made.branches) > most_bodies
    if too_long.any():
        longer = too_long[made.branch]
        made.status[longer], made.plane_mm[longer] = RayStatus.TOO_MANY_EVENTS, np.nan
    return replace(made, most_bodies=most_bodies)
