"""Patterns at millions of plane points: a chessboard with markers, a target, particles.

Each kernel adds the colour at plane points to a picture; a point that is NaN (no ray arrives) adds nothing and so
stays dark.  Points (N, 2) [mm], pictures (N, channels).
"""

import numpy as np

from ground.jit import Array, kernel, kernel_inlined

DARK, BRIGHT = 0.12, 0.88  # of the squares: neither may vanish in paper or ink
CROSS, DISC, SQUARE, DIAMOND, TRIANGLE = 0, 1, 2, 3, 4
SHAPES = 5
FAR = -(1 << 62)  # a cell that is none
UNSEEN = 20.0  # e^-20 of a particle's light: a float32 does not hold it beside 1/30, no picture shows it


@kernel_inlined
def in_shape(shape: int, x: float, y: float) -> bool:
    """Return whether a point of the square -1..1 lies in a marker."""
    if shape == CROSS:
        return bool(min(abs(x), abs(y)) < 0.28)
    if shape == DISC:
        return bool(x * x + y * y < 0.81)
    if shape == SQUARE:
        return bool(max(abs(x), abs(y)) < 0.8)
    if shape == DIAMOND:
        return bool(abs(x) + abs(y) < 1.0)
    return bool(y > -0.7 and 2.0 * abs(x) + y < 1.0)


@kernel
def add_markers(plane: Array, square: float, spacing: float, size: float, colours: Array, picture: Array) -> None:
    """Add squares with a marker every `spacing` [mm] in x and -y along the diagonal; `colours` (M, 3) in turn."""
    for k in range(plane.shape[0]):
        x, y = plane[k, 0], plane[k, 1]
        if not (np.isfinite(x) and np.isfinite(y)):
            continue
        number = int(np.rint((x - y) / (2.0 * spacing)))
        across, up = (x - number * spacing) / size, (y + number * spacing) / size
        if max(abs(across), abs(up)) < 1.0 and in_shape(number % SHAPES, across, up):
            for channel in range(3):
                picture[k, channel] += colours[number % colours.shape[0], channel]
            continue
        odd = (int(np.floor(x / square)) + int(np.floor(y / square))) % 2
        for channel in range(3):
            picture[k, channel] += BRIGHT if odd else DARK


@kernel
def add_target(plane: Array, sides: Array, discs: Array, lines: Array, odd_bright: bool, picture: Array) -> None:
    """Add a target: squares of `sides` (2,), turned over in `discs` (M, 3: x, y, diameter), paper beyond `lines`.

    `sides` and `plane` in mm, the rest in squares; where i + j is odd they are bright, or the others.
    """
    for k in range(plane.shape[0]):
        x, y = plane[k, 0], plane[k, 1]
        if not (np.isfinite(x) and np.isfinite(y)):
            continue
        x, y = x / sides[0], y / sides[1]
        i, j = np.floor(x), np.floor(y)
        bright = ((int(i) + int(j)) % 2 == 1) == odd_bright
        for number in range(discs.shape[0]):
            across, up = x - discs[number, 0], y - discs[number, 1]
            if across * across + up * up < 0.25 * discs[number, 2] * discs[number, 2]:
                bright = not bright
        paper = i < lines[0, 0] or j < lines[0, 1] or i >= lines[1, 0] or j >= lines[1, 1]
        if bright or paper:
            picture[k, 0] += 1.0


@kernel_inlined
def cell_hash(i: int, j: int, turn: int) -> float:
    """Return a number in [0, 1) that belongs to cell (i, j) (splitmix64)."""
    word = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) ^ np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F)
    word += np.uint64(turn) * np.uint64(0x165667B19E3779F9)
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    word ^= word >> np.uint64(31)
    return float(word >> np.uint64(11)) * 2.0**-53


@kernel
def add_particles(plane: Array, cell: float, diameter: float, near: Array, picture: Array) -> None:
    """Add one Gaussian particle (e^-2 `diameter`, not larger than a `cell`) a cell, at its random place.

    Points come in long runs of one cell, whose particles and those around are kept in ``near`` (9, 3).
    """
    column, row = FAR, FAR
    for k in range(plane.shape[0]):
        x, y = plane[k, 0], plane[k, 1]
        if not (np.isfinite(x) and np.isfinite(y)):
            continue
        if int(np.floor(x / cell)) != column or int(np.floor(y / cell)) != row:
            column, row = int(np.floor(x / cell)), int(np.floor(y / cell))
            for number in range(9):
                i, j = row - 1 + number // 3, column - 1 + number % 3
                near[number, 0], near[number, 1] = (j + cell_hash(i, j, 1)) * cell, (i + cell_hash(i, j, 2)) * cell
                near[number, 2] = 0.3 + 0.7 * cell_hash(i, j, 3)
        light = 0.0
        for number in range(9):
            across, up = (x - near[number, 0]) / diameter, (y - near[number, 1]) / diameter
            dark = 8.0 * (across * across + up * up)
            if dark < UNSEEN:
                light += near[number, 2] * np.exp(-dark)
        picture[k, 0] += min(light, 1.0)
