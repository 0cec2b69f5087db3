"""Somebody turns a focus ring, too far, back, and is told so; while nobody turns, nothing is claimed."""

import math

import numpy as np
import pytest

from daq.live.frame_quality import MEMORY_S, FocusTrend

PERIOD_S = 0.5


def told(places: list[float], noise: float = 0.01, seed: int = 1) -> list[str]:
    """Sentences while the ring goes through places; the focus is at 0, a unit blurs by the width of a particle."""
    rng, trend, said = np.random.default_rng(seed), FocusTrend(), []
    for look, place in enumerate(places):
        trend.see(PERIOD_S * look, 2.5 * math.hypot(1.0, place) * (1.0 + noise * rng.normal()))
        said.append(trend.sentence)
    return said


def turn(first: float, last: float, looks: int) -> list[float]:
    return np.linspace(first, last, looks).tolist()


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("noise", [0.0, 0.003, 0.01])
def test_which_way_to_turn_is_told_from_either_side(side, noise):
    path = [
        side * place
        for place in [1.0] * 8
        + turn(1.0, 2.0, 8)
        + turn(2.0, -1.0, 24)
        + [-1.0] * 8
        + turn(-1.0, 0.0, 10)
        + [0.0] * 8
    ]
    said = told(path, noise)
    assert said[:3] == ["", "", ""]
    assert "turn the ring a little" in said[7]
    assert sum("becoming softer: turn back" in text for text in said[10:16]) >= 4
    assert sum("becoming sharper: go on" in text for text in said[20:28]) >= 6
    assert sum("becoming softer: turn back" in text for text in said[36:41]) >= 3
    assert "turn back the way you came; it was 2.5" in said[47]
    assert "s ago" in said[47]
    assert "as sharp as it was" in said[-1]


def test_while_nobody_turns_nothing_is_said_to_change():
    wrong = looks = 0
    for seed in range(20):
        said = told([0.5] * 100, 0.02, seed)[8:]
        wrong += sum("becoming" in text or "turn back" in text for text in said)
        looks += len(said)
    assert wrong < 0.01 * looks


def test_one_bad_look_is_neither_a_best_nor_a_turn_for_long():
    widths = [4.0, 4.02, 3.98, 4.01, 1.0, 4.0, 3.99, 4.02, 4.0, 3.98, 4.01, 4.0, 4.02, 3.99]
    trend, said = FocusTrend(), []
    for look, width in enumerate(widths):
        trend.see(PERIOD_S * look, width)
        said.append(trend.sentence)
    assert "turn the ring a little" in said[-1]
    trend.see(100.0, float("nan"))
    assert trend.sentence == ""


def test_what_was_long_ago_or_something_else_is_forgotten():
    trend = FocusTrend()
    for look, width in enumerate([2.5] * 6 + [4.0] * 6):
        trend.see(PERIOD_S * look, width)
    assert "it was 2.50 px" in trend.sentence
    for look in range(6):
        trend.see(MEMORY_S + 10.0 + PERIOD_S * look, 4.0)
    assert "it was" not in trend.sentence
    trend.forget()
    assert trend.sentence == ""
