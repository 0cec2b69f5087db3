"""`rtpiv evaluate`: evaluate image pairs: vectors, uncertainties and a page."""

import json
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Unpack

from rich.console import Console

from correction.fitted.prepared import PreparedCorrections
from daq.errors import RunUnsuitable
from daq.frames.source import is_source
from daq.runs.names import is_run
from daq.runs.pairs import pairs_of
from daq.runs.run_views import tells_a_scale_alone, where_lit
from ground.plain_file import read_plain
from ground.printable import readable_name
from ground.terminal import console
from piv.errors import PairError, SeriesError
from piv.preprocessing.preparation import Preparation
from rtpiv.analysis.fit_beside import FIT_FILE, SCENE_FILE
from rtpiv.analysis.pairs.evaluation import Evaluation, PairDetails, PairMethod, Task, evaluate_task
from rtpiv.analysis.pairs.piv_file import PivOptions, piv_choice
from rtpiv.analysis.pictures.drawing_process import Draw, drawing
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.analysis.report.pair_folder import frame_names, write_pair
from rtpiv.analysis.series.chunk import Detailed
from rtpiv.analysis.series.run_series import Evaluated, run_series
from rtpiv.analysis.series.series_folder import SeriesFolder
from rtpiv.analysis.series.series_input import SeriesInput, series_input, tasks_of
from rtpiv.analysis.series.series_pairs import is_one_series
from rtpiv.options.numbers import Count, Positive
from rtpiv.verbs.paths import Named, path_of, paths_of
from rtpiv.verbs.results import results_in
from rtpiv.verbs.show import show_evaluation, show_series, show_through
from tracer.scene.scene_file import load_scene

USUAL = "evaluation"
MAX_SUMMARY_BYTES = 100_000_000  # of evaluation.json
COPIES = (SCENE_FILE, FIT_FILE)  # of what was given, beside results


@dataclass(frozen=True)
class EvaluationOutput:
    """Files beside the vectors.

    Parameters
    ----------
    vtk : bool
        Also write VTK text.
    figures : bool
        Write every figure as SVG and PNG files too.
    pictures : bool
        Write ``report.html``.
    overwrite : bool
        Overwrite vectors of other frames in the given folder.
    """

    vtk: bool = False
    figures: bool = False
    pictures: bool = True
    overwrite: bool = False


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
    """Correct pairs of frames and measure their displacements.

    Pairs that are a time apart, one or many, become a series (`rtpiv.analysis.series`): files of chunks and one
    page; the same call resumes an interrupted one.  Two frames, and pairs that a stage moved by a
    measured way, are each evaluated with their errors; so is every pair of a series on request
    (shift_mm, vtk, tracking), into a folder named after it.

    Parameters
    ----------
    paths : list of path, or path
        Frame A and frame B as acquired; or the folder of a run whose frames form pairs: a shift run, a stream, or
        a flow run; or external image pairs: a folder, a pattern in quotes, a stack, a video.
    out : path, optional
        Folder, on the command line by default ``evaluation`` (or ``evaluation-2`` ... where that has other
        results): ``vectors.nc``, ``evaluation.json``, ``report.html`` with its figures, and on request
        ``vectors.vtk`` and ``tracks.nc``; for a run one such folder a pair.  Of a series
        ``chunks`` with the vectors and one ``report.html``.
    scene : path, optional
        scene.yaml, best a fitted one: with the fit's ``fit.npz`` beside it vectors carry the map's uncertainty.
        Default for a run: the scene that its frames were corrected with.
    recipe : CorrectionRecipe
        Correction of frames, as for `correct`.
    details : PairDetails
        Further evaluation of each pair.
    output : EvaluationOutput
        Files beside the vectors.
    dt_us : float, optional
        Time between the frames of a pair, for external image pairs and runs without it: gives velocities
        instead of displacements.
    workers : int, optional
        Maximum number of processes; default one per core.
    **options
        Correlation of pairs, see `rtpiv.analysis.pairs.piv_file.PivOptions`.

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
    if recipe.target_clear is not None and details.tracking:
        raise PairError("tracking traces raw pixels; give the camera's lens terms in the scene, no dewarp")
    paths = recipe.frames_of(paths)
    run = paths[0] if len(paths) == 1 and (is_run(paths[0]) or is_source(paths[0])) else None
    preparation = choice.preparation or Preparation()
    how = PairMethod("", details, choice.settings, preparation, output.pictures, choice.out_of_plane)
    screen = console()
    if run is not None and (not is_run(run) or is_one_series(pairs_of(run))):
        mine = partial(holds_series_of, run=run, dt_us=dt_us)
        with results_in(out, USUAL, mine, COPIES, output.overwrite) as out:
            series = series_input(run, out, choice, scene, recipe, dt_us, timed=False)
            return _series(screen, series, how, output, workers)
    with results_in(out, USUAL, partial(holds_pair_of, frames=paths), COPIES, output.overwrite) as out:
        given = tasks_of(paths, out, scene, recipe, details.shift_mm, dt_us)
        if given.alone:
            screen.print(f"{given.alone} frames lost their partner and are in no pair")
        if isinstance(given.sigma, str) and recipe.mm_per_px is None:
            screen.print(f"no map uncertainty: {given.sigma}")
        for note in dict.fromkeys(task.note for task in given.tasks if task.note):
            screen.print(note)
        corrections, how = PreparedCorrections(), replace(how, sigma=given.sigma)

        def evaluate_one(task: Task) -> Detailed:
            prepared = corrections.of(task.scene, given.dewarp, limit=given.limit if task.scene.bodies else None)
            try:
                found = evaluate_task(task, prepared, how)
            except PairError as error:
                return error
            _write(draw, output, found)
            return found

        with drawing() as draw:
            if output.pictures and not tells_a_scale_alone(seen := given.tasks[0].scene):
                draw("rtpiv.analysis.report.pair:draw_scene_of_page", seen, output.figures)
            found, failed = _show_pairs(
                screen, ((task.name, evaluate_one(task)) for task in given.tasks), len(given.tasks)
            )
        return Evaluated(len(given.tasks), failed, found)


def _series(
    screen: Console, series: SeriesInput, how: PairMethod, output: EvaluationOutput, workers: int | None
) -> Evaluated:
    """Evaluate the pairs of a series, and each alone where more is asked of it; say and draw what came of it."""
    found: dict[str, Detailed] = {}

    def keep(tag: str, one: Detailed) -> None:
        found[tag] = one
        if isinstance(one, Evaluation):
            _write(draw, output, one)

    with drawing() as draw:
        asked = how if how.details.ask_more or output.vtk else None
        done = run_series(series, workers, closely=asked, on_pair=keep)
        show_series(screen, done)
        show_through(screen, seen := load_scene(series.out / SCENE_FILE))
        screen.print(where_lit(seen))
        in_order = [(pair.tag, found[pair.tag]) for pair in series.given.pairs if pair.tag in found]
        details, failed = _show_pairs(screen, in_order, len(in_order))
    done = replace(done, details=details)
    if output.pictures:
        from rtpiv.analysis.report.series import write_series_page

        write_series_page(series.out / "report.html", series, done, output.figures)
    look = f"look at {series.out / 'report.html'}; " if output.pictures else ""
    average = f"average with: rtpiv mean {shlex.quote(str(series.out))}"
    screen.print(f"{look}{average}")
    return replace(done, failed={**done.failed, **failed})


def _write(draw: Draw, output: EvaluationOutput, evaluation: Evaluation) -> None:
    """Write the folder of a pair, and let its page be drawn if it has pictures."""
    write_pair(evaluation, output.vtk)
    if evaluation.seen is not None:
        draw("rtpiv.analysis.report.pair_folder:write_pair_page", evaluation, output.figures)


def _show_pairs(
    screen: Console, pairs: Iterable[tuple[str, Detailed]], count: int
) -> tuple[tuple[Evaluation, ...], dict[str, str]]:
    """Print the uncertainties of each pair; one of several that failed is named and left out."""
    found, failed = list[Evaluation](), dict[str, str]()
    last: PairError | None = None
    for name, one in pairs:
        if isinstance(one, Evaluation):
            show_evaluation(screen, one, page=one.seen is not None)
            found.append(one)
            continue
        last, failed[name] = one, str(one)
        if count > 1:
            screen.print(f"{name} is left out: {one}", style="bold red")
    if last is not None and not found:
        raise last
    return tuple(found), failed


def holds_series_of(folder: Path, run: Path, dt_us: float | None) -> bool:
    """Return whether the series of this run was begun in a folder, with this time between its frames."""
    series = SeriesFolder(folder)
    try:
        if series.about["run"] != readable_name(run):
            return False
        own = dt_us is None and is_run(run)  # a run knows the time itself
        return own or series.agrees_with_dt(None if dt_us is None else 1e-6 * dt_us)
    except (RunUnsuitable, SeriesError):
        return False


def holds_pair_of(folder: Path, frames: Sequence[Path]) -> bool:
    """Return True if a folder holds vectors of these two frames; pairs of a run have their own folders."""
    try:
        known = json.loads(read_plain(folder / "evaluation.json", MAX_SUMMARY_BYTES))
        return [known["frames"], known["frames_from"]] == list(frame_names(frames).values())
    except (OSError, ValueError, KeyError, TypeError):
        return False
