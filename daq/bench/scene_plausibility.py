"""Plausibility questions about a scene: allowed but unusual values, each with its line and the likely slip.

Nothing here refuses anything: a microscope, a vessel of two metres and a line camera are scenes like others.  A
number in the wrong unit mostly passes every bound, but not what belongs together: the sensor's size, what the
camera sees of the plane, the bodies in its picture, the distance in focus, the sheet of light.  Lengths are
compared with each other, so that a small lab is asked as seldom as a large one.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ground.config import Place, open_document, validate
from ground.errors import ConfigError, Problem
from ground.plain_words import slip
from ground.usual import Usual, plausibility_questions, question
from tracer.bodies import Body, Sphere
from tracer.camera import Camera
from tracer.errors import SceneError
from tracer.scene.scene import Scene
from tracer.scene.scene_file import scene_from
from tracer.scene.scene_tables import SceneTable
from tracer.scene.view import distortion

Asked = Iterator[tuple[Place, str]]

DIAGONAL_MM = Usual(2.5, 95.0)  # of sensors; line cameras reach 82 mm
LONGEST_SHAPE, SHORTEST_PX = 4.0, 100  # longer side over shorter side
ANGLE_DEG = Usual(0.2, 100.0)  # across the longer side of the picture
MOST_DISTORTED = 0.05  # share by which lens terms move the corner of a picture
OFF_MIDDLE = 0.25  # share of the sensor between its middle and the optical axis
FOCUS = Usual(0.5, 2.0)  # distance in focus over distance of the plane
AIRY_PX = 6.0  # radius of the diffraction disc
LEAST_SHARE, MOST_SHARE = 0.2, 2.5  # all bodies together, and the largest of them, over the longer side
ALONE = 2.0  # diameters between a body and what is nearest to it
OUTLIER = 5.0  # between the radius of a ball and the median of all
THINNEST_CORE = 0.2  # radius of a core over that of its ball
WALL = Usual(0.005, 0.4)  # of a tube, over its radius
LIGHT_NODES = 64  # along the longer side, to see whether the light of a sheet reaches the view
SHEET_Z, SHEET_THICKNESS = 0.02, Usual(0.001, 0.05)  # over what the camera sees of the plane


def scene_questions(path: Path | str) -> list[str]:
    """Ask about what is unusual in a scene file.

    Parameters
    ----------
    path : path
        A scene file that `load_scene` reads.

    Returns
    -------
    list of str
        Questions with file and line, in the order of the lines; empty for a usual lab.

    Raises
    ------
    ConfigError
        The file is wrong, or no light of its sheet reaches the view.
    """
    document = open_document(path)
    table = validate(document, SceneTable)
    scene = scene_from(document, table)
    try:
        related = [*_camera_asked(table, scene), *_bodies_asked(scene), *_sheet_asked(scene)]
    except SceneError as error:  # bodies keep the light from the view
        raise ConfigError(path, [Problem(document.line(("sheet",)), f"sheet: {error}")]) from None
    asked = [*plausibility_questions(document, table), *(Problem(document.line(at), text) for at, text in related)]
    return [f"{path}:{one.line}: {one.text}" for one in sorted(asked, key=lambda one: one.line)]


def bodies_in_picture(scene: Scene) -> list[str]:
    """Names of the bodies that reach into the picture, as if nothing bent the view."""
    return [body.name for body in scene.bodies if _is_seen(scene.camera, _disc_px(scene.camera, body))]


def _camera_asked(table: SceneTable, scene: Scene) -> Asked:
    said, camera = table.camera, scene.camera
    width, height = camera.sensor_px
    if max(width, height) > LONGEST_SHAPE * min(width, height) or min(width, height) < SHORTEST_PX:
        yield ("camera", "sensor_px"), f"sensor_px: is a sensor of {width} x {height} px right?"
    if said.pixel_pitch_um is not None:
        diagonal_mm = float(np.hypot(width, height)) * said.pixel_pitch_um * 1e-3
        if asked := question("diagonal_mm", diagonal_mm, DIAGONAL_MM):
            text = f"sensor_px x pixel_pitch_um: the sensor's diagonal in mm: {asked}"
            yield ("camera", "pixel_pitch_um"), text
    angle_deg = 2.0 * float(np.rad2deg(np.arctan(0.5 * max(width, height) / camera.focal_px)))
    if asked := question("angle", angle_deg, ANGLE_DEG):
        yield ("camera",), f"camera: the angle of view in degrees: {asked} (focal length, pixels)"
    if (share := distortion(camera)) > MOST_DISTORTED:
        yield ("camera", "lens"), f"lens: do its terms move the corner of the picture by {100.0 * share:.0f} %?"
    off = np.abs((np.array(camera.principal_px) + 0.5) / camera.sensor_px - 0.5)
    if off.max() > OFF_MIDDLE:
        text = (
            f"principal_px: is the optical axis {off.max():.2g} sensors off the middle, as of a part of a sensor?"
        )
        yield ("camera", "principal_px"), text
    distance_mm, pupil = _distance_mm(camera), camera.pupil
    for key, focus_mm in (("L_mm", said.L_mm), ("focus_mm", said.focus_mm)):
        if focus_mm is not None and not FOCUS.low <= focus_mm / distance_mm <= FOCUS.high:
            text = f"{key} is {focus_mm:g}, and the plane is {distance_mm:.5g} mm away: is one of them a slip?"
            yield ("camera", key), f"camera: {text}"
    if pupil is not None:
        airy_px = 1.22 * scene.wavelength_nm * 1e-6 * camera.focal_px / (2.0 * pupil.radius_mm)
        if airy_px > AIRY_PX:
            text = (
                f"is the aperture so small? Diffraction makes discs of {airy_px:.2g} px radius of every particle"
            )
            yield ("camera", "f_number" if said.f_number is not None else "pupil_mm"), f"camera: {text}"


def _bodies_asked(scene: Scene) -> Asked:
    camera, side_px = scene.camera, max(scene.camera.sensor_px)
    places = {body.name: index for index, body in enumerate(scene.bodies)}
    lenses = [body for body in scene.bodies if body.media and body.room is None]
    discs = {body.name: _disc_px(camera, body) for body in lenses}
    seen = [name for name, disc in discs.items() if _is_seen(camera, disc)]
    if lenses and not seen:
        text = (
            "camera: none of the bodies is in the picture: is one of position_mm, look_at_mm, focal length right?"
        )
        yield ("camera",), text
    elif lenses:
        low = np.min([discs[body.name][:2] - discs[body.name][2] for body in lenses], axis=0)
        high = np.max([discs[body.name][:2] + discs[body.name][2] for body in lenses], axis=0)
        sizes = "is one of the focal length, the distance, the pixels and the sizes of bodies a slip?"
        if (share := float((high - low).max()) / side_px) < LEAST_SHARE:
            yield (
                ("camera",),
                f"camera: all bodies together fill {share:.1%} of the picture's longer side: {sizes}",
            )
        widest = max(lenses, key=lambda body: float(discs[body.name][2]))
        if (share := 2.0 * float(discs[widest.name][2]) / side_px) > MOST_SHARE:
            picture_mm = _field_of_view_mm(camera)
            text = f"{widest.name} is {share:.3g} times as large as the picture, {picture_mm:.3g} mm: {sizes}"
            yield ("bodies", places[widest.name]), text
    if lenses and all(body.highest_mm <= 0.0 for body in lenses):
        yield ("bodies",), "bodies: all stand behind the plane z = 0, where none is seen: is the sign of z right?"
    crossing = scene.spheres_in_plane
    if len(crossing) == 1 < len(scene.spheres):
        text = f"reaches {-crossing[0].lowest_mm:.4g} mm through the plane, as no other ball does: is z right?"
        yield ("bodies", places[crossing[0].name]), f"{crossing[0].name}: {text}"
    radii = [body.radius_mm for body in Sphere.among(scene.bodies)]
    middle_mm = float(np.median(radii)) if radii else 0.0
    for body in lenses:
        at, size_mm = ("bodies", places[body.name]), 2.0 * body.capsule.radius_mm
        others = [other for other in scene.bodies if other is not body and other.room is None]
        centre = 0.5 * (np.array(body.capsule.start_mm) + np.array(body.capsule.end_mm))
        gaps = [float(other.distance_mm(centre)) - 0.5 * size_mm for other in others]
        nearest_mm = min(gaps, default=np.inf)
        if min(nearest_mm, max(body.lowest_mm, 0.0)) > ALONE * size_mm:
            times = min(nearest_mm, body.lowest_mm) / size_mm
            yield at, f"{body.name}: is it {times:.3g} of its diameters away from the plane and from all else?"
        elif seen and body.name not in seen and nearest_mm > size_mm:
            hint = slip("mm", nearest_mm, 0.2 * size_mm, 5.0 * size_mm)
            text = f"is it outside of the picture, and {nearest_mm:.4g} mm from all other bodies{hint or '?'}"
            yield at, f"{body.name}: {text}"
    for ball in Sphere.among(lenses):
        at = ("bodies", places[ball.name])
        if not middle_mm / OUTLIER <= ball.radius_mm <= middle_mm * OUTLIER:
            text = (
                f"{ball.name}: is radius_mm {ball.radius_mm:g} right? Half of the balls have {middle_mm:g} or more"
            )
            yield (*at, "radius_mm"), text
        if ball.cores and ball.cores[0].radius_mm < THINNEST_CORE * ball.radius_mm:
            yield (*at, "core"), f"{ball.name}: has its core only {ball.cores[0].radius_mm:g} mm radius?"
    for body in scene.bodies:
        at = ("bodies", places[body.name])
        if body.kind == "rod" and radii and body.capsule.radius_mm > max(radii):
            yield at, f"{body.name}: is radius_mm {body.capsule.radius_mm:g} right? It is thicker than every ball"
        if body.kind == "tube":
            outer_mm, inner_mm = getattr(body, "outer_radius_mm"), getattr(body, "inner_radius_mm")  # noqa: B009
            if asked := question("wall", 1.0 - inner_mm / outer_mm, WALL):
                yield at, f"{body.name}: the wall over the outer radius: {asked}"
            if 2.0 * outer_mm < LEAST_SHARE * (picture_mm := _field_of_view_mm(camera)):
                text = f"is outer_radius_mm {outer_mm:g} right? The picture is {picture_mm:.3g} mm wide"
                yield at, f"{body.name}: {text}"


def _sheet_asked(scene: Scene) -> Asked:
    sheet, seen_mm = scene.sheet, _field_of_view_mm(scene.camera)
    if sheet is None:
        return
    try:
        lit = scene.in_light_sheet()
    except SceneError as error:  # bodies may stand elsewhere while the sheet is on
        yield ("sheet",), f"sheet: {error}"
        return
    if sheet.sources:
        from correction.grid import grid_of  # compiled kernels, for scenes that need them
        from correction.maps.lit import light_of

        light_of(lit, grid_of(lit.camera).every(-(-max(lit.camera.sensor_px) // LIGHT_NODES)))
    if abs(sheet.z_mm) > SHEET_Z * seen_mm and not (lit.spheres_in_plane and sheet.sources):
        text = f"is z_mm {sheet.z_mm:g} right, {abs(sheet.z_mm) / seen_mm:.1%} of what the camera sees?"
        yield ("sheet", "z_mm"), f"sheet: {text}"
    usual = Usual(SHEET_THICKNESS.low * seen_mm, SHEET_THICKNESS.high * seen_mm)
    if sheet.thickness_mm is not None and (asked := question("thickness_mm", sheet.thickness_mm, usual)):
        yield ("sheet", "thickness_mm"), f"sheet.thickness_mm: {asked}"


def _distance_mm(camera: Camera) -> float:
    """From the pinhole to the plane, along the optical axis."""
    return camera.position_mm[2] / max(-float(camera.rotation_matrix[2][2]), 1e-3)


def _field_of_view_mm(camera: Camera) -> float:
    """Field of view along the longer side of the picture, without glass [mm]."""
    return max(camera.sensor_px) * _distance_mm(camera) / camera.focal_px


def _disc_px(camera: Camera, body: Body) -> NDArray[np.float64]:
    """Place and radius (3,) of a disc around a body in the picture [px], as if nothing bent the view."""
    capsule = body.capsule
    ends = (np.array([capsule.start_mm, capsule.end_mm]) - camera.position_mm) @ camera.rotation_matrix.T
    depth = np.maximum(ends[:, 2:], 1e-3)  # beside or behind the pinhole: far outside
    places = np.array(camera.principal_px) + camera.focal_px * ends[:, :2] / depth
    radius = 0.5 * np.linalg.norm(places[1] - places[0]) + camera.focal_px * capsule.radius_mm / depth.min()
    return np.array([*places.mean(axis=0), radius])


def _is_seen(camera: Camera, disc_px: NDArray[np.float64]) -> bool:
    """Return whether a disc reaches into the picture."""
    middle = 0.5 * (np.array(camera.sensor_px) - 1.0)
    beside = np.maximum(np.abs(disc_px[:2] - middle) - 0.5 * np.array(camera.sensor_px), 0.0)
    return bool(np.linalg.norm(beside) <= disc_px[2])
