"""Identification of a listed ball by the squares that are seen through it.

Where no corner is where the scene shows it, corners cannot say it.  The picture can: a pixel of the ball shows a
bright square or a dark one, and for each change of the ball (another index, a core of air or none, another radius)
the share of pixels that show what they should is

    agreement = max over d of  mean [ bright(I) = shade(X + d) ],

X the traced points of the board, d a shift by up to a square each way: a ball a little aside shows the same
picture, shifted.  One a little nearer or farther shows it larger or smaller (0.3 mm: a third of a square, at the
edge of a ball far above the board), so places along the line of sight are tried before a ball counts as not as
described.  A ball that is not there shows the bare board, unshifted.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.fit.seen.prediction import in_target_frame
from correction.target import Chessboard
from tracer.bodies import Core, Sphere, vector3
from tracer.errors import SceneError
from tracer.media import MEDIA, ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose
from tracer.strategies.trace import trace

INDICES = np.arange(1.30, 1.97, 0.02)  # of glass, plastic and liquids
CORES = np.arange(0.5, 0.96, 0.05)  # radii of a core of air, of the ball's
RADII = np.arange(0.9, 1.105, 0.01)  # times that given
SHIFTS = np.arange(-1.0, 1.0, 0.25)  # squares
NEARER_MM = (-1.0, -0.5, -0.25, 0.25, 0.5, 1.0)  # to the camera: a standard deviation of an ordinary place
OWN_OUTLINE, OTHER_OUTLINE = 0.9, 1.03  # of a ball's outline that is asked, and of another's that is not
MAX_BALL_PIXELS, MIN_BALL_PIXELS = 1500, 600  # pixels of a ball
SHADE_QUANTILES, LEAST_CONTRAST = (
    (0.05, 0.95),
    0.5,
)  # quantiles that are dark and bright; of the contrast of the frame
MIN_LANDED_SHARE = 0.6  # of the pixels whose rays must reach the board
MAX_WRONG_AGREEMENT, MIN_RIGHT_AGREEMENT = (
    0.7,
    0.78,
)  # agreement up to which a ball is not as described, and from which a change explains it
UNEXPLAINED = 0.65  # of the best change, up to which none explains it
KIND_LEAD = 0.1  # of one kind of change over all others, from which it explains a view of small squares
RIVAL_AGREEMENT = 0.03  # agreement by which changes are distinguished


def balls_seen_otherwise(
    scene: Scene, image: NDArray[Any], pose: TargetPose, board: Chessboard, is_refused: bool = False
) -> dict[str, str]:
    """Return what balls seem to be through which other squares are seen than the scene shows.

    Parameters
    ----------
    scene : Scene
        As believed or fitted, the camera fitted to the bare board.
    image : (H, W)
        A frame with glass.
    pose : TargetPose
        Where the target stood.
    board : Chessboard
    is_refused : bool
        Whether to name as well what no change of the ball explains.

    Returns
    -------
    dict
        Ball -> sentence, the one that agrees least first; balls as described, or hardly seen, are not in it.
    """
    if board.dots is not None:
        return {}
    seen = in_target_frame(scene, pose)
    contrast = float(np.ptp(np.quantile(image, SHADE_QUANTILES)))
    glass = [ball for ball in seen.spheres if ball.medium is not None]
    judged = [(*_judge_ball(seen, ball, image, board, contrast, is_refused), ball.name) for ball in glass]
    return {name: sentence for _, sentence, name in sorted(judged, key=lambda one: one[0]) if sentence}


def _judge_ball(
    scene: Scene, ball: Sphere, image: NDArray[Any], board: Chessboard, contrast: float, is_refused: bool
) -> tuple[float, str]:
    """Agreement of one ball as given, and what it seems to be; "" if as described, or too little is seen of it."""
    pixels = _lone_pixels(scene, ball)
    if len(pixels) < MIN_BALL_PIXELS:
        return 1.0, ""
    light = image[tuple(pixels[:, ::-1].T)].astype(np.float64)
    dark, white = np.quantile(light, SHADE_QUANTILES)
    if white - dark < LEAST_CONTRAST * contrast:
        return 1.0, ""
    bright = light > 0.5 * (dark + white)

    def agreement(changed: Scene, shifts: NDArray[np.float64] = SHIFTS) -> float:
        return _agreement(trace(changed, pixels.astype(np.float64)).plane_mm, bright, board, shifts)

    def agreement_of(other: Sphere) -> float:
        try:
            return agreement(scene.with_bodies([other if one.name == ball.name else one for one in scene.bodies]))
        except SceneError:  # it would reach into another body
            return 0.0

    given = agreement(scene)
    if given > MAX_WRONG_AGREEMENT or any(
        agreement_of(other) > MAX_WRONG_AGREEMENT for other in _nearer_or_farther(scene, ball)
    ):
        return given, ""
    if agreement(scene.bare(), np.zeros(1)) > MIN_RIGHT_AGREEMENT:
        return given, (
            f"`{ball.name}` is not where the scene puts it: the board is seen there without glass; take the ball"
            " out of the scene, or correct its centre_mm"
        )
    found = sorted(
        ((agreement_of(other), kind, value) for other, kind, value in _changes(scene, ball)), reverse=True
    )
    best = found[0][0]
    if best < UNEXPLAINED and not is_refused:
        return given, ""
    if best < UNEXPLAINED:
        return given, (
            f"no glass, core or radius explains what is seen through `{ball.name}` (as given"
            f" {100.0 * given:.0f} %, at best {100.0 * best:.0f} % of its pixels show the right squares): a ball"
            " that the scene does not list may stand before it; list it, or take it away"
        )
    others = max((share for share, kind, _ in found if kind != found[0][1]), default=0.0)
    if best < MIN_RIGHT_AGREEMENT and best < others + KIND_LEAD:
        return given, ""
    likely: dict[str, str] = {}
    for share, kind, value in found:
        if share > best - RIVAL_AGREEMENT:
            likely.setdefault(kind, value)
    return given, (
        f"what is seen through `{ball.name}` is as through {', or '.join(likely.values())}"
        f" ({100.0 * best:.0f} % of its pixels show the right squares, as given {100.0 * given:.0f} %); check its"
        " glass, radius and core"
    )


def _nearer_or_farther(scene: Scene, ball: Sphere) -> Iterator[Sphere]:
    """The same ball at other distances from the camera."""
    centre = np.array(ball.centre_mm)
    towards = np.array(scene.camera.position_mm) - centre
    for by in NEARER_MM:
        yield replace(ball, centre_mm=vector3(centre + by * towards / np.linalg.norm(towards)))


def _changes(scene: Scene, ball: Sphere) -> Iterator[tuple[Sphere, str, str]]:
    """Balls that it may be, each with the kind of change and its value in words."""
    assert ball.medium is not None
    own = ball.medium.n(scene.wavelength_nm)
    for n in INDICES.tolist():
        yield replace(ball, medium=ConstantMedium(n)), "glass", f"glass of n = {n:.2f} and not {own:.3f}"
    for share in CORES.tolist() if not ball.cores else ():
        core = Core(share * ball.radius_mm, MEDIA["air"])
        yield replace(ball, cores=(core,)), "core", f"a hollow ball (a core of air of {core.radius_mm:.3g} mm)"
    if ball.cores:
        yield replace(ball, cores=()), "core", "a ball that is not hollow"
    for factor in RADII.tolist():
        radius = factor * ball.radius_mm
        cores = tuple(replace(core, radius_mm=factor * core.radius_mm) for core in ball.cores)
        larger = replace(ball, radius_mm=radius, cores=cores)
        yield larger, "radius", f"a radius of {radius:.3g} and not {ball.radius_mm:.3g} mm"


def _agreement(
    place_mm: NDArray[np.float64], bright: NDArray[np.bool_], board: Chessboard, shifts: NDArray[np.float64]
) -> float:
    """Share of pixels (N,) that show the square of the board which their rays meet, shifted as fits best."""
    met = np.isfinite(place_mm).all(axis=1)
    if met.mean() < MIN_LANDED_SHARE:
        return 0.0
    place_mm, bright = place_mm[met], bright[met]
    steps = np.stack(np.meshgrid(shifts, shifts), axis=-1).reshape(-1, 2) * board.sides_mm
    return max(float(np.mean((board.shade(place_mm + step) > 0.5) == bright)) for step in steps)


def _lone_pixels(scene: Scene, ball: Sphere) -> NDArray[np.int64]:
    """Pixels u, v (N, 2) well inside the outline of a ball, and outside those of all others."""
    (left, top), (right, bottom) = _outline_box(scene, ball)
    every = np.stack(np.meshgrid(np.arange(left, right), np.arange(top, bottom)), axis=-1).reshape(-1, 2)
    away = scene.camera.directions(every.astype(np.float64))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    inside = np.ones(len(every), np.bool_)
    for other in scene.spheres:
        middle, half = _cone(scene, other)
        angle = np.arccos(np.clip(away @ middle, -1.0, 1.0))
        inside &= angle < OWN_OUTLINE * half if other.name == ball.name else angle > OTHER_OUTLINE * half
    chosen = every[inside]
    return chosen[:: max(1, len(chosen) // MAX_BALL_PIXELS)]


def _cone(scene: Scene, ball: Sphere) -> tuple[NDArray[np.float64], float]:
    """Direction (3,) of a ball's middle from the camera, and half the angle that it fills."""
    towards = np.array(ball.centre_mm) - np.array(scene.camera.position_mm)
    distance = float(np.linalg.norm(towards))
    return towards / distance, float(np.arcsin(min(ball.radius_mm / distance, 0.99)))


def _outline_box(scene: Scene, ball: Sphere) -> NDArray[np.int64]:
    """First and last + 1 pixel u, v (2, 2) beyond which nothing of the part of a ball that is asked lies.

    All of the sensor if a part of its rim has no pixel.  Between two of the directions the rim bulges by less than
    1 - cos(pi / 64) = 0.12 % of its radius.
    """
    camera, (middle, half) = scene.camera, _cone(scene, ball)
    turn = np.linspace(0.0, 2.0 * np.pi, 65)
    aside = np.linalg.svd(middle[None])[2][1:]  # two directions at right angles to the middle and to each other
    rim = np.cos(half) * middle + np.sin(half) * (
        np.cos(turn)[:, None] * aside[0] + np.sin(turn)[:, None] * aside[1]
    )
    seen, size = camera.project(np.array(camera.position_mm) + rim), np.array(camera.sensor_px)
    if not np.isfinite(seen).all():
        return np.array([[0, 0], size])
    low, high = np.floor(seen.min(axis=0)) - 1.0, np.ceil(seen.max(axis=0)) + 2.0
    return np.asarray(np.clip(np.array([low, high]), 0, size), dtype=np.int64)
