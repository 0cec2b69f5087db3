"""From a run to what its series needs: pairs, scene, dewarp, settings; the folder keeps a copy of the scene."""

from dataclasses import dataclass, replace
from pathlib import Path

from daq.atomic_write import copy_whole, why
from daq.errors import DiskError
from daq.frames.source import is_source
from daq.runs.glass_place import with_glass_at
from daq.runs.pairs import pairs_of
from daq.runs.run_views import board_of, dewarp_of, is_run, scene_file
from piv.errors import PairError
from piv.preprocessing.preparation import SLIDING_MINIMUM, Preparation
from rtpiv.analysis.pairs.piv_file import PivChoice
from rtpiv.analysis.series.series_pairs import PairsOfSeries, pairs_of_series, pairs_of_source
from rtpiv.analysis.series.series_plan import Method
from rtpiv.analysis.series.tasks import FIT_FILE, sigma_limit
from tracer.scene.scene_file import load_scene

SCENE_FILE = "scene.yaml"


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
    """

    run: Path
    out: Path
    given: PairsOfSeries
    method: Method


def series_input(
    run: Path,
    out: Path,
    choice: PivChoice,
    scene: Path | None = None,
    target_clear: Path | None = None,
    dewarp_order: int = 2,
    square_mm: float | None = None,
    disc_mm: float | None = None,
    dt_us: float | None = None,
    sigma_limit_px: float | None = None,
    timed: bool = True,
) -> SeriesInput:
    """Collect what the series of a run needs.

    Parameters
    ----------
    run : Path
        A flow run, or a stream with a group; or frames of others, see `daq.frames.source`.
    out : Path
        Folder of the series.
    choice : PivChoice
        How pairs are evaluated; unless it says otherwise, a sliding minimum is taken off.
    scene, target_clear, dewarp_order, square_mm, disc_mm, dt_us, sigma_limit_px
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
    if foreign and scene is None:
        raise PairError(f"{run}: what its camera looked through is not known; give --scene")
    given = None if foreign else pairs_of_series(run, pairs_of(run), dt_us, timed)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DiskError(f"{out}: {why(error)}; choose another folder with -o") from error
    scene = scene or scene_file(run, out)
    fitted = load_scene(scene)
    given = given or pairs_of_source(run, out, fitted.camera.shape, dt_us, timed)
    board = board_of([run, *([] if target_clear is None else [target_clear])], square_mm, disc_mm)
    dewarp = dewarp_of(target_clear, fitted.camera, board, dewarp_order)
    keep_scene(scene, out)
    usual = Preparation((SLIDING_MINIMUM,) if given.usual_background else ())
    standing = with_glass_at(fitted, given.glass_place_mm) if given.glass else fitted.bare()
    through = standing.in_light_sheet()
    limit = None
    if sigma_limit_px is not None:  # glass that a stage has carried on is known as well as where it was fitted
        limit = sigma_limit(scene, fitted, dewarp is not None, sigma_limit_px, in_light_sheet=False)
        seen = limit.sigma.in_light_sheet(standing)
        limit = replace(limit, sigma=replace(seen, scene_hash=through.content_hash()))
    method = Method(through, dewarp, choice.settings, choice.preparation or usual, limit)
    return SeriesInput(run, out, given, method)


def keep_scene(scene: Path, out: Path) -> None:
    """Copy a scene file, and what its fit is unsure of, into the folder of a series; DiskError if that fails."""
    copy_whole(scene, out / SCENE_FILE)
    if scene.with_name(FIT_FILE).is_file():
        copy_whole(scene.with_name(FIT_FILE), out / FIT_FILE)
    else:
        (out / FIT_FILE).unlink(missing_ok=True)  # of another scene
