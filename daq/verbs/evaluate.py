"""`rtpiv evaluate`: vectors of pairs seen through glass, with their errors, uncertainty and a page to look at."""

from pathlib import Path

from correction.errors import PairError
from correction.prepared import PreparedCorrections
from daq.analysis.evaluation import Evaluation, Route, evaluate_task
from daq.analysis.piv_file import Window, piv_settings
from daq.analysis.report.pair_folder import write_pair
from daq.analysis.tasks import tasks_of
from daq.terminal import console
from daq.verbs.show import show_evaluation


def evaluate(
    paths: list[Path],
    out: Path,
    scene: Path | None = None,
    target_clear: Path | None = None,
    dewarp_order: int = 2,
    square_mm: float | None = None,
    disc_mm: float | None = None,
    shift_mm: tuple[float, float] | None = None,
    stage_sigma_um: float = 10.0,
    route: Route = "image",
    vtk: bool = False,
    figures: bool = False,
    piv: Path | None = None,
    first_window: int | None = None,
    final_window: int | None = None,
    passes: int | None = None,
    overlap: float | None = None,
    window: Window | None = None,
    denoise: float | None = None,
) -> list[Evaluation]:
    """Correct pairs of frames, measure their displacements, and write a page for each.

    Parameters
    ----------
    paths : list of Path
        Frame A and frame B as acquired; or the folder of a run whose frames form pairs: a shift run, or a stream.
    out : Path
        Folder: ``vectors.nc``, ``evaluation.json``, ``report.html`` with its figures, and on request
        ``vectors.vtk`` and ``vectors_velocity.nc``; for a run one such folder a pair.
    scene : Path, optional
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
    piv : Path, optional
        Settings of the correlation (docs/files.md).
    first_window, final_window, passes, overlap, window, denoise
        The same one by one, in place of what the file says; windows in px.

    Returns
    -------
    list of Evaluation
        One a pair.

    Raises
    ------
    ConfigError, FrameError, PairError, BoardError, TargetNotFound, DewarpError, RunUnsuitable, RunDamaged
        What the file, the frames, the target or the run make impossible, in one sentence. Of several pairs one
        that cannot be evaluated is named and left out.
    """
    if target_clear is not None and route != "image":
        raise PairError(
            "the velocity route traces raw pixels; give the camera's lens terms in the scene, no dewarp"
        )
    settings = piv_settings(piv, first_window, final_window, passes, overlap, window, denoise)
    screen = console()
    given = tasks_of(paths, out, scene, target_clear, dewarp_order, square_mm, disc_mm, shift_mm)
    if given.alone:
        screen.print(f"{given.alone} frames lost their partner and are in no pair")
    if isinstance(given.sigma, str):
        screen.print(f"no uncertainty of the map: {given.sigma}")
    corrections, found, failed = PreparedCorrections(), [], None
    for task in given.tasks:
        prepared = corrections.of(task.scene, given.dewarp)
        try:
            evaluation = evaluate_task(task, prepared, given.sigma, stage_sigma_um, route, settings)
        except PairError as error:
            if len(given.tasks) == 1:
                raise
            failed = error
            screen.print(f"{task.name} is left out: {error}", style="bold red")
            continue
        write_pair(evaluation, vtk, figures)
        show_evaluation(screen, evaluation)
        found.append(evaluation)
    if failed is not None and not found:
        raise failed
    return found
