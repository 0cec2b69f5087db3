"""Maps on the surface of the light: particles lit and drawn by the simulator's own optics, off the plane."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from correction.fitted.prepared import prepare
from correction.fitted.scene_sigma import SceneSigma
from correction.maps.correction_map import build_correction_map
from correction.maps.light_height import HeightRate
from correction.maps.lit import light_of
from sim.flow.particles import LightSheet as SimulatedSheet
from sim.flow.sheet_light import trace_sheet
from sim.flow.view import ParticleView
from tests.tracer.scenes import ball, camera_at
from tracer.light_sheet import LightSheet, SheetSource
from tracer.scene.scene import Scene
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


def test_light_that_meets_no_body_is_the_plane(scene):
    bare = scene.with_bodies(LENSES).in_light_sheet()
    found = build_correction_map(bare, build_ray_map(bare)).as_stored()
    lit = prepare(replace(bare, light=SHEET)).corrector.map
    np.testing.assert_array_equal(lit.pixel[:, lit.recovered], found.pixel[:, lit.recovered])


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
