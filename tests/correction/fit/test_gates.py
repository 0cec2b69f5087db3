"""Gates of a fit: which branch with too few corners refuses it, and which has nothing to say."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from correction.fit.errors import FitFailed
from correction.fit.result import check
from tracer.bodies import Sphere
from tracer.media import ConstantMedium

SPHERES = tuple(Sphere(name, (30.0 * k, 0.0, 20.0), 10.0, ConstantMedium(1.5)) for k, name in enumerate("abc"))


def fitted(**branches: tuple[int, int]) -> Any:
    """A fit that shows (paired, expected) corners a branch, `a_b` for a > b, and is right otherwise."""
    counts = {name.replace("_", " > "): numbers for name, numbers in branches.items()}
    return SimpleNamespace(
        verdict=SimpleNamespace(alarms=(), able_px=0.02, sentences=()),
        corners=SimpleNamespace(behind=np.array([True]), rms_px=lambda behind: np.array([0.02])),
        share=0.9,
        expected={name: expected for name, (_, expected) in counts.items()},
        paired=lambda name: counts[name][0],
        unknowns=SimpleNamespace(scene=SimpleNamespace(spheres=SPHERES)),
        names=tuple(f"{name}.{axis}" for name in "abc" for axis in "xyz"),
        pushed_mm=0.0,
        x=np.zeros(9),
    )


def test_few_corners_of_balls_that_others_show_well_refuse_nothing() -> None:
    check(fitted(a=(60, 65), c_b=(9, 10), a_b=(2, 5)))


@pytest.mark.parametrize(
    "branches",
    [
        {"a": (60, 65), "b": (4, 4), "a_b": (2, 5)},  # too few others see b
        {"a": (60, 65), "c_b": (7, 10), "a_b": (2, 5)},  # b is not where those show it
        {"a": (20, 65), "c_b": (9, 10), "a_b": (2, 5)},  # nor is a
        {"a": (60, 65), "c_b": (9, 10), "a_b": (4, 12)},  # not a few
        {"a": (60, 65), "b": (0, 8)},
    ],
)
def test_every_other_branch_with_too_few_does(branches: dict[str, tuple[int, int]]) -> None:
    with pytest.raises(FitFailed, match="share of corners paired through"):
        check(fitted(**branches))
