"""A board as a camera would see it: edges integrated over pixels, lens blur in front of the pixels.

Written for the tests alone.  The board is painted three times finer than the pixels with edges just soft enough
for that raster, then blurred and binned as a lens and pixels do: a product of two soft edges is not what blur
makes of a corner whose edges are not perpendicular.  Squares are painted by signed distances in the image plane:
to first order the distance of a point to a lattice line is its board coordinate over the gradient of that
coordinate, which is exact for straight lines and good to 1e-4 px for the gently curved ones here.
"""

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import erf

FINER = 3
PAINTED_PX = 0.2  # blur of the painted edges
WIDE = 6.0  # erf is 1 from there


def soft_board(
    to_board, shape, square_mm=2.5, blur_px=0.6, low=300.0, high=3100.0, discs=(), disc_mm=1.0, light=None
):
    """Noise-free image (float); to_board maps pixels (..., 2) to board millimetres, light (..., 2) to a factor."""
    rows, columns = ((np.arange(-2 * FINER, FINER * (n + 2)) + 0.5) / FINER - 0.5 for n in shape)
    places = np.stack(np.meshgrid(columns, rows), -1)
    fine = low + (high - low) * painted(to_board, places, square_mm, discs, disc_mm)
    if light is not None:
        fine = fine * light(places)
    fine = gaussian_filter(fine, FINER * np.sqrt(blur_px**2 - PAINTED_PX**2), mode="nearest")
    return fine.reshape(shape[0] + 4, FINER, shape[1] + 4, FINER).mean(axis=(1, 3))[2:-2, 2:-2]


def painted(to_board, pixels, square_mm, discs, disc_mm):
    """Brightness (H, W), 0 to 1, at points (H, W, 2) of the image, an even raster."""
    here = to_board(pixels)
    dv, du = np.gradient(here, pixels[0, 1, 0] - pixels[0, 0, 0], axis=(0, 1))
    spread = PAINTED_PX * np.sqrt(2)
    wave = np.ones(here.shape[:-1])
    for k in range(2):
        slope = np.hypot(du[..., k], dv[..., k])
        line = np.round(here[..., k] / square_mm)
        distance = (here[..., k] - line * square_mm) / slope
        edge, near = np.sign(distance), np.abs(distance) < WIDE * spread
        edge[near] = erf(distance[near] / spread)
        wave *= np.where(line % 2 == 0, edge, -edge)
    bright = 0.5 - 0.5 * wave  # square (0, 0) has both distances positive and is dark
    for i, j in discs:
        offset = here - (np.array((i, j)) + 0.5) * square_mm
        near = np.nonzero(offset[..., 0] ** 2 + offset[..., 1] ** 2 < (square_mm / 2) ** 2)
        offset = offset[near]
        radius = np.hypot(offset[..., 0], offset[..., 1])
        along = offset / np.maximum(radius, 1e-9)[..., None]
        slope = np.hypot((along * du[near]).sum(-1), (along * dv[near]).sum(-1))
        bright[near] += (0.5 - 0.5 * erf((radius - disc_mm / 2) / slope / spread)) * (1 - 2 * ((i + j) % 2 == 1))
    return bright


def photographed(image, seed, gain=0.1, read=6.0):
    """Photon noise of variance gain * counts, read noise, rounding to 12 bit in uint16."""
    rng = np.random.default_rng(seed)
    noisy = image + rng.normal(size=image.shape) * np.sqrt(gain * np.maximum(image, 0) + read**2)
    return np.clip(np.round(noisy), 0, 4095).astype(np.uint16)
