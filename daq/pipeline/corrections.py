"""The corrections of a run: one for each view, made ready before the first frame, their maps kept between runs.

The place of camera and glass is that of the plan (the scene file's): their axes arrive within their tolerance, and
a map for every micrometre would be another map for every frame.  The target's place does not matter while it lies
in the investigation plane; frames of a target off the plane are not corrected.  What was not corrected while the
frames arrived is corrected from the disk.
"""

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from correction.fitted.prepared import PreparedCorrection, prepare
from correction.maps.corrector import UINT16_OFFSET, Corrector, to_uint16
from correction.maps.dewarp import Dewarp
from correction.node_status import MEANING
from daq.atomic_write import disk_errors
from daq.pipeline.priority import lower_priority
from daq.plans.steps import CLEAR, Step
from daq.runs.acquired import read_acquired
from daq.runs.run_folder import RunFolder
from piv.files.frame_file import write_frame
from piv.resampling.sample import Method
from tracer.scene.scene import Scene


@dataclass
class Corrections:
    """Corrections of a scene by view.

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
    _prepared: dict[str, PreparedCorrection] = field(default_factory=dict)

    def prepare(self, views: Iterable[str]) -> None:
        """Build the correctors of some views now.

        It happens in a thread of low priority, so that the worker threads of the kernels, which are born here,
        have it as well: while frames come, writing them is more urgent.
        """
        wanted = dict.fromkeys(views)

        def build() -> None:
            lower_priority()
            for view in wanted:
                self._view(view)

        with ThreadPoolExecutor(1) as pool:
            pool.submit(build).result()

    def of(self, step: Step) -> Corrector | None:
        """Corrector for the frames of a step; None if they are not to be corrected."""
        return self._view(step.view).corrector if step.on_plane else None

    def corrector(self, view: str) -> Corrector:
        """Corrector for a view of the investigation plane."""
        return self._view(view).corrector

    def write(self, path: Path, corrected: NDArray[np.float32], step: Step, source: str) -> None:
        """Write a corrected frame as the verb `correct` does; DiskError if the disk does not take it."""
        corrector = self._view(step.view).corrector
        stored, _ = to_uint16(corrected)
        grid = corrector.map.grid
        about = {"source": source, "offset": UINT16_OFFSET, "origin_mm": list(grid.origin_mm), "tag": step.tag}
        about |= {"scene_hash": corrector.map.scene_hash, "method": self.method}
        with disk_errors(path, "make room, then resume the run"):
            write_frame(path, stored, grid.px_per_mm, about)

    def write_masks(self, folder: Path) -> None:
        """Write the mask of every prepared view."""
        for view, prepared in self._prepared.items():
            corrector = prepared.corrector
            about = {"meaning": list(MEANING.values()), "scene_hash": corrector.map.scene_hash}
            path = folder / f"mask_{view}.tif"
            if not path.exists():
                write_frame(path, corrector.status, corrector.map.grid.px_per_mm, about)

    def _view(self, view: str) -> PreparedCorrection:
        if view not in self._prepared:
            scene = self.scene.bare() if view == CLEAR else self.scene
            prepared = prepare(scene, self.dewarp, self.method, maps=self.maps)
            # compiled and warm before the first frame
            prepared.corrector(np.zeros(scene.camera.shape, np.uint16))
            self._prepared[view] = prepared
        return self._prepared[view]


def frames_to_correct(
    folder: RunFolder, corrections: Corrections, steps: Iterable[Step]
) -> list[tuple[Step, int]]:
    """Return the frames (step, number) that are to be corrected and have no corrected file yet."""
    return [
        (step, number)
        for step in steps
        if corrections.of(step) is not None
        for number in step.numbers
        if folder.frame_path(number).exists() and not folder.correction_path(number).exists()
    ]


def correct_from_disk(folder: RunFolder, corrections: Corrections, step: Step, number: int) -> None:
    """Correct one raw frame of a run.

    Raises
    ------
    FrameDamaged, RunDamaged
        The raw frame is not what the journal has acknowledged.
    DiskError
        The disk takes no corrected one.
    """
    corrector = corrections.of(step)
    assert corrector is not None
    source = folder.frame_path(number)
    pixels = read_acquired(source)
    corrections.write(folder.correction_path(number), corrector(pixels), step, source.name)
