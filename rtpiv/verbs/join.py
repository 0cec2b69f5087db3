"""`rtpiv mean --join`: join several views of one flow: the union of what cameras see, and the third component."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Unpack

import numpy as np
from rich.console import Console

from correction.errors import SheetError
from correction.grid import PlaneGrid, grid_of
from correction.light_sheet.two_cameras import SheetByViews
from correction.node_status import NodeStatus
from daq.errors import RunUsageError
from daq.runs.names import is_run, main_run
from ground.terminal import console
from piv.errors import PairError
from piv.statistics.three_components import MAX_SIGMA_W_PX
from rtpiv.analysis.fit_beside import SCENE_FILE
from rtpiv.analysis.pairs.piv_file import PivOptions, piv_choice
from rtpiv.analysis.report.kept_page import PAGE
from rtpiv.analysis.series.chunk import correction_of
from rtpiv.analysis.series.joined_views import JoinedViews, join_views
from rtpiv.analysis.series.moving_glass import END_PAIRS, Moves, find_moves, follow_moves
from rtpiv.analysis.series.run_series import run_series
from rtpiv.analysis.series.series_folder import FILE, MEAN
from rtpiv.analysis.series.series_input import SeriesInput, keep_scene, series_input
from rtpiv.analysis.series.series_view import SeriesView
from rtpiv.analysis.series.sheet_of_views import BALL, CHECKED_FRAMES, set_sheet, sheet_of_views
from rtpiv.analysis.series.split_focus import BEHIND, BESIDE, JoinedMean, join_series
from rtpiv.options.numbers import Count, Positive
from rtpiv.verbs.paths import Named, paths_of
from rtpiv.verbs.results import results_in
from rtpiv.verbs.show import show_series
from tracer.light_sheet import LightSheet
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene

SHEET_SIGMAS = 4.0  # of the height of the sheet, beyond which it lies elsewhere
STRANGERS = 2.0  # sigma: more, and the two runs did not see one flow, or one of them is too blurred to say
TOO_FAR_APART = (
    "that is more than chance: another flow, or a part that is too blurred to be measured in one of them"
)
FARTHEST = 10.0  # mm, mrad: beyond it a move of a camera is not linear
SHEET_ROUNDS = 2
MIN_TWICE_WINDOWS = 4  # windows of places seen twice, from which these are a view
APART = (
    "where no light sheet explains it the views are {:.3f} mm apart ({:.1f} sigma): one camera or a ball does not"
    " stand where it was calibrated"
)
MOVED = (
    "the camera of {} was moved since it was calibrated, or its calibration is worse than frames compare: what it"
    " shows is at least {:.3f} mm from its place; calibrate the cameras again, together (rtpiv calibrate --join)"
)
UNSEEN = (
    "a camera moved by less than {}, {}, {} mm along x, y, z or turned by less than {}, {}, {} mrad about them"
    " since its calibration would most likely not be noticed"
)
ELSEWHERE = (
    "the light sheet lies {:+.3f} +- {:.3f} mm from where the scenes have it, or a camera does not stand where it"
    " was calibrated; measure the sheet with --sheet"
)
UNCOMPARED = "frames of the views could not be compared with each other: {}"

KNOCKED = "{} was knocked {}{}"
CALIBRATE = (
    "; calibrate again, and evaluate the pairs from {} on with that scene: the map is right for one side alone"
)
DRIFTED = "{} drifts{} from the first pair to the last"
DRIFT_UM = " by ({:+.1f}, {:+.1f}, {:+.1f}) +- ({:.1f}, {:.1f}, {:.1f}) um"
LEAST = (
    "a knock of {} sideways below {:.0f} um, and {} pairs before the end below {:.0f} um, would most likely be"
    " missed; twice that is found in 9 of 10 runs"
)


@dataclass(frozen=True)
class Together:
    """Relation of views that are joined.

    Parameters
    ----------
    simultaneous : bool
        The views were recorded at the same time, pair by pair; cameras of one run always are.
    sheet : bool
        Measure the light sheet from the disparity of views at the same time before they are evaluated, and
        evaluate them with it; not for series.
    branches : bool
        Places that a camera sees twice, such as directly and through a ball, are two views of it: they give w from
        one camera. Of runs and frames, not of series.
    knocks : bool
        Look for a pair before which a ball, a camera or the light sheet was knocked, and for balls that drift, by
        the disparity of views at the same time; not for series.
    follow : bool
        Do so, and correct each pair for where the balls were then, as far as that changes places by more than
        0.02 px.
    """

    simultaneous: bool = False
    sheet: bool = False
    branches: bool = False
    knocks: bool = False
    follow: bool = False


def join(
    views: Sequence[Named],
    /,
    out: Named | None = None,
    scene: Sequence[Named] = (),
    dt_us: Positive | None = None,
    how: Together = Together(),
    w_limit_px: Positive = MAX_SIGMA_W_PX,
    workers: Count | None = None,
    **options: Unpack[PivOptions],
) -> JoinedMean | JoinedViews:
    """Join several views of one flow.

    Views from different places are combined by their uncertainty: what any of them sees, and the velocity w
    through the sheet where their rays differ enough.  Two runs of one camera that differ in focus alone are joined
    by what each was focused on: the first beside the glass, the second behind it.

    Parameters
    ----------
    views : path
        Folders of series (see `evaluate`) on one grid; or runs, or external image pairs, which are evaluated into
        ``view-1``, ``view-2`` ... on the grid of the first.
    out : path, optional
        Folder, default ``joined`` (or ``joined-2`` ... where that has results), for ``mean.nc``, ``mean.html``
        and, of cameras at the same time, the vectors of pairs in ``chunks``.
    scene : sequence of path, optional
        Scene file of each view, in their order; not for series.
    dt_us : float, optional
        Time between the frames of a pair, of views that are evaluated.
    how : Together
        Relation of the views.
    w_limit_px : float
        Standard uncertainty of w up to which it is reported [px of the corrected image].
    workers : int, optional
        Maximum number of processes; default one per core.
    **options
        Correlation of pairs, see `rtpiv.analysis.pairs.piv_file.PivOptions`; not for series.

    Returns
    -------
    JoinedMean or JoinedViews
        The statistics.

    Raises
    ------
    RunUsageError
        Fewer than two views, or not one scene a view.
    SeriesError, RunUnsuitable, ConfigError, DiskError
        As `rtpiv.analysis.series.joined_views.join_views` and `rtpiv.analysis.series.split_focus.join_series`.
    PairError, FrameError, RunDamaged
        As `evaluate`.
    """
    paths, scenes, choice = paths_of(views), paths_of(scene), piv_choice(**options)
    if len(paths) < 2 - how.branches or len(scenes) not in (0, len(paths)):
        raise RunUsageError(
            f"give two views or more, and no scene or one for each, not {len(paths)} and {len(scenes)}"
        )
    asked = [scenes or None, dt_us, *options.values()]
    if all((path / FILE).is_file() for path in paths) and any(each is not None for each in asked):
        raise PairError(
            "the vectors of these series are made; give runs or frames to evaluate them in another way"
        )
    screen = console()
    with results_in(out, "joined") as out:
        at_once = how.simultaneous or _is_one_run(paths)
        folders = [path if (path / FILE).is_file() else out / f"view-{k}" for k, path in enumerate(paths, start=1)]

        def inputs(scenes: Sequence[Path | None]) -> list[SeriesInput]:
            grid, found = SeriesView(folders[0]).grid if folders[0] == paths[0] else None, list[SeriesInput]()
            for path, folder, its_scene in zip(paths, folders, scenes, strict=True):
                if folder != path:
                    found.append(_on_grid(series_input(path, folder, choice, its_scene, dt_us=dt_us), grid))
                    grid = grid or grid_of(found[0].method.scene.camera)
            return found

        given = inputs(scenes or [None] * len(paths))
        compares = how.sheet or how.knocks or how.follow
        if compares and (not at_once or len(paths) < 2 or len(given) < len(paths)):
            raise RunUsageError(
                "--sheet, --knocks and --follow compare frames of two cameras at the same time: give two runs or"
                " folders of frames or more, and --simultaneous"
            )
        for _ in range(SHEET_ROUNDS if how.sheet else 0):  # a plane that is nearer changes the slopes
            moved = sheet_of_views(given)
            at_last, given = set_sheet(given, moved), inputs([folder / SCENE_FILE for folder in folders])
            screen.print(f"{at_last.summary}, from {moved.places} places")
            show_contradictions(screen, moved, paths)
        if at_once and 1 < len(paths) == len(given) and not how.sheet:
            try:
                moved = sheet_of_views(given, CHECKED_FRAMES)
                known = given[0].method.scene.sheet or LightSheet()
                show_contradictions(screen, moved, paths, known)
            except (PairError, SheetError) as error:
                screen.print(UNCOMPARED.format(error), soft_wrap=True)
        if how.knocks or how.follow:
            moves, steps = find_moves(given), 0
            if how.follow:
                given, steps = follow_moves(given, moves)
            show_moves(screen, moves, [pair.tag for pair in given[0].given.pairs], steps)
        made = [SeriesView(folder) for folder in folders if (folder / FILE).is_file() and folder in paths]
        seen = [(view.scene, view.about["glass"]) for view in made]
        seen += [(each.method.scene, each.given.glass) for each in given]
        is_focus = not how.branches and _differ_in_focus(seen)
        if how.branches:
            given, folders = add_second_views(given, folders, out)
        for each in given:
            show_series(screen, run_series(each if is_focus else _as_view(each), workers))
        series = [SeriesView(folder) for folder in folders]
        if is_focus:
            return _join_focus(screen, series, out)
        joined = join_views(series, out, at_once, w_limit_px, choice.settings.denoise)
        from rtpiv.analysis.report.joined_views import write_views_page  # draws

        write_views_page(out / PAGE, series, joined)
        for line in joined.sentences:
            screen.print(line)
        if joined.warning:
            screen.print(joined.warning, style="bold red")
        screen.print(f"look at {out / PAGE}")
        return joined


def show_contradictions(
    screen: Console, found: SheetByViews, paths: Sequence[Path], known: LightSheet | None = None
) -> None:
    """Say where frames of views do not fit together; `known` is the sheet, unless the found one is used."""
    said, height_mm = list[str](), np.inf
    if found.residual_sigma > STRANGERS:
        said.append(APART.format(found.residual_mm, found.residual_sigma))
    if found.moved:
        named = " or ".join(f"view {number + 1} ({paths[number]})" for number in found.moved)
        said.append(MOVED.format(named, found.moved_mm))
    elif known is not None:
        z_mm, sigma_mm = float(found.plane[0]), float(np.hypot(found.covariance[0, 0] ** 0.5, known.sigma_mm))
        height_mm = SHEET_SIGMAS * sigma_mm
        if abs(z_mm) > height_mm:
            said.append(ELSEWHERE.format(z_mm, sigma_mm))
    for line in said:
        screen.print(line, style="bold red", soft_wrap=True)
    # A sheet that is measured takes up what a move along the difference of slopes changes.
    least = found.least_noticed(height_mm)
    if least is not None:
        shown = ("any amount" if one > FARTHEST else f"{one:.2g}" for one in least * ([1.0] * 3 + [1e3] * 3))
        screen.print(UNSEEN.format(*shown), soft_wrap=True)


def show_moves(screen: Console, found: Moves, pairs: Sequence[str], scenes: int = 0) -> None:
    """Name what was knocked, the pairs across it, and balls that drift; `scenes` that pairs have if followed."""
    said, knock = list[str](), found.knock
    if knock is not None:
        what = " or ".join(knock.names)
        if knock.names[0].startswith(BALL):
            what += " by ({:+.0f}, {:+.0f}, {:+.0f}) um".format(*(1e3 * knock.move))
        between = f"between the pairs {pairs[knock.before]} and {pairs[knock.after]}"
        is_followed = scenes and any(path.name in knock.names for path in found.moving)
        said.append(KNOCKED.format(what, between, "" if is_followed else CALIBRATE.format(pairs[knock.after])))
    if drift := found.drifting:
        by = [*(1e3 * drift[0].position[-1, :3]), *(1e3 * drift[0].sigma[-1, :3])]
        is_ball = drift[0].name.startswith(BALL)
        said.append(
            DRIFTED.format(" or ".join(one.name for one in drift), DRIFT_UM.format(*by) if is_ball else "")
        )
    if scenes and found.moving:
        said.append(f"pairs are corrected with {scenes} scenes, that of the first pair as calibrated")
    for line in said:
        screen.print(line, style="bold red", soft_wrap=True)
    if not said:
        screen.print("no ball, camera or light sheet was knocked or drifts by more than chance")
    for name, (middle, end) in found.least_mm.items():
        screen.print(LEAST.format(name, 1e3 * middle, END_PAIRS, 1e3 * end), soft_wrap=True)


def add_second_views(
    given: Sequence[SeriesInput], folders: Sequence[Path], out: Path
) -> tuple[list[SeriesInput], list[Path]]:
    """Return series and folders of views, and behind them second views of cameras that see enough places twice.

    RunUsageError if there is none, or series are given in place of runs.
    """
    found = list[SeriesInput]()
    for each in given:
        second = replace(each, method=replace(each.method, view=1), least_valid=0.0)
        windows = second.method.settings.windows_px[-1]
        recovered = correction_of(each.out / "maps", second.method).corrector.recovered
        if np.count_nonzero(recovered) >= MIN_TWICE_WINDOWS * windows**2:
            found.append(replace(second, out=out / f"view-{len(folders) + len(found) + 1}"))
            found[-1].out.mkdir(parents=True, exist_ok=True)
            keep_scene(each.out / SCENE_FILE, found[-1].out, load_scene(each.out / SCENE_FILE))
    if len(given) < len(folders) or len(folders) + len(found) < 2:
        raise RunUsageError("--branches needs runs or frames of a camera that sees places on two paths; none does")
    return [*given, *found], [*folders, *(each.out for each in found)]


def _on_grid(given: SeriesInput, grid: PlaneGrid | None) -> SeriesInput:
    """Return the same series on the grid of another view, unless it is its own."""
    own = grid_of(given.method.scene.camera)
    return given if grid in (None, own) else replace(given, method=replace(given.method, grid=grid))


def _as_view(given: SeriesInput) -> SeriesInput:
    """Return the same series without the noise filter, which is applied to what views are combined to.

    Behind the rim of a view the flow goes on, unless a body stands in the plane or a person has masked something.
    """
    status = correction_of(given.out / "maps", given.method).corrector.map.status
    is_open = not np.isin(status, (NodeStatus.IN_GLASS, NodeStatus.LEFT_OUT)).any()
    settings = replace(given.method.settings, denoise=0.0, flow_beyond_mask=is_open)
    return replace(given, method=replace(given.method, settings=settings))


def _differ_in_focus(seen: Sequence[tuple[Scene, bool]]) -> bool:
    """Return whether two views, each with whether it is through glass, are those of one camera at one place."""
    cameras = {replace(scene.camera, pupil=None) for scene, _ in seen}
    return len(seen) == 2 and len(cameras) == 1 and any(glass for _, glass in seen)


def _is_one_run(paths: Sequence[Path]) -> bool:
    """Return whether all are cameras of one run, or their series; series beside each other may be of any runs."""
    places = {main_run(path.resolve().parent if (path / FILE).is_file() else path) for path in paths}
    return len(places) == 1 and (is_run(places.pop()) or not any((path / FILE).is_file() for path in paths))


def _join_focus(screen: Console, series: Sequence[SeriesView], out: Path) -> JoinedMean:
    """Join two runs by what each was focused on."""
    beside, behind = (each.folder for each in series)
    joined = join_series(beside, behind, out)
    counts = {name: int((joined.source == value).sum()) for name, value in (("first", BESIDE), ("second", BEHIND))}
    screen.print(f"{counts['first']} vectors from {beside}, {counts['second']} from {behind}")
    screen.print(f"where both have a mean they differ by {joined.apart_in_sigma:.2f} sigma (rms)")
    if joined.apart_in_sigma > STRANGERS:
        screen.print(TOO_FAR_APART, style="bold red")
    screen.print(f"wrote {out / MEAN}")
    return joined
