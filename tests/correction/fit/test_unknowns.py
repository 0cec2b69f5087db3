"""The free vector: what it moves, and by how much."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from correction.errors import ViewsMissing
from correction.fit.adjustment import feasible_scene
from correction.fit.solve.considered import with_considered
from correction.fit.solve.contact import push_apart, walls
from correction.fit.solve.light import back_from_light, in_light
from correction.fit.solve.solver import Corners, residuals
from correction.fit.solve.unknowns import rotation_jacobian, unknowns_of
from ground.errors import ConfigError
from sim.demo.scenes import at_size, demo_scene
from tracer.bodies import Dome, Tube, Window
from tracer.harmonics import COUNT
from tracer.light import FULL_WIDTH, gaussian
from tracer.media import MEDIA, ConstantMedium
from tracer.scene.fit_section import (
    FitCameraTable,
    FitNamedTable,
    FitSphereTable,
    FitTable,
    FitTargetTable,
)
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_priors, load_scene

ALL = FitTable(
    camera=FitCameraTable(focal_px=5.0, principal_px=1.0, k2=0.1, k3=0.1, p1=0.1, p2=0.1),
    target=FitTargetTable(rotation_deg=1.0),
)


def pixels(u, v):
    """Every pair of places (N, 2)."""
    return np.stack([each.ravel() for each in np.meshgrid(u, v)], axis=-1)


def agreed_rates(bench, x, height, glass, pixel, *depth):
    """Derivatives (N, 2, P) of residuals by the free vector, each of which agrees with differences."""
    corners = Corners(height, glass, pixel, np.zeros_like(pixel), 1.0, *depth)
    exact = residuals(bench, x, corners).rate
    for number, name in enumerate(bench.names):
        step = 1e-4 * np.eye(len(x))[number]
        ahead, behind = residuals(bench, x + step, corners).value, residuals(bench, x - step, corners).value
        both = (ahead - behind) / 2e-4
        smooth = np.abs(both).max(axis=1) < 100.0  # a ray that changes its branch has no derivative
        scale = max(np.nanmax(np.abs(exact[smooth, :, number]), initial=0.0), 1e-3)
        assert np.nanmax(np.abs(both - exact[:, :, number])[smooth]) < 2e-5 * scale, name
    return exact


@pytest.mark.parametrize("deep_mm", [(0.0, 0.0), (0.0, 1.5), (-0.8, 2.0)])
def test_every_derivative_agrees_with_differences(deep_mm):
    scene = at_size(demo_scene("pyramid_500"), 700)
    deep = any(deep_mm)
    bench = unknowns_of(scene, [0.0, -10.0], ALL, print_sigma=(0.0, 0.0, 0.01) if deep else (0.0, 0.0))
    pixel = pixels(np.linspace(150, 550, 9), np.linspace(160, 545, 9))
    x = np.random.default_rng(0).normal(size=len(bench.names)) * 0.2
    depth = np.resize(deep_mm, len(pixel))
    for height, glass in ((0, True), (1, True), (1, False)):
        agreed_rates(bench, x, height, glass, pixel, depth)


def uneven(scene: Scene, seed: int) -> Scene:
    """The scene with every ball out of round by some micrometres, clear of each other."""
    rng = np.random.default_rng(seed)
    shapes = {number: rng.normal(0.0, 1e-3, COUNT) for number in range(len(scene.spheres))}
    places = push_apart(scene.sphere_table(), shapes=shapes)[:, :3].tolist()
    return scene.with_bodies(
        [
            replace(one, centre_mm=tuple(place), shape_um=tuple((1e3 * shapes[number]).tolist()))
            for number, (one, place) in enumerate(zip(scene.spheres, places, strict=True))
        ]
    )


@pytest.mark.slow
def test_every_derivative_by_shapes_agrees_with_differences() -> None:
    """All degrees of one ball, an ellipsoid of the other; both touch, so that they push each other as well."""
    scene = uneven(at_size(demo_scene("two_spheres_500"), 700), 4)
    upper, lower = (one.name for one in scene.spheres)
    named = {upper: FitNamedTable(out_of_round_um=5.0, out_of_round_degree=6)}
    named |= {lower: FitNamedTable(out_of_round_um=5.0)}
    bench = unknowns_of(scene, [0.0], FitTable(named=named))
    assert sum(name.startswith(f"{upper}.") for name in bench.names) == 4 + COUNT
    assert sum(name.startswith(f"{lower}.") for name in bench.names) == 4 + 5
    pixel = pixels(np.linspace(240, 460, 6), np.linspace(240, 460, 6))
    x = np.random.default_rng(0).normal(size=len(bench.names)) * 0.1
    for glass in (True, False):
        agreed_rates(bench, x, 0, glass, pixel)
    full = np.array(bench.start)
    full[bench.glass].reshape(-1, 5)[0, 2] -= 0.01  # into the plane or the other ball
    full[bench.glass].reshape(-1, 5)[1, 2] -= 0.01
    legal, overlap = feasible_scene(bench, full)
    assert overlap > 0.001
    for one, other in zip(legal.spheres, scene.spheres, strict=True):
        np.testing.assert_allclose(one.shape_um, other.shape_um, rtol=1e-12)


def test_walls_of_balls_out_of_round_follow_every_number() -> None:
    scene = uneven(demo_scene("two_spheres_500"), 5)
    table, shapes = scene.sphere_table(), scene.shapes()
    depth, rate, by_shape = walls(table, shapes)
    assert (np.abs(depth) < 0.02).sum() == 2  # on the plane, and on each other
    rng = np.random.default_rng(0)
    step = rng.normal(size=(len(table), 5)) * 1e-5
    bent = {number: rng.normal(size=COUNT) * 1e-5 for number in shapes}
    moved = np.array(table)
    moved[:, :4] += step[:, :4]
    after = walls(moved, {number: shape + bent[number] for number, shape in shapes.items()})[0]
    told = rate.reshape(len(depth), -1) @ step.ravel() + by_shape @ np.concatenate(list(bent.values()))
    np.testing.assert_allclose(after - depth, told, atol=2e-7)  # of 1e-5; that the line turns is left out


def test_shapes_are_free_where_the_section_says_so(tmp_path: Path) -> None:
    text = """
camera: {focal_px: 6000.0, sensor_px: [100, 100], position_mm: [0.0, 0.0, 500.0]}
bodies:
  - {name: ball, kind: sphere, centre_mm: [0.0, 0.0, 30.0], radius_mm: 25.0, material: BK7}
  - {name: hollow, kind: sphere, centre_mm: [60.0, 0.0, 30.0], radius_mm: 25.0, material: BK7,
     core: {radius_mm: 20.0, material: air}}
fit:
"""
    path = tmp_path / "scene.yaml"
    path.write_text(text + "  spheres: {out_of_round_um: 10.0, out_of_round_degree: 3}\n")
    bench = unknowns_of(load_scene(path), [0.0], load_priors(path))
    sigma = dict(zip(bench.names, bench.sigma.tolist(), strict=True))
    assert sigma["ball.C20"] == pytest.approx(0.01 / np.sqrt(5.0))
    assert sigma["ball.S33"] == pytest.approx(0.01 / np.sqrt(5.0) * 4.0 / 9.0)
    assert not {"ball.C40", "hollow.C20"} & set(sigma)
    path.write_text(text + "  named: {hollow: {out_of_round_um: 1.0}}\n")
    with pytest.raises(ConfigError, match=r"scene.yaml:8: fit.named.hollow: out_of_round_um is no number"):
        load_priors(path)
    path.write_text(text + "  spheres: {out_of_round_degree: 7}\n")
    with pytest.raises(ConfigError, match="out_of_round_degree"):
        load_priors(path)


@pytest.mark.slow
def test_every_derivative_by_walls_agrees_with_differences() -> None:
    """Balls in a tube of liquid behind a window that holds back another one: with the glass, and without."""
    scene = walled_scene()
    bench = unknowns_of(scene, [0.0], FitTable())
    names = [name for name in bench.names if name.startswith(("window.", "tube."))]
    assert names == [
        *(f"window.{part}" for part in ("distance", "tilt_x", "tilt_y", "thickness", "n")),
        *(f"tube.{part}" for part in ("x", "z", "tilt_x", "tilt_z", "outer_radius", "inner_radius", "n")),
    ]
    pixel = pixels(np.linspace(150, 550, 12), np.linspace(160, 545, 9))
    x = np.random.default_rng(0).normal(size=len(bench.names)) * 0.2
    for glass in (True, False):
        exact = agreed_rates(bench, x, 0, glass, pixel)
        for name in names:
            assert np.nanmax(np.abs(exact[:, :, bench.names.index(name)])) > 1e-6, name


def walled_scene() -> Scene:
    """A tank behind a window, a tube in it, and two balls, one of which is in the tube."""
    scene, glass, liquid = at_size(demo_scene("one_sphere_500"), 700), MEDIA["N-BK7"], ConstantMedium(1.4)
    (ball,) = scene.spheres
    inside = replace(ball, centre_mm=(-12.0, 5.0, 21.0), radius_mm=20.0)
    outside = replace(ball, name="outside", centre_mm=(70.0, 8.0, 25.0), radius_mm=18.0)
    tube = Tube("tube", (0.0, -150.0, 0.0), (0.0, 150.0, 0.0), 50.0, 45.0, glass, ConstantMedium(1.2))
    window = Window("window", (0.0, 0.0, 120.0), (0.0, 0.0, 1.0), 10.0, 150.0, glass, liquid)
    aside = Dome("aside", (200.0, 90.0, 40.0), 30.0, 28.0, glass)  # the kinds for which other tests compile
    return scene.with_bodies([window, tube, aside, inside, outside])


def test_spheres_of_one_glass_share_n_and_others_do_not():
    same = unknowns_of(demo_scene("two_spheres_500"), [0.0], FitTable())
    assert [name for name in same.names if name.endswith(".n")] == ["glass sphere1+sphere2.n"]
    different = unknowns_of(demo_scene("pair_off_axis"), [0.0], FitTable())
    assert [name for name in different.names if name.endswith(".n")] == ["glass sphere1.n", "glass sphere2.n"]
    x = np.zeros(len(same.names))
    x[-1] = 1.0
    moved = same.scene_at(same.full(x))
    assert [sphere.medium.n(532.0) for sphere in moved.spheres] == pytest.approx([1.535, 1.535])


def test_zero_sigma_holds_a_number_and_a_name_overrides_the_rest():
    priors = FitTable(
        camera=FitCameraTable(k1=0.0),
        spheres=FitSphereTable(centre_mm=0.5),
        named={"sphere2": FitNamedTable(radius_mm=0.0, centre_mm=0.0)},
        n=0.0,
    )
    names = unknowns_of(demo_scene("two_spheres_500"), [0.0], priors).names
    assert names == (
        *(f"camera.{part}" for part in ("x", "y", "z", "rx", "ry", "rz")),
        *(f"sphere1.{part}" for part in ("x", "y", "z", "radius")),
    )


def test_focal_length_is_free_only_with_a_stack_or_on_request():
    scene = demo_scene("two_spheres_500")
    assert "camera.focal_px" not in unknowns_of(scene, [0.0], FitTable()).names
    assert "camera.focal_px" in unknowns_of(scene, [0.0, -10.0, 10.0], FitTable(), focal_free=True).names
    assert "camera.focal_px" in unknowns_of(scene, [0.0], FitTable(camera=FitCameraTable(focal_px=3.0))).names


def test_free_undoes_full():
    bench = unknowns_of(demo_scene("three_spheres_500"), [0.0, 10.0], ALL)
    x = np.random.default_rng(1).normal(size=len(bench.names))
    np.testing.assert_allclose(bench.free(bench.full(x)), x, atol=1e-9)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (1e-6, 0.0, 2e-6), (0.3, -0.2, 0.5)])
def test_left_jacobian_is_what_a_small_turn_after_the_rotation_sees(turn):
    turn = np.array(turn)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-6
        ahead = Rotation.from_rotvec(turn + step) * Rotation.from_rotvec(turn).inv()
        behind = Rotation.from_rotvec(turn - step) * Rotation.from_rotvec(turn).inv()
        rate = (ahead.as_rotvec() - behind.as_rotvec()) / 2e-6
        np.testing.assert_allclose(rotation_jacobian(turn)[:, axis], rate, atol=1e-8)


def test_overlaps_are_pushed_apart_exactly_and_no_further():
    scene = demo_scene("two_spheres_500")
    bench = unknowns_of(scene, [0.0], FitTable())
    full = np.array(bench.start)
    full[bench.glass].reshape(-1, 5)[1, 2] -= 0.004
    full[bench.glass].reshape(-1, 5)[0, 2] -= 0.002
    legal, overlap = feasible_scene(bench, full)  # a Scene refuses overlap, so it is legal if it exists
    assert overlap == pytest.approx(0.002, abs=1e-9) or overlap == pytest.approx(0.002, rel=1e-3)
    one, two = legal.spheres
    gap = np.linalg.norm(np.subtract(two.centre_mm, one.centre_mm)) - one.radius_mm - two.radius_mm
    assert 0.0 <= gap < 1e-5
    assert one.lowest_mm == pytest.approx(0.0, abs=1e-6)


def test_what_does_not_overlap_is_left_alone():
    table = demo_scene("pair_off_axis").sphere_table()
    np.testing.assert_array_equal(push_apart(table)[:, :3], table[:, :3])
    assert (walls(table)[0] <= 1e-9).all()


def test_a_fitted_index_moves_to_another_wavelength_with_the_dispersion_of_its_glass():
    scene = demo_scene("one_sphere_500")
    sphere = replace(scene.spheres[0], medium=MEDIA["N-BK7"])
    scene = replace(scene.with_bodies([sphere]), wavelength_nm=590.0)
    bench = unknowns_of(scene, [0.0], FitTable())
    x = np.zeros(len(bench.names))
    x[bench.names.index("glass N-BK7.n")] = 0.3  # 0.3 of 0.005
    fitted = bench.scene_at(bench.full(x))
    there = replace(fitted, wavelength_nm=532.0).spheres[0].medium.n(532.0)
    # Schott's data sheet of N-BK7: n(589.3) = 1.51673, n(532) = 1.51947
    assert fitted.spheres[0].medium.n(590.0) == pytest.approx(MEDIA["N-BK7"].n(590.0) + 0.0015, abs=1e-12)
    assert there == pytest.approx(1.51947 + 0.0015, abs=1e-5)


def test_the_mean_index_of_a_wide_light_follows_the_bend_of_the_dispersion():
    glass, step = MEDIA["N-BK7"], 5.0
    bend = (glass.n(560.0 + step) - 2.0 * glass.n(560.0) + glass.n(560.0 - step)) / step**2
    narrow, wide = (gaussian(560.0, width / FULL_WIDTH).index(glass) for width in (0.0, 40.0))
    assert narrow == pytest.approx(glass.n(560.0), abs=1e-12)
    assert wide - narrow == pytest.approx(bend * 40.0**2 / (16.0 * np.log(2.0)), rel=0.01)


def test_a_glass_seen_in_another_light_comes_back_as_it_was():
    scene = demo_scene("two_spheres_500")
    light = gaussian(590.0, 25.0)
    with pytest.raises(ViewsMissing, match="number without dispersion"):
        in_light(scene, light)
    glass = scene.with_bodies([replace(sphere, medium=MEDIA["N-BK7"]) for sphere in scene.spheres])
    seen = in_light(glass, light)
    assert seen.spheres[0].medium.n(532.0) == pytest.approx(light.index(MEDIA["N-BK7"]), abs=1e-12)
    assert back_from_light(seen, glass, light).spheres[0].medium.n(532.0) == pytest.approx(
        MEDIA["N-BK7"].n(532.0), abs=1e-12
    )


def test_fit_section_is_read_strictly(tmp_path):
    text = """
camera: {focal_px: 6000.0, sensor_px: [100, 100], position_mm: [0.0, 0.0, 500.0]}
glasses: {melt: {base: N-BK7, offset: 0.0012}}
bodies: [{name: ball, kind: sphere, centre_mm: [0.0, 0.0, 30.0], radius_mm: 25.0, material: melt}]
fit:
  spheres: {centre_mm: 0.3}
  glasses: {melt: 0.001}
"""
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    priors = load_priors(path)
    assert priors.sphere("ball").centre_mm == 0.3
    assert priors.index("melt") == 0.001
    assert load_scene(path).spheres[0].medium.n(532.0) == pytest.approx(1.51947 + 0.0012, abs=1e-5)
    path.write_text(text + "  named: {bal: {centre_mm: 0.1}}\n")
    with pytest.raises(ConfigError, match=r"scene.yaml:\d+: fit.named: there is no sphere, window or tube 'bal'"):
        load_priors(path)
    path.write_text(text.replace("centre_mm: 0.3", "centre_um: 0.3"))
    with pytest.raises(ConfigError, match="did you mean 'centre_mm'"):
        load_priors(path)


def test_what_is_known_of_a_wall_is_read_by_its_name(tmp_path: Path) -> None:
    text = """
camera: {focal_px: 6000.0, sensor_px: [100, 100], position_mm: [0.0, 0.0, 500.0]}
bodies:
  - {kind: window, name: front, centre_mm: [0, 0, 99],
     normal: [0, 0, 1], thickness_mm: 9, radius_mm: 80, material: BK7}
fit:
  walls: {thickness_mm: 0.02}
"""
    path = tmp_path / "scene.yaml"
    path.write_text(text + "  named: {front: {tilt_deg: 0.0}}\n")
    bench = unknowns_of(load_scene(path), [0.0], load_priors(path))
    sigma = dict(zip(bench.names, bench.sigma.tolist(), strict=True))
    assert sigma["front.thickness"] == 0.02
    assert sigma["front.n"] == 0.005
    assert "front.tilt_x" not in sigma
    assert {"front.tilt_x", "front.tilt_y"} < set(
        with_considered(bench).names
    )  # held, so the map's sigma counts them
    path.write_text(text + "  named: {front: {radius_mm: 0.1}}\n")
    with pytest.raises(ConfigError, match=r"scene.yaml:8: fit.named.front: radius_mm is no number"):
        load_priors(path)
