"""The sensor: from irradiance to counts.

    electrons = Poisson(irradiance * illumination * white_counts * electrons_per_count)
    counts    = electrons / electrons_per_count + offset + read noise,  rounded, cut to 0 .. 2^bits - 1

Irradiance 1 is a fully reflecting sheet seen without glass.  The point spread of lens and pixel, a Gaussian,
acts before the photons are counted.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from tracer.errors import SceneError


@dataclass(frozen=True)
class Sensor:
    """A camera's sensor and its noise.

    Parameters
    ----------
    white_counts : float
        Counts above the offset at irradiance 1 and illumination 1.
    electrons_per_count : float
        Photo-electrons of one count; infinite switches photon noise off.
    read_noise_counts : float
        Standard deviation of the read-out.
    offset_counts : float
        Mean counts in the dark.
    bits : int
        Depth; right-aligned in uint16.
    blur_px : float
        Sigma of the point spread.
    """

    white_counts: float = 3300.0
    electrons_per_count: float = 2.4
    read_noise_counts: float = 6.0
    offset_counts: float = 35.0
    bits: int = 12
    blur_px: float = 0.5

    def __post_init__(self) -> None:
        if not (1 <= self.bits <= 16):
            raise SceneError("a sensor has 1 to 16 bits")
        if not self.electrons_per_count > 0.0:
            raise SceneError("electrons_per_count must be positive")
        if min(self.white_counts, self.read_noise_counts, self.blur_px) < 0.0:
            raise SceneError("white_counts, read_noise_counts and blur_px must not be negative")

    def expose(
        self, irradiance: NDArray[np.float32], *, seed: int, illumination: float = 1.0
    ) -> NDArray[np.uint16]:
        """Counts (H, W) of an irradiance (H, W), 1 = white; equal seeds give equal noise."""
        rng = np.random.default_rng(seed)
        light = np.maximum(irradiance, 0.0)
        if self.blur_px > 0.0:
            light = scipy.ndimage.gaussian_filter(light, self.blur_px, mode="nearest")
        counts = np.asarray(light * np.float32(illumination * self.white_counts))
        if np.isfinite(self.electrons_per_count):
            electrons = rng.poisson(counts * np.float32(self.electrons_per_count))
            counts = electrons.astype(np.float32) / np.float32(self.electrons_per_count)
        counts += np.float32(self.offset_counts)
        if self.read_noise_counts > 0.0:
            counts += np.float32(self.read_noise_counts) * rng.standard_normal(counts.shape, dtype=np.float32)
        return np.clip(np.rint(counts), 0, 2**self.bits - 1).astype(np.uint16)


SILENT = Sensor(electrons_per_count=float("inf"), read_noise_counts=0.0)
