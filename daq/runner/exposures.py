"""Acquisition of frames by software triggers or as a stream, chosen by the camera's settings.

**Software triggers** (`single_frames`): one trigger, one frame, nothing in between.

    drain -> read the camera's clock and trigger -> wait -> does the frame belong to this trigger? -> hand it over

* What lies there before the trigger came too late for its own: rejected and counted.
* A frame that was exposed before the trigger is rejected, counted, and waited past (trigger_match).
* Pixels missing: nothing is wrong with the camera; it is triggered again at once.
* Nothing within `timeout_s`: the camera is asked whether it lives and has its settings, is armed anew, and
  triggered again, `retakes` times.  Its late frame may come at any time after that.
* Stamps that fit nothing: a trial settles what they mean (clock_calibration), then it is triggered again.

**Stream** (`stream`): the camera, or an outer clock, decides when; it is armed for one step only.  A frame keeps
the place that its id gives it, counted from the first frame that was exposed after the arming.  A place whose
frame never came stays empty: nothing can be put there later.  Who takes the stream says how many places may stay
empty; one more ends it, with the reason that the camera's counters give.

Both hand over only frames that were exposed when they should have been, in the format that was set; what they ask
of the camera is in camera_session.
"""

import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from daq.cameras.frame import Frame, FrameMeta
from daq.errors import BadFrame, CameraError, CameraTimeout, FrameIncomplete, FramesLost, OtherFormat
from daq.runner.clock_calibration import PAUSES_S, Shot, explain
from daq.runner.trigger_match import Place
from daq.runs.frame_accounting import SURPLUS, FrameAccounting

if TYPE_CHECKING:
    from daq.runner.camera_session import CameraSession

CLOCK_TRIALS = 2


class StampsUnclear(CameraError):  # noqa: N818 - stays within this file
    """The time stamp of a frame fits no trigger."""


def single_frames(taken_by: "CameraSession", places: range) -> Generator[tuple[int, Frame], None, None]:
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


def _one(taken_by: "CameraSession") -> Frame:
    """Trigger until a whole frame comes that was exposed for it."""
    why: CameraError | None = None
    match, counts, tries = taken_by.match, taken_by.counts, taken_by.section.retakes + 1
    failed = 0
    while failed < tries:
        failed += 1
        taken_by.make_ready()  # empties the queue: what lies there answers an earlier trigger
        try:
            with _waiting(taken_by):
                if match.has_restarted:
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
def _waiting(taken_by: "CameraSession") -> Iterator[Shot]:
    """Trigger; whatever ends the wait for its frame but a frame, or the remains of one, ends it in vain."""
    match, counts = taken_by.match, taken_by.counts
    counts.triggers += 1
    before_ns = time.monotonic_ns()
    match.begin()
    try:
        shot = Shot(taken_by.camera.trigger(), before_ns, time.monotonic_ns())
        match.note_trigger(shot)
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


def _await(taken_by: "CameraSession") -> Frame:
    """Wait for the frame of this trigger, past those of others."""
    match, deadline_s = taken_by.match, taken_by.now_s() + taken_by.section.timeout_s
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
            taken_by.reject(frame, match.answers_pending_trigger(frame.meta))
            continue
        taken_by.reject(frame, True, "had a time stamp that fits no trigger")
        if not match.by_time:
            taken_by.raise_ambiguity("after a wait in vain a frame came that tells neither its time nor its id")
        raise StampsUnclear("the time stamp of its frame fits no trigger")


def _settle(taken_by: "CameraSession") -> bool:
    """Learn from a trial what the stamps mean, once more if it was disturbed; False if no frame came at all."""
    each_had_one = True
    for _ in range(CLOCK_TRIALS):
        shots, metas = _try(taken_by)
        each_had_one &= len(shots) == len(metas)
        trial = explain(shots, metas)
        if trial is not None:
            break
    if not metas:
        return False
    if trial is None and not each_had_one:
        taken_by.match.note_failed_trial()
        raise FramesLost("so many frames are lost or late that their time stamps cannot be matched to triggers")
    said = taken_by.match.learn(trial)
    if said:
        taken_by.raise_ambiguity(said)
    return True


def _try(taken_by: "CameraSession") -> tuple[list[Shot], list[FrameMeta]]:
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
            frame = taken_by.wait_until(taken_by.now_s() + taken_by.section.timeout_s)
            metas.append(frame.meta)
            taken_by.reject(frame, True, "were taken only to learn what time stamps mean")
    return shots, metas


def stream(taken_by: "CameraSession", places: range, may_lose: int) -> Generator[tuple[int, Frame], None, None]:
    """Arm, yield (place, frame) in rising order, disarm.

    Parameters
    ----------
    taken_by : CameraSession
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
    before, lost, next_place = taken_by.counts.accounting(), 0, places.start
    first: int | None = None
    dried_up: CameraTimeout | None = None
    try:
        arm = taken_by.arm()
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
                taken_by.reject(frame, True, "were exposed before the stream began")
                continue
            first = frame.meta.sequence if first is None else first
            place = places.start + frame.meta.sequence - first
            if place < next_place:  # its id was there before
                taken_by.reject(frame, True, "came twice")
                continue
            lost += min(place, places.stop) - next_place
            next_place = min(place + 1, places.stop)
            deadline_s = _deadline_s(taken_by)
            if place < places.stop:
                yield place, taken_by.hand_over(frame)
            else:  # the last one that was wanted is gone
                taken_by.reject(frame, True, SURPLUS)
    finally:
        taken_by.end()
    why = _where(before, taken_by.counts.accounting())
    if lost > may_lose:
        raise FramesLost(f"{lost} of {next_place - places.start} frames are gone: {why or 'no reason given'}")
    if dried_up is not None:
        raise CameraTimeout(
            f"the stream ended after {next_place - places.start - lost} of {len(places)} frames "
            f"({dried_up}{'; ' if why else ''}{why})"
        ) from dried_up


def _deadline_s(taken_by: "CameraSession") -> float:
    return taken_by.now_s() + taken_by.section.timeout_s


def _where(before: FrameAccounting, after: FrameAccounting) -> str:
    causes = (
        ("no buffer was free (disk or computer too slow)", after.underrun - before.underrun),
        ("incomplete (link)", after.incomplete - before.incomplete),
        ("never arrived (link)", after.missing - before.missing),
    )
    return ", ".join(f"{number} {cause}" for cause, number in causes if number)
