"""A correction ready for frames: the scene, traced and inverted, and the dewarp, composed with it; made once.

    scene -> ray map -> correction map (kept on the disk where asked) -> Corrector (with dewarp and method)

All that correct take it from here: the lanes of a run, `correct`, `evaluate`, `report`, the figures of a fit.
`PreparedCorrections` keeps the latest: what is asked for again, by what it is made of (`content_key`), is at hand.

The ray map is not kept: once inverted, only tracking asks for it, and tracing it once more (`ray_map`)
costs less than its 80 MB.
"""

import hashlib
import json
import os
from collections import OrderedDict
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from correction.fitted.map_sigma import SigmaLimit
from correction.grid import PlaneGrid, grid_of
from correction.maps.aperture import through_pupil
from correction.maps.correction_map import CorrectionMap, build_correction_map, code_here
from correction.maps.corrector import Corrector
from correction.maps.dewarp import Dewarp
from correction.maps.height_change import HeightChange
from correction.maps.lit import PlaneLight, light_of, through_light
from ground.errors import GroundError
from piv.resampling.sample import Method
from tracer.errors import TracerError
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import RayMap, build_ray_map

# Maps in a folder: of one scene some glass positions and light sheets, not of all scenes ever fitted
STORED = 16
KEPT = 2  # through the glass and without it: 0.3 GB each at 4 million pixels


@dataclass(frozen=True, eq=False)
class PreparedCorrection:
    """A correction that turns frames of one scene into frames without its glass.

    Parameters
    ----------
    scene : Scene
        What the camera looked through.
    corrector : Corrector
        With the correction map and the dewarp that it was made from.
    content_key : str
        Of everything that the corrected pixels depend on, see `content_key`.
    light : PlaneLight, optional
        Light that the map was looked up on; None if the scene gives no source.
    """

    scene: Scene
    corrector: Corrector
    content_key: str
    light: PlaneLight | None = None

    @cached_property
    def height_change(self) -> HeightChange | None:
        """Bias of displacements by the change of the light's height; None where the light lies in the plane."""
        if self.light is None or not self.light.is_bent:
            return None
        return HeightChange.of(self.corrector.map, self.scene, self.light)

    @cached_property
    def ray_map(self) -> RayMap:
        """Ray map of the scene (H, W), traced when it is first asked for."""
        return build_ray_map(self.scene)


def content_key(
    scene: Scene,
    dewarp: Dewarp | None = None,
    method: Method = "quintic",
    layers: int = 1,
    limit: SigmaLimit | None = None,
    grid: PlaneGrid | None = None,
    view: int = 0,
) -> str:
    """Hex digest (16 characters) of everything that corrected pixels depend on, but for the frame itself."""
    tree: list[Any] = [scene.content_hash(), None if dewarp is None else dewarp.to_dict(), method, layers]
    if scene.camera.pupil is not None:
        tree += [scene.camera.pupil.radius_mm, scene.camera.pupil.focus_mm]
    if scene.masked:
        tree += [asdict(part) for part in scene.masked]
    if scene.light is not None:
        tree.append(asdict(scene.light))
    if limit is not None:
        of_sigma = (
            limit.sigma.root.tobytes() + limit.sigma.plane_root.tobytes() + limit.sigma.shapes.root.tobytes()
        )
        tree += [limit.limit_px, hashlib.sha256(of_sigma).hexdigest()]
    if (grid := _other(grid, scene)) is not None:
        tree.append(asdict(grid))
    if view:
        tree.append({"view": view})
    text = json.dumps(tree, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def prepare(
    scene: Scene,
    dewarp: Dewarp | None = None,
    method: Method = "quintic",
    layers: int = 1,
    maps: Path | None = None,
    limit: SigmaLimit | None = None,
    grid: PlaneGrid | None = None,
    view: int = 0,
) -> PreparedCorrection:
    """Make a correction ready.

    Parameters
    ----------
    scene : Scene
        As known, or as fitted.
    dewarp : Dewarp, optional
        Ideal pixel -> acquired pixel; without it the camera's lens terms are taken as they are.
    method : {"quintic", "bilinear"}
        Interpolation.
    layers : int
        Views of a node that are joined, where several paths through the glass show it; 1 takes the best.
    maps : Path, optional
        Folder of stored correction maps, by the hash of their scene; a map that is missing, damaged or of another
        program is made and put there.
    limit : SigmaLimit, optional
        Nodes of which the map is less sure are left out.
    grid : PlaneGrid, optional
        Nodes of the corrected frame; default `grid_of` the camera. That of another scene lets frames of two days,
        each with a camera of its own fit, be corrected node by node alike.
    view : int
        Another view than the best, 0, of nodes that the camera sees on several paths: 1 the second best. Only
        these nodes are shown.

    Raises
    ------
    MapUsageError
        `layers` is not 1 to MAX_LAYERS.
    StaleMap
        The limit is that of another scene's fit.
    """
    found = _map(scene, max(layers, view + 1), maps, _other(grid, scene))
    light = light_of(scene, found.grid)
    if view:
        found = found.of_view(view)
    lit = through_light(found, scene, light)
    found = through_pupil(lit, scene)
    corrector = Corrector(found if limit is None else limit.within(found, scene), dewarp, method)
    key = content_key(scene, dewarp, method, layers, limit, grid, view)
    return PreparedCorrection(scene, corrector, key, light)


class PreparedCorrections:
    """The corrections used last, by what they are made of.

    Parameters
    ----------
    maps : Path, optional
        Folder of stored correction maps, see `prepare`.
    kept : int
        Corrections that stay in memory; the one not used for longest goes first.
    """

    def __init__(self, maps: Path | None = None, kept: int = KEPT) -> None:
        self._maps, self._kept = maps, kept
        self._latest: OrderedDict[str, PreparedCorrection] = OrderedDict()

    def of(
        self,
        scene: Scene,
        dewarp: Dewarp | None = None,
        method: Method = "quintic",
        layers: int = 1,
        limit: SigmaLimit | None = None,
        grid: PlaneGrid | None = None,
        view: int = 0,
    ) -> PreparedCorrection:
        """Return a correction, made now if it is not at hand; what is taken and raised is that of `prepare`."""
        key = content_key(scene, dewarp, method, layers, limit, grid, view)
        if key not in self._latest:
            while len(self._latest) >= self._kept:  # before, so that memory holds no more than `kept` at any time
                self._latest.popitem(last=False)
            self._latest[key] = prepare(scene, dewarp, method, layers, self._maps, limit, grid, view)
        self._latest.move_to_end(key)
        return self._latest[key]


def _other(grid: PlaneGrid | None, scene: Scene) -> PlaneGrid | None:
    """A grid that is not the camera's own; None if it is."""
    return None if grid is None or grid == grid_of(scene.camera) else grid


def _map(scene: Scene, layers: int, maps: Path | None, grid: PlaneGrid | None) -> CorrectionMap:
    if maps is None:
        return build_correction_map(scene, build_ray_map(scene), grid, layers=layers).as_stored()
    own = ""
    for what in (grid, scene.masked or None):
        own += "" if what is None else "_" + hashlib.sha256(repr(what).encode()).hexdigest()[:16]
    path = maps / f"{scene.content_hash()}{f'_{layers}' if layers > 1 else ''}{own}.map"
    if path.exists():
        try:
            stored = CorrectionMap.load(path)
            stored.check(scene)
            if stored.made_by == code_here() and stored.grid == (grid or grid_of(scene.camera)):
                os.utime(path)
                return stored
        except (GroundError, TracerError):
            path.unlink()  # damaged or of an older layout: made again below
    built = build_correction_map(scene, build_ray_map(scene), grid, layers=layers).as_stored()
    path.parent.mkdir(parents=True, exist_ok=True)
    built.save(path)
    _remove_old(maps)
    return built


def _remove_old(maps: Path) -> None:
    """Keep the STORED maps that were used last; another process may read or remove one meanwhile."""
    used: list[tuple[float, Path]] = []
    for path in maps.glob("*.map"):
        with suppress(OSError):
            used.append((path.stat().st_mtime, path))
    for _, path in sorted(used, reverse=True)[STORED:]:
        with suppress(OSError):
            path.unlink()
