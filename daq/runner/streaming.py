"""Frames that come by themselves: the camera, or an outer clock, decides when; we are armed for one step only.

A frame keeps the place that its id gives it, counted from the first frame that was exposed after the arming.  A
place whose frame never came stays empty: nothing can be put there later.  Who takes the stream says how many
places may stay empty; one more ends it, with the reason that the camera's counters give.
"""

import time
from collections.abc import Generator

from daq.cameras.frame import Frame
from daq.errors import BadFrame, CameraTimeout, FramesLost, OtherFormat
from daq.runner.armed_camera import ArmedCamera
from daq.runner.shot import Shot
from daq.runs.conservation import Ledger


def stream(taken_by: ArmedCamera, places: range, may_lose: int) -> Generator[tuple[int, Frame], None, None]:
    """Arm, yield (place, frame) in rising order, disarm.

    Parameters
    ----------
    taken_by : ArmedCamera
        The camera; not armed.
    places : range
        Places to be filled.
    may_lose : int
        Places that may stay empty.

    Raises
    ------
    FramesLost
        More places are empty than may be.
    CameraTimeout
        No further frame came in time.
    """
    before, lost, next_place = taken_by.counts.ledger(), 0, places.start
    first: int | None = None
    dried_up: CameraTimeout | None = None
    try:
        arm = _arm(taken_by)
        deadline_s = _deadline_s(taken_by)
        while next_place < places.stop and lost <= may_lose:
            try:
                frame = taken_by.wait_until(deadline_s)
            except OtherFormat:
                raise
            except BadFrame:  # its place stays empty
                continue
            except CameraTimeout as error:
                dried_up = error
                break
            if first is None and not taken_by.match.is_of_arm(frame.meta, arm):
                taken_by.reject(frame, True)
                continue
            first = frame.meta.sequence if first is None else first
            place = places.start + frame.meta.sequence - first
            if place < next_place:  # its id was there before
                taken_by.reject(frame, True)
                continue
            lost += min(place, places.stop) - next_place
            next_place = min(place + 1, places.stop)
            deadline_s = _deadline_s(taken_by)
            if place < places.stop:
                yield place, taken_by.hand_over(frame)
            else:  # the last one that was wanted is gone
                taken_by.reject(frame, True)
    finally:
        taken_by.end()
    why = _where(before, taken_by.counts.ledger())
    if lost > may_lose:
        raise FramesLost(f"{lost} of {next_place - places.start} frames are gone: {why or 'no reason given'}")
    if dried_up is not None:
        raise CameraTimeout(
            f"the stream ended after {next_place - places.start - lost} of {len(places)} frames "
            f"({dried_up}{'; ' if why else ''}{why})"
        ) from dried_up


def _arm(taken_by: ArmedCamera) -> Shot:
    """Start the acquisition; return the moment right before."""
    before_ns, clock_ns = time.monotonic_ns(), taken_by.clock_ns()
    taken_by.make_ready()
    return Shot(clock_ns, before_ns, time.monotonic_ns())


def _deadline_s(taken_by: ArmedCamera) -> float:
    return time.monotonic() + taken_by.section.timeout_s


def _where(before: Ledger, after: Ledger) -> str:
    causes = (
        ("no buffer was free (disk or computer too slow)", after.underrun - before.underrun),
        ("incomplete (link)", after.incomplete - before.incomplete),
        ("never arrived (link)", after.missing - before.missing),
    )
    return ", ".join(f"{number} {cause}" for cause, number in causes if number)
