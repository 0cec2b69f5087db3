"""The rim of a sphere in a frame: a curve of pixels, and how it moves with the sphere.

From a pinhole at distance D a sphere of radius R fills the cone of half angle a = asin(R / D) about the
direction d of its centre. Each line of sight on the cone touches the sphere in one point,

    T(p) = P + sqrt(D^2 - R^2) (cos a d + sin a (cos p e1 + sin p e2)),        0 <= p < 2 pi,

so the rim is the picture of these points, lens terms and all. Only its moves across itself can be seen: the
rates are those along the outward normal, taken before lens terms, which change them by less than a part in a
hundred. A point is hidden where its line of sight meets a nearer sphere, and not used beyond the frame.

Where along its normals a rim is seen is found first by votes of all of it together, then point by point.  The
frame is read along the normals of the rim where it is expected, as far as the sphere may stand off: a strip of
profiles. A sphere that stands (x, y) mm aside and looks larger by c px has its rim on the normal i at

    s_i = r_x x + r_y y + c                (r: rates of `rim`),

so every profile votes with its slope at that place for every (x, y, c), each with the same weight at most. Edges
of squares, particles or bubbles in the strip vote for places that do not agree with each other; a ring of another
size finds no c that is allowed. Slopes keep their sign: all of a rim is darker inside than outside, or (bright
rings on dark ground) the other way round, and edges that are not a rim's come with either sign and cancel. Where
it is known what would be seen without glass, such as a board, the profiles vote for places where that is seen
outside and something else inside (`texture_anomaly`).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracer.camera import Camera

PROFILE_SMOOTHING_PX = 1.0
VOTERS = 240  # points of a rim that vote; more tell no more
SLOPE_REACH_PX = 2.5  # of the voted place, where the slope of each profile is looked for
WEAK = 0.3  # of the usual slope of the rim: weaker ones are left out
ASIDE = 6  # px on either side of a place that are compared with what would be seen without glass
VOTE_PERCENTILE = 90.0  # percentile of slopes from which one vote is as good as another
RADIUS_STEP_MM = 1e-3
# Of the radius of a body behind a rim, from which on the view beside the rim is undisturbed
UNDISTURBED_FROM = 1.05
FRAME_MARGIN_PX = 3.0  # of the frame, where nothing is measured


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
    """Share of a rim that agrees on each of some places.

    Parameters
    ----------
    height : (P, C) float64
        Mean votes for P places sideways and C sizes.
    """

    height: NDArray[np.float64]

    def at_best_size(self, sign: float) -> NDArray[np.float64]:
        """Votes (P,) at the size that suits each place best, for rims brighter outside (+1) or inside (-1)."""
        return np.asarray((sign * self.height).max(axis=1))


def smooth_frame(frame: NDArray[Any]) -> NDArray[np.float32]:
    """Return a frame without its finest noise, as float32."""
    import cv2

    return np.asarray(cv2.GaussianBlur(frame.astype(np.float32), (0, 0), PROFILE_SMOOTHING_PX), np.float32)


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
    cap = float(np.percentile(np.abs(strip.slope[known]), VOTE_PERCENTILE)) if known.any() else 0.0
    return np.where(known, np.clip(strip.slope / max(cap, 1e-12), -1.0, 1.0), 0.0).astype(np.float32)


def texture_anomaly(strip: Strip, expected: NDArray[np.float64], unit: float) -> NDArray[np.float32]:
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


def cast_votes(
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
    """Find the steepest place of each profile near the expected one: offsets (N,) [px] or NaN, slopes (N,), width.

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
    near = np.abs(strip.offset_px[None, :] - expected_px[:, None]) <= SLOPE_REACH_PX
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


@dataclass(frozen=True)
class Rim:
    """Points of a rim, N of them.

    Parameters
    ----------
    pixel : (N, 2) float64
        u, v.
    outward : (N, 2) float64
        Unit normal in the frame, away from the sphere.
    rate : (N, 4) float64
        How far the rim moves along it [px] per mm of the centre's x, y, z and of the radius.
    seen : (N,) bool
        Within the frame and not behind another body.
    before_glass : (N,) bool
        Another body is seen right beside the rim.
    """

    pixel: NDArray[np.float64]
    outward: NDArray[np.float64]
    rate: NDArray[np.float64]
    seen: NDArray[np.bool_]
    before_glass: NDArray[np.bool_]

    @property
    def share_seen(self) -> float:
        """Share of the rim that the frame can show."""
        return float(self.seen.mean())


def rim_of(camera: Camera, spheres: NDArray[np.float64], number: int, points: int) -> Rim:
    """Return the rim of one of some spheres.

    Parameters
    ----------
    camera : Camera
        Who looks.
    spheres : (B, 4) float64
        Centre and radius of every body that can hide a rim [mm].
    number : int
        Which of them.
    points : int
        Places around it.
    """
    centre, radius = spheres[number, :3], float(spheres[number, 3])
    angle = 2.0 * np.pi * np.arange(points) / points
    touch = tangent_points(camera, centre, radius, angle)
    ideal = camera.project_ideal(touch)
    pixel = camera.acquired(ideal)
    across = camera.project_ideal(tangent_points(camera, centre, radius + RADIUS_STEP_MM, angle)) - ideal
    outward = across / np.linalg.norm(across, axis=1)[:, None]
    rate = np.empty((points, 4))
    for axis in range(3):
        step = RADIUS_STEP_MM * np.eye(3)[axis]
        ahead, behind = (
            camera.project_ideal(tangent_points(camera, centre + s * step, radius, angle)) for s in (1.0, -1.0)
        )
        rate[:, axis] = ((ahead - behind) * outward).sum(axis=1) / (2.0 * RADIUS_STEP_MM)
    rate[:, 3] = (across * outward).sum(axis=1) / RADIUS_STEP_MM
    width, height = camera.sensor_px
    inside = (pixel >= FRAME_MARGIN_PX).all(axis=1) & (
        pixel <= np.array((width, height)) - 1.0 - FRAME_MARGIN_PX
    ).all(axis=1)
    hidden, before = _others(camera, spheres, number, touch)
    return Rim(pixel, outward, rate, inside & ~hidden, before)


def tangent_points(
    camera: Camera, centre: NDArray[np.float64], radius: float, angle: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Points (N, 3) in which lines of sight touch a sphere, at angles (N,) around it; NaN from inside it."""
    eye = np.array(camera.position_mm)
    away = centre - eye
    distance = float(np.linalg.norm(away))
    towards = away / distance
    aside = camera.rotation_matrix[0] - (camera.rotation_matrix[0] @ towards) * towards
    aside /= np.linalg.norm(aside)
    upright = np.cross(towards, aside)
    sine = radius / distance
    cosine = float(np.sqrt(1.0 - sine**2)) if sine < 1.0 else float("nan")
    around = np.cos(angle)[:, None] * aside + np.sin(angle)[:, None] * upright
    return np.asarray(eye + distance * cosine * (cosine * towards + sine * around))


def _others(
    camera: Camera, spheres: NDArray[np.float64], number: int, touch: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Points (N,) before which another sphere stands, and those behind which one does."""
    eye = np.array(camera.position_mm)
    way = touch - eye
    length = np.linalg.norm(way, axis=1)
    ray = way / length[:, None]
    hidden, before = np.zeros((2, len(touch)), dtype=np.bool_)
    for other, (x, y, z, radius) in enumerate(spheres[:, :4].tolist()):
        if other == number:
            continue
        away = np.array((x, y, z)) - eye
        along = ray @ away
        beside = np.sqrt(np.maximum(away @ away - along**2, 0.0))
        hidden |= (beside < radius) & (along < length)
        before |= (beside < UNDISTURBED_FROM * radius) & (along >= length)
    return hidden, before
