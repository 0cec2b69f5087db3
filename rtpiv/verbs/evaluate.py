"""`rtpiv evaluate`: vectors of pairs seen through glass, with their errors, uncertainty and a page to look at."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Unpack

from rich.console import Console

from correction.fitted.prepared import PreparedCorrection, PreparedCorrections
from correction.fitted.sigma_limit import SigmaLimit
from daq.errors import RunUnsuitable
from daq.frames.source import is_source
from daq.runs.pairs import pairs_of
from daq.runs.run_views import is_run, where_lit
from ground.terminal import console
from piv.errors import PairError, SeriesError
from rtpiv.analysis.pairs.evaluation import Evaluation, Route, Task, evaluate_task
from rtpiv.analysis.pairs.piv_file import PivOptions, piv_choice
from rtpiv.analysis.pictures.apart import drawing
from rtpiv.analysis.report.pair_folder import write_pair
from rtpiv.analysis.series.run_series import SeriesBooks, run_series
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.series_input import SCENE_FILE, SeriesInput, series_input
from rtpiv.analysis.series.series_pairs import is_series
from rtpiv.analysis.series.tasks import Tasks, tasks_of
from rtpiv.options.numbers import Count, DewarpOrder, Positive
from rtpiv.verbs.output import folder_for
from rtpiv.verbs.paths import Named, path_of, paths_of
from rtpiv.verbs.show import show_evaluation, show_series
from tracer.scene.scene_file import load_scene

USUAL = "evaluation"


def evaluate(
    paths: Sequence[Named] | Named,
    /,
    out: Named | None = None,
    scene: Named | None = None,
    target_clear: Named | None = None,
    dewarp_order: DewarpOrder = 2,
    square_mm: Positive | None = None,
    disc_mm: Positive | None = None,
    shift_mm: tuple[float, float] | None = None,
    stage_sigma_um: Positive = 10.0,
    route: Route = "image",
    vtk: bool = False,
    figures: bool = False,
    dt_us: Positive | None = None,
    workers: Count | None = None,
    tracking: bool = False,
    sigma_limit_px: Positive | None = None,
    pictures: bool = True,
    **options: Unpack[PivOptions],
) -> list[Evaluation] | SeriesBooks:
    """Correct pairs of frames and measure their displacements: a page for each, or the series of a flow run.

    A flow run, or a stream of more than ten pairs, becomes a series (`rtpiv.analysis.series`): files of chunks in
    m/s and one page.  The same call goes on where an earlier one stopped.  What only concerns single pairs
    (shift_mm, route, vtk, tracking) is refused for a series, workers for single pairs.

    Parameters
    ----------
    paths : list of path, or path
        Frame A and frame B as acquired; or the folder of a run whose frames form pairs: a shift run, a stream, or
        a flow run; or frames of others in pairs, see `daq.frames.source`.
    out : path, optional
        Folder, default ``evaluation`` (or ``evaluation-2`` ... where that has other results): ``vectors.nc``,
        ``evaluation.json``, ``report.html`` with its figures, and on request ``vectors.vtk``,
        ``vectors_velocity.nc`` and ``tracks.nc``; for a run one such folder a pair.
    scene : path, optional
        scene.yaml, best a fitted one: with the fit's ``fit.npz`` beside it vectors carry the map's uncertainty.
        A run without it is evaluated with the scene that its frames were corrected with.
    target_clear, dewarp_order, square_mm, disc_mm
        As for `correct`.
    shift_mm : (float, float), optional
        True displacement of the particles, x to the right and y UP: errors are stated against it.  For a run
        the displacement measured by the stages is taken.
    stage_sigma_um : float
        Standard error of the stage that moved the sheet, for the error budget.
    route : {"image", "compare", "best"}
        Correct, then correlate; also carry raw vectors through the glass and compare; or take in each region the
        better of both (the scene must hold the camera's true pose; no dewarp).
    vtk : bool
        Also write VTK text.
    figures : bool
        Write every figure as SVG and as PNG, not only as it stands in the page.
    dt_us : float, optional
        Time between the frames of a pair, for frames of others and a run that does not know it: velocities in
        place of displacements.
    workers : int, optional
        Processes that evaluate a series; default one a core.
    tracking : bool
        Also follow single particles through the glass, for seeding too thin for windows (no dewarp).
    sigma_limit_px : float, optional
        Leave out nodes of which the fitted map is less sure; needs the fit beside the scene file.
    pictures : bool
        Write ``report.html``, after all else is written and said.
    **options
        How pairs are correlated, see `rtpiv.analysis.pairs.piv_file.PivOptions`.

    Returns
    -------
    list of Evaluation, or SeriesBooks
        One a pair; or what became of the pairs of a series.

    Raises
    ------
    ConfigError, FrameError, PairError, BoardError, TargetNotFound, DewarpError, RunUnsuitable, RunDamaged
        What the file, the frames, the target or the run make impossible, in one sentence. Of several pairs one
        that cannot be evaluated is named and left out.
    SeriesError, DiskError
        As `rtpiv.analysis.series.run_series`.
    """
    paths = paths_of(paths)
    scene, target_clear = path_of(scene), path_of(target_clear)
    choice = piv_choice(**options)
    run = paths[0] if len(paths) == 1 and (is_run(paths[0]) or is_source(paths[0])) else None
    if run is not None and (not is_run(run) or is_series(run, pairs_of(run))):
        if shift_mm is not None or route != "image" or vtk or tracking:
            raise PairError(
                "--shift-mm, --route, --tracking and --vtk are for single pairs, and this run is a series; leave"
                " them out"
            )
        name = run.resolve().name
        out = folder_for(out, USUAL, lambda folder: holds_series_of(folder, name))
        dewarping = (target_clear, dewarp_order, square_mm, disc_mm)
        series = series_input(run, out, choice, scene, *dewarping, dt_us, sigma_limit_px)
        return _series(name, out, series, workers, figures, pictures)
    if workers is not None:
        raise PairError("--workers belongs to a series of many pairs, and this is none; leave it out")
    if target_clear is not None and (route != "image" or tracking):
        raise PairError(
            f"{'the velocity route' if route != 'image' else 'tracking'} traces raw pixels; give the camera's lens"
            " terms in the scene, no dewarp"
        )
    out = folder_for(out, USUAL)
    given = tasks_of(paths, out, scene, target_clear, dewarp_order, square_mm, disc_mm, shift_mm, dt_us)

    def measured(task: Task, prepared: PreparedCorrection) -> Evaluation:
        evaluation = evaluate_task(
            task,
            prepared,
            given.sigma,
            stage_sigma_um,
            route,
            choice.settings,
            choice.preparation,
            tracking,
            pictures,
        )
        write_pair(evaluation, vtk)
        show_evaluation(screen, evaluation, page=pictures)
        if pictures:
            draw("rtpiv.analysis.report.pair_folder:write_pair_page", evaluation, figures)
        return evaluation

    screen = console()
    with drawing() as draw:
        return _each(screen, given, _limit(given, sigma_limit_px), measured)


def holds_series_of(folder: Path, name: str) -> bool:
    """Whether the series of this run was begun in a folder."""
    try:
        return SeriesFolder(folder).about["run"] == name
    except (RunUnsuitable, SeriesError):
        return False


def _series(
    name: str, out: Path, given: SeriesInput, workers: int | None, figures: bool, pictures: bool
) -> SeriesBooks:
    """Evaluate a series and write its page."""
    books = run_series(name, out, given.given, given.method, workers)
    screen = console()
    show_series(screen, books)
    screen.print(where_lit(load_scene(out / SCENE_FILE)))
    if pictures:
        from rtpiv.analysis.report.series import write_series_page

        write_series_page(out / "report.html", given, books, figures)
    look = f"look at {out / 'report.html'}; " if pictures else ""
    screen.print(f"{look}average with: rtpiv mean {out}")
    return books


def _limit(given: Tasks, limit_px: float | None) -> SigmaLimit | None:
    """What the map must be sure of; PairError where nobody knows how sure it is."""
    if limit_px is None:
        return None
    if isinstance(given.sigma, str):
        raise PairError(f"--sigma-limit needs the uncertainty of the scene: {given.sigma}")
    return SigmaLimit(given.sigma, limit_px)


def _each(
    screen: Console,
    given: Tasks,
    limit: SigmaLimit | None,
    measured: Callable[[Task, PreparedCorrection], Evaluation],
) -> list[Evaluation]:
    """Evaluate one pair after the other; one of several that cannot be is named and left out."""
    if given.alone:
        screen.print(f"{given.alone} frames lost their partner and are in no pair")
    if isinstance(given.sigma, str):
        screen.print(f"no uncertainty of the map: {given.sigma}")
    for note in dict.fromkeys(task.note for task in given.tasks if task.note):
        screen.print(note)
    corrections, found, failed = PreparedCorrections(), [], None
    for task in given.tasks:
        prepared = corrections.of(task.scene, given.dewarp, limit=limit if task.scene.bodies else None)
        try:
            evaluation = measured(task, prepared)
        except PairError as error:
            if len(given.tasks) == 1:
                raise
            failed = error
            screen.print(f"{task.name} is left out: {error}", style="bold red")
            continue
        found.append(evaluation)
    if failed is not None and not found:
        raise failed
    return found
