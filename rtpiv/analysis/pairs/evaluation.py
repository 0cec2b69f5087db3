"""One pair from frames to figures: correct, correlate, carry the map's uncertainty along, compare with truth."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field as made_by
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.evaluate.particle_tracks import PlaneVectors, track_radius, track_through_glass
from correction.evaluate.regions import Regions, ShiftResult, evaluate_shift, regions_of
from correction.fitted.map_sigma import VectorMapSigma, vector_map_sigma
from correction.fitted.prepared import PreparedCorrection
from correction.fitted.scene_sigma import SceneSigma
from correction.grid import PlaneGrid
from correction.maps.corrector import Corrector
from daq.runs.acquired import full_scale, read_acquired
from daq.runs.lab_readings import Shown, readings_attribute
from ground.short_repr import short_repr
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorField
from piv.errors import FrameError, PairError
from piv.files.vector_file import Vectors
from piv.preprocessing.preparation import Preparation
from piv.preprocessing.still_light import still_light
from piv.statistics.out_of_plane import NOTHING_TOLD, OutOfPlane
from rtpiv.analysis.pairs.pair_vectors import PairResult, lengths_said, per_px, quality_of, vectors_of_pairs
from rtpiv.analysis.pairs.plausible import scale_warnings
from rtpiv.analysis.pairs.slanted import Slanted, perspective_error
from rtpiv.analysis.pictures.before_after import BeforeAfter, before_after
from rtpiv.options.numbers import Positive
from tracer.scene.scene import Scene

IMAGE_ROUTE = "image"


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
    shift_sigma_mm : (float or None, ...) or None
        Its standard deviation along x and y where hands moved the particles; None for what a motor moved.
    commanded_mm : (float, float) or None
        What was asked of the stage that moved them.
    dt_s : float or None
        Time between the frames, which makes velocities of displacements; None if it is not known.
    note : str
        What a reader must know.
    readings : mapping of str to Shown
        What gauges of the lab showed over the steps of its frames, by their names.
    """

    name: str
    frames: tuple[Path, Path]
    scene: Scene
    out: Path
    shift_mm: tuple[float, float] | None = None
    shift_sigma_mm: tuple[float | None, ...] | None = None
    commanded_mm: tuple[float, float] | None = None
    dt_s: float | None = None
    note: str = ""
    readings: Mapping[str, Shown] = made_by(default_factory=dict)


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
        Vectors on the corrected image.
    regions : Regions
        Where each belongs.
    shift : ShiftResult or None
        Errors, if the true displacement is known.
    map_sigma : VectorMapSigma or None
        What the fitted scene is unsure of, if its fit lies beside it.
    no_map_sigma : str
        Why `map_sigma` is None.
    settings : PivSettings
        How it was correlated.
    tracks : Tracked or None
        Single particles, if asked for and found.
    no_tracks : str
        Why none were found though they were asked for.
    slant : Slanted or None
        What a flow through the sheet may have made of the vectors; None if they were moved by a known way.
    """

    task: Task
    grid: PlaneGrid
    seen: BeforeAfter | None
    field: VectorField
    regions: Regions
    shift: ShiftResult | None
    map_sigma: VectorMapSigma | None
    no_map_sigma: str
    settings: PivSettings
    tracks: Tracked | None
    no_tracks: str
    slant: Slanted | None = None

    @property
    def about(self) -> dict[str, str]:
        """Provenance, as attributes of files."""
        frames = ", ".join(path.name for path in self.task.frames)
        said = {"scene_hash": self.task.scene.content_hash(), "frames": frames, "rtpiv_version": version("rtpiv")}
        said |= readings_attribute(self.task.readings) | lengths_said(self.task.scene)
        return said if self.slant is None else {**said, "out_of_plane": self.slant.said}

    @property
    def sigma_parts_px(self) -> dict[str, NDArray[np.float64]]:
        """Known parts (ny, nx, 2) of the standard uncertainty of u and v, by what they come from.

        Particles that were moved by a known way, all by the same, have no detail that windows could miss.
        """
        random = np.stack((self.field.sigma_u_px, self.field.sigma_v_px), axis=-1)
        unresolved = None if self.shift is not None else self.field.resolution_px
        parts = {
            "random sigma": random,
            "not resolved by the windows": None if unresolved is None else np.stack((unresolved,) * 2, axis=-1),
            "sigma by the fitted map": None if self.map_sigma is None else self.map_sigma.displacement_px,
            "sigma by the flow through the sheet": None if self.slant is None else self.slant.sigma_px,
        }
        return {name: part for name, part in parts.items() if part is not None}

    @property
    def total_sigma_px(self) -> NDArray[np.float64]:
        """Standard uncertainty (ny, nx, 2) of u and v by all that is known; of files, pages and verdicts."""
        return _root_sum_square(list(self.sigma_parts_px.values()))

    @property
    def relative_sigma_px(self) -> NDArray[np.float64]:
        """Standard uncertainty (ny, nx, 2) of u and v against their medians: without what the map shifts alike."""
        parts = self.sigma_parts_px
        if self.map_sigma is not None:
            parts["sigma by the fitted map"] = self.map_sigma.relative_px
        return _root_sum_square(list(parts.values()))

    @property
    def scale_warnings(self) -> tuple[str, ...]:
        """Sentences that ask whether scale and time are right, where the vectors are not plausible."""
        moved_px = np.hypot(self.field.u_px, self.field.v_px)[self.field.valid]
        speed = 0.0
        if moved_px.size and self.task.dt_s is not None:
            speed = float(np.median(moved_px)) * per_px(self.grid.pitch_mm, self.task.dt_s)
        return scale_warnings(speed, self.task.scene.camera.sensor_px[0], self.grid.pitch_mm)

    @property
    def vectors(self) -> Vectors:
        """The pair as a series of one, with all that is known of its quality."""
        task, field, settings = self.task, self.field, self.settings
        windows = settings.result_grid(self.grid.shape)
        more = quality_of(field, self.grid, self.total_sigma_px, self.map_sigma, task.dt_s, self.slant)
        slope = None if self.slant is None else self.slant.through.slope
        result = PairResult(task.name, field, task.dt_s)
        return vectors_of_pairs([result], windows, self.grid, self.about, more, slope)

    def _repr_html_(self) -> str:
        """Show a notebook its name, and its vectors."""
        return f"<p>{escape(str(self))}</p>{self.vectors._repr_html_()}"

    def __str__(self) -> str:
        """Its name, and how many vectors are what."""
        counts = ", ".join(f"{count} {name}" for name, count in self.field.counts.items())
        return f"{self.task.name}: {counts}"


@dataclass(frozen=True)
class PairDetails:
    """Requests for each pair beyond its vectors.

    Parameters
    ----------
    shift_mm : (float, float), optional
        True displacement of the particles, x to the right and y UP, from which errors are computed.  Default for a
        run: the displacement measured by the stages.
    stage_sigma_um : float
        Standard uncertainty of the position of the motor that moved the printed particles, for the error budget.
        For an axis moved by hand the bench file gives the reading uncertainty of its scale.
    route : str
        Deprecated: "image", as frames are always corrected before they are correlated.
    tracking : bool
        Also track single particles through the glass, for seeding too sparse for windows (without dewarp).
    """

    shift_mm: tuple[float, float] | None = None
    stage_sigma_um: Positive = 10.0
    route: str = IMAGE_ROUTE
    tracking: bool = False

    def __post_init__(self) -> None:
        if self.route != IMAGE_ROUTE:
            raise PairError(
                f"route {self.route}: the velocity route was removed (the image route is better in every region)",
                cure="leave route out",
            )

    @property
    def ask_more(self) -> bool:
        """Return whether any of them is requested."""
        return self != PairDetails(stage_sigma_um=self.stage_sigma_um)


@dataclass(frozen=True)
class PairMethod:
    """Settings of the evaluation of a pair, and requests beyond its vectors.

    Parameters
    ----------
    sigma : SceneSigma or str
        Uncertainty of the fitted scene, or why there is none.
    details : PairDetails
        What is asked beyond vectors; the true displacement is that of the pair's task.
    settings : PivSettings, optional
        Of the correlation.
    preparation : Preparation, optional
        What is done to the corrected frames; two frames have no background.
    pictures : bool
        Also make what only a page shows: `Evaluation.seen`.
    out_of_plane : OutOfPlane
        What is known of the velocity through the sheet.
    """

    sigma: SceneSigma | str
    details: PairDetails = PairDetails()
    settings: PivSettings = made_by(default_factory=PivSettings)
    preparation: Preparation = made_by(default_factory=Preparation)
    pictures: bool = True
    out_of_plane: OutOfPlane = NOTHING_TOLD


@dataclass(frozen=True, eq=False)
class Correlated:
    """A pair as it was correlated.

    Parameters
    ----------
    raw : (ndarray, ndarray)
        Its frames as acquired, of a series without their background.
    first : (h, w) float32
        Frame A corrected.
    field : VectorField
        Vectors of the corrected frames.
    """

    raw: tuple[NDArray[Any], NDArray[Any]]
    first: NDArray[np.float32]
    field: VectorField


def correlate_pair(
    raw: tuple[NDArray[Any], NDArray[Any]],
    corrected: tuple[NDArray[np.float32], NDArray[np.float32]],
    prepared: PreparedCorrection,
    settings: PivSettings,
    preparation: Preparation,
    still: NDArray[np.bool_] | None = None,
) -> Correlated:
    """Correlate a pair of frames corrected as `prepared`; PairError or FrameError if they are no pair.

    `still` (h, w) is what others have found of light that stands still; without it these frames show it, as they
    are before any step that brings light to one height.
    """
    seen = prepared.corrector.recovered
    if still is None and preparation.steps:
        found = still_light([corrected], seen & np.isfinite(corrected[0]) & np.isfinite(corrected[1]))
        still = np.zeros(seen.shape, bool) if found is None else found
    ready_a, ready_b = (preparation.apply(each, seen) for each in corrected)
    field = evaluate_pair(ready_a, ready_b, seen, settings, still=still)
    if prepared.height_change is not None:
        windows = settings.result_grid(seen.shape)
        field = prepared.height_change.remove_from(field, windows, settings.window_sigma)
    return Correlated(raw, corrected[0], field)


def evaluate_task(task: Task, prepared: PreparedCorrection, how: PairMethod) -> Evaluation:
    """Evaluate one pair: read, correct, correlate, and what is asked beyond that.

    Parameters
    ----------
    task : Task
        The pair.
    prepared : PreparedCorrection
        Of the task's scene.
    how : PairMethod
        How.

    Returns
    -------
    Evaluation
        Vectors, figures and small pictures.

    Raises
    ------
    PairError, FrameError, RunDamaged
        The frames cannot be read, or are no pair.
    """
    if how.preparation.background is not None:
        raise PairError(
            f"{how.preparation.background} needs a series of pairs, and here are single ones; leave it out of"
            " prepare"
        )
    corrector = prepared.corrector
    frame_a, frame_b = (read_acquired(path, task.scene.camera.shape) for path in task.frames)
    path_a, path_b = task.frames
    corrected = _correct_frame(corrector, path_a, frame_a), _correct_frame(corrector, path_b, frame_b)
    pair = correlate_pair((frame_a, frame_b), corrected, prepared, how.settings, how.preparation)
    return evaluate_correlated(task, prepared, how, pair)


def evaluate_correlated(task: Task, prepared: PreparedCorrection, how: PairMethod, pair: Correlated) -> Evaluation:
    """Say all that is asked of a pair which is correlated: errors, sigma of the map, tracks.

    Parameters
    ----------
    task : Task
        The pair.
    prepared : PreparedCorrection
        Of the task's scene.
    how : PairMethod
        How it was correlate_pair, and what is asked.
    pair : Correlated
        Its frames and vectors.
    """
    scene, settings, sigma, asked = task.scene, how.settings, how.sigma, how.details
    (frame_a, frame_b), field = pair.raw, pair.field
    corrector = prepared.corrector
    grid = corrector.map.grid
    regions = regions_of(field, corrector.map, scene)
    truth = None
    if task.shift_mm is not None:
        truth = (task.shift_mm[0] * grid.px_per_mm, -task.shift_mm[1] * grid.px_per_mm)
    tracks, no_tracks = None, ""
    if asked.tracking:
        try:
            found = track_through_glass(frame_a, frame_b, scene, prepared.ray_map, field, grid)
            tracks = Tracked(found, track_radius(found, corrector.map, scene))
        except PairError as error:
            no_tracks = str(error)
    stage_px = _stage_px(task, asked.stage_sigma_um, grid.px_per_mm)
    result = evaluate_shift(field, regions, truth, stage_px) if truth is not None else None
    why = sigma if isinstance(sigma, str) else ""
    unsure = None if isinstance(sigma, str) else vector_map_sigma(field, corrector.map, scene, sigma)
    slant = None
    if truth is None:
        slant = perspective_error(field, corrector.map, scene, settings, how.out_of_plane, task.dt_s)
    seen = None
    if how.pictures:
        seen = before_after(frame_a, pair.first, corrector, scene, full_scale(task.frames[0], frame_a))
    return Evaluation(task, grid, seen, field, regions, result, unsure, why, settings, tracks, no_tracks, slant)


def _root_sum_square(parts: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Root of the sum of squares of parts (ny, nx, 2) of an uncertainty; NaN where the first, random one is."""
    total = np.sqrt(np.square(np.nan_to_num(parts)).sum(axis=0))
    return np.where(np.isnan(parts[0]), np.nan, total)


def _stage_px(task: Task, motor_um: float, px_per_mm: float) -> tuple[float, float]:
    """Standard error of one position along u and v [px]: of the motor, or of a hand's reading."""
    x, y, *_ = task.shift_sigma_mm or (None, None)
    along_x, along_y = (motor_um * 1e-3 if way is None else way / math.sqrt(2.0) for way in (x, y))
    return along_x * px_per_mm, along_y * px_per_mm


def _correct_frame(corrector: Corrector, path: Path, frame: NDArray[Any]) -> NDArray[np.float32]:
    """Correct a frame; what is wrong with it is said with its name."""
    try:
        return corrector(frame)
    except FrameError as error:
        raise FrameError(f"{path}: {error}") from None
