"""The light of a sheet through balls, against the simulator's random rays, which share nothing with the tracer."""

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.flow.particles import LightSheet as SimulatedSheet
from sim.flow.sheet_light import count_light
from tests.tracer.scenes import ball, camera_at
from tracer.bodies import Rod
from tracer.errors import SceneError
from tracer.kernels.light_map import Raster, add_line
from tracer.light_sheet import LightSheet, SheetSource
from tracer.scene.scene import Scene
from tracer.strategies.light_map import LightMap, trace_light

Ball = tuple[float, float, float, float, float]  # x, y, z, radius, index; 0: opaque
N = 1.52
CELL = 2.0 * 10.0 / np.sqrt(3.0) + 0.01
ONE = [(3.0, 1.0, 0.4, 8.0, N)]
THREE = [(-9.0, 1.5, 0.3, 7.0, N), (6.0, -0.5, -0.5, 7.5, N), (4.0, 15.5, 2.0, 8.0, N)]
NINE = [(CELL * (i - 1), CELL * (j - 1), 0.3, 5.0, N) for i in range(3) for j in range(3)]
DARK = [*THREE[1:], (-9.0, 1.5, 0.3, 4.0, 0.0)]
LEVEL = 0.3  # of the brightness, at an edge
VIEW = (-18.0, 18.0, 36.0)  # left, top, side
WIDE, THICK = 30.0, 0.8


def of(balls: list[Ball]) -> Scene:
    """Scene of the balls; index 0 stands for an opaque one."""
    bodies = tuple(ball(f"b{k}", x, y, z, r, n or None) for k, (x, y, z, r, n) in enumerate(balls))
    return Scene(camera_at(), bodies)


def traced(balls: list[Ball], nodes: int, source: SheetSource) -> LightMap:
    left, top, side = VIEW
    pitch = side / nodes
    sheet = LightSheet(thickness_mm=THICK, sources=(source,))
    return trace_light(of(balls), sheet, (left + 0.5 * pitch, top - 0.5 * pitch), pitch, (nodes, nodes))


def drawn(
    balls: list[Ball], rays: int, rows: int, source: SheetSource, seed: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The same by the simulator's random rays."""
    raster = VIEW[:2], VIEW[2] / rows, (rows, rows)
    return count_light(of(balls), SimulatedSheet(THICK), [source], raster, rays / source.width_mm, seed)


def in_boxes(nodes: NDArray[np.float64], rows: int) -> NDArray[np.float64]:
    each = nodes.shape[0] // rows
    return nodes.reshape(rows, each, rows, each).sum(axis=(1, 3))


def compare(balls: list[Ball], rays: int, rows: int, source: SheetSource, per_box: int = 6) -> dict[str, float]:
    """Differences of brightness (relative, where a quarter of the light is), height and thickness; of powers."""
    found, (other, powers) = traced(balls, rows * per_box, source), drawn(balls, rays, rows, source)
    _, passed, stopped = powers / powers[0]
    node = (VIEW[2] / rows / per_box) ** 2
    light = in_boxes(found.brightness, rows) * node
    moment = in_boxes(np.nan_to_num(found.height_mm) * found.brightness, rows) * node
    lit = other[0] > 0.25 * (VIEW[2] / rows) ** 2
    relative = np.abs(light / np.maximum(other[0], 1e-9) - 1.0)[lit]
    high = np.abs(moment / np.maximum(light, 1e-9) - other[1] / np.maximum(other[0], 1e-9))[lit]
    return {
        "lit": float(lit.mean()),
        "brightness 99 %": float(np.quantile(relative, 0.99)),
        "brightness rms": float(np.sqrt(np.mean(relative**2))),
        "height 99 %": float(np.quantile(high, 0.99)),
        "all light": float(light.sum() / other[0].sum() - 1.0),
        "passed": found.passed / found.emitted - passed,
        "absorbed": found.absorbed / found.emitted - stopped,
    }


LEFT = SheetSource(180.0, WIDE)
ASKEW = SheetSource(37.0, WIDE, fan_deg=25.0, divergence_deg=1.0, focus_mm=5.0)


def agree(found: dict[str, float]) -> None:
    print(found)
    assert found["lit"] > 0.2
    assert found["brightness 99 %"] < 0.10
    assert found["height 99 %"] < 0.05
    assert abs(found["all light"]) < 0.01
    assert max(abs(found["passed"]), abs(found["absorbed"])) < 0.01


@pytest.mark.parametrize("balls", [ONE, THREE, NINE, DARK], ids=["one", "three", "nine", "opaque"])
@pytest.mark.parametrize("source", [LEFT, ASKEW], ids=["left", "askew"])
def test_against_random_rays(balls: list[Ball], source: SheetSource) -> None:
    agree(compare(balls, 40_000, 12, source, per_box=10))


@pytest.mark.slow
@pytest.mark.parametrize("balls", [ONE, THREE, NINE, DARK], ids=["one", "three", "nine", "opaque"])
@pytest.mark.parametrize("source", [LEFT, ASKEW], ids=["left", "askew"])
def test_against_many_random_rays(balls: list[Ball], source: SheetSource) -> None:
    agree(compare(balls, 1_000_000, 60, source))


def edges(profile: NDArray[np.float64], side: float) -> NDArray[np.float64]:
    """Places [mm] where a steep profile passes LEVEL; nothing within three boxes of another."""
    steep = np.abs(profile[3:] - profile[:-3]) > 0.5
    passes = ((profile[1:-2] > LEVEL) != (profile[2:-1] > LEVEL)) & steep
    at = np.flatnonzero(passes) + 1
    return side * (at + (LEVEL - profile[at]) / (profile[at + 1] - profile[at]))


@pytest.mark.slow
@pytest.mark.parametrize("balls", [ONE, THREE, NINE], ids=["one", "three", "nine"])
def test_edges_of_shadows(balls: list[Ball]) -> None:
    rows = 360
    other = drawn(balls, 2_000_000, rows, LEFT)[0][0] / (VIEW[2] / rows) ** 2
    found, side, apart = traced(balls, rows, LEFT).brightness, VIEW[2] / rows, []
    for column in range(0, rows, 3):
        one, two = edges(found[:, column], side), edges(other[:, column], side)
        if len(one) and len(two):
            apart += [float(np.abs(two - place).min()) for place in one]
    print(len(apart), np.quantile(apart, [0.5, 0.95, 0.99]))
    assert len(apart) > 100
    assert np.quantile(apart, 0.95) < 0.1


def test_without_bodies_the_light_is_even() -> None:
    sheet = LightSheet(thickness_mm=1.0, sources=(SheetSource(123.0, 100.0, divergence_deg=2.0, focus_mm=-4.0),))
    found = trace_light(of([]), sheet, (-10.0, 10.0), 0.1, (201, 201))
    assert np.abs(found.brightness - 1.0).max() < 0.05
    assert abs(found.brightness.mean() - 1.0) < 1e-3
    assert np.abs(found.height_mm).max() < 1e-9
    spread = np.tan(np.deg2rad(0.5))
    along = np.array([np.cos(np.deg2rad(123.0)), np.sin(np.deg2rad(123.0))])
    x = -10.0 + 0.1 * np.arange(201)
    behind = 4.0 - (x[None, :] * along[0] + x[::-1, None] * along[1])
    assert np.abs(found.thickness_mm / (4.0 * np.hypot(0.25, spread * behind)) - 1.0).max() < 0.03
    assert found.share_reflected == pytest.approx(0.0, abs=1e-12)


def test_a_line_leaves_all_of_its_power_and_height() -> None:
    rng, raster = (
        np.random.default_rng(4),
        Raster(np.array([3.0, 2.0, 0.5, 40.0, -0.5, 2.0]), 50.0, 99.0, 0.0, 0.1),
    )
    for _ in range(40):
        a, b = (tuple(rng.uniform((3.0, -9.0, -9.0), (20.0, 9.0, 9.0)).tolist()) for _ in range(2))
        compiled, plain = np.zeros((3, 80, 80)), np.zeros((3, 80, 80))
        add_line(a, b, 2.0, raster, compiled)
        add_line.py_func(a, b, 2.0, raster, plain)
        length = float(np.linalg.norm(np.subtract(a, b)))
        assert plain[0].sum() == pytest.approx(2.0 * length, rel=1e-12)
        assert plain[1].sum() / plain[0].sum() == pytest.approx(0.5 * (a[1] + b[1]), abs=1e-9)
        np.testing.assert_allclose(compiled, plain, atol=1e-12)


def test_two_sources_add_up() -> None:
    nodes = (-15.0, 15.0), 0.3, (100, 100)
    other = SheetSource(90.0, WIDE, power=0.5)
    one, two, both = (
        trace_light(of(THREE), LightSheet(thickness_mm=THICK, sources=sources), *nodes).brightness
        for sources in ((LEFT,), (other,), (LEFT, other))
    )
    assert np.abs(one + two - both).max() < 1e-12


@pytest.mark.slow
def test_a_rod_casts_a_shadow() -> None:
    scene = Scene(camera_at(), (Rod("rod", (2.0, 1.0, -40.0), (2.0, 1.0, 40.0), 3.0),), cut_mm=100.0)
    sheet = LightSheet(thickness_mm=0.4, sources=(LEFT,))
    found = trace_light(scene, sheet, (-15.0, 15.0), 0.1, (301, 301))
    y = 15.0 - 0.1 * np.arange(301)
    shadow = np.abs(y - 1.0) < 2.9
    assert found.brightness[shadow, 210:].max() < 1e-9
    assert np.abs(found.brightness[np.abs(y - 1.0) > 3.1] - 1.0)[3:-3].max() < 0.03
    assert np.abs(found.brightness[shadow, :130] - 1.0).max() < 0.03
    assert found.absorbed / found.emitted == pytest.approx(6.0 / WIDE, rel=1e-3)


def test_nowhere() -> None:
    sheet = LightSheet(thickness_mm=1.0, sources=(SheetSource(0.0, 10.0),))
    with pytest.raises(SceneError, match="never reaches the view"):
        trace_light(of(ONE), sheet, (50.0, 50.0), 1.0, (9, 9))
