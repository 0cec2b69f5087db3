"""What holds the balls goes where the balls go.

Frames of a target tell where the glass is; of rods and other opaque bodies they show a shadow at best, so
the fit has no numbers of theirs.  A support that stayed where the file has it while its ball moves would
stand in the ball, and no such scene can be.  So a body that stands within HELD_MM of a ball is taken for its
support and makes the same step (the nearest ball's, where it holds several); others stay.  What then still
overlaps, because a radius grew or another ball came near, is moved off along the shortest way, and up from
the plane: by a few hundredths of a millimetre, at the edge of a shadow.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import CONTACT_TOL_MM, Body, Sphere, shifted_by

HELD_MM = 5.0  # glue, cups and what a tape measure misses
ROUNDS = 100
CLEARANCE_MM = 0.1 * CONTACT_TOL_MM


def carried(support: Body, before: Sequence[Sphere], after: Sequence[Sphere]) -> Body:
    """Return a support where it stands once the balls have moved.

    Parameters
    ----------
    support : Body
        A body that is no ball, where the file has it.
    before, after : sequence of Sphere
        The balls where the file has them, and where they are; in the same order.
    """
    gaps_mm = [support.distance_mm(np.array(ball.centre_mm)) - ball.radius_mm for ball in before]
    if gaps_mm and min(gaps_mm) <= HELD_MM:
        held = int(np.argmin(gaps_mm))
        step_mm = np.subtract(after[held].centre_mm, before[held].centre_mm)
        support = support.moved(shifted_by(step_mm))
    return clear_of(support, after)


def clear_of(support: Body, balls: Sequence[Sphere]) -> Body:
    """Return a support that overlaps no ball and does not cross the plane."""
    for _ in range(ROUNDS):
        steps_mm = [step for ball in balls if (step := _way_out_mm(support, ball)) is not None]
        if support.lowest_mm < -CONTACT_TOL_MM and support.highest_mm > CONTACT_TOL_MM:
            steps_mm.append(np.array([0.0, 0.0, -support.lowest_mm]))
        if not steps_mm:
            break
        support = support.moved(shifted_by(np.mean(steps_mm, axis=0)))
    return support


def _way_out_mm(support: Body, ball: Sphere) -> NDArray[np.float64] | None:
    """Step (3,) [mm] that takes a support just off a ball; None if they do not overlap."""
    centre = np.array(ball.centre_mm)
    depth_mm = ball.radius_mm - support.distance_mm(centre)
    if depth_mm <= CONTACT_TOL_MM:
        return None
    start, end, _ = support.capsule
    axis = np.subtract(end, start)
    along = np.clip((centre - start) @ axis / max(float(axis @ axis), CONTACT_TOL_MM), 0.0, 1.0)
    away = np.asarray(start + along * axis - centre, dtype=np.float64)
    length = float(np.linalg.norm(away))
    direction = away / length if length > 0.0 else np.array([0.0, -1.0, 0.0])
    return np.asarray((depth_mm + CLEARANCE_MM) * direction)
