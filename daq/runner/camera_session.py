"""The camera of a run: arming, disarming, waiting, rejecting, and the account of that.

Every wait is cut into slices, and before each slice and each trigger the bench's stop is asked.  How frames are
taken is in exposures.

**Format.**  A producer may read one pixel format back and send another.  Pixels of another format are other grey
values, and those of another size another place, so not even the first such frame may be kept.  Compared is what
the camera read back with what each frame itself announces; both are known already, so it costs nothing.

**Timeout.**  With a `timeout_s` below exposure, readout and transfer every frame comes after its timeout, and a
run would end after its first triggers with words about the link.  The camera tells what it needs by its settings,
so this is said before anything moves.  Only what a camera tells is counted: one that tells nothing is never
refused.

    ExposureTime                [us]; ExposureTimeAbs before SFNC 2
    SensorReadoutTime           [us]
    PayloadSize                 [byte], over DeviceLinkThroughputLimit, or DeviceLinkSpeed, or GevLinkSpeed
    1 / ResultingFrameRate      a frame takes that long at least, whatever limits it
    1 / AcquisitionFrameRate    of a camera that runs by itself: the next frame may be that far away

A simulated camera has to draw what it sees, which takes this computer a second or minutes. That is not the
camera's time: the timeout counts what has passed less what was drawn (`now_s`).

**Loss.**  A camera without a frame for a second is asked whether it is there, so a pulled cable costs seconds,
however long the timeout.
"""

import math
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import suppress
from typing import Any, NoReturn

from daq.bench.bench_table import CameraSection, trigger_is_software
from daq.cameras.camera import Camera, Counters, Setting, probe_s
from daq.cameras.formats import FORMATS
from daq.cameras.frame import Frame, FrameMeta
from daq.cameras.link import first_of, link_speed_bytes_s
from daq.errors import (
    BadFrame,
    CameraError,
    CameraLost,
    CameraTimeout,
    FrameDoubt,
    OtherFormat,
    RunUsageError,
    SettingsChanged,
)
from daq.runner.clock_calibration import Shot
from daq.runner.exposures import single_frames, stream
from daq.runner.trigger_match import UNCONFIRMED, TriggerMatch
from daq.runs.frame_accounting import FrameAccounting, FrameCounters
from stages.stop_latch import StopLatch

SILENCE_S, SILENT_ANSWER_S = 1.0, 3.0  # without a frame, until the camera is asked; and for its answer
LATE, UNASKED = "came after timeout_s of the bench file had passed", "came unasked"
OTHER = "came in another format than the camera was set to"


class FrameFormat:
    """Pixel format and size that frames must have.

    Parameters
    ----------
    settings : mapping
        What the camera read back; what it does not tell is not compared.
    """

    def __init__(self, settings: Mapping[str, Setting]) -> None:
        name = settings.get("PixelFormat")
        self._name = name if name in FORMATS else None  # a name of the vendor's own says nothing
        self._sides = [settings.get(side) for side in ("Width", "Height")]

    def contradiction(self, frame: Frame) -> str:
        """Return how a frame differs from what was read back, as the rest of a sentence; "" if it does not."""
        height, width = frame.pixels.shape
        got = (frame.meta.pixel_format, width, height)
        announced = (self._name, *self._sides)
        if all(mine is None or mine == its for mine, its in zip(announced, got, strict=True)):
            return ""
        said = [str(mine if mine is not None else its) for mine, its in zip(announced, got, strict=True)]
        return (
            f"sends {got[0]} of {width} x {height} px and reads {said[0]} of {said[1]} x {said[2]} px back; "
            "set PixelFormat, Width and Height to what it really sends"
        )


SLICE_S = 0.05


class CameraSession:
    """A camera, its frames one after the other, and the account of them.

    Parameters
    ----------
    camera : Camera
        Open.
    section : CameraSection
        Settings, timeout, retakes.
    latch : StopLatch, optional
        The bench's stop, which ends exposures too; None where nothing can be stopped.
    report_ambiguity : callable, optional
        Called at once with every reason to distrust frames; it is also kept in `ambiguities`.
    rendering_s : callable, optional
        Seconds in which a simulation drew pictures, up to now.
    """

    def __init__(
        self,
        camera: Camera,
        section: CameraSection,
        latch: StopLatch | None = None,
        report_ambiguity: Callable[[str], None] = lambda text: None,
        rendering_s: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self.camera = camera
        self.section = section
        self.software = trigger_is_software(section.settings)
        self.match = TriggerMatch(1e9 * section.timeout_s)
        self.counts = FrameCounters(self.software)
        self.why_rejected: Counter[str] = Counter()  # frames that came whole, by reason
        self.discarded = 0  # frames that were written and are not wanted after all
        self.ambiguities: list[str] = []
        self.settings: dict[str, Setting] = {}  # as the camera read them back
        self._latch = latch
        self._report_ambiguity = report_ambiguity
        self._drawn_s = rendering_s
        self._token = 0
        self._heard_s = self.now_s()  # a frame, or an answer to a probe
        self._format = FrameFormat({})
        self.is_armed = False  # the camera waits for triggers
        self._ended = FrameAccounting()  # when the last arm ended, as the next two
        self._handed_before = self._rejected_before = 0

    # ---- the account ---------------------------------------------------------------------------

    def accounting(self, written: int) -> FrameAccounting:
        """Account of the arms that have ended.

        Parameters
        ----------
        written : int
            Frames of this session that are on the disk; what was handed over and is not there counts as lost.
        """
        accounting, discarded = self.counts.accounting(), self.discarded
        unwritten = accounting.written - written
        return accounting + FrameAccounting(
            written=-unwritten - discarded, unwritten=unwritten, rejected=discarded
        )

    def accounting_so_far(self, written: int) -> FrameAccounting:
        """Account in the middle of an arm, without asking the camera; frames under way are not counted yet."""
        counts, ended = self.counts, self._ended
        handed, rejected = counts.handed - self._handed_before, counts.rejected - self._rejected_before
        accounting = ended + FrameAccounting(triggered=handed + rejected, written=handed, rejected=rejected)
        under_way, discarded = accounting.written - written, self.discarded
        return accounting + FrameAccounting(
            triggered=-under_way, written=-under_way - discarded, rejected=discarded
        )

    # ---- what a run asks for -------------------------------------------------------------------

    def set_up(self) -> dict[str, Setting]:
        """Configure the camera; return everything it can tell about its settings."""
        markers = () if self.section.pairs is None else self.section.pairs.chunks
        chunks = tuple(dict.fromkeys((*markers, *self.section.chunks)))
        self.camera.configure(self.section.settings, **({"chunks": chunks} if chunks else {}))
        settings = self.settings = self.camera.settings()
        self._format = FrameFormat(settings)
        return settings

    def facts(self, frame: Frame) -> dict[str, Any]:
        """Return the chunk data of a frame that the bench file wants in its record."""
        chunks = {name: frame.meta.chunks[name] for name in self.section.chunks if name in frame.meta.chunks}
        return {"chunks": chunks} if chunks else {}

    def check_frame_timeout(self, settings: Mapping[str, Setting]) -> None:
        """Refuse a timeout that no frame can meet, by what `set_up` returned; RunUsageError says what would do."""
        check_frame_timeout(self.section.timeout_s, settings)

    def verify(self) -> None:
        """Make sure that the camera still has its settings.

        Raises
        ------
        SettingsChanged, CameraLost
            It has not, or does not answer; frames since the last check are unreliable.
        """
        try:
            self.camera.verify()
        except (SettingsChanged, CameraLost):
            self.counts.in_doubt |= self.is_armed
            raise

    def end(self) -> None:
        """Disarm and close the account of this arm.  Harmless when repeated."""
        if not self.is_armed:
            return
        with suppress(CameraError, FrameDoubt):  # gone; or said and kept
            self.drain()
        self.is_armed = False
        try:
            counters = self.camera.disarm()
        except CameraError:  # what it counted before is all that will ever be known
            counters = _last_counters(self.camera)
        self.counts.by_time = self.match.by_time
        self.counts.unasked += self.match.not_owed(counters.unused)
        self._ended = self.counts.close(counters)
        self._handed_before, self._rejected_before = self.counts.handed, self.counts.rejected

    def conclude(self, written: int) -> FrameAccounting:
        """End the session: close the account, and note what stays ambiguous now.

        Parameters
        ----------
        written : int
            As for `accounting`.
        """
        self.end()
        accounting = self.accounting(written)
        if accounting.imbalance:
            self.ambiguities.append(f"the frame counts do not balance ({accounting.sentence()})")
        if self.match.first_is_unconfirmed:
            self.ambiguities.append(UNCONFIRMED)
        return accounting

    def frames(self, count: int, begin: int = 0, may_lose: int = 0) -> Generator[tuple[int, Frame], None, None]:
        """Yield (place in the step, frame), in rising order.

        Parameters
        ----------
        count : int
            Places of the step.
        begin : int
            First place that is to be filled.
        may_lose : int
            Places that may stay empty where frames come by themselves.

        Raises
        ------
        FramesLost
            A frame could not be had, or a stream has more gaps than it may.
        FrameDoubt
            A frame came, and nothing tells which trigger it answers.
        CameraTimeout
            A stream has ended before its time.
        CameraLost
            The camera is gone; see `reopen`.
        MotionStopped
            The bench was stopped.
        """
        self.begin()
        places = range(begin, count)
        return single_frames(self, places) if self.software else stream(self, places, may_lose)

    def reopen(self) -> None:
        """Bring a lost camera back: close, open, configure.

        Raises
        ------
        CameraError
            It is still away.
        """
        self.end()
        self.camera.close()
        self.camera.open()
        self.match.note_reopening()
        self.set_up()

    # ---- what the two ways of taking frames ask for (exposures) --------------------------------

    def ask(self) -> None:
        """Ask the bench's stop; MotionStopped if nothing may be exposed any more."""
        if self._latch is not None:
            self._latch.check(self._token)

    def make_ready(self) -> None:
        """Arm the camera, or empty its queue."""
        self.ask()
        if self.is_armed:
            self.drain()
            return
        self.camera.arm(self.section.buffers)
        self.match.note_arming()
        self.is_armed = True

    def arm(self) -> Shot:
        """Make ready, and tell when that was, on both clocks."""
        before_ns, clock_ns = time.monotonic_ns(), self.clock_ns()
        self.make_ready()
        return Shot(clock_ns, before_ns, time.monotonic_ns())

    def clock_ns(self) -> int | None:
        """The camera's clock now; None if it cannot be read."""
        try:
            return self.camera.clock_ns()
        except CameraLost:
            raise
        except CameraError:
            return None

    def now_s(self) -> float:
        """The computer's clock [s] as a timeout sees it: without what a simulation took to draw pictures."""
        return time.monotonic() - self._drawn_s()

    def wait_until(self, deadline_s: float) -> Frame:
        """Next whole frame.

        Parameters
        ----------
        deadline_s : float
            When to give up, on `now_s`.

        Raises
        ------
        CameraTimeout
            None came by then, and the camera answers.
        BadFrame
            One came that cannot be used.
        """
        while True:
            left_s = deadline_s - self.now_s()
            frame = self.look(max(0.0, min(SLICE_S, left_s)))
            if frame is not None:
                return frame
            if left_s <= 0.0:
                break
        timeout_s = self.section.timeout_s
        self.camera.probe(probe_s(timeout_s))
        frame = self.camera.poll(0.0)  # the probe may have let a late one through
        if frame is None:
            raise CameraTimeout(f"no frame within {timeout_s:g} s; the camera answers, so look at its trigger")
        return frame

    def look(self, timeout_s: float) -> Frame | None:
        """Next whole frame within a short time, or None; BadFrame if one came that cannot be used.

        CameraLost if the camera was silent for a second and does not answer when it is asked.
        """
        self.ask()
        frame = self.camera.poll(timeout_s)
        if frame is not None or self.now_s() - self._heard_s > SILENCE_S:
            if frame is None:
                self.camera.probe(SILENT_ANSWER_S)
            self._heard_s = self.now_s()
        return frame

    def begin(self) -> None:
        """Take over the stop as it is now: what is exposed from here on ends with it."""
        self._token = self._latch.begin() if self._latch is not None else 0

    def hand_over(self, frame: Frame) -> Frame:
        """Count a frame as handed over.

        Raises
        ------
        SettingsChanged, OtherFormat
            It is not in the format that the camera was set to; it is rejected.
        """
        said = self._format.contradiction(frame)
        if said:
            self.reject(frame, True, OTHER)
            self.verify()
            raise OtherFormat(f"the camera {said}")
        self.counts.handed += 1
        return frame

    def reject(self, frame: Frame, was_asked_for: bool, why: str = "") -> None:
        """Count a frame that arrived whole and is not wanted; its memory is given back.

        Without a reason it is `LATE` if it was asked for, and `UNASKED` if not.
        """
        frame.release()
        self.why_rejected[why or (LATE if was_asked_for else UNASKED)] += 1
        self.counts.rejected += 1
        self.counts.unasked += not was_asked_for

    def drain(self) -> list[FrameMeta]:
        """Reject what has come by now; return what it was."""
        found: list[FrameMeta] = []
        while True:
            try:
                frame = self.camera.poll(0.0)
            except BadFrame:  # counted by the camera
                continue
            if frame is None:
                return found
            found.append(frame.meta)
            answers_pending_trigger = self.match.answers_pending_trigger(frame.meta)
            self.reject(frame, answers_pending_trigger)
            if not answers_pending_trigger and (said := self.match.came_unasked(frame.meta)):
                self.raise_ambiguity(said)

    def raise_ambiguity(self, said: str) -> NoReturn:
        """End everything: some frame may not show what it is filed under.

        Raises
        ------
        FrameDoubt
            Always.
        """
        self.ambiguities.append(said)
        self._report_ambiguity(said)
        raise FrameDoubt(f"{said}; look at link and trigger, raise timeout_s, and begin a new run")


def _last_counters(camera: Camera) -> Counters:
    try:
        return camera.counters
    except CameraError:
        return Counters()


EXPOSURES_US = ("ExposureTime", "ExposureTimeAbs")
READOUTS_US = ("SensorReadoutTime",)
RATES_HZ = ("ResultingFrameRate", "AcquisitionResultingFrameRate", "ResultingFrameRateAbs")
ASKED_HZ = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")


def check_frame_timeout(timeout_s: float, settings: Mapping[str, Setting]) -> None:
    """Refuse a timeout that no frame can meet.

    Parameters
    ----------
    timeout_s : float
        How long a frame is waited for.
    settings : mapping
        What the camera read back when it was set up.

    Raises
    ------
    RunUsageError
        It is too short; says how long it has to be.
    """
    parts = dict(_parts_s(settings))
    frame_s = sum(parts.values())
    least_s = max(frame_s, _period_s(settings, RATES_HZ))
    if least_s > frame_s:
        parts = {"one frame at the camera's rate": least_s}
    runs_by_itself = settings.get("TriggerMode", "Off") == "Off" and not trigger_is_software(settings)
    if runs_by_itself and settings.get("AcquisitionFrameRateEnable", True) is True:
        between_s = _period_s(settings, ASKED_HZ)
        if between_s:
            parts["time between frames"] = between_s
    needed_s = sum(parts.values())
    if timeout_s < needed_s:
        terms = " + ".join(f"{what} {part_s:.3g} s" for what, part_s in parts.items())
        raise RunUsageError(
            f"timeout_s = {timeout_s:g} is shorter than a frame takes ({terms}); set timeout_s of the camera to "
            f"more than {math.ceil(1e3 * needed_s) / 1e3:g}"
        )


def _parts_s(settings: Mapping[str, Setting]) -> Iterator[tuple[str, float]]:
    for what, names in (("exposure", EXPOSURES_US), ("readout", READOUTS_US)):
        microseconds = first_of(settings, names)
        if microseconds:
            yield what, microseconds * 1e-6
    payload_bytes, bytes_s = first_of(settings, ("PayloadSize",)), link_speed_bytes_s(settings)
    if payload_bytes and bytes_s:
        yield "transfer", payload_bytes / bytes_s


def _period_s(settings: Mapping[str, Setting], names: tuple[str, ...]) -> float:
    rate_hz = first_of(settings, names)
    return 1.0 / rate_hz if rate_hz else 0.0
