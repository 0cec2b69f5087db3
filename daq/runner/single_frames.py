"""Software-triggered frames: one trigger, one frame, and what to do if that frame does not come.

    drain -> read the camera's clock and trigger -> wait -> does the frame belong to this trigger? -> hand it over

* What lies there before the trigger came too late for its own: rejected and counted.
* A frame that was exposed before the trigger is rejected, counted, and waited past (trigger_match).
* Pixels missing: nothing is wrong with the camera; it is triggered again at once.
* Nothing within `timeout_s`: the camera is asked whether it lives and has its settings, is armed anew, and
  triggered again, `retakes` times.  Its late frame may come at any time after that.
* Stamps that fit nothing: a trial settles what they mean (clock_trial), then it is triggered again.
"""

import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress

from daq.cameras.frame import Frame, FrameMeta
from daq.errors import BadFrame, CameraError, CameraTimeout, FrameIncomplete, FramesLost, OtherFormat
from daq.runner.armed_camera import ArmedCamera
from daq.runner.clock_trial import PAUSES_S, explain
from daq.runner.shot import Shot
from daq.runner.trigger_match import Place

TRIALS = 2


class StampsUnclear(CameraError):  # noqa: N818 - stays within this file
    """The time stamp of a frame fits no trigger."""


def single_frames(taken_by: ArmedCamera, places: range) -> Generator[tuple[int, Frame], None, None]:
    """Yield (place, frame), a software trigger each.

    Raises
    ------
    FramesLost
        A frame could not be had.
    FrameDoubt
        One came, and nothing tells which trigger it answers.
    """
    for place in places:
        yield place, _one(taken_by)


def _one(taken_by: ArmedCamera) -> Frame:
    """Trigger until a whole frame comes that was exposed for it."""
    why: CameraError | None = None
    match, counts, tries = taken_by.match, taken_by.counts, taken_by.section.retakes + 1
    failed = 0
    while failed < tries:
        failed += 1
        taken_by.make_ready()
        try:
            with _waiting(taken_by):
                if match.restarted:
                    taken_by.verify()
                return _await(taken_by)
        except FrameIncomplete as error:
            why = error
            match.came_incomplete()
            if not match.by_time:
                taken_by.end()  # only an empty queue makes sure that the next frame is the next trigger's
        except CameraTimeout as error:
            why = error
            taken_by.verify()
            if match.needs_trial:
                failed -= _settle(taken_by)
            elif match.by_time:  # by its id a frame is known only as long as the camera is armed
                taken_by.end()
        except StampsUnclear as error:
            why = error
            failed -= _settle(taken_by)
        except OtherFormat:
            raise
        except BadFrame as error:
            why = error
            match.came_unusable()
            taken_by.verify()
            taken_by.end()
        except CameraError:
            counts.in_doubt = True
            raise
    raise FramesLost(f"no whole frame after {tries} triggers ({why}); look at link and trigger")


@contextmanager
def _waiting(taken_by: ArmedCamera) -> Iterator[Shot]:
    """Trigger; whatever ends the wait for its frame but a frame, or the remains of one, ends it in vain."""
    match, counts = taken_by.match, taken_by.counts
    counts.triggers += 1
    before_ns = time.monotonic_ns()
    match.begin()
    try:
        shot = Shot(taken_by.camera.trigger(), before_ns, time.monotonic_ns())
        match.sent(shot)
        yield shot
    except BadFrame:
        raise
    except StampsUnclear:  # a frame came, and perhaps it was ours
        counts.timeouts += 1
        raise
    except BaseException:
        if match.waits:
            counts.timeouts += 1
            match.gave_up()
        raise


def _await(taken_by: ArmedCamera) -> Frame:
    """Wait for the frame of this trigger, past those of others."""
    match, deadline_s = taken_by.match, time.monotonic() + taken_by.section.timeout_s
    while True:
        try:
            frame = taken_by.wait_until(deadline_s)
        except FrameIncomplete:
            if match.owes_one_frame:
                raise
            continue  # perhaps that of an earlier trigger; if it was ours, nothing more will come
        place = match.place(frame.meta)
        if place is Place.OURS:
            return taken_by.hand_over(frame)
        if place is Place.STALE:
            taken_by.reject(frame, match.was_owed(frame.meta))
            continue
        taken_by.reject(frame, True)
        if not match.by_time:
            taken_by.doubt("after a wait in vain a frame came that tells neither its time nor its id")
        raise StampsUnclear("the time stamp of its frame fits no trigger")


def _settle(taken_by: ArmedCamera) -> bool:
    """Learn from a trial what the stamps mean, once more if it was disturbed; False if no frame came at all."""
    each_had_one = True
    for _ in range(TRIALS):
        shots, metas = _try(taken_by)
        each_had_one &= len(shots) == len(metas)
        trial = explain(shots, metas)
        if trial is not None:
            break
    if not metas:
        return False
    if trial is None and not each_had_one:
        taken_by.match.learned_nothing()
        raise FramesLost("so many frames are lost or late that their time stamps cannot be matched to triggers")
    said = taken_by.match.learn(trial)
    if said:
        taken_by.doubt(said)
    return True


def _try(taken_by: ArmedCamera) -> tuple[list[Shot], list[FrameMeta]]:
    """Trigger a few times with unequal pauses; keep no frame."""
    shots: list[Shot] = []
    metas: list[FrameMeta] = []
    for pause_s in PAUSES_S:
        end_s = time.monotonic() + pause_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            taken_by.ask()
            time.sleep(min(left_s, 0.05))
        metas += taken_by.drain()
        with suppress(CameraTimeout, FrameIncomplete), _waiting(taken_by) as shot:
            shots.append(shot)
            frame = taken_by.wait_until(time.monotonic() + taken_by.section.timeout_s)
            metas.append(frame.meta)
            taken_by.reject(frame, True)
    return shots, metas
