"""What a frame of particles is worth, in numbers and as maps of tiles.

Particles are Gaussian spots of diameter d = 4 s.  The autocorrelation of such an image falls by
R(k) ~ exp(-k^2 / (4 s^2)) at a shift of k px, whatever their number and brightness; noise of the sensor adds to
R(0) alone.  So

    s^2 = 3 / (4 ln(R(1) / R(2)))

without ever looking for a particle, R taken over its value far off, which is the mean brightness squared.  Their
number comes from the local maxima that stand out, their contrast from how far: brightness of the particles over
the noise between them.  The diameter as a map is the map of the focus, and behind a ball that of its depth of
field.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

TILES = 12  # along the longer side
NOISE_OF_MAD = 1.4826  # sigma of a normal distribution / median absolute deviation
STANDS_OUT = 5.0  # noise above the median, from which a maximum is a particle
FAR_PX = 12  # a shift that no particle reaches over
FEWEST = 6  # maxima in a tile, below which nothing is said of it
BINS = 64


def saturated_share(pixels: NDArray[Any], white: int) -> float:
    """Share of saturated pixels, of those that are known."""
    known = np.isfinite(pixels)
    return float((pixels >= white).sum() / max(int(known.sum()), 1))


def histogram(pixels: NDArray[Any], white: int) -> list[int]:
    """Counts in BINS equal bins from 0 to white, of every fourth row."""
    rows = pixels[::4]
    counts, _ = np.histogram(rows[np.isfinite(rows)], BINS, (0.0, white + 1.0))
    return [int(count) for count in counts]


def particle_maps(pixels: NDArray[Any]) -> dict[str, list[list[float | None]]]:
    """Diameter [px], density [1/px] and contrast of particles in tiles, row by row; None where nobody can tell."""
    height, width = pixels.shape
    side = max(16, -(-max(height, width) // TILES))
    rows = [range(top, min(top + side, height)) for top in range(0, height - side // 2, side)]
    columns = [range(left, min(left + side, width)) for left in range(0, width - side // 2, side)]
    tiles = [[_of_tile(pixels[r.start : r.stop, c.start : c.stop]) for c in columns] for r in rows]
    return {
        name: [[tile[place] for tile in row] for row in tiles]
        for place, name in enumerate(("diameter_px", "density", "contrast"))
    }


def _of_tile(tile: NDArray[Any]) -> tuple[float | None, float | None, float | None]:
    image: NDArray[Any] = np.asarray(tile, np.float32)
    if not np.isfinite(image).mean() > 0.5:
        return None, None, None
    middle = float(np.nanmedian(image))
    image = np.where(np.isfinite(image), image, middle) - middle
    noise = max(NOISE_OF_MAD * float(np.median(np.abs(image))), 1e-6)
    inner = image[1:-1, 1:-1]
    top = inner > STANDS_OUT * noise
    for down in (0, 1, 2):
        for right in (0, 1, 2):
            if (down, right) < (1, 1):
                top &= inner > image[down : down + inner.shape[0], right : right + inner.shape[1]]
            elif (down, right) > (1, 1):
                top &= inner >= image[down : down + inner.shape[0], right : right + inner.shape[1]]
    count = int(top.sum())
    density = count / inner.size
    if count < FEWEST:
        return None, density, None
    beyond = _alike(image, FAR_PX)
    falls = [_alike(image, k) - beyond for k in (1, 2)]
    contrast = float(np.median(inner[top])) / noise
    if not falls[0] > falls[1] > 0.0:
        return None, density, contrast
    return 4.0 * math.sqrt(0.75 / math.log(falls[0] / falls[1])), density, contrast


def _alike(image: NDArray[Any], shift_px: int) -> float:
    """Mean product of an image and itself, shifted to the right and down."""
    k = shift_px
    return 0.5 * float((image[:, :-k] * image[:, k:]).mean() + (image[:-k] * image[k:]).mean())
