"""Where the scene says that balls are: their outlines in the raw frame and on the plane, to be drawn over frames.

Where lines of sight touch a ball (``correction.alignment.rim``) is its outline in the raw frame; the same lines,
going on to the plane, are the outline of what the ball hides in the corrected one.  Where a frame shows a ball
beside its outline, it stands elsewhere than the scene says.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.alignment.rim import touched
from correction.grid import grid_of
from tracer.scene.scene import Scene

ANGLES = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
MOST = 24  # balls; what is said of a moment has little room, and more lines hide the picture


def outlines(scene: Scene) -> dict[str, Any]:
    """Lines for the page: name of a picture -> list of closed lines, each with a name and points in its pixels.

    The cross is the origin of the plane.
    """
    grid, largest = grid_of(scene.camera), sorted(scene.spheres, key=lambda ball: -ball.radius_mm)[:MOST]
    origin = np.zeros((1, 3))
    said: dict[str, Any] = {"raw": {"lines": []}, "corrected": {"lines": []}}
    pinhole = np.array(scene.camera.position_mm)
    for ball in largest:
        touch = touched(scene.camera, np.array(ball.centre_mm), ball.radius_mm, ANGLES)
        if not np.isfinite(touch).all():  # the camera stands in it
            continue
        said["raw"]["lines"].append([ball.name, _rounded(scene.camera.project(touch))])
        if (touch[:, 2] < pinhole[2] - 1e-6 * ball.radius_mm).all():
            along = pinhole[2] / (pinhole[2] - touch[:, 2])
            plane = pinhole + (touch - pinhole) * along[:, None]
            said["corrected"]["lines"].append([ball.name, _rounded(grid.to_px(plane[:, :2]))])
    said["raw"]["cross"] = _rounded(scene.camera.project(origin))[0]
    said["corrected"]["cross"] = _rounded(grid.to_px(origin[:, :2]))[0]
    return said


def _rounded(pixels: NDArray[np.float64]) -> list[list[float]]:
    return [[round(float(u), 1), round(float(v), 1)] for u, v in np.nan_to_num(pixels, nan=-1e4)]
