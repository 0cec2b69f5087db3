"""Views that cannot be: what no camera shows is refused where the scene file is read.

A `Scene` itself may hold such a view, because stages move its parts and a fit tries poses.  A file that says one
was meant otherwise: a sign is wrong, or an angle is in the wrong unit.  Opaque bodies may stand anywhere: they
count for keep-out.
"""

import math
from collections.abc import Iterable

import numpy as np

from tracer.bodies import Body
from tracer.camera import Camera

LEAST_ANGLE_DEG = 5.0  # between axis and plane; PIV through glass is rarely done below 45
REACHES_MM = 1e-6


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
    for body in bodies:
        if not body.media:
            continue
        if body.highest_mm <= REACHES_MM:
            text = f"body {body.name!r} lies behind the investigation plane, which no ray passes; is its z right?"
            problems.append((body.name, text))
        elif angle_deg > 0.0 and _is_behind(pinhole_mm, axis, body):
            text = f"body {body.name!r} lies behind the camera, which cannot see through it; move one of them"
            problems.append((body.name, text))
    return problems


def _is_behind(
    pinhole_mm: "np.typing.NDArray[np.float64]", axis: "np.typing.NDArray[np.float64]", body: Body
) -> bool:
    """Whether a body lies wholly behind the plane through the pinhole that the camera's axis is normal to."""
    capsule = body.capsule
    ahead_mm = max(float((np.array(end) - pinhole_mm) @ axis) for end in (capsule.start_mm, capsule.end_mm))
    return ahead_mm + capsule.radius_mm <= 0.0
