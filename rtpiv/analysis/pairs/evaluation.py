"""One pair from frames to figures: correct, correlate, carry the map's uncertainty along, compare with truth."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from correction.evaluate.regions import Regions, regions_of
from correction.evaluate.routes import Routes, compare_routes, joined, radius_of
from correction.evaluate.shift import ShiftResult, evaluate_shift
from correction.evaluate.tracks_through_glass import track_through_glass
from correction.evaluate.velocity_route import PlaneVectors, raw_settings, velocity_route
from correction.fitted.prepared import PreparedCorrection
from correction.fitted.scene_sigma import SceneSigma
from correction.fitted.vector_map_sigma import VectorMapSigma, vector_map_sigma
from correction.grid import PlaneGrid
from correction.maps.corrector import Corrector
from daq.runs.acquired import read_acquired
from ground.short_repr import short_repr
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorField
from piv.errors import FrameError, PairError
from piv.preprocessing.preparation import Preparation
from rtpiv.analysis.pictures.before_after import BeforeAfter, before_after
from tracer.scene.scene import Scene

Route = Literal["image", "compare", "best"]


@dataclass(frozen=True)
class Task:
    """One pair to evaluate.

    Parameters
    ----------
    name : str
        What the pair is called.
    frames : (Path, Path)
        Frame A and frame B as acquired.
    scene : Scene
        What the camera looked through.
    out : Path
        Folder of its results.
    shift_mm : (float, float) or None
        True displacement, x right, y UP; None if it is not known, or not one number for all particles.
    commanded_mm : (float, float) or None
        What was asked of the stage that moved them.
    dt_s : float or None
        Time between the frames, which makes velocities of displacements; None if it is not known.
    note : str
        What a reader must know.
    """

    name: str
    frames: tuple[Path, Path]
    scene: Scene
    out: Path
    shift_mm: tuple[float, float] | None = None
    commanded_mm: tuple[float, float] | None = None
    dt_s: float | None = None
    note: str = ""


@dataclass(frozen=True)
class Tracked:
    """Single particles of a pair: their `vectors`, and r / R (N,) of each behind glass, NaN in the direct view."""

    vectors: PlaneVectors
    radius: NDArray[np.float64]


@short_repr
@dataclass(frozen=True)
class Evaluation:
    """Result of one pair: vectors, figures and small pictures; no frame, no map.

    Parameters
    ----------
    task : Task
        What was asked.
    grid : PlaneGrid
        Nodes of the corrected frames.
    seen : BeforeAfter or None
        Frame A as acquired and corrected, for a page.
    field : VectorField
        Vectors on the corrected image, of the image route unless the better routes were asked for.
    regions : Regions
        Where each belongs.
    shift : ShiftResult or None
        Errors, if the true displacement is known.
    map_sigma : VectorMapSigma or None
        What the fitted scene is unsure of, if its fit lies beside it.
    no_map_sigma : str
        Why `map_sigma` is None.
    traced : PlaneVectors or None
        Vectors of the velocity route, if asked for.
    routes : Routes or None
        Both routes against each other.
    by_velocity : (ny, nx) bool or None
        Vectors of `field` that come from the velocity route.
    settings : PivSettings
        How it was correlated.
    tracks : Tracked or None
        Single particles, if asked for and found.
    no_tracks : str
        Why none were found though they were asked for.
    """

    task: Task
    grid: PlaneGrid
    seen: BeforeAfter | None
    field: VectorField
    regions: Regions
    shift: ShiftResult | None
    map_sigma: VectorMapSigma | None
    no_map_sigma: str
    traced: PlaneVectors | None
    routes: Routes | None
    by_velocity: NDArray[np.bool_] | None
    settings: PivSettings
    tracks: Tracked | None
    no_tracks: str

    def __str__(self) -> str:
        """Its name, and how many vectors are what."""
        counts = ", ".join(f"{count} {name}" for name, count in self.field.counts.items())
        return f"{self.task.name}: {counts}"


def evaluate_task(
    task: Task,
    prepared: PreparedCorrection,
    sigma: SceneSigma | str,
    stage_sigma_um: float,
    route: Route,
    settings: PivSettings | None = None,
    preparation: Preparation | None = None,
    tracking: bool = False,
    pictures: bool = True,
) -> Evaluation:
    """Evaluate one pair.

    Parameters
    ----------
    task : Task
        The pair.
    prepared : PreparedCorrection
        Of the task's scene.
    sigma : SceneSigma or str
        Uncertainty of the fitted scene, or why there is none.
    stage_sigma_um : float
        Standard error of the stage.
    route : {"image", "compare", "best"}
        Image route alone; the velocity route beside it; or each where it is better.
    settings : PivSettings, optional
        Of the correlation.
    preparation : Preparation, optional
        What is done to the corrected frames; two frames have no background.
    tracking : bool
        Also follow single particles from raw frame to raw frame.
    pictures : bool
        Also make what only a page shows: `Evaluation.seen`.

    Raises
    ------
    PairError, FrameError, RunDamaged
        The frames cannot be read, or are no pair.
    """
    settings, preparation = settings or PivSettings(), preparation or Preparation()
    if preparation.background is not None:
        raise PairError(
            f"{preparation.background} needs a series of pairs, and here are single ones; leave it out of prepare"
        )
    scene = task.scene
    frame_a, frame_b = (read_acquired(path, scene.camera.shape) for path in task.frames)
    corrector = prepared.corrector
    grid = corrector.map.grid
    corrected_a, corrected_b = (
        _corrected(corrector, *named) for named in zip(task.frames, (frame_a, frame_b), strict=True)
    )
    ready_a, ready_b = (preparation.finished(each, corrector.recovered) for each in (corrected_a, corrected_b))
    field = evaluate_pair(ready_a, ready_b, corrector.recovered, settings)
    regions = regions_of(field, corrector.map, scene)
    truth = None
    if task.shift_mm is not None:
        truth = (task.shift_mm[0] * grid.px_per_mm, -task.shift_mm[1] * grid.px_per_mm)
    tracks, no_tracks = None, ""
    if tracking:
        try:
            found = track_through_glass(frame_a, frame_b, scene, prepared.ray_map, field, grid)
            tracks = Tracked(found, radius_of(found, corrector.map, scene))
        except PairError as error:
            no_tracks = str(error)
    traced = routes = by_velocity = None
    if route != "image":
        traced = velocity_route(frame_a, frame_b, scene, prepared.ray_map, raw_settings(settings, frame_a.shape))
        routes = compare_routes(field, regions, traced, corrector.map, scene, truth)
        if route == "best":
            field, by_velocity = joined(field, regions, traced, corrector.map, routes)
    stage_px = stage_sigma_um * 1e-3 * grid.px_per_mm
    result = evaluate_shift(field, regions, truth, stage_px) if truth is not None else None
    why = sigma if isinstance(sigma, str) else ""
    unsure = None if isinstance(sigma, str) else vector_map_sigma(field, corrector.map, scene, sigma)
    seen = before_after(frame_a, corrected_a, corrector, scene) if pictures else None
    return Evaluation(
        task, grid, seen, field, regions, result, unsure, why, traced, routes, by_velocity, settings, tracks,
        no_tracks,
    )  # fmt: skip


def _corrected(corrector: Corrector, path: Path, frame: NDArray[Any]) -> NDArray[np.float32]:
    """Correct a frame; what is wrong with it is said with its name."""
    try:
        return corrector(frame)
    except FrameError as error:
        raise FrameError(f"{path}: {error}") from None
