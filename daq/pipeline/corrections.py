"""Correctors for a run: one for each view, built before the first frame and kept on the disk between runs.

A map depends on the scene alone, so it is stored under the scene's hash; tracing 4 million rays takes seconds,
loading takes less.  The place of camera and glass is that of the plan (the scene file's): their axes arrive within
their tolerance, and a map for every micrometre would be another map for every frame.  The target's place does not
matter while it lies in the investigation plane; frames of a target off the plane are not corrected.
"""

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.correction_map import CorrectionMap, build_correction_map
from correction.corrector import UINT16_OFFSET, Corrector, to_uint16
from correction.dewarp import Dewarp
from correction.frame_file import write_frame
from correction.node_status import MEANING
from correction.resample import Method
from daq.errors import DiskError
from daq.pipeline.priority import step_back
from daq.plans.steps import CLEAR, Step
from daq.runs.whole_text import why
from tracer.errors import TracerError
from tracer.ray_map import build_ray_map
from tracer.scene import Scene


@dataclass
class Corrections:
    """Correctors of a scene by view.

    Parameters
    ----------
    scene : Scene
        As known, or as fitted.
    dewarp : Dewarp, optional
        From the bare target.
    method : {"quintic", "bilinear"}
        Interpolation.
    maps : Path, optional
        Folder of stored maps.
    """

    scene: Scene
    dewarp: Dewarp | None = None
    method: Method = "quintic"
    maps: Path | None = None
    _correctors: dict[str, Corrector] = field(default_factory=dict)

    def prepare(self, views: Iterable[str]) -> None:
        """Build the correctors of some views now.

        It happens in a thread of low priority, so that the worker threads of the kernels, which are born here,
        have it as well: while frames come, writing them is more urgent.
        """
        wanted = dict.fromkeys(views)

        def build() -> None:
            step_back()
            for view in wanted:
                self._corrector(view)

        with ThreadPoolExecutor(1) as pool:
            pool.submit(build).result()

    def of(self, step: Step) -> Corrector | None:
        """Corrector for the frames of a step; None if they are not to be corrected."""
        return self._corrector(step.view) if step.on_plane else None

    def about(self) -> dict[str, Any]:
        """What a result depends on, as plain data."""
        return {
            "scene_hash": self.scene.content_hash(),
            "method": self.method,
            "dewarp": None if self.dewarp is None else self.dewarp.to_dict(),
        }

    def write(self, path: Path, corrected: NDArray[np.float32], step: Step, source: str) -> None:
        """Write a corrected frame as the verb `correct` does; DiskError if the disk does not take it."""
        corrector = self._corrector(step.view)
        stored, _ = to_uint16(corrected)
        grid = corrector.map.grid
        about = {"source": source, "offset": UINT16_OFFSET, "origin_mm": list(grid.origin_mm), "tag": step.tag}
        about |= {"scene_hash": corrector.map.scene_hash, "method": self.method}
        try:
            write_frame(path, stored, grid.px_per_mm, about)
        except OSError as error:
            raise DiskError(f"{path}: {why(error)}; make room, then resume the run") from error

    def write_masks(self, folder: Path) -> None:
        """Write the mask of every prepared view."""
        for view, corrector in self._correctors.items():
            about = {"meaning": list(MEANING.values()), "scene_hash": corrector.map.scene_hash}
            path = folder / f"mask_{view}.tif"
            if not path.exists():
                write_frame(path, corrector.status, corrector.map.grid.px_per_mm, about)

    def _corrector(self, view: str) -> Corrector:
        if view not in self._correctors:
            scene = self.scene.with_bodies(()) if view == CLEAR else self.scene
            corrector = Corrector(self._map(scene), self.dewarp, self.method)
            corrector(np.zeros(scene.camera.shape, np.uint16))  # compiled and warm before the first frame
            self._correctors[view] = corrector
        return self._correctors[view]

    def _map(self, scene: Scene) -> CorrectionMap:
        path = self.maps / f"{scene.content_hash()}.map" if self.maps is not None else None
        if path is not None and path.exists():
            try:
                stored = CorrectionMap.load(path)
                stored.check(scene)
                return stored
            except TracerError:
                path.unlink()  # damaged or of an older layout: made again below
        built = build_correction_map(scene, build_ray_map(scene))
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            built.save(path)
        return built
