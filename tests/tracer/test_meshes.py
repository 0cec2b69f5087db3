"""Meshes against the shapes that they were made of: an exact ball, and a stone of known formula."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.errors import ConfigError
from tests.loops import loop_over
from tests.tracer.drawn_meshes import ball_points, stone_points, stone_value, write_obj, write_ply
from tests.tracer.scenes import camera_at, flat, halves
from tracer.bodies import Mesh, Sphere
from tracer.bodies.mesh_file import load_mesh
from tracer.errors import SceneError
from tracer.kernels.mesh import cross_mesh, mesh_rates
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene, load_scene
from tracer.scene.view import surface_error_px
from tracer.strategies.trace import trace, trace_from

pytest.importorskip("trimesh")
N = 1.5195
GLASS = ConstantMedium(N)
PX_MM = 0.0676  # of the table in which meshes were compared first
CAMERA = camera_at((0.0, 0.0, 250.0), (0.0, 0.0, 0.0), 250.0 / PX_MM, (64, 48))


def mesh_of(path: Path, z_mm: float, **changes: object) -> Mesh:
    return replace(Mesh("mesh", path, load_mesh(path), GLASS, (0.0, 0.0, z_mm)), **changes)


def downwards(rng: np.random.Generator, most_rad: float, count: int) -> NDArray[np.float64]:
    """Directions (count, 3) within an angle of straight down."""
    angle, around = most_rad * np.sqrt(rng.random(count)), 2.0 * np.pi * rng.random(count)
    across = np.sin(angle)[:, None] * np.stack((np.cos(around), np.sin(around)), axis=1)
    return np.concatenate((across, -np.cos(angle)[:, None]), axis=1)


def landed(scene: Scene, ways: NDArray[np.float64]) -> NDArray[np.float64]:
    """Plane points (N, 2), NaN for those that do not arrive."""
    start = np.array(scene.camera.position_mm)
    rays = trace_from(scene, np.broadcast_to(start, ways.shape), ways).rays
    return np.where((rays["status"] == 0)[:, None], np.stack((rays["x_mm"], rays["y_mm"]), axis=1), np.nan)


def off_px(found: NDArray[np.float64], exact: NDArray[np.float64]) -> NDArray[np.float64]:
    both = np.isfinite(found[:, 0]) & np.isfinite(exact[:, 0])
    return np.asarray(np.linalg.norm(found - exact, axis=1)[both] / PX_MM)


@pytest.mark.slow
@pytest.mark.parametrize(("halvings", "rms_px"), [(4, 0.03), (5, 0.005)])
def test_a_mesh_of_a_ball_is_the_ball(tmp_path: Path, halvings: int, rms_px: float) -> None:
    """20 480 triangles: 0.005 px; the mesh says itself what to expect, within a factor of two."""
    ball = mesh_of(write_ply(tmp_path / "ball.ply", *ball_points(50.0, halvings)), 50.0)
    ways = downwards(np.random.default_rng(0), float(np.arcsin(0.9 * 50.0 / 200.0)), 20_000)
    found = landed(Scene(CAMERA, (ball,)), ways)
    exact = landed(Scene(CAMERA, (Sphere("mesh", (0.0, 0.0, 50.0), 50.0, GLASS),)), ways)
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(exact))
    rms = float(np.sqrt(np.mean(off_px(found, exact) ** 2)))
    assert rms <= rms_px
    assert 0.5 * rms < surface_error_px(CAMERA, ball) < 2.0 * rms


def through_the_stone(ways: NDArray[np.float64], start: NDArray[np.float64], z_mm: float) -> NDArray[np.float64]:
    """Plane points of rays through the stone by its formula: Newton on F along the line, Snell by vectors."""
    lift = np.array([0.0, 0.0, z_mm])

    def meet(p: NDArray[np.float64], d: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
        for _ in range(200):
            value, gradient = stone_value(p + t[:, None] * d - lift)
            t = t - np.clip(value / (gradient * d).sum(axis=1), -2.0, 2.0)
        return np.where(np.abs(value) < 1e-12, t, np.nan)

    def bent(d: NDArray[np.float64], normal: NDArray[np.float64], ratio: float) -> NDArray[np.float64]:
        cosine = -(d * normal).sum(axis=1)
        beyond = np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))
        return ratio * d + (ratio * cosine - beyond)[:, None] * normal

    def normal(p: NDArray[np.float64]) -> NDArray[np.float64]:
        gradient = stone_value(p - lift)[1]
        return gradient / np.linalg.norm(gradient, axis=1, keepdims=True)

    p = np.broadcast_to(start, ways.shape)
    with np.errstate(invalid="ignore"):
        p = p + meet(p, ways, np.full(len(ways), 180.0))[:, None] * ways
        inside = bent(ways, normal(p), 1.0 / N)
        p = p + meet(p, inside, np.full(len(ways), 60.0))[:, None] * inside
        out = bent(inside, -normal(p), N)
    return p[:, :2] - p[:, 2:] / out[:, 2:] * out[:, :2]


@pytest.mark.slow
def test_a_stone_of_known_formula(tmp_path: Path) -> None:
    stone = mesh_of(write_obj(tmp_path / "stone.obj", *stone_points(5)), 30.0)
    ways = downwards(np.random.default_rng(1), 0.045, 4000)
    found = landed(Scene(CAMERA, (stone,)), ways)
    off = off_px(found, through_the_stone(ways, np.array(CAMERA.position_mm), 30.0))
    assert len(off) > 3000
    assert float(np.sqrt(np.mean(off**2))) <= 0.02, off
    direct = -ways[:, :2] / ways[:, 2:] * 250.0
    assert float(np.nanmedian(off_px(found, direct))) > 20.0  # it does bend


@pytest.mark.slow
def test_derivatives_are_those_of_the_rays(tmp_path: Path) -> None:
    stone = mesh_of(write_ply(tmp_path / "stone.ply", *stone_points(2)), 30.0)
    (row,) = Scene(CAMERA, (stone,)).other_tables()[0].rows
    rng, step = np.random.default_rng(2), 1e-6
    for _ in range(20):
        ray = np.array([*rng.uniform(-6.0, 6.0, 2), 200.0, *downwards(rng, 0.02, 1)[0]])
        fate, *_ = cross_mesh(*halves(ray), row)
        assert fate == 0
        for number in range(7):
            change, rate = np.zeros(6), np.zeros(64)
            if number < 6:
                change[number] = 1.0
                change[3:] -= (change[3:] @ ray[3:]) * ray[3:]
            else:
                rate[0] = 1.0
            ends = [
                np.array(
                    flat(
                        cross_mesh(*halves(ray + s * change), np.concatenate(([row[0] + s * rate[0]], row[1:])))[
                            1:3
                        ]
                    )
                )
                for s in (step, -step)
            ]
            found = np.array(flat(mesh_rates(*halves(ray), *halves(change), row, rate, 0)))
            np.testing.assert_allclose(found, (ends[0] - ends[1]) / (2.0 * step), rtol=1e-6, atol=1e-6)


def turned_stone(tmp_path: Path) -> Scene:
    """Scene of a stone from a file beside it: turned, moved, in metres."""
    points, normals, triangles = stone_points(4)
    (tmp_path / "shapes").mkdir()
    write_ply(tmp_path / "shapes" / "stone.ply", 1e-3 * points, normals, triangles)
    text = dump_scene(Scene(CAMERA)) + (
        "bodies:\n- {kind: mesh, name: stone, file: shapes/stone.ply, unit_mm: 1000.0,\n"
        "   position_mm: [1.0, 2.0, 30.0], material: {n: 1.5195},\n"
        "   rotation: [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]}\n"
    )
    (tmp_path / "scene.yaml").write_text(text.replace("bodies: []\n", ""))
    return load_scene(tmp_path / "scene.yaml")


@pytest.mark.slow
def test_a_mesh_stands_where_the_file_says(tmp_path: Path) -> None:
    scene = turned_stone(tmp_path)
    points, normals, triangles = stone_points(4)
    (stone,) = scene.bodies
    assert isinstance(stone, Mesh)
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(
        np.sort(stone.points_mm, axis=0), np.sort(points @ quarter + (1.0, 2.0, 30.0), axis=0), atol=1e-9
    )
    (tmp_path / "again.yaml").write_text(dump_scene(scene))
    assert load_scene(tmp_path / "again.yaml").content_hash() == scene.content_hash()
    (tmp_path / "shapes" / "stone.ply").write_text("ply\n")
    with pytest.raises(ConfigError, match=r"stone\.ply"):
        load_scene(tmp_path / "again.yaml")
    write_ply(tmp_path / "shapes" / "stone.ply", 1.1e-3 * points, normals, triangles)
    with pytest.raises(ConfigError, match="is not the file it was"):
        load_scene(tmp_path / "again.yaml")


@pytest.mark.slow
def test_a_mesh_moved_by_a_stage_is_traced_where_it_is(tmp_path: Path) -> None:
    scene = turned_stone(tmp_path)
    moved = scene.bodies[0].moved(lambda point: (point[0] + 3.0, point[1], point[2]))
    pixels = np.random.default_rng(3).uniform(0.0, 48.0, (50, 2))
    aside = scene.camera.position_mm[0] + 3.0, *scene.camera.position_mm[1:]
    with_camera = Scene(replace(scene.camera, position_mm=aside), (moved,))
    seen = trace(scene, pixels).plane_mm
    assert np.isfinite(seen).any()
    np.testing.assert_allclose(trace(with_camera, pixels).plane_mm - (3.0, 0.0), seen, atol=1e-9)
    assert with_camera.content_hash() != scene.content_hash()


Broken = Callable[[Path, NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]], Path]


def dented(path: Path, p: NDArray[np.float64], n: NDArray[np.float64], t: NDArray[np.int64]) -> Path:
    p = p.copy()
    p[7] *= 0.8
    return write_ply(path, p, n, t)


@loop_over("write, words",
    [
        (lambda path, p, n, t: write_ply(path, p, None, t), "has no normals"),
        (lambda path, p, n, t: write_ply(path, p, n, t[1:]), "is open at"),
        (lambda path, p, n, t: write_ply(path, p, n, t[:, ::-1]), "is inside out"),
        (lambda path, p, n, t: write_ply(path, p, -n, t), "points into it"),
        (lambda path, p, n, t: write_ply(path, p, n, np.concatenate((t[:1, ::-1], t[1:]))), "orient them alike"),
        (lambda path, p, n, t: write_ply(path, p, n, t + 1), "of a point that is not there"),
        (lambda path, p, n, t: write_ply(path, p * np.nan, n, t), "no number"),
        (lambda path, p, n, t: write_ply(path, p * 0.0, n, t), "no extent"),
        (dented, "is hollow at"),
        (lambda path, p, n, t: write_ply(path.with_suffix(".stl"), p, n, t), "neither PLY nor OBJ"),
        (lambda path, p, n, t: path.with_name("none.ply"), "cannot be read"),
    ],
)  # fmt: skip
def test_what_cannot_be_traced_is_refused(tmp_path: Path, write: Broken, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        load_mesh(write(tmp_path / "mesh.ply", *ball_points(10.0, 2)))


def test_cut_and_cluttered_files_are_refused(tmp_path: Path) -> None:
    good = write_ply(tmp_path / "good.ply", *ball_points(10.0, 1)).read_bytes()
    rng, said = np.random.default_rng(4), []
    for number in range(200):
        content = bytearray(good[: int(rng.integers(len(good)))] if number % 2 else good)
        for at in rng.integers(0, max(len(content), 1), 3 if content else 0):
            content[at] = int(rng.integers(256))
        (tmp_path / "mesh.ply").write_bytes(content)
        try:
            load_mesh(tmp_path / "mesh.ply")
        except SceneError as error:
            said.append(str(error))
    assert len(said) > 100
    assert all("mesh.ply" in text for text in said)


def test_a_scan_is_refused_by_what_it_is_off(tmp_path: Path) -> None:
    """Points with a micrometre of noise, normals made of them: 0.65 px, and no tracer can mend it."""
    points, normals, triangles = ball_points(50.0, 4)
    noise = np.random.default_rng(5).normal(0.0, 1e-3, len(points))
    corners = (points + noise[:, None] * normals)[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rough = np.zeros_like(points)
    np.add.at(rough, triangles.reshape(-1), np.repeat(across, 3, axis=0))
    rough /= np.linalg.norm(rough, axis=1, keepdims=True)
    write_ply(tmp_path / "scan.ply", points + noise[:, None] * normals, rough, triangles)
    text = dump_scene(Scene(CAMERA)).replace("bodies: []\n", "")
    place = "position_mm: [0.0, 0.0, 50.5], material: {n: 1.5195}"
    text += f"bodies:\n- {{kind: mesh, name: scan, file: scan.ply, {place}}}\n"
    (tmp_path / "scene.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"px in the picture, and 0\.1 are the most"):
        load_scene(tmp_path / "scene.yaml")
