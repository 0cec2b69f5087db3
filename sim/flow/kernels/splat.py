"""Points of light on the pixels: Gaussian spots, integrated over each pixel, in bands of rows."""

import numpy as np

from ground.jit import Array, kernel


@kernel
def count_bands(images: Array, band_rows: int, counts: Array) -> None:
    """Count the images (N, 3) whose middle lies in each band of rows; the first and last are off the sensor."""
    for n in range(images.shape[0]):
        band = int(np.floor((images[n, 1] + 0.5) / band_rows)) + 1
        counts[min(max(band, 0), counts.shape[0] - 1)] += 1


@kernel
def order_by_band(images: Array, band_rows: int, places: Array, out: Array) -> None:
    """Copy images into `out` (N, 3) band by band, each in its given order; `places` is where each band goes on."""
    bands = places.shape[0]
    for n in range(images.shape[0]):
        band = min(max(int(np.floor((images[n, 1] + 0.5) / band_rows)) + 1, 0), bands - 1)
        for k in range(3):
            out[places[band], k] = images[n, k]
        places[band] += 1


@kernel
def splat(images: Array, first: int, last: int, table: Array, across: Array, out: Array) -> None:
    """Add spots to rows first..last of `out` (H, W); images (N, 3) are u, v [px] and light, ``across`` scratch.

    `table` (phases + 1, 2 r + 2): what pixel k - r of a row gets of a spot that lies phase/phases beyond the
    middle of pixel 0; interpolated between phases.
    """
    phases, reach = table.shape[0] - 1, table.shape[1] // 2 - 1
    width = out.shape[1]
    for n in range(images.shape[0]):
        u, v, light = images[n, 0], images[n, 1], images[n, 2]
        row, column = int(np.floor(v)), int(np.floor(u))
        top, left = row - reach, column - reach
        if top >= last or top + table.shape[1] <= first or left >= width or left + table.shape[1] <= 0:
            continue
        p = (u - column) * phases
        i = min(int(p), phases - 1)
        p -= i
        for k in range(table.shape[1]):
            across[k] = light * ((1.0 - p) * table[i, k] + p * table[i + 1, k])
        p = (v - row) * phases
        i = min(int(p), phases - 1)
        p -= i
        c0, c1 = max(left, 0), min(left + table.shape[1], width)
        for r in range(max(top, first), min(top + table.shape[1], last)):
            weight = (1.0 - p) * table[i, r - top] + p * table[i + 1, r - top]
            for c in range(c0, c1):
                out[r, c] += weight * across[c - left]
