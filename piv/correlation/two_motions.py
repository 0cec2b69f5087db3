"""Still light before a flow that moves by less than its particle images: one peak, drawn to zero.

With w the share of the light that stands still, d the flow and m the vector,

    m = (1 - w) d,      b' - a' = (d - m) grad P - m grad T

in frames a', b' deformed by the vectors, of particles P and still light T: displacements about m whose variance is
w/(1 - w) m^2. The correlation of b' - a' with itself shows them. Lost particles leave the shape of an image there,
R_0, noise leaves nothing beyond a pixel, displacements e leave lobes of the other sign along e,

    R(s) = loss R_0(s) - <(e . grad)^2> R_0(s).

So there is still light where most places show such lobes (`VARIANCE`), or these have a direction that places
beside each other share, which is that of the vectors if these mean anything. Waves that windows do not resolve
leave lobes as well, in no proportion to m: in slow flows alone both are below 0.15 m^2, behind still light 0.1 to
100 m^2.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piv.correlation.common_light import Known
from piv.correlation.deform import DeformedPair

# Products are averaged over cells, and by a Gaussian
PRODUCT_CELL_PX = 4
REACH_CELLS = 3.0
MOST_PX = 1024  # side of the part of a frame that is asked
APART_PX = 32  # between places whose directions are independent
INDEPENDENT_PX2 = 1800.0  # area of one such place
LEAST_NODES = 24  # vectors that must be known
SHORT = 2.0  # deviations of the images' correlation: one peak
REST_PX = 0.02  # error of short vectors
VARIANCE = 0.3  # of m^2
POSITIVE = 0.8  # share of the places that must show it
DIRECTED = 0.15  # of m^2, along any direction
CLEAR_DEVIATIONS = 3.8  # chance deviations
# The same, along the vectors
ALONG = 0.08
CLEAR_ALONG = 3.5

Floats = NDArray[np.float64]


class Mixture(NamedTuple):
    """Displacements about vectors: variance (ny, nx), and (ny, nx, 2) that along u less v, and along diagonals."""

    variance_px2: Floats
    along_px2: Floats


def share_at_rest(pair: DeformedPair, known: Known, spread_px2: float) -> float:
    """Share of the light that stands still and draws vectors to zero; 0 where nothing tells of it.

    Parameters
    ----------
    pair : DeformedPair
        Frames deformed by nearly these vectors.
    known : Known
        Vectors that are believed, and NaN.
    spread_px2 : float
        Variance of a particle image.
    """
    grid = known.grid
    rows, columns = (
        np.flatnonzero(np.abs(place - (side - 1) / 2) < MOST_PX / 2)
        for place, side in zip((grid.y_px, grid.x_px), pair.a.shape, strict=True)
    )
    vectors = known.vectors_px[np.ix_(rows, columns)]
    length_px = np.linalg.norm(vectors, axis=-1)
    short = length_px < SHORT * np.sqrt(2.0 * spread_px2)
    if short.sum() < LEAST_NODES:
        return 0.0
    found = mixture_at(pair, grid.y_px[rows], grid.x_px[columns], spread_px2)
    square = float(np.median(np.square(length_px[short]))) + REST_PX**2
    variance = found.variance_px2[short]
    ratios = [float(np.median(variance)) / square]
    is_mixed = [ratios[0] > VARIANCE and (variance > 0.0).mean() > POSITIVE]
    # Angles are doubled: directions have no sign.
    along = np.where(short[..., None], found.along_px2, np.nan)
    u, v = np.moveaxis(vectors, -1, 0)
    unit = np.stack((u**2 - v**2, 2.0 * u * v), axis=-1) / np.maximum(length_px, 1e-9)[..., None] ** 2
    steps = max(1, round(APART_PX / grid.step_px))
    pairs = [(one[steps:], one[:-steps]) for one in (along, along.swapaxes(0, 1))]
    products, beside = (np.concatenate(each) for each in zip(*(_products(*one) for one in pairs), strict=True))
    lengths, with_vectors = _products(along, unit)
    clear = [
        float(each.mean()) * np.sqrt(2.0 * len(each) * grid.step_px**2 / INDEPENDENT_PX2)
        for each in (beside, with_vectors)
    ]
    ratios += [np.sqrt(max(np.median(products), 0.0)) / square, np.median(lengths) / square]
    both = np.hypot(*np.maximum(clear, 0.0)) > CLEAR_DEVIATIONS and clear[1] > -1.0 and max(ratios[1:]) > DIRECTED
    is_mixed += [both, both or (clear[1] > CLEAR_ALONG and ratios[2] > ALONG)]
    ratio = max((float(one) for one, mixed in zip(ratios, is_mixed, strict=True) if mixed), default=0.0)
    return ratio / (1.0 + ratio)


def _products(one: Floats, other: Floats) -> tuple[Floats, Floats]:
    """Scalar products (n,) of vectors (..., 2) that are known, and cosines of their angles."""
    found = (one * other).sum(axis=-1)
    known = np.isfinite(found)
    lengths = np.linalg.norm(one, axis=-1) * np.linalg.norm(other, axis=-1)
    return found[known], found[known] / np.maximum(lengths[known], 1e-30)


def mixture_at(pair: DeformedPair, y_px: Floats, x_px: Floats, spread_px2: float) -> Mixture:
    """Displacements about vectors at nodes of rows `y_px` and columns `x_px`; see the top."""
    import cv2

    top, bottom, left, right = (
        int(np.clip(edge, 0, side))
        for place, side in zip((y_px, x_px), pair.a.shape, strict=True)
        for edge in (place[0] - APART_PX, place[-1] + APART_PX)
    )
    part = slice(top, bottom), slice(left, right)
    both, apart = ((pair.b[part] + sign * pair.a[part]) * pair.valid[part] for sign in (1.0, -1.0))
    height, width = both.shape
    size = width // PRODUCT_CELL_PX, height // PRODUCT_CELL_PX
    at = np.ix_(
        *(
            np.clip(np.floor((place - first) / PRODUCT_CELL_PX), 0, count - 1).astype(int)
            for place, first, count in ((y_px, top, size[1]), (x_px, left, size[0]))
        )
    )

    def products(frame: NDArray[np.float32], down: int, across: int) -> Floats:
        whole = np.zeros_like(frame)
        here, there = slice(0, width - abs(across)), slice(abs(across), width)
        one, other = (here, there) if across >= 0 else (there, here)
        np.multiply(frame[: height - down, one], frame[down:, other], out=whole[: height - down, one])
        cells = cv2.resize(
            whole[: size[1] * PRODUCT_CELL_PX, : size[0] * PRODUCT_CELL_PX], size, interpolation=cv2.INTER_AREA
        )
        return np.asarray(cv2.GaussianBlur(cells, (0, 0), REACH_CELLS)[at], np.float64)

    width_px2 = 2.0 * spread_px2  # of the correlation
    straight, inclined = (max(1, round(float(np.sqrt(part * width_px2)))) for part in (1.0, 0.5))
    rings = []
    for _ in range(2):
        offsets = (0, straight), (straight, 0), (inclined, inclined), (inclined, -inclined)
        sums = np.array([[products(frame, *offset) for offset in offsets] for frame in (both, apart)])
        square = np.array([float(down**2 + across**2) for down, across in offsets])
        rings.append((sums, square, np.exp(-0.5 * square / width_px2)))
        straight, inclined = 2 * straight, 2 * inclined
    (near, near_px2, fall), (far, far_px2, far_fall) = rings
    light = near[0].mean(axis=0) / fall.mean()
    light = np.maximum(light, 0.2 * np.median(light))
    # Shape of an image, as the frames show it
    shape = float(np.median(far[0].mean(axis=0) / light)) / fall.mean()
    lobes = [
        float(np.mean((1.0 - 0.5 * each / width_px2) * part))
        for each, part in ((near_px2, fall), (far_px2, far_fall))
    ]
    whole = lobes[1] - lobes[0] * far_fall.mean() / fall.mean()
    variance = 4.0 * width_px2 * (far[1].mean(axis=0) - shape * near[1].mean(axis=0)) / (whole * light)
    along = []
    for one, other in ((0, 1), (2, 3)):
        loss = (near[1, one] + near[1, other]) / (2.0 * fall[one] * light)
        uneven = near[1, other] - near[1, one] - loss * (near[0, other] - near[0, one])
        along.append(4.0 * width_px2**2 * uneven / (near_px2[one] * fall[one] * light))
    return Mixture(variance, np.stack(along, axis=-1))
