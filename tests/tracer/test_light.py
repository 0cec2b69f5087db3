"""Spectra of lamps, filters and cameras: what index a glass shows in them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from ground.errors import ConfigError
from sim.flow.particles import LightSheet as SimulatedSheet
from sim.flow.sheet_light import count_light
from tests.correction.small_scenes import EXAMPLES, small_scene
from tests.loops import loop_over
from tests.tracer.scenes import ball, camera_at
from tracer.bodies import Rod, translate_by
from tracer.errors import SceneError
from tracer.kernels.light_map import Raster, add_line
from tracer.light import band, gaussian, light_of, line, white_led
from tracer.light_sheet import LightSheet, SheetSource
from tracer.light_table import LAMPS_DIFFER_NM, ONE_FIGURE_NM, LightTable
from tracer.media import MEDIA
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene, load_scene
from tracer.strategies.light_map import LightMap, trace_light
from tracer.strategies.sensitivity import TargetPose, landings
from tracer.strategies.trace import trace

GLASS = MEDIA["N-BK7"]
TYPICAL_NM = {2733.0: 592.5, 2998.0: 586.8, 4103.0: 564.6, 5109.0: 553.9, 6598.0: 541.4}  # CIE LED-B1 to LED-B5


def mean_index(low_nm: float, high_nm: float, density) -> float:
    """Mean index by a plain sum over picometres of Sellmeier's equation, written out here."""
    nm = np.arange(low_nm, high_nm, 0.01) + 0.005
    square = (nm * 1e-3) ** 2
    b, c = (1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)
    n = np.sqrt(1.0 + sum(bi * square / (square - ci) for bi, ci in zip(b, c, strict=True)))
    return float(np.average(n, weights=density(nm)))


@pytest.mark.parametrize(
    ("told", "low", "high", "density"),
    [
        ({"band_nm": [450.0, 650.0]}, 450.0, 650.0, np.ones_like),
        (
            {"mean_nm": 530.0, "width_nm": 33.0},
            450.0,
            610.0,
            lambda nm: 2.0 ** -((2.0 * (nm - 530.0) / 33.0) ** 2),
        ),
        ({"mean_nm": 530.0, "sigma_nm": 20.0}, 450.0, 610.0, lambda nm: np.exp(-0.5 * ((nm - 530.0) / 20.0) ** 2)),
        ({"points": [[420.0, 0.0], [460.0, 3.0], [500.0, 0.0]]}, 420.0, 500.0, lambda nm: 40.0 - abs(nm - 460.0)),
        (
            {
                "band_nm": [450.0, 650.0],
                "filters": [{"band_nm": [500.0, 700.0]}],
                "response": [[400.0, 0.0], [800.0, 4.0]],
            },
            500.0,
            650.0,
            lambda nm: nm - 400.0,
        ),
        (
            {"band_nm": [450.0, 650.0], "quantum_efficiency": [[400.0, 0.5], [700.0, 0.5]]},
            450.0,
            650.0,
            lambda nm: nm,
        ),
    ],
    ids=["band", "width", "sigma", "points", "filter and response", "quantum efficiency"],
)
def test_a_glass_shows_the_mean_index_of_what_the_camera_counts(told, low, high, density):
    assert LightTable(**told).light().index(GLASS) == pytest.approx(mean_index(low, high, density), abs=1e-6)


def test_lines_weigh_by_their_power():
    light = LightTable(lines=[[546.1, 3.0], [577.0, 1.0]]).light()
    assert light.index(GLASS) == pytest.approx(0.75 * GLASS.n(546.1) + 0.25 * GLASS.n(577.0), abs=1e-15)
    assert line(532.0).index(GLASS) == GLASS.n(532.0)


def test_a_flat_band_is_no_gaussian_of_its_width():
    """`width_nm: 200` for 450-650 nm, as was advised once, is wrong by as much as nothing said."""
    flat, told, alike = band(450.0, 650.0), gaussian(550.0, 200.0 / 2.3548), gaussian(550.0, 200.0 / np.sqrt(12.0))
    assert told.index(GLASS) - flat.index(GLASS) > 4e-4
    assert abs(alike.index(GLASS) - flat.index(GLASS)) < 2e-5


@pytest.mark.parametrize(("temperature_k", "mean_nm"), TYPICAL_NM.items())
def test_a_white_led_has_the_mean_wavelength_of_typical_lamps(temperature_k, mean_nm):
    light = white_led(temperature_k)
    assert light.mean_nm == pytest.approx(mean_nm, abs=0.6 * light.unsure_nm)
    assert 65.0 < light.spread_nm < 80.0


def test_colours_have_the_mean_and_nearly_the_spread_of_the_light():
    for light in (white_led(4000.0), band(450.0, 650.0), gaussian(530.0, 15.0)):
        nm, weight = light.colours(12)
        assert weight @ nm == pytest.approx(light.mean_nm, abs=0.01)
        assert np.sqrt(weight @ (nm - light.mean_nm) ** 2) == pytest.approx(light.spread_nm, rel=0.03)
    few = light_of([546.1, 577.0], [3.0, 1.0]).colours(12)
    np.testing.assert_allclose(few, [[546.1, 577.0], [0.75, 0.25]])


@loop_over(
    "told, words",
    [
        ({}, "exactly one of"),
        ({"source": "lamp"}, "exactly one of"),
        ({"source": "laser", "band_nm": [450.0, 650.0]}, "stands alone"),
        ({"source": "laser", "unsure_nm": 3.0}, "stands alone"),
        ({"source": "laser", "filters": [{"band_nm": [600.0, 700.0]}]}, "needs some power"),
        ({"mean_nm": 550.0, "band_nm": [450.0, 650.0]}, "exactly one of"),
        ({"band_nm": [650.0, 450.0]}, "shorter to a longer"),
        ({"band_nm": [450.0, 650.0], "width_nm": 20.0}, "belong to mean_nm"),
        ({"mean_nm": 550.0, "width_nm": 20.0, "sigma_nm": 9.0}, "either width_nm"),
        ({"points": [[500.0, 1.0], [450.0, 1.0]]}, "ascending"),
        ({"points": [[0.5, 1.0], [0.6, 1.0]]}, "in nm"),
        ({"points": [[450.0, 0.0], [650.0, 0.0]]}, "zero everywhere"),
        ({"mean_nm": 532.0, "filters": [{"band_nm": [600.0, 700.0]}]}, "needs some power"),
        ({"mean_nm": 532.0, "filters": [{"mean_nm": 532.0}]}, "needs a width"),
        ({"band_nm": [450.0, 650.0], "response": [[500.0, 1.0], [700.0, 1.0]]}, "25 % of the light"),
        ({"colour_temperature_k": 1800.0}, "2500"),
        ({"mean_nm": 532.0, "width_nm": 20.0, "source": "laser"}, "beside mean_nm alone"),
        ({"mean_nm": 532.0, "unsure_nm": 3.0, "source": "laser"}, "beside mean_nm alone"),
    ],
)
def test_what_is_no_light_is_refused(told, words):
    with pytest.raises(ValidationError, match=words):
        LightTable(**told)


def test_a_light_without_power_is_none():
    for power in ([0.0, 0.0], [1.0, -1.0], [1.0, np.nan]):
        with pytest.raises(SceneError, match="needs some power"):
            light_of([500.0, 600.0], power)


def test_a_width_may_mean_a_band_or_a_gaussian_as_wide_or_of_the_same_variance():
    table = LightTable(mean_nm=550.0, sigma_nm=30.0)
    as_wide, as_spread = (light.spread_nm for light in table.rivals())
    assert as_wide == pytest.approx(30.0 * np.sqrt(8.0 * np.log(2.0) / 12.0), rel=1e-3)
    assert as_spread == pytest.approx(30.0, rel=1e-3)
    as_wide, as_spread = (light.spread_nm for light in LightTable(band_nm=[500.0, 600.0]).rivals())
    assert as_wide == pytest.approx(100.0 / np.sqrt(8.0 * np.log(2.0)), rel=3e-3)
    assert as_spread == pytest.approx(100.0 / np.sqrt(12.0), rel=3e-3)
    assert not LightTable(mean_nm=532.0).rivals()
    assert not LightTable(colour_temperature_k=4000.0).rivals()
    cut = LightTable(mean_nm=550.0, width_nm=100.0, filters=[{"band_nm": [540.0, 560.0]}])
    assert max(light.spread_nm for light in cut.rivals()) < 6.0


@loop_over(
    "told, unsure_nm",
    [
        ({"mean_nm": 550.0}, ONE_FIGURE_NM),
        ({"mean_nm": 532.0}, ONE_FIGURE_NM),  # the particles' own, and nobody says that it is their laser
        ({"mean_nm": 532.0, "source": "laser"}, 0.0),
        ({"mean_nm": 550.0, "source": "laser"}, 0.0),
        ({"source": "laser"}, 0.0),
        ({"mean_nm": 550.0, "unsure_nm": 0.0}, 0.0),
        ({"mean_nm": 532.0, "source": "lamp"}, LAMPS_DIFFER_NM),
        ({"mean_nm": 532.0, "source": "lamp", "unsure_nm": 2.0}, 2.0),
        ({"mean_nm": 530.0, "width_nm": 30.0}, LAMPS_DIFFER_NM),
        ({"lines": [[546.1, 1.0]]}, 0.0),
    ],
)
def test_one_colour_is_a_lamp_unless_it_is_said_to_be_a_laser(told, unsure_nm):
    assert LightTable(**told).light(532.0).unsure_nm == unsure_nm


def test_a_laser_alone_is_the_one_that_lights_the_particles():
    assert LightTable(source="laser").light(488.0) == LightTable(mean_nm=488.0, source="laser").light(488.0)


# The light of a sheet through balls, against the simulator's random rays, which share nothing with the tracer.


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
    with pytest.raises(SceneError, match="no light of the sheet reaches the view"):
        trace_light(of(ONE), sheet, (50.0, 50.0), 1.0, (9, 9))


# The scene as seen in a light sheet, against rays of the scene as it stands, carried to the tilted plane.


SHEET = LightSheet(-0.3, 0.7, -1.1, 0.02, 0.03, (0.3, -0.2, 0.1), 1.2)


@pytest.fixture(scope="module")
def scene():
    return replace(small_scene("tilted_pair", 252), sheet=SHEET)


def test_rays_end_on_the_sheet(scene):
    rng = np.random.default_rng(1)
    pixels = rng.uniform(0.0, 251.0, (2000, 2))
    seen = trace(scene.in_light_sheet(), pixels)
    pose = TargetPose((0.0, 0.0, SHEET.z_mm), tuple(map(tuple, SHEET.axes())))
    wanted = landings(scene, pixels, pose)
    assert np.array_equal(seen.recovered, wanted.recovered)
    np.testing.assert_allclose(seen.plane_mm, wanted.point_mm, rtol=1e-9, atol=1e-9)
    world = pose.to_world(seen.plane_mm[seen.recovered])
    np.testing.assert_allclose(world[:, 2], SHEET.height_mm(world[:, 0], world[:, 1]), atol=1e-8)
    rise = SHEET.height_mm(np.array([10.0, 0.0]), np.array([0.0, 10.0])) - SHEET.z_mm
    np.testing.assert_allclose(rise, 10.0 * np.tan(np.deg2rad([0.7, -1.1])), rtol=1e-12)
    # Coordinates on the sheet are nearly the world's.
    near = np.abs(world).max(axis=1) < 100.0
    np.testing.assert_allclose(seen.plane_mm[seen.recovered][near], world[near, :2], atol=0.03)


def test_the_target_does_not_know_of_the_sheet(scene):
    plain = replace(scene, sheet=None)
    assert scene.content_hash() == plain.content_hash()
    assert scene.in_light_sheet().content_hash() != plain.content_hash()
    assert plain.in_light_sheet() is plain
    level = replace(scene, sheet=LightSheet()).in_light_sheet()
    pixels = np.random.default_rng(2).uniform(0.0, 251.0, (500, 2))
    assert np.array_equal(trace(level, pixels).rays, trace(plain, pixels).rays)
    assert level.content_hash() == plain.content_hash()


def test_a_scene_file_keeps_its_sheet(scene, tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(dump_scene(scene))
    assert load_scene(path).sheet == SHEET
    path.write_text(dump_scene(replace(scene, sheet=None)))
    assert "sheet" not in path.read_text()
    assert load_scene(path).sheet is None


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("z: 0.1", "z"),
        ("tilt_x_deg: 40.0", "30"),
        ("sigma_mm: -0.1", "sigma_mm"),
        ("thickness_mm: 0.0", "thickness_mm"),
        ("correlation: [0.9, 0.9, -0.9]", "contradict"),
        ("z_mm: 600.0", "behind the camera"),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(section, said, tmp_path):
    path = tmp_path / "scene.yaml"
    lines = (EXAMPLES / "two_spheres_500.yaml").read_text() + f"\nsheet: {{{section}}}\n"
    path.write_text(lines)
    with pytest.raises(ConfigError, match=said) as refused:
        load_scene(path)
    last = len(lines.rstrip().splitlines())
    assert [problem.line for problem in refused.value.problems] == [last]


def test_the_sheet_may_run_through_balls_and_not_through_a_rod():
    scene = small_scene("two_spheres_500", 252)  # its first ball touches the target's plane
    touching = replace(scene, sheet=LightSheet(0.4)).in_light_sheet()
    assert touching.spheres[0].lowest_mm == pytest.approx(-0.4)
    through = replace(scene, sheet=LightSheet(1.4))
    (cut,) = through.in_light_sheet().spheres_in_plane
    assert (cut.name, cut.lowest_mm) == ("near", pytest.approx(-1.4))
    rod = Rod("rod", (40.0, 0.0, 2.0), (60.0, 0.0, 2.0), 2.0)
    with pytest.raises(SceneError, match=r"runs through 'rod' \(1.4 mm deep\)"):
        through.with_bodies([*through.bodies, rod]).in_light_sheet()
    free = through.with_bodies([body.moved(translate_by((0.0, 0.0, 4.0))) for body in through.bodies])
    assert free.in_light_sheet().spheres[0].lowest_mm == pytest.approx(2.6)
