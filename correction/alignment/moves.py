"""Moves that align the glass, from successive frames, and a check that each did what it should.

A look says where glass and camera stand, p, while their axes have carried them by a from their places in the
scene file. What is left, e = p - a, is how they were put up; it does not change with a move. So looks are averaged
over e (weighted by their sigmas), and the axes shall go to

    a = -e,

where glass and camera stand as in the scene file. After a first move the looks from nearby count alone: a scale
that is off by a part in a thousand is then a micrometre.

**Depth.** A rim tells little of it (`spheres_seen`), and towards the target glass can break. So along z glass
moves only if it is too far by more than `TELLING` sigmas, or seen nearer than keep-out allows at all, and then not
nearer to the target than `MOVE_SIGMAS` sigmas before what keep-out allows: what is left is said, and a person, or
`rtpiv calibrate`, has to do the rest. The camera is moved in all directions if it is surely off.

**Check.** Between two looks p must change as a does. If it changes the other way, or not at all, an axis is wired
with the wrong sign, slips, or its motor is off: nothing is moved any more (`MoveDoubted`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from correction.alignment.seen import Arrangement
from correction.errors import MoveDoubted

STAGE_STEP_MM = 0.01  # one step of a stage: glass that stands so well is aligned
WORTH = 0.1  # of a step; what is less is not worth a move
TELLING = 2.0  # sigmas
MOVE_SIGMAS = 3.0
TOUCH_MM = 0.02  # by which glass may be seen too near, as keep-out has it of bodies that touch
NEAR_MM = 0.3  # looks from within this distance of the last one are averaged
FOLLOWS = 0.15  # share by which a move may differ from what was asked for
LEAST_MM = 0.02  # moves smaller than this are not judged
CAMERA_MM = 0.05  # by which a camera is left off its place
DIRECTIONS = "xyz"


@dataclass(frozen=True)
class Look:
    """One look.

    Parameters
    ----------
    glass_mm, camera_mm : (3,) float64
        How far the axes have carried them from their places in the scene file, as measured.
    seen : Arrangement
        Where they stand.
    """

    glass_mm: NDArray[np.float64]
    camera_mm: NDArray[np.float64]
    seen: Arrangement


@dataclass(frozen=True)
class Wanted:
    """Places to which axes are to carry glass and camera next.

    Parameters
    ----------
    glass_mm, camera_mm : (3,) float64
        From their places in the scene file; what cannot or need not move has its present place.
    glass_left_mm, glass_sigma_mm : (3,) float64
        How far the glass is off its place now, and how well that is known.
    put_up_mm : (3,) float64
        How far off its place the glass would stand with its axes where the scene file holds.
    camera_put_up_mm : (3,) float64
        The same of the camera.
    stands_off_mm : float
        How far before its place the glass is to be left, for safety, along z.
    """

    glass_mm: NDArray[np.float64]
    camera_mm: NDArray[np.float64]
    glass_left_mm: NDArray[np.float64]
    glass_sigma_mm: NDArray[np.float64]
    put_up_mm: NDArray[np.float64]
    camera_put_up_mm: NDArray[np.float64]
    stands_off_mm: float

    @property
    def sideways_mm(self) -> float:
        """Distance of the glass from its place, sideways."""
        return float(np.hypot(*self.glass_left_mm[:2]))


def plan_moves(looks: Sequence[Look], axes: Mapping[str, str], free_mm: float) -> Wanted:
    """Return where axes shall carry glass and camera after some looks.

    Parameters
    ----------
    looks : sequence of Look
        In their order, one at least.
    axes : mapping
        Directions, such as ``xyz``, in which there are axes for ``glass`` and for ``camera``.
    free_mm : float
        How much nearer to the target keep-out lets the glass come than its place in the scene file.
    """
    last = looks[-1]
    near = [look for look in looks if np.hypot(*(look.glass_mm - last.glass_mm)[:2]) <= NEAR_MM]
    put_up, sigma = _average(
        [look.seen.glass_mm - look.glass_mm for look in near], [look.seen.sigma_mm for look in near]
    )
    left = last.glass_mm + put_up
    glass, stands_off = last.glass_mm.copy(), 0.0
    for axis, name in enumerate(DIRECTIONS):
        if name not in axes.get("glass", ""):
            continue
        if name != "z" and abs(left[axis]) > WORTH * STAGE_STEP_MM:
            glass[axis] = -put_up[axis]
        if name == "z":
            telling = max(TELLING * float(sigma[2]), STAGE_STEP_MM)
            stands_off = max(0.0, MOVE_SIGMAS * float(sigma[2]) - free_mm)
            if left[2] > max(telling, stands_off + float(sigma[2])) or left[2] < -free_mm - TOUCH_MM:
                glass[2] = stands_off - put_up[2]
    camera, camera_put_up = _camera(looks, last, axes.get("camera", ""))
    return Wanted(glass, camera, left, sigma, put_up, camera_put_up, stands_off)


def _camera(looks: Sequence[Look], last: Look, directions: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place to which the camera is to be carried, and its distance from its nominal one."""
    offs, sigmas = [], []
    for look in looks:
        if look.seen.camera_mm is not None and look.seen.camera_sigma_mm is not None:
            offs.append(look.seen.camera_mm - look.camera_mm)
            sigmas.append(look.seen.camera_sigma_mm)
    camera = last.camera_mm.copy()
    if not offs:
        return camera, np.zeros(3)
    put_up, sigma = _average(offs, sigmas)
    for axis, name in enumerate(DIRECTIONS):
        off = abs(camera[axis] + put_up[axis])
        if name in directions and off > max(TELLING * float(sigma[axis]), CAMERA_MM):
            camera[axis] = -put_up[axis]
    return camera, put_up


def _average(
    values: Sequence[NDArray[np.float64]], sigmas: Sequence[NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weighted mean (3,), and the best sigma of one: looks from one place err alike."""
    weight = 1.0 / np.maximum(np.array(sigmas), 1e-9) ** 2
    mean = (weight * np.array(values)).sum(axis=0) / weight.sum(axis=0)
    return np.asarray(mean), np.asarray(np.min(sigmas, axis=0))


def require_followed(looks: Sequence[Look], names: Mapping[tuple[str, str], str]) -> None:
    """Refuse to go on if what is seen does not follow the last move.

    Parameters
    ----------
    looks : sequence of Look
        The last two count.
    names : mapping
        Element and direction, such as ``("glass", "x")`` -> name of the axis.

    Raises
    ------
    MoveDoubted
        An axis moved the other way, not at all, or by another length.
    """
    if len(looks) < 2:
        return
    before, after = looks[-2:]
    for (element, direction), name in names.items():
        axis = DIRECTIONS.index(direction)
        if element == "glass":
            asked = after.glass_mm[axis] - before.glass_mm[axis]
            seen = after.seen.glass_mm[axis] - before.seen.glass_mm[axis]
            sigma = _relative_sigma(before, after, axis)
        else:
            if before.seen.camera_mm is None or after.seen.camera_mm is None:
                continue
            asked = after.camera_mm[axis] - before.camera_mm[axis]
            seen = after.seen.camera_mm[axis] - before.seen.camera_mm[axis]
            sigma = float(np.hypot(before.seen.camera_sigma_mm[axis], after.seen.camera_sigma_mm[axis]))  # type: ignore[index]
        if abs(asked) < max(LEAST_MM, MOVE_SIGMAS * sigma):
            continue
        if abs(seen - asked) <= max(FOLLOWS * abs(asked), MOVE_SIGMAS * sigma):
            continue
        raise MoveDoubted(_doubt(name, element, direction, float(asked), float(seen)))


def _relative_sigma(before: Look, after: Look, axis: int) -> float:
    """Sigma of a change of place: along z, what makes rims larger cancels between two looks but for a third."""
    sigma = float(np.hypot(before.seen.sigma_mm[axis], after.seen.sigma_mm[axis]))
    return sigma / 3.0 if axis == 2 else sigma


def _doubt(name: str, element: str, direction: str, asked_mm: float, seen_mm: float) -> str:
    went = f"{name} was moved by {asked_mm:+.3f} mm and the {element} is seen to have moved by {seen_mm:+.3f} mm"
    if abs(seen_mm) < 0.2 * abs(asked_mm):
        return f"{went} along {direction}: it stands still; look at motor, coupling and what the axis carries"
    if seen_mm * asked_mm < 0.0:
        return f"{went} along {direction}: the other way; correct its sign in the bench file, or its wiring"
    return f"{went} along {direction}: not the way that was asked for; check its steps_per_mm, or what holds it"
