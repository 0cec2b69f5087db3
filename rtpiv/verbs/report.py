"""`rtpiv report`: evaluate a run and write its report."""

from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

import numpy as np

from correction.evaluate.target_error import target_error
from correction.fitted.prepared import prepare
from daq.errors import RunUnsuitable, RunUsageError
from daq.runs.acquired import full_scale, read_acquired
from daq.runs.displacement import FILE as MOVED
from daq.runs.pairs import pairs_of
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import first_view, scene_file
from ground.terminal import console
from piv.errors import PairError
from rtpiv.analysis.fit_beside import FIT_FILE
from rtpiv.analysis.pairs.evaluation import IMAGE_ROUTE, Evaluation, PairDetails
from rtpiv.analysis.pairs.piv_file import PivOptions
from rtpiv.analysis.pictures.before_after import before_after
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.analysis.report.page import Link, Page
from rtpiv.analysis.report.table import Table
from rtpiv.analysis.series.series_pairs import is_flow
from rtpiv.options.numbers import DewarpOrder, Positive
from rtpiv.verbs.evaluate import COPIES, evaluate
from rtpiv.verbs.join import join
from rtpiv.verbs.mean import mean
from rtpiv.verbs.paths import Named, one_of, path_of
from rtpiv.verbs.results import results_in
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene


def report(
    run: Sequence[Named] | Named,
    /,
    out: Named | None = None,
    scene: Named | None = None,
    target_clear: Named | None = None,
    dewarp_order: DewarpOrder = 2,
    stage_sigma_um: Positive = 10.0,
    route: str = IMAGE_ROUTE,
    **options: Unpack[PivOptions],
) -> Path:
    """Evaluate a run and write its page.

    Parameters
    ----------
    run : path
        Folder of a run; of several of one plan, the newest finished one.
        Pairs of a shift run are evaluated (each also gets a folder with its vectors); a flow run
        is averaged as by `mean`, or its cameras are joined as by `mean --join`; of any other run the first
        frame through the glass is shown corrected.
    out : path, optional
        Folder, default ``report`` inside the run: ``report.html``, its figures, and a folder a pair; of a further
        camera the same in ``cameras/NAME``.
    scene : path, optional
        scene.yaml, best a fitted one; default the one that the run was corrected with, else the bench's.
    target_clear, dewarp_order
        As for `correct`.
    stage_sigma_um, route
        As for `evaluate`.
    **options
        How pairs are correlated, see `rtpiv.analysis.pairs.piv_file.PivOptions`.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    RunUnsuitable
        The folder is no run, or holds no frame yet.
    ConfigError, FrameError, PairError, TargetNotFound, DewarpError
        As for `evaluate`.
    """
    run, scene, recipe = one_of(run), path_of(scene), CorrectionRecipe(target_clear, dewarp_order)
    folder = RunFolder.open(run)
    about = folder.about
    out = Path(out) if out is not None else folder.own("report")
    cameras = folder.cameras()
    if _is_flow(run):
        if cameras:
            _join_cameras(folder, out, scene, recipe, **options)
        else:
            mean(run, out, scene, recipe, **options)
        return out / "mean.html"
    from rtpiv.analysis.report.calibration import calibration_chapter
    from rtpiv.analysis.report.pair import pair_chapters, pair_summary
    from rtpiv.analysis.report.run import account_chapter, displacement_chapter, pairs_chapter, provenance_chapter

    with results_in(out, copies=COPIES):
        scene = scene or scene_file(run, out)
        loaded = load_scene(scene)
        page = Page(f"{about['name']}: PIV through glass", f"run {folder.path.name}", twice=True)
        if (run / MOVED).is_file():
            asked = PairDetails(stage_sigma_um=stage_sigma_um, route=route)
            found = evaluate([run], out, scene, recipe, asked, **options).details
            shown = _most_telling(found)
            pair_summary(page, shown)
            pairs_chapter(page, found)
            if len(found) > 1:
                page.text(
                    f"What follows is the pair {shown.task.name}; each of the others has a page in its folder."
                )
            pair_chapters(page, shown)
        else:
            _single_frame(page, folder, loaded, recipe)
        calibration_chapter(page, scene.with_name(FIT_FILE), loaded)
        displacement_chapter(page, folder)
        if cameras:
            page.heading("Further cameras")
            own = "each has a report of its own, with its own scene"
            rows = [(Link(name, f"cameras/{name}/report.html"), each.path.name) for name, each in cameras.items()]
            page.table(Table(own, ("camera", "run"), rows))
        account_chapter(page, folder)
        provenance_chapter(page, folder, loaded.content_hash(), [("scene file", str(scene))])
        path = out / "report.html"
        page.write(path)
        for name, each in cameras.items():
            report(each.path, out / "cameras" / name, stage_sigma_um=stage_sigma_um, route=route, **options)
        console().print(f"look at {path}", style="bold")
        return path


def _join_cameras(
    folder: RunFolder, out: Path, scene: Path | None, recipe: CorrectionRecipe, **options: Unpack[PivOptions]
) -> None:
    """Join the cameras of a flow run: one page, with u, v, w and the reasons of each camera."""
    if recipe.target_clear is not None:
        raise RunUsageError("a report of several cameras has no dewarp: leave out --target-clear")
    views = [folder.path, *(each.path for each in folder.cameras().values())]
    scenes = [] if scene is None else [scene, *(scene_file(each, out / each.name) for each in views[1:])]
    join(views, out, scenes, **options)


def _is_flow(run: Path) -> bool:
    """Return True if a run is a series of pairs; other runs are shown by their frames."""
    try:
        return is_flow(pairs_of(run))
    except (PairError, RunUnsuitable):
        return False


def _most_telling(found: Sequence[Evaluation]) -> Evaluation:
    """Return the first pair through the glass whose shift is known, else what comes nearest to that."""
    return max(found, key=lambda e: (bool(e.task.scene.bodies), e.shift is not None))


def _single_frame(page: Page, folder: RunFolder, scene: Scene, recipe: CorrectionRecipe) -> None:
    """Chapters of a run without pairs: its first frame through the glass, and the target's errors in it."""
    from rtpiv.analysis.report.page import through_lead
    from rtpiv.analysis.report.pair import scene_chapter, slider_chapter
    from rtpiv.analysis.report.tables import image_table

    view = first_view(folder)
    if view is None:
        raise RunUnsuitable("holds no frame yet", place=folder.path, cure="resume the run first")
    board = recipe.board([folder.path])
    dewarp = recipe.dewarp(scene.camera, board)
    through = scene if view.glass else scene.bare()
    if view.shows == "flow":
        through = through.in_light_sheet()
    corrector = prepare(through, dewarp).corrector
    frame = read_acquired(view.path, scene.camera.shape)
    corrected = corrector(frame)
    seen = before_after(frame, corrected, corrector, through, full_scale(view.path, frame))
    tiles = []
    if seen.through is not None:
        console().print(seen.through.sentence, style="bold")
    through_lead(page, seen.through, through, seen.recovered)
    if view.shows == "chessboard" and view.on_plane:
        errors = target_error(corrected, corrector, board)
        for name, region in list(errors.regions.items())[1:]:
            if region.found:
                rms = float(np.max(region.rms_px))
                tiles.append(
                    (f"{rms:.3f} px", f"corner error, {name}", f"{region.found} of {region.expected} corners")
                )
        if tiles:
            page.tiles(tiles)
        page.heading("Target")
        columns = ("region", "corners found", "bias u, v", "rms u, v", "largest")
        page.table(Table("Position error of target corners, corrected minus grid [px]", columns, errors.rows()))
    slider_chapter(page, seen, f"Frame {view.path.name}, {view.tag}.")
    if view.shows != "chessboard":  # whose squares are no particles
        page.table(image_table(seen.figures, seen.full_scale))
    scene_chapter(page, through)
