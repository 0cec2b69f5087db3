"""Figures of a frame against frames that were drawn with them."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from daq.live.frame_quality import edge_map, histogram, middle_of, particle_maps, share_of_saturated
from daq.live.picture import HEAD, NOTHING, SATURATED, Part, columns_of, picture_bytes


def particles(diameter_px: float, a_pixel: float, side: int = 512, noise: float = 3.0) -> np.ndarray:
    """Gaussian particles, integrated over pixels: standard deviation = diameter / 4."""
    rng = np.random.default_rng(1)
    image = np.full((side, side), 100.0)
    v, u = np.mgrid[0:side, 0:side]
    sigma = diameter_px / 4.0
    for at_u, at_v in rng.uniform(0, side, (int(a_pixel * side * side), 2)):
        low_u, low_v = max(int(at_u) - 12, 0), max(int(at_v) - 12, 0)
        cut = np.s_[low_v : low_v + 25, low_u : low_u + 25]
        scale = np.sqrt(2.0) * sigma
        across = erf((u[cut] + 0.5 - at_u) / scale) - erf((u[cut] - 0.5 - at_u) / scale)
        down = erf((v[cut] + 0.5 - at_v) / scale) - erf((v[cut] - 0.5 - at_v) / scale)
        image[cut] += 400.0 * across * down
    return np.clip(image + rng.normal(0.0, noise, image.shape), 0, 4095).astype(np.uint16)


@pytest.mark.parametrize("diameter_px", [2.5, 4.0, 6.0])
def test_diameter_and_density_are_those_drawn(diameter_px: float) -> None:
    """A pixel adds its own width: 1/12 px^2 to the variance."""
    maps = particle_maps(particles(diameter_px, 0.01))
    expected = 4.0 * np.sqrt((diameter_px / 4.0) ** 2 + 1.0 / 12.0)
    assert np.nanmedian(np.array(maps["diameter_px"], float)) == pytest.approx(expected, rel=0.15)
    assert np.median(np.array(maps["density"], float)) == pytest.approx(0.01, rel=0.3)


def board(blur_px: float, side: int = 500, seed: int = 4) -> np.ndarray:
    """Squares of 40 px, drawn four times as fine and joined, blurred."""
    v, u = np.mgrid[0 : 4 * side, 0 : 4 * side] / 4.0
    turn = np.radians(10.0)
    a, b = u * np.cos(turn) - v * np.sin(turn), u * np.sin(turn) + v * np.cos(turn)
    fine = 300.0 + 2500.0 * ((np.floor(a / 40.0) + np.floor(b / 40.0)) % 2)
    joined = fine.reshape(side, 4, side, 4).mean(axis=(1, 3))
    soft = gaussian_filter(joined, np.sqrt(blur_px**2 - 1.0 / 12.0))
    return np.clip(soft + np.random.default_rng(seed).normal(0.0, 15.0, soft.shape), 0, 4095).astype(np.uint16)


@pytest.mark.parametrize("blur_px", [1.0, 2.0, 4.0])
def test_edges_of_a_board_are_as_wide_as_they_were_blurred(blur_px: float) -> None:
    """Squares turned by 10 degrees; nothing is said of noise, nor of nothing."""
    assert middle_of(edge_map(board(blur_px))) == pytest.approx(blur_px, rel=0.12)
    noise = np.random.default_rng(3).normal(100.0, 3.0, (300, 200)).astype(np.uint16)
    assert all(value is None for row in edge_map(noise) for value in row)
    assert np.isnan(middle_of(edge_map(np.full((64, 64), 7, np.uint16))))


def test_nothing_is_said_of_nothing() -> None:
    empty = np.random.default_rng(2).normal(100.0, 3.0, (300, 200)).astype(np.uint16)
    maps = particle_maps(empty)
    assert all(value is None for row in maps["diameter_px"] for value in row)
    masked = particles(3.0, 0.02, 256).astype(np.float32)
    masked[:, :128] = np.nan
    rows = particle_maps(masked)["density"]
    assert rows[0][0] is None
    assert rows[0][-1] is not None


def test_saturation_survives_averaging() -> None:
    frame = np.full((2016, 2016), 10, np.uint16)
    frame[1001, 1003] = 4095
    assert share_of_saturated(frame, 4095) == pytest.approx(1.0 / 2016**2)
    assert histogram(frame[1:], 4095)[-1] == 1
    message = picture_bytes("raw", 7, frame, 4095, Part())
    *numbers, name = HEAD.unpack_from(message)
    assert numbers == [b"rtp2", 7, 0, 0, 1008, 1008, 2.0, 0, 1008]
    assert name.rstrip(b"\0") == b"raw"
    pixels = np.frombuffer(message, "<u2", offset=HEAD.size).reshape(1008, 1008)
    assert (pixels == SATURATED).sum() == 1
    assert pixels[500, 501] == SATURATED
    assert pixels[0, 0] == 11
    right = picture_bytes(
        "raw", 7, frame, 4095, Part(), 800, columns_of([0.4567, 1])
    )  # what is seen beside a slider
    *numbers, name = HEAD.unpack_from(right)
    assert numbers == [b"rtp2", 7, 0, 0, 672, 672, 3.0, 309, 363]
    seen = np.frombuffer(right, "<u2", offset=HEAD.size).reshape(672, 363)
    assert np.argwhere(seen == SATURATED).tolist() == [[333, 334 - 309]]
    for asked in (
        None,
        [1, 0],
        [0.5, 0.5],
        [-3, 7],
        ["a", 1],
        [float("nan"), 1.0],
        [0, float("inf")],
        [True, False],
    ):
        assert columns_of(asked) == (0.0, 1.0), asked
    assert columns_of([0.999, 1]) == columns_of([1, 1e99]) == columns_of([0, 10**400]) == (0.0, 1.0)
    part = picture_bytes("corrected", 8, np.array([[np.nan, 4.0], [0.0, -3.0]], np.float32), 255, Part(0, 0, 2))
    assert np.frombuffer(part, "<u2", offset=HEAD.size).tolist() == [NOTHING, 5, 1, 1]
    for asked in ([0, 0, 10**9], [10**9, 10**9, 5], [-1, -1, -1], None, ["a", 1, 2]):
        assert len(picture_bytes("raw", 1, frame, 4095, Part.of(asked))) > HEAD.size
