"""Corrected frames: right values, right places, no light thrown away, honest fill."""

import cv2
import numpy as np
import pytest

from correction.maps.correction_map import build_correction_map
from correction.maps.corrector import NEGLIGIBLE_PX, UINT16_OFFSET, Corrector, to_uint16
from correction.maps.dewarp import Dewarp, powers
from piv.errors import FrameError
from tests.correction.small_scenes import small_scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.trace import trace


@pytest.fixture(scope="module")
def ball():
    scene = small_scene("one_sphere_250", 504)
    return scene, build_correction_map(scene, build_ray_map(scene))


def wavy(plane_mm):
    """A smooth picture on the plane, about 12 mm a wave."""
    x, y = plane_mm[..., 0], plane_mm[..., 1]
    return 1500.0 + 900.0 * np.sin(x / 1.9) * np.cos(y / 2.3)


def acquired(scene, pattern):
    """What an ideal camera records of a pattern: one exact ray a pixel centre."""
    height, width = scene.camera.shape
    v, u = np.indices((height, width))
    plane = trace(scene, np.stack((u, v), axis=-1)).plane_mm
    return np.nan_to_num(pattern(plane)).astype(np.float32)


@pytest.mark.parametrize(("method", "limit"), [("quintic", 1.5), ("bilinear", 25.0)])
def test_a_smooth_picture_comes_back(ball, method, limit):
    scene, cmap = ball
    corrected = Corrector(cmap, method=method)(acquired(scene, wavy))
    low, high = cmap.magnification()
    calm = cmap.recovered & (high < 3.0) & (low > 0.8)
    # The mean over a footprint of one node lowers this wave by (pitch/1.9)^2/24 + (pitch/2.3)^2/24 < 0.2 %.
    error = (corrected - wavy(cmap.grid.nodes_mm()))[calm]
    assert calm.sum() > 10000
    assert np.sqrt((error**2).mean()) < limit


def test_a_smooth_picture_comes_back_through_hollow_balls():
    """Through the cores as through glass: where the spline's reach ends within one branch, the same bounds."""
    scene = small_scene("hollow_pair", 504)
    ray_map = build_ray_map(scene)
    cmap = build_correction_map(scene, ray_map)
    corrected = Corrector(cmap)(acquired(scene, wavy))
    low, high = cmap.magnification()
    number, reach = ray_map.branch.astype(np.float32), np.ones((9, 9), np.uint8)
    inside = cv2.erode(number, reach) == cv2.dilate(number, reach)
    u, v = np.rint(np.nan_to_num(cmap.pixel[0])).astype(int).transpose(2, 0, 1)
    calm = cmap.recovered & (high < 3.0) & (low > 0.8) & inside[v, u]
    error = corrected - wavy(cmap.grid.nodes_mm())
    ways = [" ".join(names) for names in cmap.branches]
    for word in ("high core", "low core"):
        here = calm & np.isin(cmap.branch[0], [k for k, way in enumerate(ways) if way.endswith(word)])
        assert here.sum() > 500
        assert np.sqrt((error[here] ** 2).mean()) < 1.5


def test_a_constant_frame_stays_constant(ball):
    scene, cmap = ball
    for dtype in (np.uint8, np.uint16, np.float32):
        corrected = Corrector(cmap)(np.full(scene.camera.shape, 200, dtype))
        assert np.abs(corrected[cmap.recovered] - 200.0).max() < 0.01
        assert np.isnan(corrected[~cmap.recovered]).all()


def test_magnified_views_use_all_their_light(ball):
    """White noise seen 5 times over (area) must come out calmer by about sqrt 5; point sampling would not."""
    scene, cmap = ball
    noise = np.random.default_rng(0).normal(0.0, 100.0, scene.camera.shape).astype(np.float32)
    corrected = Corrector(cmap, method="bilinear")(noise)
    low, high = cmap.magnification()
    area = low * high
    magnified = cmap.behind_glass & (area > 4.5) & (area < 6.0)
    assert magnified.sum() > 500
    assert corrected[magnified].std() < 100.0 / np.sqrt(4.5)


def test_particles_keep_their_places(ball):
    """Gaussians on the plane, imaged by exact rays, corrected: centroids within a few thousandths of a pixel."""
    scene, cmap = ball
    rng = np.random.default_rng(3)
    pitch = cmap.grid.pitch_mm
    places = []
    while len(places) < 25:
        place = rng.uniform(-9.0, 9.0, 2)
        if np.hypot(*place) < 9.0 and all(np.hypot(*(place - other)) > 9 * pitch for other in places):
            places.append(place)
    sigma = 0.9 * pitch

    def particles(plane):
        return sum(2000.0 * np.exp(-((plane - place) ** 2).sum(-1) / (2 * sigma**2)) for place in places)

    corrected = Corrector(cmap)(acquired(scene, particles))
    errors = []
    for place in places:
        u, v = cmap.grid.to_px(place)
        rows, columns = np.mgrid[int(v) - 3 : int(v) + 5, int(u) - 3 : int(u) + 5]
        weight = corrected[rows, columns].astype(float)
        errors.append(((weight * columns).sum() / weight.sum() - u, (weight * rows).sum() / weight.sum() - v))
    assert np.sqrt(np.mean(np.square(errors))) < 0.01


def test_blending_joins_two_views_of_one_node():
    scene = small_scene("one_sphere_250", 504)
    ray_map = build_ray_map(scene)
    best, both = (build_correction_map(scene, ray_map, layers=layers) for layers in (1, 2))
    twice = both.weight[1] > 0.0
    assert twice.sum() > 100
    frame = acquired(scene, wavy)
    one, two = Corrector(best)(frame), Corrector(both)(frame)
    assert np.array_equal(one[~twice], two[~twice], equal_nan=True)
    smooth = twice & (both.magnification()[1] < 3.0)
    assert np.abs(two - wavy(both.grid.nodes_mm()))[smooth].max() < 120.0
    assert (one[twice] != two[twice]).any()


def test_a_mask_takes_nodes_out_and_their_work_with_them(ball):
    scene, cmap = ball
    mask = np.zeros(cmap.grid.shape, bool)
    mask[20:60, 20:100] = True
    frame = np.random.default_rng(1).integers(0, 4096, scene.camera.shape).astype(np.uint16)
    for method in ("quintic", "bilinear"):
        whole, part = Corrector(cmap, method=method), Corrector(cmap, method=method, mask=mask, fill=-7.0)
        expected, found = whole(frame), part(frame)
        wanted = mask & cmap.recovered
        assert np.array_equal(part.recovered, wanted)
        assert np.abs(found - expected)[wanted].max() < 0.01  # of 4096: vectors begin elsewhere
        assert (found[~wanted] == -7.0).all()
        assert part._footprints.samples < 0.05 * whole._footprints.samples
    assert len(Corrector(cmap, mask=mask)._tiles) <= 2 < len(Corrector(cmap)._tiles)


def test_leaving_out_what_no_sample_reads_changes_no_bit(ball):
    scene, cmap = ball
    mask = np.zeros(cmap.grid.shape, bool)
    mask[230:270, :] = True
    frame = np.random.default_rng(1).integers(0, 4096, scene.camera.shape).astype(np.uint16)
    some, every = (Corrector(cmap, mask=mask, skip=skip) for skip in (True, False))
    assert len(some._tiles) < len(every._tiles)
    assert np.array_equal(some(frame), every(frame), equal_nan=True)


def shifted(shift_px, size=504):
    """A dewarp of order 2 that moves u by exactly `shift_px` at the corners and less elsewhere."""
    scale = size / 2.0
    pairs = {(1, 0): (1.0, 0.0), (0, 1): (0.0, 1.0), (2, 0): (shift_px / scale / ((size - 1) / size) ** 2, 0.0)}
    coefficients = tuple(pairs.get(power, (0.0, 0.0)) for power in powers(2))
    return Dewarp(2, ((size - 1) / 2,) * 2, scale, coefficients, 0.0, 0.0, 1.0, 1.0, 100, 0)


def test_a_dewarp_is_left_out_only_if_it_moves_nothing_by_more_than_the_bound(ball):
    scene, cmap = ball
    corners = np.stack(np.meshgrid((0.0, 100.0, 251.5, 503.0), (0.0, 503.0)), axis=-1)
    for shift in (0.9 * NEGLIGIBLE_PX, 1.1 * NEGLIGIBLE_PX):
        moved = np.abs(shifted(shift).apply(corners) - corners).max()
        assert moved == pytest.approx(shift, rel=1e-6)
        assert moved <= shifted(shift).largest_shift_px(scene.camera.sensor_px) * (1 + 1e-9)
    frame = acquired(scene, wavy)
    steepest = max(np.abs(np.diff(frame, axis=axis)).max() for axis in (0, 1))
    plain = Corrector(cmap)(frame)
    small, large = shifted(0.9 * NEGLIGIBLE_PX), shifted(1.1 * NEGLIGIBLE_PX)
    assert np.array_equal(Corrector(cmap, small)(frame), plain, equal_nan=True)
    assert not np.array_equal(Corrector(cmap, large)(frame), plain, equal_nan=True)
    composed = Corrector(cmap, small, skip=False)(frame)
    assert 0.0 < np.nanmax(np.abs(composed - plain)) < 2.0 * steepest * NEGLIGIBLE_PX


def test_a_view_that_the_dewarp_moves_off_the_sensor_leaves_its_share_to_the_others():
    scene = small_scene("one_sphere_250", 504)
    both = build_correction_map(scene, build_ray_map(scene), layers=2)
    flat = np.full(scene.camera.shape, 300, np.uint16)
    one = Dewarp(
        2,
        (251.5, 251.5),
        252.0,
        tuple(
            (0.6 * (k == 1) - (k + m == 0) * 0.55, 0.6 * (m == 1) - (k + m == 0) * 0.55)
            if k + m < 2
            else (0.0, 0.0)
            for k, m in powers(2)
        ),
        0.0,
        0.0,
        1.0,
        1.0,
        100,
        0,
    )
    corrector = Corrector(both, one)
    found = corrector(flat)
    assert np.abs(found[corrector.recovered] - 300.0).max() < 0.01
    position = one.apply(both.pixel)
    inside = ((position >= 0.0) & (position <= 503.0)).all(axis=-1)
    some_left = (inside & (both.weight > 0.0)).any(axis=0)
    assert np.array_equal(corrector.recovered, some_left)
    assert ((both.weight[1] > 0.0) & (inside[0] != inside[1])).any()


def test_frames_of_another_size_are_refused(ball):
    _, cmap = ball
    with pytest.raises(FrameError, match="500 x 504 px"):
        Corrector(cmap)(np.zeros((504, 500), np.uint16))
    with pytest.raises(FrameError, match="2-D"):
        Corrector(cmap)(np.zeros((504, 504, 3), np.uint8))


def test_storing_as_uint16_keeps_negative_lobes_and_counts_what_it_cuts():
    values = np.array([[-30.4, 0.0, np.nan, 70000.0, -5000.0]], np.float32)
    stored, clipped = to_uint16(values)
    assert stored.tolist() == [[UINT16_OFFSET - 30, UINT16_OFFSET, 0, 65535, 1]]
    assert clipped == 2


def test_same_bits_for_any_number_of_threads(ball, monkeypatch):
    scene, cmap = ball
    frame = np.random.default_rng(1).integers(0, 4096, scene.camera.shape).astype(np.uint16)
    results = []
    for threads in ("1", "2"):
        monkeypatch.setenv("RTPIV_THREADS", threads)
        results.append(Corrector(cmap)(frame))
    assert np.array_equal(*results, equal_nan=True)
