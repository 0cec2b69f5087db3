"""Where corrected pixels lie on the plane: where a camera straight above sees them without glass."""

import numpy as np
import pytest

from correction.grid import PlaneGrid, grid_of
from tracer.camera import Camera, look_at

PLACE_MM, PRINCIPAL_PX = (31.0, -22.0, 480.0), (210.0, 95.0)


def camera(rotation):
    return Camera(4800.0, PRINCIPAL_PX, (400, 300), PLACE_MM, rotation)


def test_a_corrected_pixel_is_the_pixel_of_a_camera_straight_above():
    above = camera(look_at(PLACE_MM, (PLACE_MM[0], PLACE_MM[1], 0.0)))
    grid = grid_of(above)
    assert (grid.shape, grid.pitch_mm) == ((300, 400), pytest.approx(0.1))
    nodes = np.concatenate((grid.nodes_mm(), np.zeros((*grid.shape, 1))), axis=-1)
    rows, columns = np.indices(grid.shape)
    assert np.abs(above.project(nodes) - np.stack((columns, rows), axis=-1)).max() < 1e-9


def test_the_principal_point_keeps_its_place_however_the_camera_is_tilted():
    aim = (3.0, 2.0)
    assert grid_of(camera(look_at(PLACE_MM, (*aim, 0.0), 0.2))).to_px(np.array(aim)) == pytest.approx(PRINCIPAL_PX)


def test_pixels_and_millimetres_are_each_others_inverse():
    grid = PlaneGrid((-40.0, 25.0), 0.2, (30, 20))
    assert grid.to_px(np.array([-38.0, 24.0])) == pytest.approx([10.0, 5.0])
    assert grid.to_mm(np.array([10.0, 5.0])) == pytest.approx([-38.0, 24.0])
    assert grid.nodes_mm()[5, 10] == pytest.approx([-38.0, 24.0])
