"""Positions of the spheres of a scene, by their rims in one frame.

The rim of each sphere is looked for around its place (`rim`), then its centre is fitted to the crossings of
the rim with its normals. Per crossing i, with the outward normal's rates (`rim`),

    s_i = r_xyz . move + r_R dR + e + noise,      dR ~ N(0, sigma_R),  e ~ N(0, BIAS w),

where e is what light and blur (of a standard deviation w, seen at the edges) do to every edge of a rim alike: just
inside a ball it is dark because rays graze the glass, and how wide that is depends on what stands behind. Both e
and dR make a rim larger all around, as a move towards the camera does, and nothing in one frame tells them apart:
depth is known to hypot(r_R sigma_R, BIAS w) / r_z at best, half a millimetre on the benches of the examples.
Sideways they cancel around the rim, but for a ball off the axis, whose place depends on its depth: the covariance
holds that.

Neighbouring crossings share the squares behind them, so they count as one each `TOGETHER_PX` of the rim. Outliers
go by weights that fall to zero (Tukey's biweight at 4.7 deviations).

A sphere behind another, of whose rim less than `MIN_RIM_SHARE` can be seen, is not found: it has `own_rim` false
and moves with the others.
"""

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from correction.alignment.rim import (
    VOTERS,
    Rim,
    Strip,
    Votes,
    cast_votes,
    crossings,
    in_deviations,
    rim_of,
    slopes,
    smooth_frame,
    strip_of,
    texture_anomaly,
)
from correction.errors import RimNotFound, RimUnclear
from tracer.bodies import Sphere
from tracer.camera import Camera
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene

BIAS = 0.25  # of the width of edges: standard deviation of where one is seen, all around a rim alike
TOGETHER_PX = 8.0  # of a rim, within which crossings err together
BESIDE_PX = 1.0, 5.0  # inside and outside a rim: bright there, if what stands behind is known
BLUR_PX = 1.5  # of a usual lens and of the smoothing
MIN_RIM_SHARE = 0.2  # of a rim that must be in sight, or the sphere has none of its own
LEAST_CROSSED = 0.15  # of what is in sight that must show the rim
MAX_DEPTH_ERROR_MM = 2.0  # how far a sphere may be off in depth
PLACE_PRIOR_MM = 3.0  # what is known of a place before
VOTE_ROUNDS = 4
VOTE_BIWEIGHT = 4.7
POINTS_PX = 2.0  # along a rim
MOST_POINTS = 1440
MIN_VOTE_LEAD = 6.0  # deviations of the votes for all places, by which the best must stand out
LEAST_STRANGE = 0.12  # more that must differ from the board inside a rim than outside, of bright less dark
SECOND = 0.8  # of the best vote: another place with as much is another rim
WIDE_PX = 2.0  # between places that are voted for first, where outside and inside of a rim are compared
OTHER_PLACE_PX = 8.0  # from there on a place is another one
MAX_STRAY_MM = 0.7  # by which a sphere may stand off where the others stand


class Behind(Protocol):
    """Background of the glass, as it would be seen directly."""

    def shade(self, pixel: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bright (1) or dark (0) at pixels (..., 2)."""
        ...

    def blur(self, pixel: NDArray[np.float64], blur_px: float) -> NDArray[np.float64]:
        """Return the same with blur of this standard deviation."""
        ...

    @property
    def levels(self) -> tuple[float, float]:
        """Intensity of dark and of bright in the frame."""
        ...


@dataclass(frozen=True)
class _Look:
    """A smoothed frame, with what is known of how it was taken: camera, radii, what stands behind the glass."""

    smooth: NDArray[np.float32]
    camera: Camera
    priors: FitTable
    behind: Behind | None


@dataclass(frozen=True)
class SphereSeen:
    """A sphere and where its rim puts it.

    Parameters
    ----------
    name : str
        Of the sphere.
    off_mm : (3,) float64
        From its expected place to where it stands, in the world; 0 without a rim of its own.
    covariance_mm2 : (3, 3) float64
        Of it.
    own_rim : bool
        Whether a rim of its own is seen.
    share_seen : float
        Share of the rim that is in sight.
    crossed : float
        Share of that where the rim was measured.
    rms_px : float
        Of the crossings about the fitted rim.
    """

    name: str
    off_mm: NDArray[np.float64]
    covariance_mm2: NDArray[np.float64]
    own_rim: bool
    share_seen: float
    crossed: float = 0.0
    rms_px: float = float("nan")

    @property
    def sigma_mm(self) -> NDArray[np.float64]:
        """Standard deviation (3,) of its place."""
        return np.asarray(np.sqrt(np.diag(self.covariance_mm2)))


def find_spheres(
    frame: NDArray[Any],
    scene: Scene,
    camera: Camera,
    reach_mm: float,
    priors: FitTable | None = None,
    behind: Behind | None = None,
) -> tuple[SphereSeen, ...]:
    """Find the spheres of a scene by their rims.

    Parameters
    ----------
    frame : (H, W) uint8, uint16 or float
        What the camera sees.
    scene : Scene
        Spheres where they are expected.
    camera : Camera
        Where it stands.
    reach_mm : float
        How far sideways a sphere may be off.
    priors : FitTable, optional
        How well radii are known.
    behind : Behind, optional
        What would be seen without glass.

    Returns
    -------
    tuple of SphereSeen
        In the order of the scene.

    Raises
    ------
    RimNotFound
        A sphere that should show a rim shows none, or none of the spheres can.
    RimUnclear
        Another rim is as good.
    """
    spheres, look = scene.spheres, _Look(smooth_frame(frame), camera, priors or FitTable(), behind)
    require_direct_view(scene)
    expected = np.array([[*ball.centre_mm, ball.radius_mm] for ball in spheres])
    rims = {n: _rim(camera, expected, n) for n in range(len(spheres))}
    shown = [n for n, rim in rims.items() if rim.share_seen >= MIN_RIM_SHARE]
    if not shown:
        raise RimNotFound(
            "no sphere of the scene shows enough of its rim in the frame; look from farther away, or aim the"
            " camera at the glass"
        )
    beside = [n for n in shown if (rims[n].seen & ~rims[n].before_glass).mean() >= MIN_RIM_SHARE]
    voters, board = (
        (beside, look) if beside else (shown, replace(look, behind=None))
    )  # before the board, if any is
    moves, polarity = _vote_coarsely([(spheres[n], rims[n]) for n in voters], board, reach_mm)
    start = expected.copy()
    start[:, :2] += moves.mean(axis=0)  # a sphere that cannot vote goes with the others
    start[voters, :2] = expected[voters, :2] + moves
    found = start.copy()
    seen = {n: _fit_sphere(n, spheres[n], look, expected, found, polarity) for n in shown}
    return tuple(seen.get(n) or _unseen(n, spheres[n], look, found) for n in range(len(spheres)))


def require_direct_view(scene: Scene) -> None:
    """Refuse a scene in which rims are not seen in the direction in which spheres stand.

    Raises
    ------
    RimNotFound
        There is no sphere, or one stands behind a window, in a tube or in liquid.
    """
    if not scene.spheres:
        raise RimNotFound("the scene has no sphere whose rim could be seen; name its spheres")
    for ball in scene.spheres:
        if not scene.in_camera_room(ball):
            raise RimNotFound(f"{ball.name} stands behind a wall, which displaces the image of its rim")


def _rim(camera: Camera, spheres: NDArray[np.float64], number: int) -> Rim:
    """Rim of a sphere, a point every `POINTS_PX`."""
    few = rim_of(camera, spheres, number, 16)
    size = 0.5 * np.ptp(few.pixel, axis=0)
    around = 2.0 * np.pi * float(np.nanmean(size)) if np.isfinite(size).any() else POINTS_PX
    return rim_of(camera, spheres, number, int(np.clip(around / POINTS_PX, 90, MOST_POINTS)))


def _vote_coarsely(
    shown: list[tuple[Sphere, Rim]], look: _Look, reach_mm: float
) -> tuple[NDArray[np.float64], float]:
    """Coarse moves (B, 2) [mm] of the spheres that show a rim, and the sign of their edges.

    The glass is carried as a whole: all rims vote together for one move, then each for its own near to it.
    """
    # Steps that move no rim by more than a pixel in the picture, or than `WIDE_PX`.
    finest = max(float(np.abs(rim.rate[:, :2]).max()) for _, rim in shown)
    step_mm = (1.0 if look.behind is None else WIDE_PX) / finest
    places = _around(reach_mm, step_mm)
    ballots = [_ballot(ball, rim, look, reach_mm + step_mm) for ball, rim in shown]
    votes = [ballot.votes(places) for ballot in ballots]
    signs, least = ((1.0, -1.0), MIN_VOTE_LEAD) if look.behind is None else ((1.0,), LEAST_STRANGE)

    def evidence(vote: NDArray[np.float64]) -> NDArray[np.float64]:
        return in_deviations(vote) if look.behind is None else vote

    # Bright outside or dark outside: one sign for all, whichever they agree on better.
    alike = {sign: evidence(np.mean([v.at_best_size(sign) for v in votes], axis=0)) for sign in signs}
    sign = max(alike, key=lambda s: float(alike[s].max()))
    together = alike[sign]
    best = int(together.argmax())
    names = ", ".join(ball.name for ball, _ in shown)
    if together[best] < least:
        raise RimNotFound(
            f"no rim of {names} is seen within {reach_mm:g} mm of its place; is the glass there, is it lit and in"
            " focus, does the scene name these balls and their sizes?"
        )
    # A second place that is nearly as good, and not beside the first, leaves it open which one it is.
    apart = np.hypot(*(places - places[best]).T) * finest
    rival = int(np.where(apart > OTHER_PLACE_PX, together, -np.inf).argmax())
    if apart[rival] > OTHER_PLACE_PX and together[rival] > SECOND * together[best]:
        raise RimUnclear(
            f"two rims are seen where {names} may stand, {apart[rival]:.0f} px apart; wipe the glass, or take away"
            " what is not in the scene"
        )
    own = apart <= MAX_STRAY_MM * finest
    moves = []
    for (ball, _), vote, ballot in zip(shown, votes, ballots, strict=True):
        height = np.where(own, evidence(vote.at_best_size(sign)), -np.inf)
        at = int(height.argmax())
        if height[at] < 0.5 * least:
            raise RimNotFound(
                f"the other rims are seen, and not that of {ball.name}: does this ball stand there, and is it as"
                " large as in the scene?"
            )
        # Around its own best place once more, a pixel a step.
        near = places[at] + _around(step_mm, 1.0 / finest)
        moves.append(near[int(ballot.votes(near).at_best_size(sign).argmax())])
    return np.array(moves), sign


def _around(reach_mm: float, step_mm: float) -> NDArray[np.float64]:
    """Places (P, 2) on a grid within a circle around (0, 0) [mm]."""
    last = np.ceil(reach_mm / step_mm)
    grid = np.arange(-last, last + 1.0) * step_mm
    x, y = np.meshgrid(grid, grid)
    places = np.stack((x.ravel(), y.ravel()), axis=-1)
    return np.asarray(places[np.hypot(*places.T) <= reach_mm + 0.5 * step_mm])


@dataclass(frozen=True)
class _Ballot:
    """Evidence of one rim: profiles (N, M) from an offset on, and the motion of the rim along them."""

    vote: NDArray[np.float32]
    first_px: float
    rate: NDArray[np.float64]
    larger_px: NDArray[np.float64]

    def votes(self, places: NDArray[np.float64]) -> Votes:
        """Votes for places (P, 2) [mm] of the sphere."""
        return cast_votes(self.vote, self.first_px, places @ self.rate[:, :2].T, self.larger_px)


def _ballot(ball: Sphere, rim: Rim, look: _Look, reach_mm: float) -> _Ballot:
    """Profiles of one rim as far as its sphere may stand off sideways."""
    behind = look.behind
    seen = np.flatnonzero(rim.seen if behind is None else rim.seen & ~rim.before_glass)
    seen = seen[np.linspace(0, len(seen) - 1, min(VOTERS, len(seen))).round().astype(np.intp)]
    rate = rim.rate[seen]
    deep = (
        MAX_DEPTH_ERROR_MM * float(np.abs(rate[:, 2]).max())
        + float(rate[:, 3].max()) * look.priors.sphere(ball.name).radius_mm
    )
    larger = np.arange(-np.ceil(deep), np.ceil(deep) + 1.0)
    far = reach_mm * float(np.hypot(rate[:, 0], rate[:, 1]).max())
    strip = strip_of(look.smooth, rim.pixel[seen], rim.outward[seen], far + deep + 1.0)
    vote = slopes(strip)
    if behind is not None:
        dark, bright = behind.levels
        vote = texture_anomaly(strip, _predict_intensity(strip.place, behind), bright - dark)
    return _Ballot(vote, float(strip.offset_px[0]), rate, larger)


def _predict_intensity(place: NDArray[np.float64], behind: Behind) -> NDArray[np.float64]:
    """Intensity (N, M) that would be seen without glass, with some blur."""
    dark, bright = behind.levels
    return np.asarray(dark + (bright - dark) * behind.blur(place, BLUR_PX))


def _fit_sphere(
    number: int,
    ball: Sphere,
    look: _Look,
    expected: NDArray[np.float64],
    spheres: NDArray[np.float64],
    sign: float,
) -> SphereSeen:
    """Fit the centre of a sphere to the crossings of its rim; `spheres` holds all places and gets this one."""
    unsure_mm = max(look.priors.sphere(ball.name).radius_mm, 1e-4)
    loose = np.array((PLACE_PRIOR_MM, PLACE_PRIOR_MM, PLACE_PRIOR_MM, unsure_mm, 1.0))
    extra = np.zeros(2)  # of the radius, and of the edge
    for _ in range(VOTE_ROUNDS):
        rim = _rim(look.camera, spheres, number)
        seen = rim.seen & _clear_beside(rim, look.behind)
        strip: Strip = strip_of(look.smooth, rim.pixel[seen], rim.outward[seen], 8.0)
        offset, slope, width = crossings(strip, rim.rate[seen, 3] * extra[0] + extra[1], sign)
        used = np.isfinite(offset)
        if used.sum() < 12 or used.mean() < LEAST_CROSSED:
            raise RimNotFound(
                f"the rim of {ball.name} is seen in {100 * used.mean():.0f} % of the places where it should be;"
                " more light beside the glass, or a sharper view, would show it"
            )
        loose[4] = BIAS * width
        rate = rim.rate[seen][used]
        columns = np.column_stack((rate, np.ones(len(rate))))
        target = offset[used] - columns[:, 3:] @ extra
        weight = slope[used] / np.median(slope[used])
        weight = np.minimum(weight, 2.0)
        gone = np.concatenate((spheres[number, :3] - expected[number, :3], extra))
        step, spread = _robust(columns, target, weight, loose, gone)
        spheres[number, :3] += step[:3]
        extra = gone[3:] + step[3:]
    spacing = float(np.median(np.linalg.norm(np.diff(rim.pixel, axis=0), axis=1)))
    together = max(1.0, TOGETHER_PX / spacing)
    scale = np.sqrt(weight) / (spread * np.sqrt(together))
    normal = (columns * scale[:, None]).T @ (columns * scale[:, None]) + np.diag(loose**-2.0)
    covariance = np.linalg.inv(normal)[:3, :3]
    off = spheres[number, :3] - expected[number, :3]
    return SphereSeen(ball.name, off, covariance, True, rim.share_seen, float(used.mean()), spread)


def _clear_beside(rim: Rim, behind: Behind | None) -> NDArray[np.bool_]:
    """Points (N,) of a rim that are bright just outside, or before glass; all, if that is unknown."""
    if behind is None:
        return np.ones(len(rim.pixel), dtype=np.bool_)
    out = np.arange(-BESIDE_PX[0], BESIDE_PX[1] + 0.5)
    around = rim.pixel[:, None, :] + out[None, :, None] * rim.outward[:, None, :]
    return np.asarray((behind.shade(around) > 0.5).all(axis=1) | rim.before_glass)


def _robust(
    columns: NDArray[np.float64],
    target: NDArray[np.float64],
    weight: NDArray[np.float64],
    loose: NDArray[np.float64],
    gone: NDArray[np.float64],
) -> tuple[NDArray[np.float64], float]:
    """Least squares with priors about `gone` steps ago; outliers lose their weight. Step (5,) and spread [px]."""
    step, trust = np.zeros(len(loose)), np.ones(len(target))
    spread = 1.0
    for _ in range(12):
        scale = np.sqrt(weight * trust)
        a = np.vstack((columns * scale[:, None] / spread, np.diag(1.0 / loose)))
        b = np.concatenate((target * scale / spread, -gone / loose))
        step = np.asarray(np.linalg.lstsq(a, b, rcond=None)[0], np.float64)
        left = target - columns @ step
        spread = max(1.4826 * float(np.median(np.abs(left - np.median(left)))), 0.02)
        ratio = left / (VOTE_BIWEIGHT * spread)
        trust = np.where(np.abs(ratio) < 1.0, (1.0 - ratio**2) ** 2, 0.0)
    return step, spread


def _unseen(number: int, ball: Sphere, look: _Look, spheres: NDArray[np.float64]) -> SphereSeen:
    """A sphere without a rim of its own."""
    known = look.priors.sphere(ball.name).centre_mm
    share = _rim(look.camera, spheres, number).share_seen
    return SphereSeen(ball.name, np.zeros(3), known**2 * np.eye(3), False, share)
