"""Sentences on what frames leave open of many balls: one for all of a quantity."""

from types import SimpleNamespace

import numpy as np

from correction.fit.judge.weakness import describe_numbers, list_names

BALLS = [f"ball{k}" for k in range(17)]


def fitted(names, sigmas):
    return SimpleNamespace(names=tuple(names), sigmas=np.array(sigmas))


def test_one_quantity_of_many_balls_is_summarised_with_its_range():
    names = tuple(f"{ball}.radius" for ball in BALLS)
    words = describe_numbers(fitted(names, np.linspace(0.01, 0.02, 17)), names)
    assert words.startswith("radius of 17 bodies (ball0, ball1 and others): +-")
    assert " to " in words
    assert len(words) < 80


def test_few_numbers_and_different_ones_are_named_with_their_sigmas():
    names = ("ball0.radius", "ball1.radius", "glass.n", "ball2.z")
    words = describe_numbers(fitted(names, [0.01, 0.02, 0.001, 0.1]), names)
    assert all(f"{name} (+-" in words for name in names)
    assert list_names(["a"]) == "a"
    assert list_names(["a", "b", "c"]) == "a, b and c"
