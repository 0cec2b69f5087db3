"""`rtpiv trace`: ray-trace a scene: field of view, magnification, viewing slope, what is lost and why."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from correction.grid import PlaneGrid
from correction.light_sheet.double_views import AROUND, double_views
from correction.light_sheet.forecast import SheetForecast, sheet_forecast
from correction.maps.correction_map import CorrectionMap, build_correction_map
from correction.maps.lit import LEAST_BRIGHTNESS, MOST_BRIGHTNESS, light_of, through_light
from correction.node_status import MEANING, NodeStatus
from daq.bench.scene_plausibility import scene_questions
from ground.terminal import console, progress_if_long
from rtpiv.analysis.fit_beside import FIT_FILE, scene_sigma_beside
from rtpiv.analysis.gaps import RING, Gaps, LitGaps, gap_share
from rtpiv.analysis.pictures.drawing_process import Draw, drawing
from rtpiv.analysis.pictures.saved import short
from rtpiv.analysis.report.table import Table
from rtpiv.analysis.steepness import ShownSlant, Steepness
from rtpiv.analysis.through_glass import BodyShare, PlaneShare, percent, plane_share
from rtpiv.analysis.views.field_of_view import FieldOfView, field_of_view
from rtpiv.analysis.views.sigma_forecast import packing_forecast
from rtpiv.analysis.views.two_cameras import double_view_forecast, sentences_of, two_cameras
from rtpiv.verbs.paths import Named
from rtpiv.verbs.results import results_in
from rtpiv.verbs.show import say_through
from tracer.errors import SceneError
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_priors, load_scene
from tracer.strategies.ray_map import RayMap, build_ray_map

if TYPE_CHECKING:
    from correction.maps.aperture import BlurMap

PICTURES = "rtpiv.analysis.pictures"
DRAWN = ("plane.png", "camera_view.png", "light.png", "slant.png", "scene.png", "blur.png", "radial_curve.png")
SHOWN_BODIES = 40
LONGEST_BODY_NAME = 32
# In contact: the time for the forecast of their centres grows with the cube of their number
MOST_FORECAST_BALLS = 100
# Corrected pixels between places that may be seen twice; 2 says the same in four times the time
SHEET_STEP = 4


@dataclass(frozen=True)
class Traced:
    """View of the plane through a scene.

    Parameters
    ----------
    share : PlaneShare
        Areas, as a whole and of each body.
    view : FieldOfView or None
        Radial figures, of spheres in a row on the camera's perpendicular only.
    steepness : Steepness
        How steeply rays meet the plane, behind glass and beside it.
    sheet : SheetForecast or None
        How well frames of a flow will tell where the light sheet is; None if it runs through a body.
    pictures : tuple of Path
        What was drawn.
    gaps : Gaps or None
        Share of the gaps that is seen, where the plane cuts two balls or more.
    """

    share: PlaneShare
    view: FieldOfView | None
    steepness: Steepness
    sheet: SheetForecast | None
    pictures: tuple[Path, ...] = field(repr=False)
    gaps: Gaps | None = None


def trace(
    scene: Named | Scene,
    /,
    out: Named | None = None,
    pictures: bool = True,
    overwrite: bool = False,
    beside: Named | Scene | None = None,
) -> Traced:
    """Trace a scene; print its view of the plane, and write pictures.

    Parameters
    ----------
    scene : path or Scene
        scene.yaml, or in Python the value of `load_scene`.
    out : path, optional
        Folder, default ``trace`` (or ``trace-2`` ... where that has results), for ``plane.png`` (what is recovered
        of the plane, why the rest is not, and the magnification), ``camera_view.png`` (a board with markers as
        the camera sees it), ``light.png`` (brightness and height of the light, if the scene gives its
        sources), ``slant.png`` (how steeply rays meet the plane), ``scene.png`` (the scene to scale,
        cut where the rays lie), of spheres in a row only ``radial_curve.png``, and ``blur.png`` if the scene says
        the camera's aperture.
    pictures : bool
        Draw figures.
    overwrite : bool
        Overwrite figures of another scene in the given folder.
    beside : path or Scene, optional
        Scene of a second camera at the same time: print what both recover, the uncertainty of the
        out-of-plane velocity and of ball positions from one pair, and the smallest knock of a ball that shows.

    Returns
    -------
    Traced
        The figures.

    Raises
    ------
    ConfigError
        The scene file is wrong.
    RunUsageError, DiskError
        The folder cannot hold results.
    """
    loaded, name = (scene, "scene") if isinstance(scene, Scene) else (load_scene(scene), Path(scene).stem)
    screen = console()
    source = Path("a scene in memory") if isinstance(scene, Scene) else Path(scene)
    made_from = dict.fromkeys(DRAWN if pictures else (), source)
    with results_in(out, "trace", overwrite=overwrite, made_from=made_from) as out:
        for question in [] if isinstance(scene, Scene) else scene_questions(scene):
            screen.print(question, soft_wrap=True, highlight=False)
        given, loaded = loaded, _in_bed(loaded)
        if loaded is not given:
            screen.print(f"in {given.lit.summary}")
        ray_map = build_ray_map(loaded)
        seen = build_correction_map(loaded, ray_map)
        light = light_of(loaded, seen.grid)
        correction_map = through_light(seen, loaded, light)
        share = plane_share(loaded, correction_map)
        blur = None
        if loaded.camera.pupil is not None:
            from correction.maps.aperture import blur_map

            blur = blur_map(correction_map, loaded)
        try:
            view: FieldOfView | None = field_of_view(loaded)
        except SceneError:  # not in a row: the areas say it all
            view = None
        gaps = gap_share(loaded, seen, light)
        say_through(screen, gaps or share.through, loaded)
        screen.print(_plane_table(f"{name}, scene {loaded.content_hash()}", share))
        if share.bodies:
            screen.print(_body_table(share))
        if gaps is not None and gaps.lit is not None:
            screen.print(_light_table(gaps.lit))
        if view is not None:
            screen.print(_radial_table(view))
        if blur is not None and np.isfinite(blur.width_px).any():
            screen.print(
                f"blur behind glass, median {np.nanmedian(blur.width_px):.2f} px; left out by the aperture"
                f" {100.0 * blur.left_out:.1f} % of the view behind glass"
            )
        with drawing(patient=True) as draw:
            if pictures:
                _draw_plane(draw, out, name, loaded, correction_map, share)
            slant = ShownSlant.of(correction_map, loaded)
            if slant.steepness.sentence:
                screen.print(slant.steepness.sentence)
            file = None if isinstance(scene, Scene) else Path(scene)
            forecast, moves = _sheet_forecast(file, given, loaded, ray_map)
            for line in [] if forecast is None else [forecast.sentence, *moves]:
                screen.print(line)
            if beside is not None:
                other = beside if isinstance(beside, Scene) else load_scene(beside)
                for line in two_cameras(loaded, _in_bed(other)).sentences:
                    screen.print(line, soft_wrap=True)
            if not isinstance(scene, Scene) and (contact_mm := load_priors(scene).contact_mm) is not None:
                screen.print(_packing_text(given, contact_mm), soft_wrap=True)
            del ray_map
            if pictures:
                _draw_on_plane(draw, out, loaded, correction_map.grid, slant, blur)
                if light is not None:
                    draw(f"{PICTURES}.traced:draw_light", out / "light.png", loaded, light)
                _draw_views(draw, out, name, loaded, share.size_mm[0], view)
        lacking = {"light.png": light is None, "blur.png": blur is None, "radial_curve.png": view is None}
        names = [name for name in DRAWN if pictures and not lacking.get(name)]
        if pictures:
            screen.print(f"{', '.join(names)} are in {out}")
        return Traced(share, view, slant.steepness, forecast, tuple(out / name for name in names), gaps)


def _packing_text(scene: Scene, contact_mm: float) -> Table | str:
    """Expected uncertainty of the balls after a calibration; a sentence if they are too many for a forecast."""
    if len(scene.spheres) > MOST_FORECAST_BALLS:
        return (
            f"centres after a calibration are forecast for up to {MOST_FORECAST_BALLS} balls in contact, not for"
            f" {len(scene.spheres)}: trace a part of the packing"
        )
    columns = ("known by", "sideways, median", "worst", "along z, median", "worst")
    found = packing_forecast(scene, contact_mm)
    rows = [(one.known_by, *(f"{mm:.3f}" for mm in (*one.sideways_mm, *one.along_mm))) for one in found]
    return Table("centres of balls after a calibration, standard deviation [mm]", columns, rows)


def _draw_plane(
    draw: Draw, out: Path, name: str, scene: Scene, correction_map: CorrectionMap, share: PlaneShare
) -> None:
    """Draw the first results while the rest is computed."""
    from rtpiv.analysis.pictures.rasters import ShownPlane

    draw(f"{PICTURES}.traced:draw_plane", out / "plane.png", scene, ShownPlane.of(correction_map), share, name)
    draw(f"{PICTURES}.drawing:draw_scene", out / "scene.png", scene)


def _draw_on_plane(
    draw: Draw, out: Path, scene: Scene, grid: PlaneGrid, slant: ShownSlant, blur: "BlurMap | None"
) -> None:
    """Draw how rays meet the plane, and how sharp it is seen."""
    draw(f"{PICTURES}.traced:draw_slant", out / "slant.png", scene, grid, slant)
    if blur is not None:
        draw(f"{PICTURES}.traced:draw_blur", out / "blur.png", grid, blur)


def _draw_views(draw: Draw, out: Path, name: str, scene: Scene, width_mm: float, view: FieldOfView | None) -> None:
    """Draw what the camera sees of a plane of some width; what takes longest to compute comes last."""
    from rtpiv.analysis.pictures.patterns import WIDEST_PX, MarkerBoard, pattern_view, square_for
    from rtpiv.analysis.through_glass import coarsen_scene

    if view is not None:
        draw(f"{PICTURES}.traced:draw_curve", out / "radial_curve.png", scene, view, name)
    square_mm = square_for(width_mm)
    image = pattern_view(coarsen_scene(scene, WIDEST_PX), MarkerBoard(square_mm), watched=progress_if_long)
    view_of = image, scene.camera.sensor_px, square_mm, name
    draw(f"{PICTURES}.traced:draw_camera_view", out / "camera_view.png", *view_of)


def _in_bed(scene: Scene) -> Scene:
    """Return the scene in its light sheet where that runs through a bed or its sources are given; else itself."""
    if scene.sheet is None or (scene.sheet.is_target_plane and not scene.sheet.sources):
        return scene
    try:
        lit = scene.in_light_sheet()
    except SceneError:
        if scene.sheet.sources:
            raise
        return scene  # `correct` reports it: the glass may stand elsewhere then
    return lit if lit.light is not None or lit.spheres_in_plane else scene


def _sheet_forecast(
    path: Path | None, scene: Scene, shown: Scene, ray_map: RayMap
) -> tuple[SheetForecast | None, list[str]]:
    """Return the forecast for the light sheet, where glass can stand in front of it, and for balls that move."""
    fitted = path is not None and path.with_name(FIT_FILE).is_file()
    sigma = scene_sigma_beside(path, scene, dewarped=False) if path is not None and fitted else "no fit"
    try:
        lit = shown if shown.sheet is None else scene.in_light_sheet()
    except SceneError:  # `correct` reports it: the glass may stand elsewhere then
        return None, []
    views = double_views(lit, ray_map if lit is shown else None, SHEET_STEP)
    forecast = sheet_forecast(lit, views, None if isinstance(sigma, str) else sigma)
    return forecast, sentences_of(double_view_forecast(lit, views.at(views.free(AROUND))))


def _plane_table(title: str, share: PlaneShare) -> Table:
    """Return the table of recovered and lost areas of the plane."""
    width, height = share.size_mm
    columns = (f"of the plane, {width:.1f} x {height:.1f} mm", "area [mm\u00b2]", "share")
    rows = [("recovered", share.recovered_mm2), ("  seen directly", share.direct_mm2)]
    rows.append(("  through glass", share.glass_mm2))
    lost = [(MEANING[each], area) for each, area in share.areas_mm2.items() if each != NodeStatus.RECOVERED]
    rows += [("not recovered", share.whole_mm2 - share.recovered_mm2), *((f"  {why}", area) for why, area in lost)]
    texts = [(name, f"{area:.1f}", f"{100.0 * area / share.whole_mm2:.2f} %") for name, area in rows]
    return Table(title, columns, texts)


def _body_table(share: PlaneShare) -> Table:
    """Return the table of what each body hides, what is recovered of it, and what is seen through it."""
    unseen = len(share.bodies) - SHOWN_BODIES
    more = f"; {unseen} smaller ones are left out" if unseen > 0 else ""
    columns = (
        "body",
        "hides [mm\u00b2]",
        "recovered",
        "lost [mm\u00b2]",
        "mainly lost",
        "seen through it [mm\u00b2]",
    )
    largest = sorted(share.bodies, key=lambda body: -body.outline_mm2)[:SHOWN_BODIES]
    rows = [_body_row(body) for body in largest]
    return Table("area of the plane hidden by each body" + more, columns, rows, left=(0, 4))


def _light_table(lit: LitGaps) -> Table:
    """Return the table of the gas around each ball: what is seen and lit of it."""
    title = (
        f"gas within {RING:g} R of each ball; lit: {LEAST_BRIGHTNESS:g} to {MOST_BRIGHTNESS:g} times the"
        f" undisturbed sheet; {percent(lit.reflected)} of the light is reflected and not followed"
    )
    columns = ("ball", "gas [mm\u00b2]", "seen", "lit", "lit and seen", "brightness", "height [mm]")
    rows = [
        (
            short(side.name, LONGEST_BODY_NAME),
            f"{side.gas_mm2:.1f}",
            percent(side.seen),
            percent(side.lit),
            percent(side.both),
            *((f"{side.brightness:.2f}", f"{side.height_mm:+z.3f}") if side.lit else ("-", "-")),
        )
        for side in sorted(lit.balls, key=lambda side: -side.gas_mm2)[:SHOWN_BODIES]
    ]
    return Table(title, columns, rows)


def _body_row(body: BodyShare) -> tuple[str, ...]:
    name = short(body.name, LONGEST_BODY_NAME)
    if not body.outline_mm2:
        return name, "0", "-", "-", "out of view", f"{body.shown_mm2:.1f}"
    share = f"{100.0 * body.recovered_mm2 / body.outline_mm2:.1f} %"
    why = MEANING[body.main_loss] if body.main_loss is not None else "-"
    shows = f"{body.shown_mm2:.1f}" if body.is_glass else "opaque"
    return name, f"{body.outline_mm2:.1f}", share, f"{body.outline_mm2 - body.recovered_mm2:.1f}", why, shows


def _radial_table(view: FieldOfView) -> Table:
    """Figures of spheres in a row, as Martins et al. (2018) give them."""
    radius = view.radius_mm
    rows = [
        ("share of a ball's cross-section seen through it (FOV_in)", f"{100.0 * view.inside:.1f} %"),
        ("share of the square around its silhouette (FOV_total)", f"{100.0 * view.total:.1f} %"),
        ("recovered up to, from the axis on the plane (r_o/R)", f"{view.edge_mm / radius:.3f}"),
        (
            "where that is seen: at a fold (r_i/R)" if view.folds else "where that is seen: at the edge (r_i/R)",
            f"{view.fold_mm / radius:.3f}",
        ),
        ("silhouette of the balls (r_red/R)", f"{view.silhouette_mm / radius:.3f}"),
        ("enlarged at the centre by (r_i/r_o)", f"{view.centre_magnification:+.3f}"),
        ("distance of the camera (L/R)", f"{view.distance_mm / radius:.3g}"),
    ]
    return Table("balls in a row; lengths in radii R of the balls", ("", "value"), rows)
