"""`rtpiv evaluate`: vectors of pairs seen through glass, with their errors, uncertainty and a page to look at."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Unpack

from rich.console import Console

from correction.fitted.map_sigma import SigmaLimit
from correction.fitted.prepared import PreparedCorrections
from daq.errors import RunUnsuitable
from daq.frames.source import is_source
from daq.runs.pairs import pairs_of
from daq.runs.run_views import is_run, where_lit
from ground.terminal import console
from piv.errors import PairError, SeriesError
from piv.preprocessing.preparation import Preparation
from rtpiv.analysis.evaluated import Evaluated
from rtpiv.analysis.pairs.evaluation import Evaluation, PairMethod, Route, Task, evaluate_task
from rtpiv.analysis.pairs.piv_file import PivOptions, piv_choice
from rtpiv.analysis.pictures.apart import Draw, drawing
from rtpiv.analysis.report.pair_folder import write_pair
from rtpiv.analysis.series.clean_frames import make_light
from rtpiv.analysis.series.preview import evaluated_closely
from rtpiv.analysis.series.run_series import SeriesBooks, run_series
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.series_input import SCENE_FILE, SeriesInput, Tasks, series_input, tasks_of
from rtpiv.analysis.series.series_mean import sigma_of
from rtpiv.analysis.series.series_pairs import is_one_series
from rtpiv.analysis.series.series_plan import jobs_of
from rtpiv.options.numbers import Count, DewarpOrder, Positive
from rtpiv.verbs.output import folder_for
from rtpiv.verbs.paths import Named, path_of, paths_of
from rtpiv.verbs.show import show_evaluation, show_series, show_through
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
) -> Evaluated:
    """Correct pairs of frames and measure their displacements, with a page to look at.

    Pairs that are a time apart, one or many, become a series (`rtpiv.analysis.series`): files of chunks and one
    page; the same call goes on where an earlier one stopped.  Two frames, and pairs that a stage moved by a
    measured way, are each evaluated with their errors; so is every pair of a series where that is asked for
    (shift_mm, route, vtk, tracking), into a folder named after it.

    Parameters
    ----------
    paths : list of path, or path
        Frame A and frame B as acquired; or the folder of a run whose frames form pairs: a shift run, a stream, or
        a flow run; or frames of others in pairs, see `daq.frames.source`.
    out : path, optional
        Folder, on the command line by default ``evaluation`` (or ``evaluation-2`` ... where that has other
        results): ``vectors.nc``, ``evaluation.json``, ``report.html`` with its figures, and on request
        ``vectors.vtk``, ``vectors_velocity.nc`` and ``tracks.nc``; for a run one such folder a pair.  Of a series
        ``chunks`` with the vectors and one ``report.html``.
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
        Processes at most, where there is work for several; default one a core.
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
    Evaluated
        Vectors of all pairs, those that have none and why, and what is known of single pairs.

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
    if target_clear is not None and (route != "image" or tracking):
        raise PairError(
            f"{'the velocity route' if route != 'image' else 'tracking'} traces raw pixels; give the camera's lens"
            " terms in the scene, no dewarp"
        )
    run = paths[0] if len(paths) == 1 and (is_run(paths[0]) or is_source(paths[0])) else None
    preparation = choice.preparation or Preparation()
    how = PairMethod("", stage_sigma_um, route, choice.settings, preparation, tracking, pictures)
    screen = console()
    if run is not None and (not is_run(run) or is_one_series(pairs_of(run))):
        name = run.resolve().name
        out = folder_for(out, USUAL, lambda folder: holds_series_of(folder, name))
        dewarping = (target_clear, dewarp_order, square_mm, disc_mm)
        series = series_input(run, out, choice, scene, *dewarping, dt_us, sigma_limit_px, timed=False)
        books = run_series(name, out, series.given, series.method, workers)
        show_series(screen, books)
        show_through(screen, seen := load_scene(out / SCENE_FILE))
        screen.print(where_lit(seen))
        details: list[Evaluation] = []
        failed: dict[str, str] = {}
        if how.asks_more or vtk or shift_mm is not None:
            how = replace(how, sigma=sigma_of(out))
            with drawing() as draw:
                tasks = _closely(series, books, how, shift_mm)
                details, failed = _each(screen, tasks, lambda found: _kept(screen, draw, found, vtk, figures))
        _show_page(screen, series, books, figures, pictures)
        return Evaluated(books.pairs, {**books.failed, **failed}, tuple(details), books.folder, books.kept)
    out = folder_for(out, USUAL)
    given = tasks_of(paths, out, scene, target_clear, dewarp_order, square_mm, disc_mm, shift_mm, dt_us)
    limit = _limit(given, sigma_limit_px)
    if given.alone:
        screen.print(f"{given.alone} frames lost their partner and are in no pair")
    if isinstance(given.sigma, str):
        screen.print(f"no uncertainty of the map: {given.sigma}")
    for note in dict.fromkeys(task.note for task in given.tasks if task.note):
        screen.print(note)
    corrections, how = PreparedCorrections(), replace(how, sigma=given.sigma)

    def measured(task: Task) -> Evaluation:
        prepared = corrections.of(task.scene, given.dewarp, limit=limit if task.scene.bodies else None)
        return evaluate_task(task, prepared, how)

    with drawing() as draw:
        jobs = [(task.name, partial(measured, task)) for task in given.tasks]
        details, failed = _each(screen, jobs, lambda found: _kept(screen, draw, found, vtk, figures))
    return Evaluated(len(given.tasks), failed, tuple(details))


Job = tuple[str, Callable[[], Evaluation]]  # name of a pair, and what evaluates it


def _closely(
    given: SeriesInput, books: SeriesBooks, how: PairMethod, shift_mm: tuple[float, float] | None
) -> list[Job]:
    """What evaluates every pair of a series that has vectors as a pair alone is."""
    pairs, method = given.given.pairs, given.method
    shape = method.scene.camera.shape
    light = make_light(given.out, method.preparation.background, pairs, given.given.unseeded, shape)
    jobs = [(job.pairs[0].tag, job) for job in jobs_of(given.out, pairs, method, light, 1)]
    return [(tag, partial(evaluated_closely, job, how, shift_mm)) for tag, job in jobs if tag not in books.failed]


def _kept(screen: Console, draw: Draw, evaluation: Evaluation, vtk: bool, figures: bool) -> None:
    """Write the folder of a pair, say how well it was measured, and draw its page if it has pictures."""
    write_pair(evaluation, vtk)
    show_evaluation(screen, evaluation, page=evaluation.seen is not None)
    if evaluation.seen is not None:
        draw("rtpiv.analysis.report.pair_folder:write_pair_page", evaluation, figures)


def _each(
    screen: Console, jobs: Sequence[Job], keep: Callable[[Evaluation], None]
) -> tuple[list[Evaluation], dict[str, str]]:
    """Evaluate one pair after the other; one of several that cannot be is named and left out."""
    found: list[Evaluation] = []
    failed: dict[str, str] = {}
    last: PairError | None = None
    for name, measured in jobs:
        try:
            evaluation = measured()
        except PairError as error:
            if len(jobs) == 1:
                raise
            last, failed[name] = error, str(error)
            screen.print(f"{name} is left out: {error}", style="bold red")
            continue
        keep(evaluation)
        found.append(evaluation)
    if last is not None and not found:
        raise last
    return found, failed


def holds_series_of(folder: Path, name: str) -> bool:
    """Whether the series of this run was begun in a folder."""
    try:
        return SeriesFolder(folder).about["run"] == name
    except (RunUnsuitable, SeriesError):
        return False


def _show_page(screen: Console, given: SeriesInput, books: SeriesBooks, figures: bool, pictures: bool) -> None:
    """Write the page of a series, and say where it is and what comes next."""
    out = given.out
    if pictures:
        from rtpiv.analysis.report.series import write_series_page

        write_series_page(out / "report.html", given, books, figures)
    look = f"look at {out / 'report.html'}; " if pictures else ""
    screen.print(f"{look}average with: rtpiv mean {out}" if given.given.timed else look.removesuffix("; "))


def _limit(given: Tasks, limit_px: float | None) -> SigmaLimit | None:
    """What the map must be sure of; PairError where nobody knows how sure it is."""
    if limit_px is None:
        return None
    if isinstance(given.sigma, str):
        raise PairError(f"--sigma-limit needs the uncertainty of the scene: {given.sigma}")
    return SigmaLimit(given.sigma, limit_px)
