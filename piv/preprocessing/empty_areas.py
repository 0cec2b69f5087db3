"""Areas without particles: beyond the edge of a round window, a shadow, gas without seeding.

A window that reaches into such an area is bright on one side in both frames, and matches where it is cut, at no
displacement. So these areas belong to no window, up to the outermost particles.

A pixel belongs to a particle if it and a neighbour exceed their surroundings by `CLEAR` deviations of the noise of
the darkest blocks, in either frame. A disc without such pixels is no gap between particles if so large a gap is
improbable anywhere in a frame of particles that lie at random: for n of them per pixel, half of a disc of radius R
(at the edge of the frame there is no more of it) is empty with the probability exp(-n pi R^2/2), so that about
N exp(-n pi R^2/2) of N particles have such a gap beside them. R makes this `CHANCE`. n is that around the
particles themselves: the median over them of how many others are in their block, which no empty part of the frame
changes. All discs of radius R without particles, together, are the empty area (a morphological opening).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.rows import map_parts

LEVEL = 9  # side of the surroundings, in pixels of half the resolution as all of these
CLEAR, PER_MEAN = 4.0, 1.25  # deviations of the noise; one of them over its mean size
BLOCK, LEAST = (
    16,
    0.05,
)  # side of the blocks that noise and particles are counted in; share of them with less noise
LEAST_PARTICLES = 50
CHANCE = 1e-3  # of a gap so large somewhere in a frame
LARGEST = 0.2  # radius of gaps, in sides of the frame: with fewer particles nothing is said


def empty_areas(a: NDArray[Any], b: NDArray[Any], valid: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Find the areas of a pair that hold no particles.

    Parameters
    ----------
    a, b : ndarray, shape (H, W)
        Frames, as they are.
    valid : ndarray of bool, shape (H, W)
        True where they show the flow and are finite.

    Returns
    -------
    ndarray of bool, shape (H, W), or None
        True where there are none; None if that is nowhere, or not known.
    """
    import cv2

    height, width = a.shape
    size = width // 2, height // 2
    if min(size) < 2 * LEVEL or not valid.any():
        return None
    inside = cv2.resize(valid.astype(np.float32), size, interpolation=cv2.INTER_AREA) == 1.0

    def particles_of(frame: NDArray[Any]) -> tuple[NDArray[np.bool_], float]:
        half = cv2.resize(np.where(valid, frame, 0).astype(np.float32), size, interpolation=cv2.INTER_AREA)
        above = half - cv2.blur(half, (LEVEL, LEVEL))
        noise = PER_MEAN * float(np.quantile(_of_blocks(np.abs(above)), LEAST))
        clear = (above > CLEAR * noise) & inside
        clear &= cv2.filter2D(clear.astype(np.uint8), -1, np.ones((3, 3), np.uint8)) > 1
        peaks = clear & (above == cv2.dilate(above, np.ones((3, 3), np.uint8)))
        return np.asarray(clear), _density(peaks)

    (of_a, density_a), (of_b, density_b) = map_parts(particles_of, (a, b))
    particles, density = ~inside | of_a | of_b, max(0.0, density_a, density_b)
    if density == 0.0:
        return None
    radius = np.sqrt(2.0 * np.log(density * inside.sum() / CHANCE) / (np.pi * density))
    if radius > LARGEST * min(size):
        return None
    edge = int(np.ceil(radius)) + 1  # a gap goes on beyond the edge of the frame as it is before it
    free = cv2.copyMakeBorder((~particles).view(np.uint8), edge, edge, edge, edge, cv2.BORDER_REFLECT)
    middles = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) > radius
    if not middles.any():
        return None
    far = cv2.distanceTransform((~middles).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    empty = (far <= radius)[edge:-edge, edge:-edge] & inside
    return np.asarray(cv2.resize(empty.view(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0)


def _of_blocks(values: NDArray[Any]) -> NDArray[np.float32]:
    """Means of values (H, W) over whole blocks."""
    import cv2

    rows, columns = (side // BLOCK for side in values.shape)
    part = values[: rows * BLOCK, : columns * BLOCK].astype(np.float32)
    return np.asarray(cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)


def _density(peaks: NDArray[np.bool_]) -> float:
    """Particles per pixel around the particles; 0 if there are too few."""
    counts = np.rint(_of_blocks(peaks) * BLOCK**2).astype(np.int64).ravel()
    if counts.sum() < LEAST_PARTICLES:
        return 0.0
    others = np.sort(np.repeat(counts, counts)) - 1  # in the block of each particle
    return float(others[len(others) // 2]) / BLOCK**2
