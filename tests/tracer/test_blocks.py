"""Boxes, plates, prisms and cuvettes: rays against 50 digits, derivatives, branches and bad input."""

from pathlib import Path

import mpmath
import numpy as np
import pytest
import yaml
from mpmath import mpf

from ground.errors import ConfigError
from tests.tracer.blocks_reference import Reference, follow
from tests.tracer.scenes import camera_at
from tests.tracer.walls_reference import vector
from tracer.bodies import Body, Box, Prism, Sphere
from tracer.bodies.block import ROW, UNTURNED, rectangle, rotate_axes
from tracer.errors import SceneError
from tracer.media import ConstantMedium, Medium
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene, load_scene
from tracer.strategies.sensitivity import landings
from tracer.strategies.trace import RayStatus, trace_from

GLASS, WATER = ConstantMedium(1.5195), ConstantMedium(1.333)
STATUS = {
    "recovered": RayStatus.RECOVERED,
    "tir": RayStatus.TIR,
    "missed": RayStatus.MISSED_PLANE,
    "in glass": RayStatus.IN_GLASS,
    "edge": RayStatus.EDGE,
}
CAMERA_Z = 400.0


def drawn_index(rng: np.random.Generator) -> Medium:
    return ConstantMedium(float(rng.choice([1.0, 1.333, 1.46, 1.5195, 1.9])))


def drawn_profile(rng: np.random.Generator) -> tuple[tuple[float, float], ...]:
    """A convex polygon: corners of an ellipse, at random angles that keep apart."""
    count = int(rng.integers(3, 7))
    angles = 2.0 * np.pi / count * (np.arange(count) + rng.uniform(-0.3, 0.3, count))
    x, y = rng.uniform(8.0, 25.0, 2)
    return tuple((float(x * np.cos(angle)), float(y * np.sin(angle))) for angle in angles)


def drawn_block(rng: np.random.Generator, number: int) -> Body:
    kind, wall = rng.integers(3), float(rng.choice([0.0, 0.0, 0.3, 2.0]))
    place = tuple(float(x) for x in (*rng.uniform(-25.0, 25.0, 2), rng.uniform(-5.0, 80.0)))
    axes = UNTURNED if rng.random() < 0.2 else rotate_axes(UNTURNED, rng.uniform(-np.pi, np.pi, 3).tolist())
    filled = drawn_index(rng) if wall and rng.random() < 0.7 else None
    common = (drawn_index(rng), place, axes, wall, filled, float(rng.choice([0.0, 0.0, 0.5])))
    if kind == 0:
        return Prism(f"block{number}", drawn_profile(rng), float(rng.uniform(10.0, 40.0)), *common)
    width, height, depth = rng.uniform(12.0, 50.0, 3).tolist()
    return Box(f"block{number}", rectangle(width, height), depth if kind == 1 else 8.0, *common)


def drawn_scene(rng: np.random.Generator) -> Scene:
    """A camera, up to three blocks and some balls, before, beside and inside of them."""
    position = (*(float(x) for x in rng.uniform(-150.0, 150.0, 2)), CAMERA_Z)
    scene = Scene(camera_at(position, (0.0, 0.0, 0.0), 5000.0, (64, 48)))
    wanted: list[Body] = [drawn_block(rng, number) for number in range(3)]
    for number in range(8):
        radius = float(rng.uniform(1.0, 8.0))
        centre = (*(float(x) for x in rng.uniform(-25.0, 25.0, 2)), float(rng.uniform(radius, 90.0)))
        wanted.append(Sphere(f"ball{number}", centre, radius, drawn_index(rng)))
    for body in wanted:
        try:
            scene = scene.with_bodies([*scene.bodies, body])
        except SceneError:  # no room for it
            continue
    return scene


def judge(scenes: int, rays: int, seed: int) -> dict[str, int]:
    """Follow random rays through random scenes both ways; returns how many ended how."""
    rng, ends = np.random.default_rng(seed), dict.fromkeys(STATUS, 0)
    for _ in range(scenes):
        scene = drawn_scene(rng)
        start, world = np.array(scene.camera.position_mm), Reference(scene)
        ways = np.stack((*rng.uniform(-40.0, 40.0, (2, rays)), rng.uniform(0.0, 60.0, rays)), axis=1) - start
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        traced = trace_from(scene, np.broadcast_to(start, ways.shape), ways)
        for ray, way in zip(traced.rays, ways.tolist(), strict=True):
            status, point, path, light, branch = follow(world, vector(tuple(start.tolist())), vector(tuple(way)))
            assert RayStatus(ray["status"]) == STATUS[status], (scene, way, status)
            ends[status] += 1
            if status == "recovered":
                off = mpmath.hypot(point[0] - mpf(float(ray["x_mm"])), point[1] - mpf(float(ray["y_mm"])))
                bound = 1e-9 if abs(ray["direction"][2]) > 0.05 else 1e-5
                assert off < bound * (1.0 + 1e3 * len(branch)), (scene, way)
                assert abs(path - mpf(float(ray["path_mm"]))) < 1e-6
                assert abs(light - mpf(float(ray["transmittance"]))) < 1e-6
                assert traced.branches[int(ray["key"])] == branch, (scene, way)
    return ends


def test_random_rays_against_50_digits() -> None:
    ends = judge(scenes=8, rays=9, seed=3)
    assert min(ends[status] for status in ("recovered", "missed")) > 0


@pytest.mark.slow
def test_many_random_rays_against_50_digits() -> None:
    ends = judge(scenes=150, rays=25, seed=4)
    assert ends["recovered"] > 1500
    assert min(ends.values()) > 10


@pytest.mark.slow
def test_derivatives_are_those_of_the_rays() -> None:
    box = Box(
        "box", rectangle(30.0, 24.0), 20.0, GLASS, (-14.0, 2.0, 50.0), rotate_axes(UNTURNED, (0.1, 0.3, 0.05))
    )
    sides = ((-12.0, -8.0), (14.0, -9.0), (0.0, 14.0))
    prism = Prism(
        "prism", sides, 60.0, GLASS, (18.0, 0.0, 30.0), rotate_axes(UNTURNED, (1.4, 0.2, 0.9)), 1.5, WATER
    )
    scene = Scene(camera_at((60.0, -30.0, 400.0), (0.0, 0.0, 0.0), 1000.0, (160, 120)), (box, prism))
    pixels, step = np.random.default_rng(2).uniform((20.0, 10.0), (140.0, 110.0), (150, 2)), 1e-5
    here = landings(scene, pixels)
    assert len(set(here.key[here.recovered].tolist())) > 5

    def check(rate: np.ndarray, ahead: Scene, back: Scene, shift: tuple[float, float] = (0.0, 0.0)) -> None:
        one, other = landings(ahead, pixels + shift), landings(back, pixels - shift)
        same = here.recovered & (one.key == here.key) & (other.key == here.key) & one.recovered & other.recovered
        numeric = (one.point_mm - other.point_mm) / (2.0 * step)
        size = 0.1 + np.abs(numeric).max(axis=1, keepdims=True)
        assert same.sum() > 80
        assert (np.abs(numeric - rate) < 1e-6 * size)[same].all()

    for pixel in range(2):
        shift = (step, 0.0) if pixel == 0 else (0.0, step)
        check(here.pixel_rate[:, :, pixel], scene, scene, shift)
    for body in (box, prism):
        numbers = body.numbers(scene.wavelength_nm)
        columns = here.columns([f"{body.name}.{part}" for part in ROW])
        for place in range(len(numbers)):
            scenes = []
            for by in (step, -step):
                values = [number.value + by * (at == place) for at, number in enumerate(numbers)]
                moved = body.with_numbers(values, scene.wavelength_nm)
                scenes.append(scene.with_bodies([moved if one is body else one for one in scene.bodies]))
            change = [one.row_of(next(b for b in one.bodies if b.name == body.name)) for one in scenes]
            check(columns @ ((change[0] - change[1]) / (2.0 * step)), *scenes)


BOX = {"name": "box", "kind": "box", "centre_mm": [0, 0, 40], "size_mm": [30, 24, 20], "material": "N-BK7"}
PRISM = {
    "name": "prism", "kind": "prism", "centre_mm": [0, 0, 40], "length_mm": 30, "material": "N-BK7",
    "profile_mm": [[-10, -10], [10, -10], [-10, 10]],
}  # fmt: skip


def written(folder: Path, *bodies: object) -> Path:
    camera = {"focal_px": 1000.0, "sensor_px": [100, 80], "position_mm": [0, 0, 400]}
    file = folder / "scene.yaml"
    file.write_text(yaml.safe_dump({"wavelength_nm": 532.0, "camera": camera, "bodies": [*bodies]}))
    return file


@pytest.mark.parametrize(
    "bodies",
    [
        [BOX | {"turned_deg": [10, 20, 30], "edge_mm": 0.2}],
        [BOX | {"wall_mm": 2, "filled": "water", "carried_by": "glass"}],
        [PRISM | {"profile_mm": [[-10, 10], [10, -10], [-10, -10]]}],  # clockwise
    ],
)
def test_a_scene_file_holds_a_block(tmp_path: Path, bodies: list[object]) -> None:
    scene = load_scene(written(tmp_path, *bodies))
    again = tmp_path / "again.yaml"
    again.write_text(dump_scene(scene))
    assert load_scene(again).bodies == scene.bodies
    assert load_scene(again).content_hash() == scene.content_hash()


@pytest.mark.parametrize(
    ("bodies", "said"),
    [
        ([BOX | {"size_mm": [30, 24, 0]}], "size_mm"),
        ([BOX | {"size_mm": [30, 24, 1e-9]}], "leave nothing of its half"),
        ([BOX | {"wall_mm": 9.8}], "leave nothing of its half of 10 mm"),
        ([BOX | {"filled": "water"}], "has no inside"),
        ([BOX | {"turned_deg": [0, 0, 1], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}], "not both"),
        ([BOX | {"centre_mm": [0, 0, 400]}], "the camera is inside body 'box'"),
        ([BOX | {"centre_mm": [0, 0, 409], "wall_mm": 2}], "the camera stands in the glass of 'box'"),
        ([BOX | {"centre_mm": [0, 0, 400], "wall_mm": 2}], "as kind: window, or correct"),
        ([PRISM | {"profile_mm": [[-10, -10], [10, -10], [0, 0], [-10, 10]]}], "must be a convex polygon"),
        ([PRISM | {"profile_mm": [[-10, -10], [10, -10], [-10, 10], [-10, -10]]}], "no thickness"),
        ([PRISM | {"profile_mm": [[0, 0], [10, 10], [10, 0], [0, 10]]}], "must be a convex polygon"),
        ([PRISM | {"profile_mm": [[0, 0], [10, 0]]}], "profile_mm"),
        ([BOX, BOX | {"name": "other", "centre_mm": [29, 0, 40]}], "overlap by 1 mm"),
        ([BOX | {"wall_mm": 1}, BOX | {"name": "other", "centre_mm": [29, 0, 40]}], "'box' cuts body 'other'"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_said_in_a_sentence(tmp_path: Path, bodies: list[object], said: str) -> None:
    with pytest.raises(ConfigError) as error:
        load_scene(written(tmp_path, *bodies))
    assert said in str(error.value), str(error.value)


def test_plates_side_by_side_do_not_overlap(tmp_path: Path) -> None:
    plates = [BOX | {"name": str(k), "size_mm": [30, 24, 2], "centre_mm": [0, 0, 20 + 2 * k]} for k in range(4)]
    assert len(load_scene(written(tmp_path, *plates)).bodies) == 4
