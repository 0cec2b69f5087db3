"""What shows more of a scene: a promise that a traced scene keeps, and silence where nothing is to be gained."""

from dataclasses import replace

import pytest

from correction.maps.correction_map import build_correction_map
from rtpiv.analysis.through_glass import ThroughGlass, coarse_share, through_glass
from rtpiv.analysis.views import arranged
from rtpiv.analysis.views.arranged import LITTLE, Offer, little, offers
from tests.rtpiv.analysis.test_plane_share import scene_of
from tracer.bodies import Rod, Sphere
from tracer.media import ConstantMedium
from tracer.strategies.ray_map import build_ray_map

FLINT, CROWN = ConstantMedium(1.62), ConstantMedium(1.49)


def share_of(scene):
    found = build_correction_map(scene, build_ray_map(scene))
    return through_glass(scene, found.grid, found.recovered).share


def raised(scene, by_mm):
    return scene.with_bodies([body.moved(lambda at: (*at[:2], at[2] + by_mm)) for body in scene.bodies])


def test_what_is_offered_for_two_balls_of_two_glasses_beside_each_other_is_kept_by_the_scene_that_follows_it():
    left, right = Sphere("left", (-24.0, 3.0, 24.0), 20.0, CROWN), Sphere("right", (22.0, -5.0, 20.0), 16.0, FLINT)
    scene = scene_of(left, right, Rod("rod", (-24.0, -40.0, 24.0), (-24.0, -80.0, 24.0), 3.0), px_per_mm=3.0)
    now = share_of(scene)
    assert now < LITTLE
    moved, doubled = offers(scene)[:2]
    by_mm = float(moved.what.split()[2])
    assert moved.what == f"the glass {by_mm:g} mm farther from the plane"
    assert share_of(raised(scene, by_mm)) == pytest.approx(moved.share, abs=0.02)
    assert moved.share > 1.5 * now
    assert doubled.what.startswith("a second such ball before each and the glass ")
    more = [
        replace(ball, name=f"{ball.name}2", centre_mm=(x, y, z + 2.0 * ball.radius_mm + 0.01))
        for ball in (left, right)
        for x, y, z in (ball.centre_mm,)
    ]
    by_mm = float(doubled.what.split()[9])
    followed = raised(scene.with_bodies([*scene.bodies, *more]), by_mm)
    assert share_of(followed) == pytest.approx(doubled.share, abs=0.02)
    said = little(scene, ThroughGlass(1.0, now, "the balls"))
    assert moved.sentence in said
    assert doubled.sentence in said


def test_three_in_a_row_are_better_without_the_last():
    row = [Sphere(f"ball{k}", (0.0, 0.0, 24.0 + 40.01 * k), 20.0, CROWN) for k in range(3)]
    scene = scene_of(*row, px_per_mm=3.0)
    last = offers(scene)[-1]
    assert last.what.startswith("without ball2 and the glass ")
    fewer = raised(scene.with_bodies(row[:2]), float(last.what.split()[5]))
    assert share_of(fewer) == pytest.approx(last.share, abs=0.02)


def test_no_scene_is_traced_twice(monkeypatch):
    traced = []
    monkeypatch.setattr(arranged, "coarse_share", lambda scene: traced.append(scene.content_hash()) or 0.01)
    row = [Sphere(f"ball{k}", (0.0, 0.0, 24.0 + 40.01 * k), 20.0, CROWN) for k in range(3)]
    assert offers(scene_of(*row, px_per_mm=3.0)) == []
    assert len(traced) > 10
    assert len(set(traced)) == len(traced)


def test_nothing_is_said_where_enough_is_seen_or_nothing_hidden():
    pair = scene_of(*[Sphere(name, (0.0, 0.0, z), 20.0, CROWN) for name, z in (("a", 40.0), ("b", 80.01))])
    assert coarse_share(pair) > 0.8
    assert little(pair, ThroughGlass(1.0, coarse_share(pair), "the balls")) == ""
    assert offers(scene_of()) == []
    assert (
        Offer("the glass 3 mm nearer to the plane", 0.0425).sentence == "the glass 3 mm nearer to the plane: 4.2 %"
    )
