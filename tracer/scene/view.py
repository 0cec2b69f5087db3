"""Views that cannot be: what no camera shows is refused where the scene file is read.

A `Scene` itself may hold such a view, because stages move its parts and a fit tries poses.  A file that says one
was meant otherwise: a sign is wrong, or an angle is in the wrong unit.  Opaque bodies may stand anywhere: they
count for keep-out.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from tracer.bodies import Body
from tracer.camera import Camera
from tracer.light_sheet import LightSheet

COARSEST_PX = 0.1  # what a mesh may be off in the picture of the plane
LEAST_ANGLE_DEG = 5.0  # between axis and plane; PIV through glass is rarely done below 45
REACHES_MM = 1e-6
FARTHEST_MM = 1e5  # a hundred metres: no lab is longer
FEWEST_PX = 16  # along the longer side of a sensor
MOST_DISTORTED = 100.0  # distances from the axis by which lens terms may move a corner: far above any lens
VIEW_POINTS = 33  # along each side of a frame: gas is looked for there
NM = 550.0  # any light will do for an estimate


def view_problems(camera: Camera, bodies: Iterable[Body]) -> list[tuple[str, str]]:
    """Return what is wrong with a view: name of the body at fault, empty for the camera, and a sentence.

    Parameters
    ----------
    camera : Camera
        It stands before the plane.
    bodies : iterable of Body
        What stands around.
    """
    axis = camera.rotation_matrix[2]
    pinhole_mm = np.array(camera.position_mm)
    angle_deg = math.degrees(math.asin(min(1.0, max(-1.0, -float(axis[2])))))
    problems = []
    if angle_deg <= 0.0:
        text = "the camera looks away from the investigation plane z = 0; let it look_at_mm a point of the plane"
        problems.append(("", text))
    elif angle_deg < LEAST_ANGLE_DEG:
        text = (
            f"the camera sees the investigation plane edge-on: its axis is {angle_deg:.2g} degrees off the plane"
        )
        problems.append(("", f"{text}, and {LEAST_ANGLE_DEG:g} are the least"))
    if max(camera.sensor_px) < FEWEST_PX:
        text = f"a sensor of {camera.sensor_px[0]} x {camera.sensor_px[1]} px shows nothing; is sensor_px right?"
        problems.append(("", text))
    if float(np.abs(pinhole_mm).max()) > FARTHEST_MM:
        problems.append(("", f"the camera is farther than {FARTHEST_MM:g} mm away; um for mm?"))
    if (share := distortion(camera)) > MOST_DISTORTED:
        text = f"the lens terms move a corner of the picture by {100.0 * share:.3g} %, which no lens does"
        problems.append(("", f"{text}; they belong to radii in units of the focal length"))
    bodies = tuple(bodies)
    if angle_deg > 0.0 and (around := _names_around_view(camera, bodies)):
        text = f"all that the camera sees of the investigation plane lies inside body {_in_quotes(around)}"
        problems.append((around[0], f"{text}; let the plane cut the gas beside it"))
    for body in bodies:
        if float(np.abs([body.capsule.start_mm, body.capsule.end_mm]).max()) > FARTHEST_MM:
            problems.append((body.name, f"body {body.name!r} is farther than {FARTHEST_MM:g} mm away; um for mm?"))
        if not body.media:
            continue
        if (expected_px := surface_error_px(camera, body)) > COARSEST_PX:
            text = (
                f"{body.kind} {body.name!r} knows its slope to {1e6 * body.slope_rad:.0f} urad,"
                f" {expected_px:.2g} px in the picture, and {COARSEST_PX:g} are the most; give it more points and"
                " exact normals or, for a scan, fit a smooth shape to it"
            )
            problems.append((body.name, text))
        if angle_deg > 0.0 and _is_behind(pinhole_mm, axis, body):
            text = f"body {body.name!r} lies behind the camera, which cannot see through it; move one of them"
            problems.append((body.name, text))
    return problems


def sheet_problem(camera: Camera, bodies: Sequence[Body], sheet: LightSheet) -> str:
    """Return why a camera can see nothing in a light sheet, as a sentence; empty if it may.

    Parameters
    ----------
    camera, bodies
        In the coordinates of the sheet.
    sheet : LightSheet
        For its sources, and to be named.
    """
    if around := _names_around_view(camera, bodies):
        where = f"the light sheet at z = {sheet.z_mm:g} mm lies inside body {_in_quotes(around)}"
        return f"all that the camera sees of {where}; correct z_mm or the body"
    places = _view_mm(camera)
    for source in sheet.sources:
        who = f"the light sheet from {source.from_deg:g} degrees"
        if places is not None and not source.meets(places):
            return (
                f"{who} never reaches the view; its width_mm of {source.width_mm:g} is about the origin: correct"
                " from_deg or width_mm"
            )
        if not source.bend_per_mm:
            continue
        apex_mm = source.comes_from / source.bend_per_mm
        for body in bodies:
            if body.distance_mm(apex_mm) < 0.0:
                return (
                    f"{who} starts {1.0 / source.bend_per_mm:.0f} mm from the origin, inside body {body.name!r},"
                    " by its width_mm there and its fan_deg: correct either"
                )
    return ""


def _names_around_view(camera: Camera, bodies: Iterable[Body]) -> list[str]:
    """Names of the bodies inside which all that a camera sees of z = 0 lies, so that nothing flows there."""
    if (places := _view_mm(camera)) is None:
        return []
    inside = {body.name: body.distance_mm(places) < 0.0 for body in bodies if body.may_cross_plane}
    if not np.any(list(inside.values()), axis=0).all():
        return []
    return [name for name, here in inside.items() if here.any()]


def _in_quotes(names: list[str]) -> str:
    return " and ".join(map(repr, names))


def distortion(camera: Camera) -> float:
    """Displacement of a corner of the picture by lens terms, over its distance from the axis."""
    if camera.lens.is_ideal:
        return 0.0
    axis_px, (width, height) = np.array(camera.principal_px), camera.sensor_px
    corners = np.array([(u, v) for u in (-0.5, width - 0.5) for v in (-0.5, height - 0.5)])
    moved_px = np.linalg.norm(camera.ideal(corners) - corners, axis=-1)
    return float(moved_px.max() / np.linalg.norm(corners - axis_px, axis=-1).max())


def surface_error_px(camera: Camera, body: Body) -> float:
    """Error of the plane seen through a body, rms, from the slope uncertainty it states (`Body.slope_rad`).

    A slope wrong by s turns a ray by (n - 1) s, which is (n - 1) s z on the plane, at both faces.
    """
    if body.slope_rad == 0.0:
        return 0.0
    turned = (body.media[0][1].n(NM) - 1.0) * body.slope_rad
    px_per_mm = camera.focal_px / max(abs(camera.position_mm[2]), REACHES_MM)
    return turned * math.hypot(body.highest_mm, body.lowest_mm) * px_per_mm


def _view_mm(camera: Camera) -> "np.typing.NDArray[np.float64] | None":
    """Points (N, 3) of the plane z = 0 all over what the frame would see without glass; None beside it."""
    u, v = (np.linspace(-0.5, side - 0.5, VIEW_POINTS) for side in camera.sensor_px)
    rays = camera.directions(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    if not (rays[:, 2] < 0.0).all():
        return None
    return np.asarray(np.array(camera.position_mm) - (camera.position_mm[2] / rays[:, 2:]) * rays)


def _is_behind(
    pinhole_mm: "np.typing.NDArray[np.float64]", axis: "np.typing.NDArray[np.float64]", body: Body
) -> bool:
    """Return whether a body lies wholly behind the plane through the pinhole across the camera's axis."""
    capsule = body.capsule
    ahead_mm = max(float((np.array(end) - pinhole_mm) @ axis) for end in (capsule.start_mm, capsule.end_mm))
    return ahead_mm + capsule.radius_mm <= 0.0
