"""Threads from camera to disk: raw ones write every frame or end the run; the live one may fall behind.

    next_frame -> submit --> raw thread:  checksum, TIFF, fsync, rename, journal
                        `-> live thread: correct  -> store thread: corrected TIFF
                                               `-> vectors of the last pair (`preview_vectors`)
                               `-> viewers (`PreviewThread`)

A frame stays in the camera's shared memory until both threads are through with it; it is never copied.

* The raw thread comes first: it has two writers, so that one computes while the other waits for the disk; the
  others run at a lower priority, and a frame that arrives while raw frames queue up is not corrected live.
* The raw queue is bounded, below the number of the camera's buffers.  When the disk is slower than the camera,
  `submit` waits: a software-triggered run slows down.  A stream cannot wait: the camera runs out of buffers,
  counts that, and the run ends with that reason.  A disk that does not move for
  `DISK_TIMEOUT_S` ends the run as well.
* The live queue leaves its OLDEST frames out when new ones come, a pair as a whole (`live_queue`): what is shown
  is recent, and what was skipped is counted.  Skipped frames are corrected from the disk when the run is over.

Latency is taken from the moment the frame was complete (`received_ns`) to the moment its corrected pixels exist.

The last frame is shown to viewers by a thread of low priority, for which no other thread waits.  One frame
lies in a tray until the thread takes it; a newer one takes its place. So at most two buffers of the camera are
held for it, the one in the tray and the one that is being shown. What goes wrong in showing is said once and ends
the showing: the run goes on.
"""

import math
import queue
import threading
import time
import warnings
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.errors import DaqError, DiskError
from daq.pipeline.corrections import Corrections
from daq.pipeline.job import Job, SharedJob, Show
from daq.pipeline.live_queue import LiveQueue
from daq.pipeline.preview_vectors import PreviewVectors
from daq.pipeline.priority import lower_priority
from daq.pipeline.stats import PipelineStats
from daq.runs.journal import Journal
from daq.runs.raw_frame import checksum, write_raw
from daq.runs.run_folder import RunFolder
from ground.errors import RtpivWarning

SHOWN_WITHIN_S = 10.0


class PreviewThread:
    """Shows the last frame.

    Parameters
    ----------
    show : callable
        Called with a frame and its correction, or None instead of it.
    """

    def __init__(self, show: Show) -> None:
        self._show_to = show
        self._tray: tuple[SharedJob, NDArray[np.float32] | None] | None = None
        self._wake = threading.Condition()
        self._ends = False
        self._thread = threading.Thread(target=self._work, name="preview thread", daemon=True)
        self._thread.start()

    def offer(self, shared: SharedJob, corrected: NDArray[np.float32] | None) -> None:
        """Lay a frame into the tray; its correction must not be written to any more."""
        with self._wake:
            if self._ends:
                return
            shared.hold()
            older, self._tray = self._tray, (shared, corrected)
            self._wake.notify()
        if older is not None:
            older[0].let_go()

    def close(self) -> None:
        """End; what lies in the tray is still shown."""
        with self._wake:
            self._ends = True
            self._wake.notify()
        self._thread.join(SHOWN_WITHIN_S)

    def _work(self) -> None:
        lower_priority(2)
        try:
            while (taken := self._take()) is not None:
                shared, corrected = taken
                try:
                    self._show_to(shared.job, corrected)
                finally:
                    shared.let_go()
                del taken, shared, corrected  # memory that is large
        except Exception as error:
            with self._wake:
                self._ends, left, self._tray = True, self._tray, None
            if left is not None:
                left[0].let_go()
            warnings.warn(f"the live page shows nothing any more: {error!r}", RtpivWarning, stacklevel=1)

    def _take(self) -> tuple[SharedJob, NDArray[np.float32] | None] | None:
        """Wait for the contents of the tray; None at the end."""
        with self._wake:
            while self._tray is None and not self._ends:
                self._wake.wait()
            taken, self._tray = self._tray, None
            return taken


DISK_TIMEOUT_S = 30.0
RAW_QUEUE = 8
RAW_WRITERS = 2
RAW_FIRST = 2  # raw frames waiting from which on the live thread gets nothing
LIVE_QUEUE = 4
STORE_QUEUE = 4


class Pipeline:
    """The threads of one session.

    Parameters
    ----------
    folder : RunFolder
        Where everything goes.
    journal : Journal
        Gets a line for each frame that is on the disk.
    corrections : Corrections, optional
        None to write raw frames only.
    live_queue : int
        Frames that may wait for the live thread, a whole group always; 1 for the lowest latency, more to ride out
        bursts.
    raw_queue : int
        Frames that may wait to be written: it bridges moments in which the disk is busy.
    show : callable, optional
        Called with the last frame and its correction, or with None instead of it when the frame is on the disk and
        is not to be corrected; by a thread that may miss frames.
    """

    def __init__(
        self,
        folder: RunFolder,
        journal: Journal,
        corrections: Corrections | None,
        live_queue: int = LIVE_QUEUE,
        raw_queue: int = RAW_QUEUE,
        show: Show | None = None,
    ) -> None:
        self.stats = PipelineStats()
        self._folder = folder
        self._journal = journal
        self._corrections = corrections
        self._preview = None if show is None else PreviewThread(show)
        self._raw: queue.Queue[SharedJob | None] = queue.Queue(raw_queue)
        self._store: queue.Queue[tuple[Job, NDArray[np.float32]] | None] = queue.Queue(STORE_QUEUE)
        self._live: LiveQueue[SharedJob] = LiveQueue(live_queue)
        self._error: DaqError | None = None
        self._bug: Exception | None = None
        self._flow_lock = threading.Lock()
        self._pairs = PreviewVectors(self.stats) if corrections is not None else None
        loops = [("raw", self._write_raw_frames)] * RAW_WRITERS
        if corrections is not None:
            loops += [("live", self._correct_frames), ("store", self._store_corrected)]
        self._threads = [
            threading.Thread(target=self._run_guarded, args=(loop,), name=f"{name} thread", daemon=True)
            for name, loop in loops
        ]
        for thread in self._threads:
            thread.start()

    @property
    def waiting(self) -> tuple[int, int]:
        """Frames waiting in the raw and in the live queue."""
        return self._raw.qsize(), len(self._live)

    def submit(self, job: Job) -> None:
        """Hand a frame over; waits while the raw queue is full.

        Raises
        ------
        DiskError
            The raw thread has failed, or has not moved for `DISK_TIMEOUT_S`.
        """
        is_live = self._is_live(job)
        shared = SharedJob(job, 2 if is_live else 1)
        begun_s = time.monotonic()
        try:
            self._put(shared, begun_s)
        except BaseException:
            job.frame.release()
            raise
        self.stats.submit_wait_s += time.monotonic() - begun_s
        self.stats.submitted += 1
        self.stats.raw_waiting_most = max(self.stats.raw_waiting_most, self._raw.qsize())
        if is_live:
            self._show(shared)

    def flush(self) -> None:
        """Wait until every frame that was handed over is on the disk; DiskError if one cannot be."""
        moved, since_s = -1, time.monotonic()
        while self.stats.written < self.stats.submitted:
            self._raise()
            if self.stats.written != moved:
                moved, since_s = self.stats.written, time.monotonic()
            if time.monotonic() - since_s > DISK_TIMEOUT_S:
                raise DiskError(
                    f"no frame was written for {DISK_TIMEOUT_S:g} s; free or repair the disk, then resume"
                )
            time.sleep(0.001)
        self._raise()

    def close(self) -> None:
        """End the threads; frames that wait are still written and corrected, unless the disk hangs."""
        if self._error is not None or self._bug is not None:
            self._let_all_go()
        with suppress(queue.Full):
            for _ in range(RAW_WRITERS):
                self._raw.put(None, timeout=DISK_TIMEOUT_S)
        self._live.end()
        for thread in self._threads:
            thread.join(DISK_TIMEOUT_S)
        if self._pairs is not None:
            self._pairs.close()
        if self._preview is not None:
            self._preview.close()
        self._let_all_go()

    def _is_live(self, job: Job) -> bool:
        return self._corrections is not None and self._corrections.of(job.step) is not None

    def _put(self, shared: SharedJob, begun_s: float) -> None:
        while True:
            self._raise()
            try:
                self._raw.put(shared, timeout=0.1)
                return
            except queue.Full:
                if time.monotonic() - begun_s > DISK_TIMEOUT_S:
                    text = f"no frame was written for {DISK_TIMEOUT_S:g} s; free or repair the disk, then resume"
                    raise DiskError(text) from None

    def _show(self, shared: SharedJob) -> None:
        step, number = shared.job.step, shared.job.number
        first = number - (number - step.first_frame) % step.group
        has_room = self._raw.qsize() <= RAW_FIRST
        for dropped in self._live.put(shared, (step.index, first), step.group, has_room):
            self.stats.skipped.append(dropped.job.number)
            dropped.let_go()

    def _raise(self) -> None:
        if self._bug is not None:
            raise self._bug
        if self._error is not None:
            raise self._error

    def _run_guarded(self, loop: Any) -> None:  # noqa: ANN401
        try:
            loop()
        except DaqError as error:
            self._error = self._error or error
        except Exception as error:  # shown by the thread that runs the run, not by this one
            self._bug = self._bug or error

    def _let_all_go(self) -> None:
        """Give the memory of frames back that will not be written."""
        while True:
            try:
                shared = self._raw.get_nowait()
            except queue.Empty:
                return
            if shared is not None:
                shared.let_go()

    def _write_raw_frames(self) -> None:
        while (shared := self._raw.get()) is not None:
            try:
                self._write(shared.job)
                if self._preview is not None and not self._is_live(shared.job):
                    self._preview.offer(shared, None)
            finally:
                shared.let_go()

    def _write(self, job: Job) -> None:
        begun_s = time.perf_counter()
        frame, path = job.frame, self._folder.frame_path(job.number)
        meta = frame.meta
        facts = {
            "step": job.step.index,
            "tag": job.step.tag,
            "crc32": checksum(frame.pixels),
            "frame_id": meta.frame_id,
            "sequence": meta.sequence,
            "timestamp_ns": meta.timestamp_ns,
            "received_ns": meta.received_ns,
            "exposure_us": meta.exposure_us if math.isfinite(meta.exposure_us) else None,
            "bits": meta.significant_bits,
            "sensor_px": list(frame.pixels.shape[::-1]),
            **job.record,
        }
        write_raw(path, frame.pixels, facts)
        self._journal.append("frame", frame=job.number, file=f"frames/{path.name}", **facts)
        with self._flow_lock:
            self.stats.raw_latency_ms.append((time.monotonic_ns() - meta.received_ns) / 1e6)
            self.stats.write_s += time.perf_counter() - begun_s
            self.stats.written_bytes += frame.pixels.nbytes
            self.stats.written += 1

    def _correct_frames(self) -> None:
        assert self._corrections is not None
        lower_priority()
        try:
            while (shared := self._live.take()) is not None:
                self._correct(shared)
        finally:
            self._store.put(None)

    def _correct(self, shared: SharedJob) -> None:
        assert self._corrections is not None
        job = shared.job
        begun_s = time.perf_counter()
        try:
            corrector = self._corrections.of(job.step)
            assert corrector is not None
            corrected = corrector(job.frame.pixels)
            self.stats.latency_ms.append((time.monotonic_ns() - job.frame.meta.received_ns) / 1e6)
            self.stats.correct_s += time.perf_counter() - begun_s
            self.stats.corrected += 1
            if self._preview is not None:
                self._preview.offer(shared, corrected)
        finally:
            shared.let_go()
        if self._pairs is not None:
            self._pairs.see(job.step, job.number, corrected, job.frame.meta.received_ns)
        self._store.put((job, corrected))

    def _store_corrected(self) -> None:
        assert self._corrections is not None
        lower_priority()
        failed = False
        while (item := self._store.get()) is not None:
            if failed:
                continue  # keep the live thread from waiting for a thread that has died
            job, corrected = item
            try:
                name = self._folder.frame_path(job.number).name
                self._corrections.write(self._folder.correction_path(job.number), corrected, job.step, name)
            except DiskError as error:
                self._error, failed = self._error or error, True
