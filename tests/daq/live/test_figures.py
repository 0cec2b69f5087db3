"""Figures of a frame against frames that were drawn with them."""

import numpy as np
import pytest
from scipy.special import erf

from daq.live.figures import histogram, particle_maps, saturated_share
from daq.live.picture import HEAD, NOTHING, SATURATED, Part, sent


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
    assert saturated_share(frame, 4095) == pytest.approx(1.0 / 2016**2)
    assert histogram(frame[1:], 4095)[-1] == 1
    message = sent("raw", 7, frame, 4095, Part())
    magic, number, left, top, width, height, block, name = HEAD.unpack_from(message)
    assert (magic, number, left, top, width, height, block) == (b"rtp1", 7, 0, 0, 1008, 1008, 2.0)
    assert name.rstrip(b"\0") == b"raw"
    pixels = np.frombuffer(message, "<u2", offset=HEAD.size).reshape(1008, 1008)
    assert (pixels == SATURATED).sum() == 1
    assert pixels[500, 501] == SATURATED
    assert pixels[0, 0] == 11
    part = sent("corrected", 8, np.array([[np.nan, 4.0], [0.0, -3.0]], np.float32), 255, Part(0, 0, 2))
    assert np.frombuffer(part, "<u2", offset=HEAD.size).tolist() == [NOTHING, 5, 1, 1]
    for asked in ([0, 0, 10**9], [10**9, 10**9, 5], [-1, -1, -1], None, ["a", 1, 2]):
        assert len(sent("raw", 1, frame, 4095, Part.of(asked))) > HEAD.size
