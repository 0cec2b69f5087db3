"""Where along its normals a rim is seen: first by votes of all of it together, then point by point.

The frame is read along the normals of the rim where it is expected, as far as the sphere may stand off: a strip of
profiles. A sphere that stands (x, y) mm aside and looks larger by c px has its rim on the normal i at

    s_i = r_x x + r_y y + c                (r: rates of `rim`),

so every profile votes with its slope at that place for every (x, y, c), each with the same weight at most. Edges
of squares, particles or bubbles in the strip vote for places that do not agree with each other; a ring of another
size finds no c that is allowed. Slopes keep their sign: all of a rim is darker inside than outside, or (bright
rings on dark ground) the other way round, and edges that are not a rim's come with either sign and cancel. Where
it is known what would be seen without glass, such as a board, the profiles vote for places where that is seen
outside and something else inside (`strangeness`).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

SMOOTH_PX = 1.0
VOTERS = 240  # points of a rim that vote; more tell no more
NEAR_PX = 2.5  # of the voted place, where the slope of each profile is looked for
WEAK = 0.3  # of the usual slope of the rim: weaker ones are left out
ASIDE = 6  # px on either side of a place that are compared with what would be seen without glass
CLIP = 90.0  # percentile of slopes from which one vote is as good as another


@dataclass(frozen=True)
class Strip:
    """A frame along normals, N of them, at M offsets spaced by 1 px.

    Parameters
    ----------
    value, slope : (N, M) float32
        Intensity, and its rate outwards; NaN outside the frame.
    offset_px : (M,) float64
        From the rim where it is expected.
    place : (N, M, 2) float64
        Pixels u, v.
    """

    value: NDArray[np.float32]
    slope: NDArray[np.float32]
    offset_px: NDArray[np.float64]
    place: NDArray[np.float64]


@dataclass(frozen=True)
class Votes:
    """How much of a rim agrees on each of some places.

    Parameters
    ----------
    height : (P, C) float64
        Mean votes for P places sideways and C sizes.
    """

    height: NDArray[np.float64]

    def at_best_size(self, sign: float) -> NDArray[np.float64]:
        """Votes (P,) at the size that suits each place best, for rims brighter outside (+1) or inside (-1)."""
        return np.asarray((sign * self.height).max(axis=1))


def smoothed(frame: NDArray[Any]) -> NDArray[np.float32]:
    """Return a frame without its finest noise, as float32."""
    import cv2

    return np.asarray(cv2.GaussianBlur(frame.astype(np.float32), (0, 0), SMOOTH_PX), np.float32)


def strip_of(
    smooth: NDArray[np.float32], pixel: NDArray[np.float64], outward: NDArray[np.float64], reach_px: float
) -> Strip:
    """Read a smoothed frame along normals.

    Parameters
    ----------
    smooth : (H, W) float32
        The frame.
    pixel, outward : (N, 2) float64
        Places and unit normals.
    reach_px : float
        How far to either side.
    """
    import cv2

    reach = int(np.ceil(reach_px)) + 1
    offset = np.arange(-reach, reach + 1, dtype=np.float64)
    place = pixel[:, None, :] + offset[None, :, None] * outward[:, None, :]
    u, v = place[..., 0].astype(np.float32), place[..., 1].astype(np.float32)
    read = cv2.remap(smooth, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
    value: NDArray[np.float32] = np.asarray(read).astype(np.float32)
    slope = 0.5 * (value[:, 2:] - value[:, :-2])
    inner = slice(1, -1)
    return Strip(value[:, inner], np.asarray(slope, np.float32), offset[inner], place[:, inner])


def slopes(strip: Strip) -> NDArray[np.float32]:
    """Votes (N, M) of profiles by their slopes, none with more than 1."""
    known = np.isfinite(strip.slope)
    cap = float(np.percentile(np.abs(strip.slope[known]), CLIP)) if known.any() else 0.0
    return np.where(known, np.clip(strip.slope / max(cap, 1e-12), -1.0, 1.0), 0.0).astype(np.float32)


def strangeness(strip: Strip, expected: NDArray[np.float64], unit: float) -> NDArray[np.float32]:
    """Votes (N, M) of profiles by how much stranger they are inside than outside.

    Strange is what differs from what would be seen without glass, `expected` (N, M), in units of `unit`; its mean
    over `ASIDE` px inside of a place is compared with that outside.
    """
    strange = np.abs(strip.value - expected) / unit
    strange = np.where(np.isfinite(strange), np.minimum(strange, 1.0), 0.0)
    total = np.concatenate((np.zeros((len(strange), 1)), np.cumsum(strange, axis=1)), axis=1)
    last = strange.shape[1]
    at = np.arange(last)
    begin, end = np.maximum(at - ASIDE, 0), np.minimum(at + 1 + ASIDE, last)
    inside = (total[:, at] - total[:, begin]) / np.maximum(at - begin, 1)
    outside = (total[:, end] - total[:, np.minimum(at + 1, last)]) / np.maximum(end - at - 1, 1)
    return np.asarray(inside - outside, np.float32)


def voted(
    vote: NDArray[np.float32], first_px: float, shift_px: NDArray[np.float64], larger_px: NDArray[np.float64]
) -> Votes:
    """Let a rim vote.

    Parameters
    ----------
    vote : (N, M) float32
        Of each profile for each offset.
    first_px : float
        The first offset.
    shift_px : (P, N) float64
        Where each place puts the rim on each profile.
    larger_px : (C,) float64
        By how much it may be larger all around.
    """
    last = vote.shape[1] - 1
    row, flat = np.arange(len(vote), dtype=np.int32) * vote.shape[1], vote.ravel()
    mean = np.empty((len(shift_px), len(larger_px)))
    for number, larger in enumerate(larger_px.tolist()):
        at = np.clip(np.rint(shift_px + (larger - first_px)), 0, last).astype(np.int32)
        mean[:, number] = flat[row + at].mean(axis=1)
    return Votes(mean)


def in_deviations(votes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Votes about their median, in robust deviations of all of them."""
    off = votes - np.median(votes)
    return np.asarray(off / max(1.4826 * float(np.median(np.abs(off))), 1e-12))


def crossings(
    strip: Strip, expected_px: NDArray[np.float64], sign: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Where each profile is steepest near the expected place: offsets (N,) [px] or NaN, slopes (N,), and width.

    The width is that of the edges, the median standard deviation [px] of the step that was blurred.

    Parameters
    ----------
    strip : Strip
        Profiles.
    expected_px : (N,) float64
        Offset at which each is expected.
    sign : float
        Of the slope.
    """
    slope = sign * strip.slope.astype(np.float64)
    near = np.abs(strip.offset_px[None, :] - expected_px[:, None]) <= NEAR_PX
    value = np.where(near & np.isfinite(slope), slope, -np.inf)
    at = value.argmax(axis=1)
    row, last = np.arange(len(slope)), slope.shape[1] - 1
    inner = (at > 0) & (at < last)
    left, here, right = (slope[row, np.clip(at + k, 0, last)] for k in (-1, 0, 1))
    bend = left - 2.0 * here + right
    with np.errstate(invalid="ignore", divide="ignore"):
        peak = inner & (here >= left) & (here >= right) & (bend < 0.0) & (here > 0.0)
        place = strip.offset_px[at] + 0.5 * (left - right) / bend
        usual = float(np.median(here[peak])) if peak.any() else np.inf
        peak &= here > WEAK * usual
    width = float(np.sqrt(np.median(-here[peak] / bend[peak]))) if peak.any() else float("nan")
    return np.where(peak, place, np.nan), np.where(peak, here, 0.0), width
