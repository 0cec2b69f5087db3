"""Outlines of what stands between camera and plane, and of what stands around the camera."""

from pathlib import Path

import numpy as np

from rtpiv.analysis.pictures.plane_axes import outline_mm
from tests.tracer.drawn_meshes import ball_points
from tracer.bodies import Dome, Mesh, Sphere
from tracer.bodies.mesh_file import MeshFile
from tracer.media import ConstantMedium

GLASS = ConstantMedium(1.5)


def test_a_dome_around_the_camera_has_no_outline() -> None:
    assert outline_mm(Dome("port", (0.0, 0.0, 300.0), 80.0, 70.0, GLASS), (0.0, 0.0, 300.0)) is None
    assert outline_mm(Dome("flask", (0.0, 0.0, 100.0), 80.0, 70.0, GLASS), (0.0, 0.0, 300.0)) is not None


def test_a_mesh_of_a_ball_has_the_outline_of_the_ball(tmp_path: Path) -> None:
    mesh = Mesh("mesh", tmp_path, MeshFile(*ball_points(20.0, 4), ""), GLASS, (3.0, 1.0, 30.0))
    ball = Sphere("ball", (3.0, 1.0, 30.0), 20.0, GLASS)
    extents = [np.ptp(outline_mm(body, (0.0, 0.0, 400.0)), axis=0) for body in (mesh, ball)]
    np.testing.assert_allclose(extents[0], extents[1], rtol=2e-3)
