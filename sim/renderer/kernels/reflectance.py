"""The loops of the patterns over millions of points of the sheet."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.jit import kernel
from sim.renderer.kernels.rays import Float32, Int64
from sim.renderer.kernels.surfaces import Float64


@kernel
def chessboard(
    points: Float64,
    square: float,
    disc_radius: float,
    discs: Float64,
    lines: Float64,
    odd_bright: bool,
    shades: Float32,
    out: Float32,
) -> None:
    """Reflectance of the chessboard at points (N, 2) [mm]; discs in the squares (M, 2) named, `lines` end it."""
    for index in range(points.shape[0]):
        i, j = np.floor(points[index, 0] / square), np.floor(points[index, 1] / square)
        odd = (i + j) - 2.0 * np.floor(0.5 * (i + j)) == 1.0
        for k in range(discs.shape[0]):
            if i == discs[k, 0] and j == discs[k, 1]:
                x, y = points[index, 0] - (i + 0.5) * square, points[index, 1] - (j + 0.5) * square
                if x * x + y * y < disc_radius * disc_radius:
                    odd = not odd
        paper = i < lines[0, 0] or j < lines[0, 1] or i >= lines[1, 0] or j >= lines[1, 1]
        out[index] = shades[1] if paper or odd == odd_bright else shades[0]


@kernel
def dot_grid(
    points: Float64, pitch: float, radii: Float64, large: Float64, lines: Float64, shades: Float32, out: Float32
) -> None:
    """Reflectance of a grid of dots at points (N, 2) [mm].

    radii (2,) of usual and large dots [mm]; large (M, 2) places of the large ones and lines (2, 2), before and
    beyond which there are none, in pitches; shades (2,) of dots and ground.
    """
    for index in range(points.shape[0]):
        x, y = points[index, 0] / pitch, points[index, 1] / pitch
        i, j = np.round(x), np.round(y)
        radius = radii[0]
        for k in range(large.shape[0]):
            if large[k, 0] == i and large[k, 1] == j:
                radius = radii[1]
        there = lines[0, 0] < i < lines[1, 0] and lines[0, 1] < j < lines[1, 1]
        inside = np.hypot(x - i, y - j) * pitch < radius
        out[index] = shades[0] if there and inside else shades[1]


@kernel
def plate(
    points: Float64,
    below: Float64,
    sizes: Float64,
    large: Float64,
    lines: Float64,
    groove: Int64,
    shades: Float32,
    out: Float32,
) -> None:
    """Reflectance of a plate with dots on its face and in its grooves, as rays meet it.

    points (N, 2) and below (N, 2): where rays cross the face, and where they would cross the ground of the grooves
    [mm]; sizes: pitch and the two radii; large and lines as of `dot_grid`.  groove (3,): whether every second
    column is one, and every second row, both of which make fields like those of a chessboard; and whether the
    origin lies in one.  shades (3,) of dots, ground and walls.
    """
    pitch = sizes[0]
    for index in range(points.shape[0]):
        x, y = points[index, 0] / pitch, points[index, 1] / pitch
        i, j = np.round(x), np.round(y)
        if (groove[0] * i + groove[1] * j + groove[2]) % 2 != 0:  # over a groove: on to its ground
            x, y = below[index, 0] / pitch, below[index, 1] / pitch
            if (groove[0] and np.round(x) != i) or (groove[1] and np.round(y) != j):
                out[index] = shades[2]
                continue
            i, j = np.round(x), np.round(y)
        radius = sizes[1]
        for k in range(large.shape[0]):
            if large[k, 0] == i and large[k, 1] == j:
                radius = sizes[2]
        there = lines[0, 0] < i < lines[1, 0] and lines[0, 1] < j < lines[1, 1]
        inside = np.hypot(x - i, y - j) * pitch < radius
        out[index] = shades[0] if there and inside else shades[1]


class Bins(NamedTuple):
    """Particles by cell.

    `places` (M, 2) and `peaks` (M,) are sorted by cell (row-major, edge `cell`, from `corner`); `starts`
    (rows, columns + 1) is the first particle of each cell, so three cells of a row are one run.
    """

    places: Float64
    peaks: Float64
    starts: Int64
    corner: Float64
    cell: float


@kernel
def particles(points: Float64, bins: Bins, sigma: float, background: float, out: Float32) -> None:
    """Reflectance of Gaussian particles at points (N, 2) [mm]; a particle reaches as far as one cell."""
    places, peaks, starts, corner, cell = bins
    rows, columns = starts.shape[0], starts.shape[1] - 1
    fade = -0.5 / (sigma * sigma)
    for index in range(points.shape[0]):
        x, y = points[index, 0], points[index, 1]
        fx, fy = np.floor((x - corner[0]) / cell), np.floor((y - corner[1]) / cell)
        total = background
        if -1.0 <= fx <= columns and -1.0 <= fy <= rows:
            column, row = int(fx), int(fy)
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for k in range(starts[r, max(column - 1, 0)], starts[r, max(min(column + 2, columns), 0)]):
                    a, b = x - places[k, 0], y - places[k, 1]
                    r2 = a * a + b * b
                    if r2 < cell * cell:
                        total += peaks[k] * np.exp(fade * r2)
        out[index] = min(total, 1.0)


@kernel
def draw_image(points: Float64, image: Float32, pixel: float, outside: float, out: Float32) -> None:
    """Bilinear value of an image printed with `pixel` mm a pixel, centred on the origin, row 0 at the top."""
    rows, columns = image.shape
    for index in range(points.shape[0]):
        u = points[index, 0] / pixel + 0.5 * (columns - 1)
        v = 0.5 * (rows - 1) - points[index, 1] / pixel
        if not (0.0 <= u <= columns - 1 and 0.0 <= v <= rows - 1):
            out[index] = outside
            continue
        column, row = min(int(u), max(columns - 2, 0)), min(int(v), max(rows - 2, 0))
        right, below = min(column + 1, columns - 1), min(row + 1, rows - 1)
        a, b = u - column, v - row
        upper = (1.0 - a) * image[row, column] + a * image[row, right]
        lower = (1.0 - a) * image[below, column] + a * image[below, right]
        out[index] = (1.0 - b) * upper + b * lower


@kernel
def sharp_image(
    places: Float64, image: NDArray[np.uint8], side: int, dark: float, bright: float, out: Float32
) -> None:
    """Reflectance of an image with `side` pixels a unit at places (N, 2) from its lower left; bright around it."""
    rows, columns = image.shape
    for index in range(places.shape[0]):
        column, row = np.floor(places[index, 0] * side), rows - 1.0 - np.floor(places[index, 1] * side)
        inside = 0.0 <= column < columns and 0.0 <= row < rows
        out[index] = dark if inside and image[int(row), int(column)] == 0 else bright
