"""Corners of the target that should be seen and are not, side by side: something hides them.

Single corners are lost to dirt and noise, anywhere.  A support, a wire or a hand hides a patch.  Of the corners
that the scene shows on a way and that lie off its border, the lost ones are joined to patches over the board's
lattice (neighbours, diagonals too); the largest patch is compared with those of SHUFFLES random choices of as many
corners (a permutation test).  A patch of PATCH or more that at most HIDDEN_FALSE_ALARMS of the choices reach is
reported. Not near the border of a way, where light fades and the view twists in patches of its own, and not beyond
the corners that bare frames show, where the board may end.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.fit.seen.measurement import MeasuredFrame
from correction.masked import hull_px
from tracer.masked import UNLISTED, MaskedPart

SHUFFLES = 400
HIDDEN_FALSE_ALARMS = 0.0025
PATCH = 4  # corners
BORDER_PX = 12.0


@dataclass(frozen=True)
class Hidden:
    """A patch of corners that are not seen.

    Parameters
    ----------
    frame, way : str
        Where.
    corners : int
        In the patch.
    middle_px : (float, float)
        Its middle, u, v.
    masked : MaskedPart
        What no map is to use: its corners, and half a square around them.
    """

    frame: str
    way: str
    corners: int
    middle_px: tuple[float, float]
    masked: MaskedPart

    def __str__(self) -> str:
        """Return one sentence."""
        where = f"through `{self.way}`" if self.way else "beside the glass"
        u, v = self.middle_px
        return (
            f"{self.frame}: {self.corners} corners side by side {where}, around pixel ({u:.0f}, {v:.0f}), are not"
            " seen: something that the scene does not list seems to stand there (a support, dirt, a shadow); it is"
            " masked in every map"
        )


def find_hidden_patches(frames: Sequence[MeasuredFrame]) -> tuple[Hidden, ...]:
    """Patches of lost corners in frames, the largest first."""
    found = []
    bare = [frame.index for frame in frames if not frame.corners.glass and len(frame)]
    if not bare:
        return ()
    low, high = np.concatenate(bare).min(axis=0), np.concatenate(bare).max(axis=0)
    for frame in frames:
        lost = frame.lost
        on_board = ((lost.index >= low) & (lost.index <= high)).all(axis=1)
        for way in np.unique(lost.branch_name).tolist():
            away = (lost.branch_name == way) & (lost.rim_px > BORDER_PX) & on_board
            seen = frame.index[(frame.branch_name == way) & (frame.rim_px > BORDER_PX)]
            if np.count_nonzero(away) < PATCH or not len(seen):
                continue
            index = np.concatenate((lost.index[away], seen))
            count = int(np.count_nonzero(away))
            patch = _largest(index, np.arange(count))
            if len(patch) < PATCH:
                continue
            rng = np.random.default_rng(0)
            reached = sum(
                len(_largest(index, rng.choice(len(index), count, replace=False))) >= len(patch)
                for _ in range(SHUFFLES)
            )
            if reached <= HIDDEN_FALSE_ALARMS * SHUFFLES:
                corners, axes = lost.pixel[away][patch], lost.axes_px[away][patch]
                u, v = corners.mean(axis=0).tolist()
                around = corners[:, None, :] + np.concatenate((axes, -axes), axis=2).swapaxes(1, 2)
                masked = MaskedPart(UNLISTED, hull_px(around.reshape(-1, 2)))
                found.append(Hidden(frame.name, way, len(patch), (u, v), masked))
    return tuple(sorted(found, key=lambda one: -one.corners))


def _largest(index: NDArray[np.int64], chosen: NDArray[np.intp]) -> NDArray[np.intp]:
    """Members of `chosen`, as places in it, that form the largest patch of the lattice."""
    at = index[chosen] - index.min(axis=0)
    board = np.zeros(np.ptp(index, axis=0) + 1, bool)
    board[at[:, 0], at[:, 1]] = True
    label, _ = scipy.ndimage.label(board, np.ones((3, 3)))
    own = label[at[:, 0], at[:, 1]]
    return np.flatnonzero(own == np.bincount(own).argmax())
