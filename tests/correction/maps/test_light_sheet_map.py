"""Maps for a light sheet: against pictures of points in it that the simulator draws, and with their sigma."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from correction.fitted.prepared import prepare
from correction.fitted.scene_sigma import SceneSigma
from correction.node_status import NodeStatus
from sim.flow.view import ParticleView
from tests.correction.small_scenes import small_scene
from tracer.bodies import translate_by
from tracer.errors import StaleMap
from tracer.light_sheet import LightSheet
from tracer.strategies.sensitivity import CAMERA, SPHERE
from tracer.strategies.trace import trace

SHEET = LightSheet(-0.4, 0.5, -0.3, 0.004, 0.01, (0.4, -0.3, 0.2))


@pytest.fixture(scope="module")
def scene():
    return replace(small_scene("tilted_pair", 252), sheet=SHEET)


def miss_px(scene, sheet, points):
    """Where a map for a sheet looks up points, and where the simulator draws them (N, 2); NaN if it does not."""
    found = prepare(replace(scene, sheet=sheet).in_light_sheet()).corrector.map
    view = ParticleView(replace(scene, sheet=None), (-1.0, 1.0))
    out = np.full((len(points), 2), np.nan)
    for number, point in enumerate(points):
        column, row = found.grid.to_px(np.array(sheet.place(tuple(point)))[:2])
        wanted = [map_coordinates(found.pixel[0, ..., k], [[row], [column]], order=1)[0] for k in (0, 1)]
        drawn = view.images(point[None], np.ones(1))[:, :2]
        if np.isfinite(wanted).all() and len(drawn):
            off = drawn - wanted
            out[number] = off[np.argmin(np.hypot(*off.T))]
    return out


def test_points_of_the_sheet_are_looked_up_where_they_are_seen(scene):
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-25.0, 25.0, (2, 150))
    points = np.stack((x, y, SHEET.height_mm(x, y)), axis=-1)
    at_sheet = np.hypot(*miss_px(scene, SHEET, points).T)
    at_target = np.hypot(*miss_px(scene, LightSheet(), points).T)
    assert np.isfinite(at_sheet).sum() > 35
    assert np.nanmedian(at_sheet) < 0.01
    assert np.nanmedian(at_target) > 0.05  # 2.7 px/mm, and the target's plane is 0.4 mm off and tilted


def test_the_sigma_of_the_sheet_is_the_spread_of_drawn_sheets(scene):
    """All of it: a scene that is known exactly, in a sheet that is not."""
    zero = np.zeros((len(CAMERA) + 2 * len(SPHERE), 1))
    sigma = SceneSigma(scene.content_hash(), zero).in_light_sheet(scene)
    seen = scene.in_light_sheet()
    sigma.check(seen)
    with pytest.raises(StaleMap):
        sigma.check(scene)
    rng = np.random.default_rng(3)
    pixels = rng.uniform(20.0, 230.0, (150, 2))
    claimed = sigma.sigma(seen, pixels)
    root, (a, b) = SHEET.root(), SHEET.slopes
    landed = []
    for _ in range(400):
        z, one, two = np.array([SHEET.z_mm, a, b]) + root @ rng.normal(size=3)
        tilts = np.rad2deg(np.arctan([one, two]))
        landed.append(trace(replace(scene, sheet=LightSheet(z, *tilts)).in_light_sheet(), pixels).plane_mm)
    drawn = np.std(landed, axis=0)
    good = np.isfinite(drawn).all(axis=1) & (drawn > 2e-5).all(axis=1)
    assert good.sum() > 60
    ratio = claimed[good] / drawn[good]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.06)
    assert np.mean(np.abs(ratio - 1.0) < 0.15) > 0.95
    # Differences: the sheet moves all of the field together.
    spread = sigma.spread(seen, pixels)
    gap = np.sqrt(np.sum((spread[1:] - spread[:-1]) ** 2, axis=2))
    drawn_gap = np.std(np.diff(landed, axis=1), axis=0)
    both = good[1:] & good[:-1] & (drawn_gap > 2e-5).all(axis=1)
    assert np.median(gap[both] / drawn_gap[both]) == pytest.approx(1.0, abs=0.06)


def test_the_scenes_own_sigma_turns_with_it(scene):
    rng = np.random.default_rng(6)
    steep = replace(scene, sheet=LightSheet(-0.2, 20.0, -10.0, 0.0, 0.0))
    sigma = SceneSigma(scene.content_hash(), rng.normal(size=(len(CAMERA) + 2 * len(SPHERE), 4)))
    pixels = rng.uniform(10.0, 240.0, (400, 2))
    # A sphere's centre, moved in the world: the landing point in the sheet moves as the turned root says.
    column, step = 2, 1e-4
    low, high = scene.spheres
    ball = sigma.root[len(CAMERA) : len(CAMERA) + 3, column] * step
    only = np.zeros_like(sigma.root)
    only[len(CAMERA) : len(CAMERA) + 3, column] = ball
    spread = replace(sigma, root=only).in_light_sheet(steep).spread(steep.in_light_sheet(), pixels)[:, :, column]
    pushed = replace(low, centre_mm=tuple(np.array(low.centre_mm) + ball))
    before = trace(steep.in_light_sheet(), pixels).plane_mm
    after = trace(steep.with_bodies([pushed, high]).in_light_sheet(), pixels).plane_mm
    known = np.isfinite(spread).all(axis=1) & np.isfinite(after - before).all(axis=1)
    known &= np.abs(spread).max(axis=1) > 1e-6
    assert known.sum() > 10
    np.testing.assert_allclose(spread[known], (after - before)[known], rtol=0.02, atol=1e-7)


def test_a_sheet_that_the_scene_does_not_name_is_unsure_by_half_a_millimetre():
    """Particles 0.25 mm off the target's plane, in a scene known exactly: half a sigma beside their places."""
    scene = small_scene("two_spheres_500", 252)
    scene = scene.with_bodies([body.moved(translate_by((0.0, 0.0, 4.0))) for body in scene.bodies])
    zero = np.zeros((len(CAMERA) + len(SPHERE) * len(scene.spheres), 1))
    known = SceneSigma(scene.content_hash(), zero)
    view = ParticleView(scene, (-0.6, 0.6), step_px=0.5)
    x, y = np.random.default_rng(4).uniform(-18.0, 18.0, (2, 60))
    share, told = [], []
    for point in np.stack((x, y, np.full(60, 0.25)), axis=-1):
        drawn = view.images(point[None], np.ones(1))[:, :2].astype(np.float64)
        off = np.hypot(*(trace(scene, drawn).plane_mm - point[:2]).T)
        claim = np.hypot(*known.in_light_sheet(scene).sigma(scene, drawn).T)
        share += list(off / claim)
        exact = replace(scene, sheet=LightSheet(sigma_mm=0.0, tilt_sigma_deg=0.0))
        told += list(np.hypot(*known.in_light_sheet(exact).sigma(scene, drawn).T))
    share = np.array(share)[np.isfinite(share)]
    assert len(share) >= 60
    assert 0.4 < np.median(share) < 0.52  # the tilt that nobody measured comes on top
    assert np.mean(share < 1.0) > 0.95
    assert np.nanmax(told) < 1e-9


def test_what_lies_in_glass_is_masked():
    ball = small_scene("two_spheres_500", 252)
    cut = prepare(replace(ball, sheet=LightSheet(0.3)).in_light_sheet()).corrector
    inside = cut.status == NodeStatus.IN_GLASS
    area_mm2 = inside.sum() * cut.map.grid.pitch_mm**2
    assert area_mm2 == pytest.approx(np.pi * (25.0**2 - 24.7**2), rel=0.05)
    assert np.isnan(cut(np.full(ball.camera.shape, 9, np.uint8))[inside]).all()
    behind = prepare(replace(ball, sheet=LightSheet(-0.3)).in_light_sheet()).corrector
    assert not (behind.status == NodeStatus.IN_GLASS).any()


def test_balls_behind_a_sheet_inside_a_bed_are_no_part_of_its_sigma(scene):
    """The fit knows three balls; the view of the sheet has two, and the rows of the right ones."""
    low, high = scene.spheres
    deep = replace(low, name="deep", centre_mm=(30.0, -30.0, -40.0))
    behind = tuple(body.moved(translate_by((0.0, 0.0, 80.0))) for body in (deep, low, high))
    bed = replace(scene.with_bodies(behind), sheet=replace(SHEET, z_mm=79.6))
    root = np.random.default_rng(8).normal(size=(len(CAMERA) + 3 * len(SPHERE), 6)) * 1e-3
    sigma = SceneSigma(bed.content_hash(), root).in_light_sheet(bed)
    alone = replace(bed.with_bodies(behind[1:]), sheet=bed.sheet)
    rest = np.delete(root, np.arange(len(CAMERA), len(CAMERA) + len(SPHERE)), axis=0)
    other = SceneSigma(alone.content_hash(), rest).in_light_sheet(alone)
    pixels = np.random.default_rng(4).uniform(20.0, 230.0, (50, 2))
    known = sigma.spread(bed.in_light_sheet(), pixels)
    assert np.isfinite(known).any()
    np.testing.assert_array_equal(known, other.spread(alone.in_light_sheet(), pixels))
