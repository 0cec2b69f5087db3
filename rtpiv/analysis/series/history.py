"""Convergence of a series: mean of the first 1, 2, 4, ... pairs, and fractions of pixels of its vectors.

The mean of the first n pairs differs from that of all N by about s sqrt(1/n - 1/N) if pairs are independent:
where it falls more slowly, more pairs are worth less than they cost. Displacements of a flow know nothing of
pixels, so their fractions are spread evenly; a pile at whole pixels is peak locking (particle images too small,
saturated).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piv.statistics.moments import Moments
from rtpiv.analysis.pairs.pair_vectors import ChunkContent
from rtpiv.analysis.series.mean_flow import MeanFlow

BINS = 40
# Components whose mean is below it are those of a fluid at rest, and pile up at 0 with right
MOVING_PX = 1.0
FEW = 1000  # displacements below which nothing is said of their fractions
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class History:
    """Convergence of a series and its peak locking.

    Parameters
    ----------
    pairs : (k,) int64
        Numbers of pairs n, powers of two below that of all.
    off_px : (k,) float64
        Difference of the mean of the first n from that of all, rms over places and components [px].
    expected_px : (k,) float64
        The same if pairs were independent.
    fractions : (BINS,) int64
        Displacements by their fraction, from -0.5 to 0.5 px, of components whose mean exceeds MOVING_PX.
    """

    pairs: NDArray[np.int64]
    off_px: Floats
    expected_px: Floats
    fractions: NDArray[np.int64]

    @property
    def locking(self) -> float:
        """Excess of displacements within a quarter of a pixel of a whole one: 0 none, 1 all; NaN of a few."""
        total = int(self.fractions.sum())
        near = int(self.fractions[BINS // 4 : -BINS // 4].sum())
        return 2.0 * near / total - 1.0 if total >= FEW else float("nan")


def history(chunks: Iterable[ChunkContent], mean: MeanFlow) -> History:
    """Go through the chunks of a series in order once more, with its mean known."""
    left_out = {tag for tag, _ in mean.left_out}
    moments = Moments.nothing((len(mean.y_mm), len(mean.x_mm)))
    final, variance, count = mean.moments.mean_uv, mean.noisy_stresses_m2_s2[..., :2], mean.count
    with np.errstate(invalid="ignore"):
        moving = np.abs(mean.mean_px) > MOVING_PX
    fractions, rows, used = np.zeros(BINS, np.int64), [], 0
    for chunk in chunks:
        for field in chunk.fields:
            if field.failure or field.tag in left_out:
                continue
            used += 1
            moments = moments.add(field.velocity_m_s, field.valid)
            shift = field.displacement_px[field.valid[..., None] & moving]
            fractions += np.histogram(shift - np.rint(shift), BINS, (-0.5, 0.5))[0]
            if used & (used - 1) == 0 and used < mean.used:
                rows.append((used, *_off(moments, final, variance, count, mean.px_per_m_s)))
    table = np.array(rows, float).reshape(-1, 3)
    return History(table[:, 0].astype(np.int64), table[:, 1], table[:, 2], fractions)


def _off(
    moments: Moments, final: Floats, variance: Floats, count: NDArray[np.int64], scale: float
) -> tuple[float, float]:
    """Rms difference from the final mean, and what independent pairs would leave."""
    here = (moments.count > 0) & (moments.count < count)
    if not here.any():
        return float("nan"), float("nan")
    off = (moments.mean_uv - final)[here]
    left = (1.0 / moments.count[here] - 1.0 / count[here])[:, None] * variance[here]
    return scale * float(np.sqrt(np.mean(off**2))), scale * float(np.sqrt(np.mean(left)))
