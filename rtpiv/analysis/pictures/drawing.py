"""The scene drawn to scale: from the side with the camera, from the camera, and cut where the rays lie."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.patches import Circle, Patch, Polygon

from rtpiv.analysis.pictures.plane_axes import INK, MOST_NAMES, SOFT, Figure, add_axes_in, bare, outline_mm
from rtpiv.analysis.pictures.saved import save_picture, short
from rtpiv.analysis.pictures.section import (
    BESIDE,
    GLASS,
    STOPPED,
    Floats,
    Ray,
    Section,
    fan,
    is_central,
    reach_mm,
    sections_of,
)
from tracer.bodies import Body, Sphere
from tracer.scene.scene import Scene

WIDTH_IN = 8.4
BLUE, STEEL = "#8fb7d3", "#5c667a"
RAY = {GLASS: ("#dd7a3a", 0.8), BESIDE: ("#b9c0cc", 0.6), STOPPED: ("#1d2433", 0.6)}
RASTER = 240  # points along each side of a cut through a support
CAPTION = (
    "To scale. Blue: glass; grey: opaque; thick line: the plane. Orange rays pass through glass, pale ones beside"
    " it, black ones never reach the plane. A cut shows bodies where it meets them, and rays as far as they stay"
    " in it: a dot where one leaves."
)


def scene_figure(scene: Scene) -> Figure:
    """Draw a scene: side view, view from the camera with the cuts marked, and below the cuts with their rays."""
    cuts = sections_of(scene)
    reach = reach_mm(scene, cuts[0])
    frames = [_frame(scene, cut) for cut in cuts]
    corners = _view_corners(scene)
    width, height = corners.max(axis=0) - corners.min(axis=0)
    upper = max((reach[1] - reach[0]) / scene.camera.position_mm[2] * 0.58, 0.27 * height / width)
    lower = 0.86 * max((high - low) / (1.05 * top) for low, high, top in frames) / len(cuts)
    tall = [float(np.clip(share, 0.16, 0.62)) for share in (upper, lower)]
    above, below, between = 0.35, 0.55, 0.7  # inches for titles and labels
    upper_in, lower_in = (WIDTH_IN * share for share in tall)
    figure = Figure(figsize=(WIDTH_IN, upper_in + lower_in + 2.0 * (above + below)))
    inner, high = WIDTH_IN - between - 0.1, 2.0 * below + lower_in + above
    wide = 0.68 * (inner - between)
    _from_the_side(add_axes_in(figure, between, high, wide, upper_in), scene, cuts[0], reach)
    beside = 2.0 * between + wide
    _from_the_camera(add_axes_in(figure, beside, high, WIDTH_IN - beside - 0.1, upper_in), scene, cuts, corners)
    each = (inner + between) / len(cuts)
    for number, (cut, frame) in enumerate(zip(cuts, frames, strict=True)):
        place = between + number * each
        _cut(add_axes_in(figure, place, below, each - between, lower_in), scene, cut, frame)
    return figure


def draw_scene(path: Path, scene: Scene) -> None:
    """Draw `scene_figure` as PNG."""
    save_picture(scene_figure(scene), path, 130)


def _from_the_side(axes: Axes, scene: Scene, cut: Section, reach: tuple[float, float]) -> None:
    """Everything with the camera, seen at right angles to the first cut."""
    place = cut.within(np.array(scene.camera.position_mm))
    cone = [(0.0, reach[0]), (0.0, reach[1]), (place[1], place[0])]
    axes.add_patch(Polygon(cone, color="#f3e3d6", lw=0, zorder=0))
    _add(axes, [_shadow(body, cut) for body in scene.seen], [_colour(body) for body in scene.seen], 0.8)
    axes.plot([0.0, 0.0], reach, color=INK, linewidth=2.0)
    axes.annotate("plane", (0.0, reach[1]), (0, 4), textcoords="offset points", ha="center", fontsize=8, color=INK)
    box = 0.035 * float(place[1])
    x, s = float(place[1]), float(place[0])
    axes.add_patch(Polygon([(x, s), (x + box, s - box), (x + box, s + box)], color=INK, lw=0))
    axes.annotate(
        f"camera, pinhole at z = {place[1]:.6g} mm",
        (x + box, s + box),
        (0, 4),
        textcoords="offset points",
        ha="right",
        fontsize=8,
        color=INK,
    )
    low, high = min(reach[0], s - 2 * box), max(reach[1], s + 2 * box)
    margin = 0.06 * (high - low)
    axes.set(xlim=(-0.04 * x, x + 1.5 * box), ylim=(low - margin, high + 3 * margin), aspect="equal")
    _label(axes, "z [mm]", _along(cut), "side view")


def _from_the_camera(axes: Axes, scene: Scene, cuts: Sequence[Section], corners: Floats) -> None:
    """Outlines of the bodies on the plane, as the pinhole sees them, and where the cuts go."""
    seen = [(body, outline_mm(body, scene.camera.position_mm)) for body in scene.seen]
    known = [(body, outline) for body, outline in seen if outline is not None and body.room is None]
    known.sort(key=lambda pair: pair[0].highest_mm)
    _add(axes, [Polygon(outline) for _, outline in known], [_colour(body) for body, _ in known], 0.5)
    axes.add_patch(Polygon(corners, fill=False, edgecolor=INK, linewidth=1.2))
    low, high = corners.min(axis=0), corners.max(axis=0)
    room = 0.07 * float(high[1] - low[1])
    taken: list[tuple[float, float]] = []
    for body, outline in known[:MOST_NAMES]:
        shown = np.clip(outline, low, high)  # a rod may leave the picture: its name stands on what is seen of it
        x, y = (0.5 * (shown.min(axis=0) + shown.max(axis=0))).tolist()
        while any(abs(y - other_y) < room and abs(x - other_x) < 4.0 * room for other_x, other_y in taken):
            y -= room
        taken.append((x, y))
        axes.text(x, y, short(body.name), ha="center", va="center", fontsize=8, color=INK, parse_math=False)
    for cut in cuts:
        ends = np.array(reach_mm(scene, cut))
        line = cut.foot_mm + ends[:, None] * cut.along
        axes.plot(*line.T, color="#b4472f", linewidth=1.0, linestyle="-.")
        for end, side in zip(line, ("right", "left"), strict=True):
            axes.annotate(cut.letter, end, color="#b4472f", fontsize=9, ha=side, va="bottom", fontweight="bold")
    margin = 0.06 * (high - low)
    axes.set(xlim=(low[0] - margin[0], high[0] + margin[0]), ylim=(low[1] - margin[1], high[1] + margin[1]))
    axes.set_aspect("equal")
    _label(axes, "x [mm]", "y [mm]", "from the camera")


def _cut(axes: Axes, scene: Scene, cut: Section, frame: tuple[float, float, float]) -> None:
    """One cut: bodies where it meets them, and rays as far as they stay in it."""
    (low, high, top), view, balls = frame, reach_mm(scene, cut), _balls_cut(scene, cut)
    _draw_rays(axes, fan(scene, cut, max(low, view[0]), min(high, view[1])))
    patches, colours = [], []
    for ball in balls:
        s, z = cut.within(np.array(ball.centre_mm))
        off = float(cut.beside(np.array(ball.centre_mm)))
        radii = [ball.radius_mm, *(core.radius_mm for core in ball.cores)]
        shades = [_colour(ball), *(_shade(core.medium.n(scene.wavelength_nm)) for core in ball.cores)]
        for radius, shade in zip(radii, shades, strict=True):
            if abs(off) < radius:
                patches.append(Circle((z, s), float(np.sqrt(radius**2 - off**2))))
                colours.append(shade)
        if len(balls) <= MOST_NAMES:
            name = short(ball.name) + ("" if is_central(cut, ball) else f"\n{abs(off):.2g} mm off")
            axes.text(
                z,
                s,
                name,
                ha="center",
                va="center",
                fontsize=8,
                color=INK if ball.media else "white",
                parse_math=False,
                zorder=5,
                clip_on=True,
            )
    _add(axes, patches, colours, 0.55)
    axes.set(xlim=(-0.05 * top, top), ylim=(low, high), aspect="equal")
    for body in scene.others:
        _draw_support(axes, body, cut)
    axes.axvline(0.0, color=INK, linewidth=2.0)
    _label(axes, "z [mm], camera to the right", _along(cut), f"cut {cut.letter}")


def _balls_cut(scene: Scene, cut: Section) -> list[Sphere]:
    """Balls that a cut meets."""
    return [ball for ball in scene.spheres if abs(cut.beside(np.array(ball.centre_mm))) < ball.radius_mm]


def _frame(scene: Scene, cut: Section) -> tuple[float, float, float]:
    """From where to where in s, and how high, a cut is drawn [mm]: the balls that it goes through, with room."""
    view, balls = reach_mm(scene, cut), _balls_cut(scene, cut)
    if not balls:
        return view[0], view[1], 1.3 * max((body.highest_mm for body in scene.seen), default=view[1] - view[0])
    middles = [(float(cut.within(np.array(ball.centre_mm))[0]), ball.radius_mm) for ball in balls]
    supports = [body.capsule for body in scene.others]
    for start, end, radius in supports:  # that go through the cut
        one, other = cut.beside(np.array([start, end]))
        if one * other < 0.0:
            crossing = np.array(start) + one / (one - other) * (np.array(end) - np.array(start))
            middles.append((float(cut.within(crossing)[0]), radius))
    low, high = min(m - 1.3 * r for m, r in middles), max(m + 1.3 * r for m, r in middles)
    return max(low, view[0]), min(high, view[1]), 1.3 * max(ball.highest_mm for ball in balls)


def _draw_rays(axes: Axes, rays: Sequence[Ray]) -> None:
    """Draw rays as one artist of each fate, and a dot where one leaves the cut."""
    for fate, (colour, width) in RAY.items():
        lines = [ray.corners_mm[:, ::-1] for ray in rays if ray.fate == fate]
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=width), autolim=False)
    ends = np.array([ray.corners_mm[-1, ::-1] for ray in rays if ray.leaves]).reshape(-1, 2)
    axes.plot(*ends.T, ".", color=RAY[GLASS][0], markersize=3, zorder=4)


def _draw_support(axes: Axes, body: Body, cut: Section) -> None:
    """Draw where a cut meets a body that is no ball."""
    (z0, z1), (s0, s1) = axes.get_xlim(), axes.get_ylim()
    z, s = np.linspace(z0, z1, RASTER), np.linspace(s0, s1, RASTER)
    points = cut.world(np.stack(np.meshgrid(s, z, indexing="ij"), axis=-1))
    distance = body.distance_mm(points)
    if distance.min() < 0.0:
        levels = [float(distance.min()) - 1.0, 0.0]
        axes.contourf(z, s, distance, levels=levels, colors=[_colour(body)], zorder=2)


def _shadow(body: Body, cut: Section) -> Polygon:
    """Shadow of a body on a cut: the hull of its outline, as z, s."""
    import cv2

    points, radius = body.outline_mm
    ends = cut.within(points)[:, ::-1]
    if radius == 0.0:
        return Polygon(cv2.convexHull(ends.astype(np.float32))[:, 0])
    axis = ends[1] - ends[0]
    turn = float(np.arctan2(axis[1], axis[0]))
    half = np.linspace(0.5 * np.pi, 1.5 * np.pi, 32) + turn
    round_end = radius * np.stack((np.cos(half), np.sin(half)), axis=-1)
    return Polygon(np.vstack((ends[0] + round_end, ends[1] - round_end)))


def _view_corners(scene: Scene) -> Floats:
    """Corners (N, 2) [mm] of what the camera sees of the plane without glass, below the horizon."""
    width, height = scene.camera.sensor_px
    pixels = np.array([(-0.5, -0.5), (width - 0.5, -0.5), (width - 0.5, height - 0.5), (-0.5, height - 0.5)])
    ways, pinhole = scene.camera.directions(pixels), np.array(scene.camera.position_mm)
    ways = ways[ways[:, 2] < -1e-3]
    return np.asarray((pinhole - pinhole[2] / ways[:, 2:] * ways)[:, :2])


def _add(axes: Axes, patches: Sequence[Patch], colours: Sequence[str], alpha: float) -> None:
    drawn = PatchCollection(patches, facecolors=colours, edgecolors=INK, linewidths=0.8, alpha=alpha, zorder=2)
    axes.add_collection(drawn, autolim=False)


def _colour(body: Body) -> str:
    return BLUE if body.media else STEEL


def _shade(n: float) -> str:
    """Colour of a core: the denser, the bluer."""
    share = min(1.0, 2.0 * (n - 1.0))
    blue = np.array([0x8F, 0xB7, 0xD3])
    return "#{:02x}{:02x}{:02x}".format(*np.rint(255 + share * (blue - 255)).astype(int))


def _along(cut: Section) -> str:
    """Return the label of the s axis of a cut."""
    if abs(cut.along[1]) < 1e-9:
        return "x [mm]" if cut.foot_mm[0] == 0.0 else "x from the pinhole's [mm]"
    return f"s along ({cut.along[0]:.2f}, {cut.along[1]:.2f}) [mm]"


def _label(axes: Axes, x: str, y: str, title: str) -> None:
    bare(axes)
    axes.set(xlabel=x, ylabel=y)
    axes.set_title(title, fontsize=10, color=SOFT)
