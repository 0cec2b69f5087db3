"""`rtpiv evaluate`: vectors of pairs seen through glass, with their errors, uncertainty and a page to look at."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Unpack

from rich.console import Console

from correction.fitted.prepared import PreparedCorrections
from daq.errors import RunUnsuitable
from daq.frames.source import is_source
from daq.runs.pairs import pairs_of
from daq.runs.run_views import is_run, where_lit
from ground.terminal import console
from piv.errors import PairError, SeriesError
from piv.preprocessing.preparation import Preparation
from rtpiv.analysis.pairs.evaluation import Evaluation, PairDetails, PairMethod, Task, evaluate_task
from rtpiv.analysis.pairs.piv_file import PivOptions, piv_choice
from rtpiv.analysis.pictures.apart import Draw, drawing
from rtpiv.analysis.recipe import SCENE_FILE, CorrectionRecipe
from rtpiv.analysis.report.pair_folder import write_pair
from rtpiv.analysis.series.clean_frames import make_light
from rtpiv.analysis.series.evaluated import Evaluated
from rtpiv.analysis.series.preview import evaluated_closely
from rtpiv.analysis.series.run_series import SeriesBooks, run_series
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.series_input import SeriesInput, series_input, tasks_of
from rtpiv.analysis.series.series_mean import sigma_of
from rtpiv.analysis.series.series_pairs import is_one_series
from rtpiv.analysis.series.series_plan import jobs_of
from rtpiv.options.numbers import Count, Positive
from rtpiv.verbs.output import folder_for
from rtpiv.verbs.paths import Named, path_of, paths_of
from rtpiv.verbs.show import show_evaluation, show_series, show_through
from tracer.scene.scene_file import load_scene

USUAL = "evaluation"


@dataclass(frozen=True)
class EvaluationOutput:
    """What is written beside the vectors.

    Parameters
    ----------
    vtk : bool
        Also write VTK text.
    figures : bool
        Write every figure as SVG and as PNG, not only as it stands in the page.
    pictures : bool
        Write ``report.html``, after all else is written and said.
    """

    vtk: bool = False
    figures: bool = False
    pictures: bool = True


def evaluate(
    paths: Sequence[Named] | Named,
    /,
    out: Named | None = None,
    scene: Named | None = None,
    recipe: CorrectionRecipe = CorrectionRecipe(),
    details: PairDetails = PairDetails(),
    output: EvaluationOutput = EvaluationOutput(),
    dt_us: Positive | None = None,
    workers: Count | None = None,
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
    recipe : CorrectionRecipe
        How frames are corrected, as for `correct`.
    details : PairDetails
        What is asked of each pair beyond its vectors.
    output : EvaluationOutput
        What is written beside them.
    dt_us : float, optional
        Time between the frames of a pair, for frames of others and a run that does not know it: velocities in
        place of displacements.
    workers : int, optional
        Processes at most, where there is work for several; default one a core.
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
    paths, scene = paths_of(paths), path_of(scene)
    choice = piv_choice(**options)
    if recipe.target_clear is not None and details.traces_raw_pixels:
        raise PairError(
            f"{details.traces_raw_pixels} traces raw pixels; give the camera's lens terms in the scene, no dewarp"
        )
    run = paths[0] if len(paths) == 1 and (is_run(paths[0]) or is_source(paths[0])) else None
    preparation = choice.preparation or Preparation()
    how = PairMethod("", details, choice.settings, preparation, output.pictures)
    screen = console()
    if run is not None and (not is_run(run) or is_one_series(pairs_of(run))):
        name = run.resolve().name
        out = folder_for(out, USUAL, lambda folder: holds_series_of(folder, name))
        series = series_input(run, out, choice, scene, recipe, dt_us, timed=False)
        books = run_series(name, out, series.given, series.method, workers)
        show_series(screen, books)
        show_through(screen, seen := load_scene(out / SCENE_FILE))
        screen.print(where_lit(seen))
        found: list[Evaluation] = []
        failed: dict[str, str] = {}
        if details.ask_more or output.vtk:
            how = replace(how, sigma=sigma_of(out))
            with drawing() as draw:
                found, failed = _each(screen, _closely(series, books, how), partial(_kept, screen, draw, output))
        _show_page(screen, series, books, output)
        return Evaluated(books.pairs, {**books.failed, **failed}, tuple(found), books.folder, books.kept)
    out = folder_for(out, USUAL)
    given = tasks_of(paths, out, scene, recipe, details.shift_mm, dt_us)
    if given.alone:
        screen.print(f"{given.alone} frames lost their partner and are in no pair")
    if isinstance(given.sigma, str):
        screen.print(f"no uncertainty of the map: {given.sigma}")
    for note in dict.fromkeys(task.note for task in given.tasks if task.note):
        screen.print(note)
    corrections, how = PreparedCorrections(), replace(how, sigma=given.sigma)

    def measured(task: Task) -> Evaluation:
        prepared = corrections.of(task.scene, given.dewarp, limit=given.limit if task.scene.bodies else None)
        return evaluate_task(task, prepared, how)

    with drawing() as draw:
        jobs = [(task.name, partial(measured, task)) for task in given.tasks]
        found, failed = _each(screen, jobs, partial(_kept, screen, draw, output))
    return Evaluated(len(given.tasks), failed, tuple(found))


Job = tuple[str, Callable[[], Evaluation]]  # name of a pair, and what evaluates it


def _closely(given: SeriesInput, books: SeriesBooks, how: PairMethod) -> list[Job]:
    """What evaluates every pair of a series that has vectors as a pair alone is."""
    pairs, method = given.given.pairs, given.method
    shape = method.scene.camera.shape
    light = make_light(given.out, method.preparation.background, pairs, given.given.unseeded, shape)
    jobs = [(job.pairs[0].tag, job) for job in jobs_of(given.out, pairs, method, light, 1)]
    return [(tag, partial(evaluated_closely, job, how)) for tag, job in jobs if tag not in books.failed]


def _kept(screen: Console, draw: Draw, output: EvaluationOutput, evaluation: Evaluation) -> None:
    """Write the folder of a pair, say how well it was measured, and draw its page if it has pictures."""
    write_pair(evaluation, output.vtk)
    show_evaluation(screen, evaluation, page=evaluation.seen is not None)
    if evaluation.seen is not None:
        draw("rtpiv.analysis.report.pair_folder:write_pair_page", evaluation, output.figures)


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


def _show_page(screen: Console, given: SeriesInput, books: SeriesBooks, output: EvaluationOutput) -> None:
    """Write the page of a series, and say where it is and what comes next."""
    out = given.out
    if output.pictures:
        from rtpiv.analysis.report.series import write_series_page

        write_series_page(out / "report.html", given, books, output.figures)
    look = f"look at {out / 'report.html'}; " if output.pictures else ""
    screen.print(f"{look}average with: rtpiv mean {out}" if given.given.timed else look.removesuffix("; "))
