"""Cuts in which rays stay, and rays drawn where they are."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from rtpiv.analysis.pictures.drawing import scene_figure
from rtpiv.analysis.pictures.plane_axes import colour_bar, outline_mm
from rtpiv.analysis.pictures.saved import short
from rtpiv.analysis.pictures.section import BESIDE, CENTRAL, GLASS, STOPPED, fan, is_central, sections_of
from tests.rtpiv.analysis.test_plane_share import GLASS as CROWN
from tests.rtpiv.analysis.test_plane_share import cone_area_mm2, scene_of
from tracer.bodies import Rod, Sphere

TRIANGLE = [Sphere(name, (x, y, 22.0), 20.0, CROWN) for name, x, y in
            (("left", -22.0, -12.0), ("right", 22.0, -12.0), ("top", 0.0, 26.0))]  # fmt: skip


def test_every_ball_of_a_triangle_is_cut_through_its_centre():
    scene = scene_of(*TRIANGLE)
    cuts = sections_of(scene)
    assert [cut.letter for cut in cuts] == ["A", "B", "C"]
    for ball in TRIANGLE:
        assert any(is_central(cut, ball) for cut in cuts)


def test_a_row_needs_one_cut_and_a_pyramid_two():
    row = [Sphere(f"b{k}", (0.0, 0.0, 25.0 + 50.0 * k), 25.0, CROWN) for k in range(3)]
    assert len(sections_of(scene_of(*row))) == 1
    base = [Sphere(f"{x}{y}", (x, y, 28.0), 25.0, CROWN) for x in (-25.0, 25.0) for y in (-25.0, 25.0)]
    cuts = sections_of(scene_of(*base, Sphere("top", (0.0, 0.0, 28.0 + 25.0 * 2**0.5), 25.0, CROWN)))
    assert len(cuts) == 2
    assert sum(is_central(cut, ball) for cut in cuts for ball in base) == 4


def test_rays_bend_on_the_drawn_circles_and_nowhere_else():
    """The fault of old: circles and rays lay in different planes, and rays bent inside the balls."""
    far = Sphere("far", (30.0, 30.0, 80.0), 25.0, CROWN)
    scene = scene_of(*TRIANGLE, far, position=(5.0, -3.0, 500.0))
    bends = 0
    for cut in sections_of(scene):
        for ray in fan(scene, cut, -60.0, 60.0):
            for place in ray.corners_mm[1:-1] if not ray.leaves else ray.corners_mm[1:]:
                world = cut.world(place)
                gaps = [abs(np.linalg.norm(world - ball.centre_mm) - ball.radius_mm) for ball in scene.spheres]
                assert min(gaps) < 2.5 * CENTRAL * 20.0  # a cut may pass a centre by CENTRAL radii
                bends += 1
    assert bends > 50


def test_an_opaque_body_stops_rays_where_it_stands():
    ball = Sphere("lead", (0.0, 0.0, 40.0), 10.0, None)
    rod = Rod("support", (30.0, -60.0, 20.0), (30.0, 60.0, 20.0), 3.0)
    scene = scene_of(ball, rod)
    rays = fan(scene, sections_of(scene)[0], -50.0, 50.0, 201)
    stopped = [ray for ray in rays if ray.fate == STOPPED]
    assert {ray.fate for ray in rays} == {STOPPED, BESIDE}
    assert len(stopped) > 40
    for ray in stopped:
        s, z = ray.corners_mm[-1]
        assert min(abs(np.hypot(s, z - 40.0) - 10.0), abs(np.hypot(s - 30.0, z - 20.0) - 3.0)) < 0.01


def test_what_is_thrown_on_the_plane_has_the_area_of_its_ellipse():
    ball = Sphere("ball", (30.0, -20.0, 60.0), 25.0, CROWN)
    outline = outline_mm(ball, (60.0, -25.0, 480.0))
    x, y = outline.T
    area = 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))
    assert area == pytest.approx(cone_area_mm2(ball, (60.0, -25.0, 480.0)), rel=5e-3)
    assert outline_mm(Sphere("beside", (0.0, 600.0, 500.0), 50.0, CROWN), (0.0, 0.0, 500.0)) is None


@pytest.mark.parametrize("bodies", [[], [Rod("only", (-9.0, 0.0, 9.0), (9.0, 0.0, 9.0), 1.0)], TRIANGLE])
def test_any_scene_is_drawn(bodies, tmp_path):
    named = [*bodies, Sphere("$x_{1}$ \\frac " + 70 * "n", (0.0, 0.0, 80.0), 12.0, CROWN)]
    scene_figure(scene_of(*named if bodies else [])).savefig(tmp_path / "scene.svg")
    assert (tmp_path / "scene.svg").stat().st_size > 5000


def test_long_names_keep_both_ends():
    assert short("ball") == "ball"
    assert len(short("b" * 80)) <= 18
    assert short("beginning of a very long end").startswith("beginning"[:8])
    assert short("beginning of a very long end").endswith("end")


def test_a_colour_bar_is_as_tall_as_its_picture():
    figure = Figure(figsize=(6.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    bar = colour_bar(axes.imshow(np.zeros((10, 40))), axes, "[px]")
    figure.draw_without_rendering()
    picture, beside = axes.get_window_extent(), bar.ax.get_window_extent()
    assert (beside.y0, beside.y1) == pytest.approx((picture.y0, picture.y1), abs=0.5)


def test_glass_rays_reach_the_plane():
    rays = fan(scene_of(TRIANGLE[2]), sections_of(scene_of(TRIANGLE[2]))[0], 15.0, 35.0)
    assert {ray.fate for ray in rays} == {GLASS}
    assert all(abs(ray.corners_mm[-1, 1]) < 1e-9 for ray in rays)
