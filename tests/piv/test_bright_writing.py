"""Writing far brighter than the particles in flows that are slow, turn or rest at a wall; and bright flows."""

import cv2
import numpy as np
import pytest

from piv.correlation.pair import evaluate_pair
from piv.preprocessing.still_light import still_light
from tests.piv.correlation.test_image_shapes import SIDE, ellipse, pair_of
from tests.slow_cases import slow

SLOW = lambda x, y: (0.9 + 0.0 * x, -0.5 + 0.0 * y)  # noqa: E731
TURN = lambda x, y: (-0.03 * (y - 120.0), 0.03 * (x - 140.0))  # noqa: E731
WALL = lambda x, y: (6.0 * (1.0 - np.exp(-np.maximum(SIDE - y, 0.0) / 30.0)), 0.0 * x)  # noqa: E731


def written_on(frames, words, scale, thick, foot):
    """Frames with a line of writing each, at the brightest count of the frame, and where it is."""
    ink = [np.zeros((SIDE, SIDE), np.uint8) for _ in frames]
    for one, line in zip(ink, words, strict=True):
        cv2.putText(one, line, (12, foot), cv2.FONT_HERSHEY_SIMPLEX, scale, 255, thick, cv2.LINE_AA)
    top = int(max(frame.max() for frame in frames))
    found = [np.rint(f + (top - f.astype(float)) * (one / 255.0)) for f, one in zip(frames, ink, strict=True)]
    return [frame.astype(np.uint16) for frame in found], (ink[0] > 0) | (ink[1] > 0)


@pytest.mark.parametrize(("scale", "thick"), [(1.2, 4), slow(1.6, 6)])
@pytest.mark.parametrize("flow", [SLOW, TURN, WALL], ids=["slow", "turn", "wall"])
def test_writing_that_outshines_the_particles_is_found(flow, scale, thick):
    """Particles before it, or a fluid in which hardly anything is quick, hid it: up to 171 vectors were wrong."""
    for seed in (11, 12):
        frames = pair_of(flow, ellipse(1.1, 1.1, 0.0), 7, seed=seed, count=3000)
        frames, ink = written_on(frames, ("10:42.1357", "10:42.1369"), scale, thick, 200)
        field = evaluate_pair(*frames, threads=1)
        x, y = np.meshgrid(field.x_px, field.y_px)
        off = np.hypot(*(got - true for got, true in zip((field.u_px, field.v_px), flow(x, y), strict=True)))
        silent = field.valid & (off > 0.5) & (off > 3.0 * field.total_sigma_px.max(axis=-1))
        most = 10 if flow is SLOW else 1  # digits that change move like a slow fluid
        assert silent.sum() <= most, seed
        assert field.counts["still"] > 50
        assert field.valid[np.abs(y - 190.0) > 45.0].mean() > 0.97
        assert field.valid[ink[np.rint(y).astype(int), np.rint(x).astype(int)]].sum() < most


@pytest.mark.parametrize("flow", [SLOW, TURN], ids=["slow", "turn"])
@pytest.mark.parametrize(("scale", "level"), [(0.45, 1500), slow(0.7, 4095)])
def test_thin_writing_is_found_by_the_very_same_numbers(flow, scale, level):
    """Strokes of a pixel were not: up to 59 vectors of a pair were beyond 5 sigma and 0.3 px."""
    frames = pair_of(flow, ellipse(1.1, 1.1, 0.0), 7, seed=13, count=3000)
    ink = np.zeros((2, SIDE, SIDE), np.uint8)
    for one, line in zip(ink, ("t = 1.357 s", "t = 1.369 s"), strict=True):
        cv2.putText(one, line, (12, 200), cv2.FONT_HERSHEY_SIMPLEX, scale, 255, 1, cv2.LINE_8)
    frames = [np.where(one > 0, level, frame).astype(np.uint16) for frame, one in zip(frames, ink, strict=True)]
    found = still_light([tuple(frames)], np.ones((SIDE, SIDE), bool))
    assert found[(ink > 0).any(axis=0)].mean() > 0.98
    assert found.mean() < 0.08


@pytest.mark.parametrize("rests_px", [SIDE, SIDE // 2], ids=["everywhere", "in half"])
def test_saturated_particles_at_rest_are_no_writing(rests_px):
    """Without the look at other areas 0.2 of the frame; clumps of them beside a quick flow do stand still."""
    flow = lambda x, y: (0.05 * np.maximum(x - rests_px, 0.0), 0.0 * y)  # noqa: E731
    frames = pair_of(flow, ellipse(2.0, 2.0, 0.0), 7, seed=14, count=2500)
    frames = tuple(np.minimum(frame, 900) for frame in frames)
    found = still_light([frames], np.ones((SIDE, SIDE), bool))
    assert found is None if rests_px == SIDE else found.mean() < 0.06


@pytest.mark.parametrize("width_px", [60.0, slow(80.0)])
@pytest.mark.parametrize("flow", [SLOW, TURN, WALL], ids=["slow", "turn", "wall"])
def test_a_flow_that_is_brightly_lit_does_not_stand_still(flow, width_px):
    """Nor where it turns or rests in the middle of the light: five times as bright as at its sides."""
    lit = 0.2 + 0.8 * np.exp(-(((np.arange(SIDE) - 130.0) / width_px) ** 2))
    for seed in (21, 22):
        frames = pair_of(flow, ellipse(1.0, 1.0, 0.0), 7, seed=seed)
        frames = [np.rint(60.0 + (frame - 60.0) * lit).clip(0, 4095).astype(np.uint16) for frame in frames]
        field = evaluate_pair(*frames, threads=1)
        assert field.counts["still"] == 0
        assert field.valid.mean() > 0.97


@pytest.mark.parametrize("flow", [SLOW, TURN, WALL], ids=["slow", "turn", "wall"])
def test_a_small_frame_that_is_brightly_lit_does_not_stand_still(flow):
    lit = 0.2 + 0.8 * np.exp(-(((np.arange(SIDE) - 130.0) / 30.0) ** 2))
    frames = pair_of(flow, ellipse(1.0, 1.0, 0.0), 7, seed=21)
    frames = [np.rint(60.0 + (frame - 60.0) * lit).clip(0, 4095).astype(np.uint16) for frame in frames]
    assert still_light([tuple(frame[:, 75:185] for frame in frames)], np.ones((SIDE, 110), bool)) is None
