"""`rtpiv mean`: mean flow and Reynolds stresses; evaluates missing pairs first."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, Unpack

from daq.errors import RunUnsuitable
from daq.frames.source import is_source, no_source_reason
from daq.runs.names import is_run
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import where_lit
from ground.printable import readable_name
from ground.terminal import console
from piv.errors import PairError
from piv.statistics.out_of_plane import NOTHING_TOLD, OutOfPlane
from rtpiv.analysis.pairs.piv_file import PivOptions, piv_choice
from rtpiv.analysis.pairs.slanted import viewing_slopes
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.analysis.report.kept_page import PAGE, is_current, note_page, page_key
from rtpiv.analysis.series.ensemble_series import SUMMED, ensemble_flow
from rtpiv.analysis.series.mean_flow import MeanFlow
from rtpiv.analysis.series.run_series import run_series
from rtpiv.analysis.series.self_check import check_sheet, spheres_checked
from rtpiv.analysis.series.series_folder import FILE
from rtpiv.analysis.series.series_input import series_input
from rtpiv.analysis.series.series_mean import ensemble_vectors, mean_of_series, write_mean, write_statistics
from rtpiv.analysis.series.series_view import SeriesView
from rtpiv.options.numbers import Count, Positive
from rtpiv.verbs.evaluate import COPIES, USUAL, holds_series_of
from rtpiv.verbs.paths import Named, one_of, path_of
from rtpiv.verbs.results import results_in
from rtpiv.verbs.show import show_mean, show_series, show_through

OUT_OF_PLANE = ("sigma_w_m_s", "w_over_u")  # options that change only uncertainties


@dataclass(frozen=True)
class MeanOutput:
    """Files of a mean.

    Parameters
    ----------
    figures : bool
        Write every figure as SVG and PNG files too.
    files : bool
        Write ``mean.nc``, ``mean.html`` and ``mean_ensemble.nc``.
    overwrite : bool
        Overwrite vectors of other frames in the given folder.
    """

    figures: bool = False
    files: bool = True
    overwrite: bool = False


def mean(
    path: Sequence[Named] | Named,
    /,
    out: Named | None = None,
    scene: Named | None = None,
    recipe: CorrectionRecipe = CorrectionRecipe(),
    output: MeanOutput = MeanOutput(),
    dt_us: Positive | None = None,
    workers: Count | None = None,
    ensemble: Literal[8, 16, 32] | None = None,
    **options: Unpack[PivOptions],
) -> MeanFlow:
    """Average the vectors of a flow run: mean flow and Reynolds stresses, with uncertainties.

    Parameters
    ----------
    path : path
        A flow run (of several of one plan, the newest finished one is used) or external image pairs (a folder, a
        pattern in quotes, a stack, a video): pairs that have no vectors with these settings are evaluated first.
        Or the folder of a series that `evaluate` has written.
    out : path, optional
        Folder of the series, for ``mean.nc``, ``mean.html`` and the files of `evaluate`; on the command line by
        default ``series`` in the run, or ``evaluation`` for external frames.
    scene, recipe, dt_us, workers
        As for `evaluate`; for a run only.
    output : MeanOutput
        Files, beside the chunks of the series.
    ensemble : {8, 16, 32}, optional
        Also ensemble correlation with windows of this size [px], in ``mean_ensemble.nc``: for rims, walls and
        sparse seeding, where single pairs fail; for a run only.
    **options
        Settings of the correlation, see `rtpiv.analysis.pairs.piv_file.PivOptions`; for a run only, except
        `sigma_w_m_s` and `w_over_u`, which change no vector.

    Returns
    -------
    MeanFlow
        The statistics.

    Raises
    ------
    PairError, SeriesError
        What the run or its series make impossible: no pair with vectors, a chunk that is missing or damaged.
    RunUnsuitable
        The folder is neither a run nor a series.
    ConfigError, FrameError, BoardError, TargetNotFound, DewarpError, RunDamaged, DiskError
        As for `evaluate`.
    """
    screen = console()
    (path,), out, scene = recipe.frames_of([one_of(path)]), path_of(out), path_of(scene)
    with ExitStack() as held:
        series = None
        if is_run(path) or (not (path / FILE).is_file() and is_source(path)):
            choice = piv_choice(**options)
            if is_run(path) and out is None:
                out = RunFolder(path).own("series")
            mine = partial(holds_series_of, run=path, dt_us=dt_us)
            alone = results_in(out, USUAL, mine, COPIES, output.overwrite)
            folder = held.enter_context(alone)
            given = series_input(path, folder, choice, scene, recipe, dt_us)
            done = run_series(given, workers)
            show_series(screen, done)
            series = given, done
        elif (path / FILE).is_file():
            folder = path
            if output.files:
                held.enter_context(results_in(folder))
            if (
                (out is not None and output.files)
                or scene is not None
                or recipe != CorrectionRecipe()
                or dt_us is not None
                or ensemble is not None
                or any(value is not None for name, value in options.items() if name not in OUT_OF_PLANE)
            ):
                raise PairError(f"{path}: its vectors are made; give the run to evaluate it in another way")
        else:
            none = "is neither a run, nor frames in pairs, nor the folder of a series"
            raise RunUnsuitable(f"{path}: {none}: {no_source_reason(path)}")
        motion = OutOfPlane(options.get("sigma_w_m_s"), options.get("w_over_u"))
        view = SeriesView(folder, None if series is not None or motion == NOTHING_TOLD else motion)
        found = mean_of_series(view)
        key = None
        if output.files:
            run = path if series is not None and is_run(path) else None
            rest = (output.figures, ensemble, None if series is None else series[1].failed)
            key = page_key(view, rest, run)
        is_drawn = key is not None and is_current(folder, key) and ensemble is None
        check = None
        if output.files:
            check, said_of_spheres = spheres_checked(folder, series[0] if series and not is_drawn else None)
            found = replace(found, spheres=said_of_spheres)
            if not is_drawn:
                write_mean(view, found)
        by_ensemble = None
        if series is not None and ensemble is not None:
            given = series[0]
            by_ensemble = ensemble_flow(given, found, ensemble, workers)
            said = {"run": readable_name(path), "scene_hash": given.method.scene.content_hash()}
            said |= view.readings
            seen = view.correction.corrector.map
            slope = viewing_slopes(seen, view.scene, by_ensemble.windows, SUMMED)
            slope = None if slope is None else slope[::-1]
            vectors = ensemble_vectors(by_ensemble, said, slope, view.out_of_plane)
            found = replace(found, by_ensemble=vectors)
            if output.files:
                write_statistics(folder / "mean_ensemble.nc", vectors)
        if key is not None and not is_drawn:
            from rtpiv.analysis.report.mean import write_mean_page

            write_mean_page(folder / PAGE, view, found, output.figures, by_ensemble, series, check)
            note_page(folder, key)
        show_through(screen, view.scene)
        screen.print(where_lit(view.standing))
        if series is not None and (height := check_sheet(series[0])) is not None:
            screen.print(height.sentence, style="bold red" if height.is_elsewhere else "")
        show_mean(
            screen,
            found,
            folder / PAGE if output.files else None,
            () if series is None else series[1].failed,
        )
    return found
