"""The focal depth that two balls need, as the paper found it: a wide aperture, the camera travelling along z.

Behind two balls the target's centre comes to a focus of its own, a real image 124.7 mm before the plane (twice the
Gaussian formula of a ball lens, n R / (2 (n - 1)) from its centre), while what is seen beside them is sharp at the
plane.  A single corner of the board fills the view, so that magnification does not change how much edge there is.
"""

from dataclasses import replace

import numpy as np
import pytest

from sim.demo.scenes import demo_scene
from sim.renderer.patterns import Chessboard
from sim.renderer.render import Aperture, render_irradiance

VIEW_PX = 33
LENS = Aperture(60.0, 2.8, 500.0)  # focused 500 mm ahead, wherever the camera stands
BOARD = Chessboard(square_mm=10.0, disc_mm=0.0)


def sharpness(scene, travel_mm):
    """Mean squared gradient of the view along the axis, with the camera moved back."""
    camera = scene.camera
    middle = 0.5 * (VIEW_PX - 1)
    place = (0.0, 0.0, camera.position_mm[2] + travel_mm)
    camera = replace(camera, sensor_px=(VIEW_PX, VIEW_PX), principal_px=(middle, middle), position_mm=place)
    light = render_irradiance(scene.with_camera(camera), BOARD, samples=12, aperture=LENS)
    return float(np.mean(np.sum(np.square(np.gradient(light)), axis=0)))


def best_focus(scene, travels_mm):
    """Vertex of the parabola through the sharpest place of a scan and its neighbours."""
    found = np.array([sharpness(scene, travel) for travel in travels_mm])
    top = int(np.argmax(found))
    assert 0 < top < len(found) - 1, found
    a, b, _ = np.polyfit(travels_mm[top - 1 : top + 2], found[top - 1 : top + 2], 2)
    return -b / (2.0 * a)


def test_two_balls_need_125_mm_of_focal_depth():
    scene = demo_scene("two_spheres_500")
    background = best_focus(scene.with_bodies(()), np.arange(-8.0, 8.1, 4.0))
    centre = best_focus(scene, np.arange(108.0, 140.1, 8.0))
    assert background == pytest.approx(0.0, abs=1.0)
    assert centre - background == pytest.approx(124.7, abs=3.0)
