"""Maps on the surface of the light: particles lit and drawn by the simulator's own optics, off the plane."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from correction.fitted.prepared import prepare
from correction.fitted.scene_sigma import SceneSigma
from correction.grid import PlaneGrid
from correction.maps.correction_map import build_correction_map
from correction.maps.corrector import Corrector
from correction.maps.height_change import HeightChange
from correction.maps.light_height import HeightRate
from correction.maps.lit import PlaneLight, light_of
from correction.node_status import NodeStatus
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from piv.correlation.windows import WindowGrid
from sim.flow.fields import Flow, Uniform
from sim.flow.images import FlowCamera
from sim.flow.particles import LightSheet as SimulatedSheet
from sim.flow.particles import Seeding
from sim.flow.sheet_light import trace_sheet
from sim.flow.view import ParticleView
from tests.tracer.scenes import ball, camera_at
from tracer.light_sheet import LightSheet, SheetSource
from tracer.scene.scene import Scene
from tracer.strategies.light_map import LightMap
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.sensitivity import CAMERA, SPHERE

R, OFF_MM = 10.0, 0.5
SHEET = LightSheet(0.0, sigma_mm=0.1, tilt_sigma_deg=0.0, thickness_mm=0.8, sources=(SheetSource(180.0, 90.0),))
LIGHTING = ball("left", -25.0, 1.0, -OFF_MM, R)  # the sheet passes 0.5 mm over its middle
LENSES = (ball("low", 8.0, 4.0, 25.0, 20.0), ball("high", 10.0, 3.0, 66.0, 20.0))  # before that light


@pytest.fixture(scope="module")
def scene() -> Scene:
    camera = camera_at(focal_px=2600.0, sensor_px=(320, 256))
    return replace(Scene(camera, (LIGHTING, *LENSES)), sheet=SHEET)


def height_by_simulator(scene, places):
    """Mean height (N,) of the light at places (N, 2), by the simulator's rays."""
    simulated = SimulatedSheet(SHEET.thickness_mm, SHEET.z_mm)
    found = trace_sheet(scene, simulated, SHEET.sources, np.array([[-45.0, -30.0], [45.0, 30.0]]))
    x, y = places.T
    boxes = np.array(((found.corner_mm[1] - y) / found.side_mm, (x - found.corner_mm[0]) / found.side_mm)) - 0.5
    light, first = (map_coordinates(one, boxes, order=1) for one in found.sums[0][:2])
    return first / light


def misses_px(scene, found, points):
    """Distances (N,) [px] of the places where a map looks points up from where the simulator draws them."""
    view = ParticleView(replace(scene, sheet=None), (-2.0, 2.0), plane_mm=0.0)
    column, row = found.grid.to_px(points[:, :2]).T
    wanted = np.stack([map_coordinates(found.pixel[0, ..., k], (row, column), order=1) for k in (0, 1)], axis=-1)
    out = np.full(len(points), np.nan)
    for number, point in enumerate(points):
        drawn = view.images(point[None], np.ones(1))[:, :2]
        if len(drawn):
            out[number] = np.hypot(*(drawn - wanted[number]).T).min()
    return out


@pytest.mark.slow
def test_nodes_are_looked_up_where_lit_particles_are_seen(scene):
    """Light that a ball has bent lies off the plane: particles behind two balls are seen 1 px aside."""
    lit = prepare(scene.in_light_sheet()).corrector.map
    plane = build_correction_map(scene.in_light_sheet(), build_ray_map(scene.in_light_sheet()))
    rng = np.random.default_rng(2)
    row, column = np.nonzero(lit.recovered & plane.recovered)
    some = rng.permutation(len(row))[:200]
    places = lit.grid.nodes_mm()[row[some], column[some]]
    points = np.column_stack((places, height_by_simulator(scene, places)))
    bent = np.abs(points[:, 2]) > 0.2
    behind = bent & (lit.branch[0, row[some], column[some]] != 0)
    assert min(bent.sum(), behind.sum()) > 30
    on_surface, on_plane = misses_px(scene, lit, points), misses_px(scene, plane, points)
    print(np.nanquantile(on_surface[behind], [0.5, 0.9]), np.nanquantile(on_plane[behind], [0.5, 0.9]))
    assert np.nanmedian(on_plane[behind]) > 0.8
    assert np.nanmedian(on_surface[behind]) < 0.01
    assert np.nanquantile(on_surface[bent], 0.9) < 0.03
    assert np.nanmax(on_surface[~bent]) < 0.05


def place_of(found, pixels, near):
    """Places (N, 2) [px of the corrected frame] that a map looks up at pixels (N, 2), near to given ones."""

    def look(at):
        pixel = np.moveaxis(found.pixel[0], -1, 0)
        return np.stack([map_coordinates(one, at.T[::-1], order=1, cval=np.nan) for one in pixel], axis=-1)

    at, steps = near.copy(), 0.5 * np.eye(2)
    for _ in range(6):
        (a, c), (b, d) = (((look(at + step) - look(at - step)).T) for step in steps)
        left, top = (look(at) - pixels).T
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.stack((d * left - b * top, a * top - c * left), axis=-1) / (a * d - b * c)[:, None]
        at -= np.clip(step, -3.0, 3.0)
    return at


def shifts_px(scene, maps, middles, shift_px):
    """Displacements (N, 2) [px] in frames by each map of particles at (N, 3) that move by a shift (2,), v down."""
    view = ParticleView(replace(scene, sheet=None), (-2.0, 2.0), plane_mm=0.0)
    ends = []
    for way in (-0.5, 0.5):
        near = maps[0].grid.to_px(middles[:, :2]) + way * shift_px
        points = np.column_stack((maps[0].grid.to_mm(near), middles[:, 2]))
        drawn = [view.images(point[None], np.ones(1))[:, :2] for point in points]
        for found in maps:
            pixel = np.moveaxis(found.pixel[0], -1, 0)
            wanted = np.stack([map_coordinates(one, near.T[::-1], order=1) for one in pixel], axis=-1)
            pixels = [
                each[np.hypot(*(each - place).T).argmin()] if len(each) and np.isfinite(place).all() else place
                for each, place in zip(drawn, wanted, strict=True)
            ]
            ends.append(place_of(found, np.array(pixels), near))
    return [last - first for first, last in zip(ends[: len(maps)], ends[len(maps) :], strict=True)]


def test_displacements_are_those_of_particles_that_keep_their_height(scene):
    """Behind two balls the light changes its height: a particle that moves by 5 px seems to move otherwise."""
    seen = scene.in_light_sheet()
    prepared = prepare(seen)
    lit, plane = prepared.corrector.map, build_correction_map(seen, build_ray_map(seen))
    size_px, rng = 8, np.random.default_rng(11)
    rows, columns = (np.arange(8, length - 16, 4) for length in lit.grid.shape)
    row, column = (each.ravel() for each in np.meshgrid(rows, columns, indexing="ij"))
    middle = size_px // 2
    light = np.abs(prepared.light.height_at(lit.grid.nodes_mm())) > 0.2
    good = (lit.recovered & plane.recovered & light & (lit.branch[0] != 0))[row + middle, column + middle]
    some = rng.permutation(np.nonzero(good)[0])[:160]
    nodes_mm = lit.grid.to_mm(np.column_stack((column, row))[some] + 0.5 * (size_px - 1))
    middles = np.column_stack((nodes_mm, height_by_simulator(scene, nodes_mm)))
    shift_px = np.array((3.0, -4.0))
    on_plane, on_surface = shifts_px(scene, (plane, lit), middles, shift_px)
    windows, each = WindowGrid(rows, columns, size_px, 4), np.zeros((rows.size, columns.size, 2))
    bias, _ = prepared.height_change.bias_px(each + shift_px, windows, 0.0)
    off = [np.hypot(*(one - shift_px).T) for one in (on_plane, on_surface, on_surface - bias.reshape(-1, 2)[some])]
    whole = np.isfinite(off).all(axis=0) & (np.array(off) < 3.0).all(axis=0)
    print(*(np.quantile(one[whole], (0.5, 0.85, 0.95)) for one in off), whole.sum())
    assert whole.sum() > 120
    plane_off, surface_off, left = (one[whole] for one in off)
    assert np.median(surface_off) > 0.01
    assert np.median(left) < 0.1 * np.median(surface_off)
    assert np.quantile(left, 0.85) < 0.2 * np.median(plane_off)  # beyond: across a step, which no window follows


@pytest.mark.parametrize("brightness", [0.0, 0.1, 1.0])
def test_what_is_dark_in_one_frame_moves_nothing(brightness):
    """Beside a shadow the light has no height to change to: the slope of the rest counts."""
    grid = PlaneGrid((0.0, 0.0), 0.1, (64, 64))
    x_mm = grid.nodes_mm()[..., 0]
    bright = np.where(x_mm < 3.2, 1.0, brightness)
    height = np.where(bright == 1.0, 0.02 * x_mm, 0.0)
    light = PlaneLight(grid, LightMap(bright, height, np.full(grid.shape, 0.5), 1.0, 1.0, 0.0), 1)
    nodes_mm = grid.nodes_mm()[::4, ::4]
    change = HeightChange(light, nodes_mm, np.full_like(nodes_mm, (0.2, 0.0)), 10.0, grid.shape)
    windows = WindowGrid(np.array([20]), np.array([24]), 16, 8)
    shift_px = np.array([[(10.0, 0.0)]])
    bias, _ = change.bias_px(shift_px, windows, 0.0)
    slope_px = 0.02 * 0.2 * 10.0
    assert bias[0, 0, 1] == 0.0
    assert bias[0, 0, 0] == pytest.approx(slope_px, rel=0.02)


def test_vectors_before_the_noise_filter_lose_the_same_bias():
    """Means are made of these; and what is left at a step is the same in every pair."""
    grid = PlaneGrid((0.0, 0.0), 0.1, (60, 80))
    height = np.where(np.arange(80) < 40, 0.0, 0.02) * np.ones((60, 1))
    light = PlaneLight(grid, LightMap(np.ones(grid.shape), height, np.full(grid.shape, 0.5), 1.0, 1.0, 0.0), 1)
    nodes_mm = grid.nodes_mm()[::4, ::4]
    change = HeightChange(light, nodes_mm, np.full_like(nodes_mm, (0.2, 0.0)), 10.0, grid.shape)
    frame = np.random.default_rng(1).normal(size=(60, 88))
    frames = [cv2.GaussianBlur(frame[:, left : left + 80], (0, 0), 1.0) for left in (6, 0)]
    settings = PivSettings(windows_px=(32, 16))
    field = evaluate_pair(*frames, None, settings)
    windows = settings.result_grid(grid.shape)
    left = change.remove_from(field, windows, settings.window_sigma)
    moved = np.stack((field.u_px - left.u_px, field.v_px - left.v_px), axis=-1)[field.valid]
    assert np.abs(moved[..., 0]).max() > 0.01
    np.testing.assert_allclose((field.unfiltered_px - left.unfiltered_px)[field.valid], moved, atol=1e-12)
    grown = [
        np.square(getattr(left, name)) - np.square(getattr(field, name))
        for name in ("resolution_px", "steady_px", "unfiltered_steady_px")
    ]
    assert np.nanmax(grown[0]) > 1e-5
    np.testing.assert_allclose(grown[1:], [grown[0]] * 2, atol=1e-12)


def mean_errors_px(scene, flow_px, pairs, seed):
    """Errors (4, V, 2) of mean vectors of rendered pairs, v down, and which (V,) are behind balls.

    Looked up on the plane, on the surface of the light, and there without what its height adds; then its signs.
    """
    seen = scene.in_light_sheet()
    prepared = prepare(seen)
    lit = prepared.corrector.map
    plane = build_correction_map(seen, build_ray_map(seen)).as_stored()
    plane = plane.without(plane.recovered & ~lit.recovered, NodeStatus.DARK)
    velocity = np.array((flow_px[0], -flow_px[1], 0.0)) * lit.grid.pitch_mm / 1e-3
    sheet = SimulatedSheet(SHEET.thickness_mm, scene.sheet.z_mm)
    camera = FlowCamera(
        scene, Flow(Uniform(tuple(velocity))), sheet, Seeding(0.05), None, particle_counts=200.0, seed=seed
    )
    settings, found = PivSettings(windows_px=(48, 24, 24, 24)), ([], [], [])
    windows = settings.result_grid(lit.grid.shape)
    for number in range(pairs):
        raw = camera.pair(number, 1e-3, 0.0)
        for vectors, corrector in zip(found, (Corrector(plane), prepared.corrector), strict=False):
            field = evaluate_pair(*(corrector(one) for one in raw), corrector.recovered, settings)
            vectors.append(np.where(field.valid[..., None], np.stack((field.u_px, field.v_px), axis=-1), np.nan))
        field = prepared.height_change.remove_from(field, windows, settings.window_sigma)
        found[2].append(np.where(field.valid[..., None], np.stack((field.u_px, field.v_px), axis=-1), np.nan))
    measured = np.isfinite(found).all(axis=-1).sum(axis=1).min(axis=0) > 0.5 * pairs
    behind = lit.branch[0][np.ix_(np.rint(windows.y_px).astype(int), np.rint(windows.x_px).astype(int))] != 0
    return np.nanmean(np.array(found)[:, :, measured], axis=1) - flow_px, behind[measured]


@pytest.mark.slow  # test_displacements_are_those_of_particles_that_keep_their_height is the fast one
@pytest.mark.parametrize(("height_mm", "flow_px", "seed"), [(0.25, (1.0, 4.9), 72), (-0.2, (-4.9, -1.0), 73)])
def test_mean_vectors_on_the_surface_are_never_worse_than_on_the_plane(scene, height_mm, flow_px, seed):
    raised = replace(scene, sheet=replace(SHEET, z_mm=height_mm))
    errors, behind = mean_errors_px(raised, flow_px, 20, seed)
    for there in (behind, ~behind):
        plane, surface, left = np.sqrt(np.mean(errors[:, there] ** 2, axis=(1, 2)))
        print(there.sum(), plane, surface, left)
        assert there.sum() > 100
        assert left < 1.1 * min(plane, surface)
        if there is behind:
            assert left < min(0.6 * plane, surface)


def test_light_that_meets_no_body_is_the_plane(scene):
    bare = scene.with_bodies(LENSES).in_light_sheet()
    found = build_correction_map(bare, build_ray_map(bare)).as_stored()
    lit = prepare(replace(bare, light=SHEET)).corrector.map
    np.testing.assert_array_equal(lit.pixel[:, lit.recovered], found.pixel[:, lit.recovered])
    assert prepare(replace(bare, light=SHEET)).height_change is None


@pytest.mark.slow
def test_the_sigma_of_the_surface_is_the_spread_of_drawn_sheets(scene):
    """Sheets at other heights light other surfaces: maps of each, and the stated standard deviation."""
    seen = scene.in_light_sheet()
    zero = np.zeros((len(CAMERA) + 3 * len(SPHERE), 1))
    sigma = SceneSigma(scene.content_hash(), zero).in_light_sheet(scene)
    grid, nodes = prepare(seen).corrector.map.grid, np.s_[30:210:6, 30:290:6]
    maps = [
        prepare(replace(scene, sheet=replace(SHEET, z_mm=z)).in_light_sheet(), grid=grid).corrector.map
        for z in (-0.1, 0.0, 0.1)
    ]
    low, middle, high = (one.pixel[0][nodes] for one in maps)
    drawn = np.hypot(*np.moveaxis(0.5 * (high - low), -1, 0))
    known = np.isfinite(drawn) & np.isfinite(middle).all(axis=-1)
    jacobian = maps[1].jacobian[0][nodes].reshape(*known.shape, 2, 2)[known]
    spread = sigma.spread(seen, middle[known])  # one standard deviation is 0.1 mm
    moved = jacobian @ (spread * np.array([[1.0], [-1.0]]) / grid.pitch_mm)
    claimed = np.sqrt((moved**2).sum(axis=(1, 2)))
    rate = HeightRate.of(seen).at(grid.nodes_mm()[nodes][known])
    for part in (rate < -0.3, np.abs(rate - 1.0) < 0.05):
        there = part & (drawn[known] > 2e-3)
        assert there.sum() > 30
        assert np.median(claimed[there] / drawn[known][there]) == pytest.approx(1.0, abs=0.1)


def test_the_height_of_the_light_is_that_of_the_sheet_without_bodies(scene):
    rate = HeightRate.of(scene.with_bodies(()).in_light_sheet())
    assert np.abs(rate.rate - 1.0).max() < 1e-9
    assert HeightRate.of(replace(scene, sheet=LightSheet()).in_light_sheet()) is None
    assert light_of(replace(scene, sheet=LightSheet()).in_light_sheet(), rate.grid) is None
