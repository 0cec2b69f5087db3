"""Gates of a fit, way by way: what fails is masked with its reason, the rest is delivered."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from correction.errors import FitFailed
from correction.fit.judge.result import SceneFit, check
from correction.fit.seen.unconfirmed_ways import find_unconfirmed
from correction.maps.correction_map import build_correction_map
from correction.masked import pixels_in
from correction.node_status import NodeStatus
from sim.demo.scenes import at_size, demo_scene
from tracer.bodies import Sphere
from tracer.media import ConstantMedium
from tracer.strategies.ray_map import build_ray_map

GLASS = ConstantMedium(1.5)
SPHERES = tuple(Sphere(name, (30.0 * k - 30.0, 0.0, 20.0), 10.0, GLASS) for k, name in enumerate("abc"))
SCENE = at_size(demo_scene("two_spheres_500"), 252).with_bodies(SPHERES)
PLACE_MM = {"a": 0.1, "b": 0.1, "c": 0.1}


class Fitted(SimpleNamespace):
    """What `check` asks of a fit."""

    share = SceneFit.share
    rms_confirmed_px = SceneFit.rms_confirmed_px


def fitted(rms_px: float = 0.02, **ways: tuple[int, int]) -> Any:
    """A fit that shows (paired, expected) corners a way, `a_b` for a > b, and is right otherwise."""
    counts = {name.replace("_", " > "): numbers for name, numbers in ways.items()}
    expected = {name: count for name, (_, count) in counts.items()}
    paired = {name: count for name, (count, _) in counts.items()}
    names = np.repeat(list(paired), list(paired.values()))
    wrong = np.isin(names, [name for name in expected if paired[name] < 0.5 * expected[name]])
    residual = np.where(wrong, 3.0, rms_px)[:, None] * np.ones(2)
    corners = SimpleNamespace(
        behind=np.ones(len(names), bool), inlier=np.ones(len(names), bool), branch_name=names, residual_px=residual
    )
    lost = find_unconfirmed(SCENE, expected, paired, PLACE_MM)
    return Fitted(
        verdict=SimpleNamespace(alarms=(), corner_noise_px=0.02, sentences=(), unconfirmed=lost, pulls=()),
        corners=corners,
        corners_expected=sum(expected.values()),
        corners_paired=sum(paired.values()),
        pushed_mm=0.0,
        x=np.zeros(9),
        unknowns=SimpleNamespace(contact_mm=None),
    )


def lost_of(fit: Any) -> list[tuple[str, bool]]:
    return [(one.name, one.is_ball) for one in fit.verdict.unconfirmed]


@pytest.mark.parametrize(
    ("ways", "lost"),
    [
        ({"a": (60, 65), "c": (58, 60)}, []),
        ({"a": (60, 65), "c": (58, 60), "a_b": (2, 6), "b": (30, 32)}, [("a > b", False)]),
        ({"a": (60, 65), "c": (58, 60), "b": (3, 12)}, [("b", True)]),
        ({"a": (60, 65), "c": (58, 60), "b": (0, 3)}, [("b", True)]),
        ({"a": (60, 65), "c": (58, 60), "b": (1, 8), "a_b": (2, 7)}, [("b", True)]),
        ({"a": (60, 65), "c": (58, 60), "b": (2, 4)}, []),
    ],
)
def test_one_ball_refuses_no_lab(ways: dict[str, tuple[int, int]], lost: list[tuple[str, bool]]) -> None:
    fit = fitted(**ways)
    assert lost_of(fit) == lost
    check(fit)


@pytest.mark.parametrize(
    "ways",
    [
        {"a": (60, 65), "b": (10, 40), "c": (10, 40)},  # most of the glass
        {"a": (2, 65)},
        {"a": (60, 65), "b": (30, 60)},  # each above its limit, all together below
    ],
)
def test_a_fit_of_which_little_is_confirmed_is_refused(ways: dict[str, tuple[int, int]]) -> None:
    with pytest.raises(FitFailed, match="share of"):
        check(fitted(**ways))


def test_what_is_confirmed_must_fit_by_itself() -> None:
    with pytest.raises(FitFailed, match="rms behind glass"):
        check(fitted(rms_px=0.9, a=(60, 65), c=(58, 60), b=(3, 12)))


def test_a_ball_held_in_the_fit_section_is_not_asked() -> None:
    assert not find_unconfirmed(SCENE, {"a": 60, "b": 3}, {"a": 60}, {"a": 0.1})


def test_few_corners_do_not_confirm_a_ball_whose_rim_is_seen_elsewhere() -> None:
    """Three corners please three numbers anywhere; sixty do not."""
    expected, rims = {"a": 65, "b": 3}, {"a": (0.0, 0.0, 20.0), "b": (1.0, 3.0, 20.0)}
    (ball,) = find_unconfirmed(SCENE, expected, {"a": 60, "b": 3}, PLACE_MM, rims)
    assert (ball.name, ball.is_ball) == ("b", True)
    assert "does not stand where its rim is seen, and no more than 3 corners" in str(ball)
    x, y = SCENE.camera.project(np.array([1.0, 12.8, 20.0]))  # of the rim alone
    assert [bool(pixels_in(p, (252, 252))[round(float(y)), round(float(x))]) for p in ball.masked[:2]] == [
        False,
        True,
    ]
    assert not find_unconfirmed(SCENE, expected, {"a": 60, "b": 3}, PLACE_MM)


def test_a_lost_ball_is_masked_with_all_around_it() -> None:
    (ball,) = fitted(a=(60, 65), c=(58, 60), b=(3, 12)).verdict.unconfirmed
    scene = replace(SCENE, masked=ball.masked)
    whole, found = (build_correction_map(one, build_ray_map(one)) for one in (SCENE, scene))
    ways = np.array([("b" in names) for names in whole.branches])
    through = whole.recovered & ways[whole.branch[0]]
    assert through.any()
    assert (found.status[through] == NodeStatus.UNCONFIRMED).all()
    others = whole.recovered & (whole.branch[0] != 0) & ~through
    assert np.mean(found.recovered[others]) > 0.95
    x, y = np.moveaxis(SCENE.camera.project(np.array([[0.0, 10.2, 20.0], [0.0, 11.5, 20.0]])), -1, 0)
    inside = pixels_in(ball.masked[0], (252, 252))[np.rint(y).astype(int), np.rint(x).astype(int)]
    assert inside.tolist() == [True, False]


@pytest.mark.parametrize(("expected", "is_few"), [(7, True), (70, False)])
def test_a_lab_that_shows_few_corners_behind_glass_is_told_so(expected, is_few):
    fit = fitted(a=(expected * 5 // 7, expected))
    fit.verdict.unconfirmed = ()
    with pytest.raises(FitFailed, match="share of visible corners paired") as refusal:
        check(fit)
    assert (f"only {expected} corners behind glass, of which" in str(refusal.value)) == is_few
