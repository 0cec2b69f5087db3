"""The direct view through one window against rays: what it finds is seen there, and it finds what is seen."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from correction.grid import PlaneGrid
from correction.inversion.invert import Inversion
from correction.node_status import NodeStatus
from tests.slow_cases import slow_but
from tests.tracer.drawn_walls import GLASS, WATER, among_all_kinds, seen
from tests.tracer.scenes import camera_at
from tracer.bodies import Sphere, Window
from tracer.camera import Lens
from tracer.errors import SceneError
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import RayMap, build_ray_map
from tracer.strategies.strategy import choose

GRID = PlaneGrid((-31.0, 27.0), 0.37, (150, 170))
CAMERA = camera_at((12.0, -7.0, 400.0), (0.0, 0.0, 0.0), 1000.0, (150, 131))
BALLS = (
    Sphere("near", (5.0, 4.0, 60.0), 9.0, ConstantMedium(1.6)),
    Sphere("low", (-14.0, -6.0, 12.0), 8.0, GLASS),
)


def window(normal: tuple[float, float, float] = (0.05, -0.08, 1.0), **other: Any) -> Window:
    unit = np.array(normal) / np.linalg.norm(normal)
    plain: dict[str, Any] = {"thickness_mm": 8.0, "radius_mm": 90.0, "medium": GLASS, "behind": None}
    return Window("window", (0.0, 0.0, 150.0), tuple(unit.tolist()), **(plain | other))


SCENES = {
    "plate": Scene(CAMERA, (window(), *BALLS)),
    "steep": Scene(CAMERA, (window((0.4, -0.5, 1.0), radius_mm=150.0), *BALLS)),
    "liquid": Scene(CAMERA, (window(behind=WATER), *BALLS)),
    "liquid and a lens": Scene(
        replace(CAMERA, lens=Lens(k1=-0.05, p1=1e-3)), (window((0.2, 0.1, 1.0), behind=WATER), *BALLS)
    ),
    "porthole": Scene(CAMERA, (window(radius_mm=14.0), *BALLS)),
    "wide angle, thick": Scene(
        camera_at((12.0, -7.0, 210.0), (0.0, 0.0, 0.0), 140.0, (150, 131)),
        (window(thickness_mm=40.0, radius_mm=500.0, medium=ConstantMedium(1.9), behind=WATER), *BALLS),
    ),
}


def direct(scene: Scene, ray_map: RayMap | None = None) -> Inversion:
    """The arrays of an inversion after the direct view."""
    made = Inversion(choose(scene), ray_map or build_ray_map(scene), GRID, 2, (0.5, 16.0), None, skip=True)
    assert made.window is not None or scene.arrangement.is_one_room
    made.direct()
    return made


@pytest.mark.parametrize("name", slow_but(SCENES, *[*SCENES][::2]))
def test_the_ray_of_the_pixel_found_meets_the_node(name: str) -> None:
    scene = SCENES[name]
    made = direct(scene)
    found = made.status == NodeStatus.RECOVERED
    assert 2000 < found.sum() < found.size
    rays = seen(among_all_kinds(*scene.bodies).with_camera(scene.camera), made.pixel[0, found])
    assert {rays.branches[int(key)] for key in np.unique(rays.rays["key"])} == {()}
    np.testing.assert_allclose(rays.plane_mm, GRID.nodes_mm()[found], rtol=0.0, atol=1e-10)
    light = rays.rays["transmittance"]
    np.testing.assert_allclose(made.transmittance[0, found], light, rtol=3e-7)
    area = np.abs(np.linalg.det(made.jacobian[0, found].reshape(-1, 2, 2)))
    np.testing.assert_allclose(made.weight[0, found], np.minimum(1.0, area) * light, rtol=1e-5)


@pytest.mark.parametrize("name", SCENES)
def test_what_pixels_see_past_the_glass_is_found(name: str) -> None:
    """The node in the middle of nine pixels that all look past the spheres."""
    scene = SCENES[name]
    ray_map = build_ray_map(scene)
    made, plane = direct(scene, ray_map), ray_map.plane_mm
    past = ((ray_map.branch == 0) & np.isfinite(plane[..., 0])).astype(np.uint8)
    inner = cv2.erode(past, np.ones((3, 3)), borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    column = np.rint((plane[..., 0] - GRID.origin_mm[0]) / GRID.pitch_mm)
    row = np.rint((GRID.origin_mm[1] - plane[..., 1]) / GRID.pitch_mm)
    inner &= (row >= 0) & (row < GRID.shape[0]) & (column >= 0) & (column < GRID.shape[1])
    away = np.hypot(column - (plane[..., 0] - GRID.origin_mm[0]) / GRID.pitch_mm,
                    row - (GRID.origin_mm[1] - plane[..., 1]) / GRID.pitch_mm)  # fmt: skip
    inner &= away * GRID.pitch_mm < 0.9 * np.abs(np.gradient(plane[..., 0], axis=1))
    assert inner.sum() > 500
    assert (made.status[row[inner].astype(int), column[inner].astype(int)] == NodeStatus.RECOVERED).all()


@pytest.mark.parametrize("name", SCENES)
def test_jacobians_are_the_differences_of_the_pixels(name: str) -> None:
    made = direct(SCENES[name])
    pixel = made.pixel[0]
    across, along = 0.5 * (pixel[1:-1, 2:] - pixel[1:-1, :-2]), 0.5 * (pixel[2:, 1:-1] - pixel[:-2, 1:-1])
    there = np.isfinite(across + along + pixel[1:-1, 1:-1]).all(axis=-1)
    differences = np.stack((across, along), axis=-1)[there].reshape(-1, 4)
    assert there.sum() > 2000
    np.testing.assert_allclose(made.jacobian[0, 1:-1, 1:-1][there], differences, rtol=0.0, atol=3e-5)


def test_drawn_windows() -> None:
    """Thin and thick ones of weak and strong glass, liquids of any index, leaning by up to 24 degrees."""
    rng = np.random.default_rng(7)
    tried = 0
    while tried < 12:
        thickness, n, behind = rng.uniform(0.2, 40.0), rng.uniform(1.02, 3.0), rng.uniform(1.0, 2.5)
        one = window(
            (rng.uniform(-0.4, 0.4), rng.uniform(-0.2, 0.2), 1.0),
            thickness_mm=thickness,
            radius_mm=150.0,
            medium=ConstantMedium(n),
            behind=ConstantMedium(behind),
        )
        scene = Scene(CAMERA, (one,))
        try:
            judge = among_all_kinds(one).with_camera(CAMERA)
        except SceneError:  # what stands far away there would be cut by this wall
            continue
        ray_map = build_ray_map(scene)
        made = Inversion(choose(scene), ray_map, GRID, 1, (0.5, 16.0), None, skip=True)
        if made.window is None:  # not the usual case
            continue
        tried += 1
        made.direct()
        found = made.status == NodeStatus.RECOVERED
        assert found.sum() > 1000
        rays = seen(judge, made.pixel[0, found])
        np.testing.assert_allclose(rays.plane_mm, GRID.nodes_mm()[found], rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(made.transmittance[0, found], rays.rays["transmittance"], rtol=3e-7)


def test_a_window_of_nothing_changes_nothing() -> None:
    air = window((0.3, -0.2, 1.0), medium=ConstantMedium(1.0))
    made, bare = direct(Scene(CAMERA, (air, *BALLS))), direct(Scene(CAMERA, BALLS))
    np.testing.assert_array_equal(made.status, bare.status)
    np.testing.assert_allclose(made.pixel, bare.pixel, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(made.jacobian, bare.jacobian, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(made.weight, bare.weight, rtol=1e-6)


def test_beside_the_opening_the_wall_is_in_the_way() -> None:
    """Faces of a porthole, met by the rays of its nodes: straight geometry before the glass."""
    scene = SCENES["porthole"]
    made = direct(scene)
    assert set(np.unique(made.status)) == set(NodeStatus) & {
        NodeStatus.RECOVERED, NodeStatus.RIM, NodeStatus.BLOCKED, NodeStatus.OUT_OF_FRAME
    }  # fmt: skip
    wide = direct(scene.with_bodies((window(), *BALLS)))
    found = wide.status == NodeStatus.RECOVERED
    one, eye = scene.bodies[0], np.array(scene.camera.position_mm)
    assert isinstance(one, Window)
    normal, ray = np.array(one.normal), scene.camera.directions(wide.pixel[0, found])
    entry = eye + ((np.array(one.centre_mm) - eye) @ normal / (ray @ normal))[:, None] * ray
    aside = np.linalg.norm(entry - np.array(one.centre_mm), axis=1)
    shut = made.status[found] == NodeStatus.BLOCKED
    assert shut[aside > one.radius_mm].all()
    assert not shut[aside < one.radius_mm - 1.0].any()


def test_gas_behind_liquid_is_left_to_the_sheets() -> None:
    """Where what lies behind is thinner than what lies before, rays may be totally reflected."""
    thin = Scene(CAMERA, (window(behind=ConstantMedium(1.0)),), ambient=WATER)
    assert Inversion(choose(thin), build_ray_map(thin), GRID, 1, (0.5, 16.0), None, skip=True).window is None
