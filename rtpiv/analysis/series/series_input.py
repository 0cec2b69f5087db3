"""Input of an evaluation from the named paths: the series of a run, or single pairs.

A series needs pairs, scene, dewarp and settings, and its folder keeps a copy of the scene.  Two frames, and pairs
that a stage moved, are tasks, each with what it was seen through and the displacement that is known of it.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from correction.fitted.map_sigma import SigmaLimit
from correction.fitted.scene_sigma import SceneSigma
from correction.maps.dewarp import Dewarp
from daq.atomic_write import OTHER_FOLDER, copy_whole, disk_errors, write_text
from daq.errors import RunUnsuitable
from daq.frames.likeness import require_pairs
from daq.frames.numbered_files import MOST_NAMED, FoundFiles, first_pairs
from daq.frames.source import FrameSource, is_source, source_of
from daq.runs.acquired import read_acquired
from daq.runs.glass_place import with_glass_at
from daq.runs.names import is_run
from daq.runs.pairs import FramePair, RunPairs, pairs_of
from daq.runs.run_views import length_unit, scene_file, shows_light_sheet, where_lit
from ground.plain_words import quantity
from ground.printable import readable_name
from ground.terminal import console
from piv.errors import PairError, SeriesError
from piv.files.frame_file import stem_of
from piv.preprocessing.preparation import SLIDING_MINIMUM, Preparation
from rtpiv.analysis.fit_beside import FIT_FILE, SCENE_FILE, scene_sigma_beside
from rtpiv.analysis.pairs.evaluation import Task
from rtpiv.analysis.pairs.piv_file import PivChoice
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.analysis.series.chunk import correction_of
from rtpiv.analysis.series.clean_frames import make_light
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.series_pairs import PairsOfSeries, dt_of, pairs_of_series, pairs_of_source
from rtpiv.analysis.series.series_plan import ChunkJob, Method, jobs_of, usual_chunk
from rtpiv.analysis.series.shared_file import SharedFile
from rtpiv.analysis.series.still_frames import make_still
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene, load_scene

SCALE_KNOWN = "a run knows what its pixels show; leave --mm-per-px out"
IN_PLANE_MM = 0.01  # a sheet moved farther out of its plane shows no uniform displacement


@dataclass(frozen=True)
class Tasks:
    """Pairs to evaluate.

    Parameters
    ----------
    tasks : tuple of Task
        One a pair.
    dewarp : Dewarp or None
        Of the camera, if a bare target was given.
    sigma : SceneSigma or str
        Uncertainty of the scene, or why there is none.
    limit : SigmaLimit or None
        Largest accepted uncertainty of the map.
    alone : int
        Frames of the run whose partner was lost.
    """

    tasks: tuple[Task, ...]
    dewarp: Dewarp | None
    sigma: SceneSigma | str
    limit: SigmaLimit | None
    alone: int


def tasks_of(
    paths: list[Path],
    out: Path,
    scene: Path | None = None,
    recipe: CorrectionRecipe = CorrectionRecipe(),
    shift_mm: tuple[float, float] | None = None,
    dt_us: float | None = None,
) -> Tasks:
    """Collect what is to be evaluated, and read every frame once: a damaged one is found now, not after an hour.

    Parameters
    ----------
    paths, out, scene, recipe, dt_us
        As for the verb `evaluate`.
    shift_mm : (float, float), optional
        True displacement of the particles, x to the right and y UP.

    Raises
    ------
    PairError
        Neither two frames with a scene nor one run; or the run holds no pair, or has no or another time between
        its frames.
    MapUsageError
        The map is to be surer than a limit, and there is no fit beside the scene that would know.
    ConfigError, FrameError, BoardError, TargetNotFound, DewarpError, RunUnsuitable, RunDamaged
        What scene, frames, target or run make impossible.
    """
    run = paths[0] if len(paths) == 1 and is_run(paths[0]) else None
    if run is None and len(paths) == 2:
        scene = recipe.scene_of(scene, paths[0], out)
    if run is None and len(paths) == 1:
        source_of(paths[0])  # an error that says why it is none
    if run is None and len(paths) != 2:
        raise PairError(
            f"give two frames, or one folder of a run or of frames in pairs, not {len(paths)}; a pattern with *"
            " needs quotes"
        )
    if run is not None and recipe.mm_per_px is not None:
        raise PairError(SCALE_KNOWN, place=run)
    given = pairs_of(run) if run is not None else RunPairs((), ())
    kept = tuple(_with_time(run, pair, dt_us) for pair in given.pairs if not pair.is_background)
    given = replace(given, pairs=kept)
    if scene is None:
        scene = scene_file(paths[0], out)
    fitted = recipe.apply_mask(load_scene(scene))
    dewarp = recipe.dewarp(fitted.camera, recipe.board(paths))
    frames = [path for pair in given.pairs for path in pair.frames] or paths
    lit = shift_mm is None and shows_light_sheet(frames)  # moved by a known way: a print on the target's stage
    seen = fitted.in_light_sheet() if lit else fitted
    tasks = [
        replace(_task(pair, seen, out), readings=given.statistics_during([pair])) for pair in given.pairs
    ] or [_two_frames(paths, seen, out, shift_mm, dt_us)]
    if lit:
        tasks = [replace(task, note=where_lit(fitted)) for task in tasks]
    for path in frames:
        read_acquired(path, fitted.camera.shape)
    sigma = scene_sigma_beside(scene, fitted, dewarp is not None, in_light_sheet=lit)
    return Tasks(tuple(tasks), dewarp, sigma, recipe.limit(sigma), len(given.alone))


def _two_frames(
    paths: list[Path], scene: Scene, out: Path, shift_mm: tuple[float, float] | None, dt_us: float | None
) -> Task:
    """Task of two frames."""
    first, second = paths
    dt_s = None if dt_us is None or length_unit(scene) == "px" else 1e-6 * dt_us
    return Task(f"{stem_of(first)}, {stem_of(second)}", (first, second), scene, out, shift_mm, dt_s=dt_s)


def _with_time(run: Path | None, pair: FramePair, dt_us: float | None) -> FramePair:
    """The pair of a run with the time between its frames, as known or as given."""
    if dt_us is None or run is None:
        return pair
    if pair.measured_mm is not None:
        raise PairError(
            f"{run}: a stage moved its particles, so there is no time between frames; leave --dt-us out"
        )
    return replace(pair, dt_s=dt_of(run, pair, dt_us))


def _task(pair: FramePair, scene: Scene, out: Path) -> Task:
    """Task of a pair of a run."""
    task = Task(pair.tag, pair.frames, scene if pair.glass else scene.bare(), out / pair.tag, dt_s=pair.dt_s)
    if pair.measured_mm is None or pair.commanded_mm is None:
        return task
    x, y, z = pair.measured_mm
    task = replace(task, commanded_mm=pair.commanded_mm[:2])
    if abs(z) > IN_PLANE_MM:
        return replace(task, note=f"moved by {z:+.3f} mm along z: no one displacement is true for all vectors.")
    return replace(task, shift_mm=(x, y), shift_sigma_mm=pair.sigma_mm)


@dataclass(frozen=True)
class SeriesInput:
    """A series that can be evaluated.

    Parameters
    ----------
    run : Path
        The run.
    out : Path
        Folder of the series.
    given : PairsOfSeries
        Its pairs.
    method : Method
        How each is evaluated.
    least_valid : float
        Share of windows with valid vectors, median of the pairs, below which the series is an error.
    """

    run: Path
    out: Path
    given: PairsOfSeries
    method: Method
    least_valid: float = 0.0

    @property
    def name(self) -> str:
        """Of the run."""
        return readable_name(self.run)

    def light(self) -> SharedFile | None:
        """The background of the whole series, made if it is not there yet; raises as `make_light`."""
        background, shape = self.method.preparation.background, self.method.scene.camera.shape
        return make_light(self.out, background, self.given.pairs, self.given.unseeded, shape)

    def still(self) -> SharedFile:
        """The light that stands still in all pairs, looked for if that is not done yet; raises as `make_still`."""
        corrector = correction_of(self.out / "maps", self.method).corrector
        return make_still(self.out, self.given.pairs, self.method, corrector)

    @property
    def chunk(self) -> int:
        """Pairs of a chunk: as those in the folder are cut, so that they are kept, else `usual_chunk`."""
        try:
            cut = SeriesFolder(self.out).about["chunk_pairs"]
        except (RunUnsuitable, SeriesError):
            cut = 0
        return cut if cut.bit_count() == 1 else usual_chunk(len(self.given.pairs), self.method)

    def jobs(self, chunk: int | None = None) -> list[ChunkJob]:
        """Cut it into chunks of `chunk` pairs, a power of two, with the light that they share."""
        cut = chunk or self.chunk
        return jobs_of(self.out, self.given.pairs, self.method, self.light(), cut, self.still())


def series_input(
    run: Path,
    out: Path,
    choice: PivChoice,
    scene: Path | None = None,
    recipe: CorrectionRecipe = CorrectionRecipe(),
    dt_us: float | None = None,
    timed: bool = True,
) -> SeriesInput:
    """Collect what the series of a run needs.

    Parameters
    ----------
    run : Path
        A flow run, or a stream with a group; or external frames, see `daq.frames.source`.
    out : Path
        Folder of the series.
    choice : PivChoice
        How pairs are evaluated; unless it says otherwise, a sliding minimum is taken off.
    scene, recipe, dt_us
        As for the verb `evaluate`.
    timed : bool
        Refuse pairs whose frames are an unknown time apart; else these have displacements in mm.

    Raises
    ------
    MapUsageError
        There is no fit beside the scene that would know the sigma of the map.
    PairError, ConfigError, FrameError, BoardError, TargetNotFound, DewarpError, RunUnsuitable, RunDamaged
        What pairs, scene, target or run make impossible.
    DiskError
        The folder cannot be written to.
    """
    foreign = not is_run(run) and is_source(run)
    if foreign:
        source = source_of(run)
        _announce(run, source)
        scene = recipe.scene_of(scene, source.pairs()[0][1], out)
    elif recipe.mm_per_px is not None:
        raise PairError(SCALE_KNOWN, place=run)
    given = None if foreign else pairs_of_series(run, pairs_of(run), dt_us, timed)
    with disk_errors(out, OTHER_FOLDER):
        out.mkdir(parents=True, exist_ok=True)
    scene = scene or scene_file(run, out)
    fitted = recipe.apply_mask(load_scene(scene))
    in_mm = length_unit(fitted) == "mm"  # a time makes no velocities of pixels
    given = given or pairs_of_source(run, out, fitted.camera.shape, dt_us if in_mm else None)
    dewarp = recipe.dewarp(fitted.camera, recipe.board([run]))
    keep_scene(scene, out, fitted)
    usual = Preparation((SLIDING_MINIMUM,) if given.usual_background else ())
    standing = with_glass_at(fitted, given.glass_place_mm) if given.glass else fitted.bare()
    through = standing.in_light_sheet()
    limit = None
    if recipe.sigma_limit_px is not None:  # glass that a stage has carried on is known as well as where it was
        limit = recipe.limit(scene_sigma_beside(scene, fitted, dewarp is not None, in_light_sheet=False))
    if limit is not None:
        seen = limit.sigma.in_light_sheet(standing)
        limit = replace(limit, sigma=replace(seen, scene_hash=through.content_hash()))
    settings = replace(choice.settings, drop_uncertain=False)
    method = Method(through, dewarp, settings, choice.preparation or usual, limit)
    method = replace(method, out_of_plane=choice.out_of_plane)
    return SeriesInput(run, out, given, method, choice.least_valid)


def _announce(run: Path, source: FrameSource) -> None:
    """Name the first pairs, and what is in none, before anything is computed; PairError as `require_pairs`."""
    files = source if isinstance(source, FoundFiles) else FoundFiles()
    if files.is_sequence:
        require_pairs(run, source.pairs())
    said = [first_pairs(source.pairs())]
    if source.count_unpaired():
        said.append(f"{quantity(source.count_unpaired(), 'frame')} without a partner, in no pair")
    if files.missing:
        where = ", ".join(f"between {before} and {after}" for before, after in files.gaps[:MOST_NAMED])
        more = ", ..." if len(files.gaps) > MOST_NAMED else ""
        said.append(f"{quantity(files.missing, 'frame')} missing by number, {where}{more}; in no pair")
    if files.set_aside:
        said.append(f"set aside: {', '.join(files.set_aside[:MOST_NAMED])}")
    console().print("; ".join(said), soft_wrap=True, highlight=False)


def keep_scene(scene: Path, out: Path, loaded: Scene | None = None) -> None:
    """Copy a scene file, and what its fit is unsure of, into the folder of a series.

    Parameters
    ----------
    scene : Path
        The file.
    out : Path
        The folder.
    loaded : Scene, optional
        The scene, where more is left out of it than the file says.

    Raises
    ------
    DiskError
        It cannot be written.
    """
    loaded = loaded or load_scene(scene)
    if loaded.left_out:  # by pictures perhaps, that stand elsewhere
        write_text(out / SCENE_FILE, dump_scene(loaded))
    elif scene != out / SCENE_FILE:
        copy_whole(scene, out / SCENE_FILE)
    if scene.with_name(FIT_FILE).is_file():
        copy_whole(scene.with_name(FIT_FILE), out / FIT_FILE)
    else:
        (out / FIT_FILE).unlink(missing_ok=True)  # of another scene
