"""Frames for a step, and the books about them.

Two ways of triggering, told apart by the camera's settings:

* **software**: one trigger, one frame, nothing in between.  A frame that does not arrive whole is taken again,
  a few times; before that the camera is disarmed, so that a late frame can never be taken for the next one.
* **stream**: the camera (or an outer clock) decides; it is armed for the step only, and frames keep the place
  that their id gives them.  A gap cannot be filled: the step has failed, and the error says why.
"""

from collections.abc import Iterator

from daq.bench.bench_file import CameraSection, trigger_is_software
from daq.cameras.camera import Camera, Counters, Setting
from daq.cameras.frame import Frame
from daq.errors import CameraError, CameraLost, CameraTimeout, FrameError, FramesLost, SettingsChanged
from daq.runs.conservation import Bookkeeper, Ledger

SURPLUS_S = 0.001


class Exposures:
    """The camera of a run.

    Parameters
    ----------
    camera : Camera
        Open.
    section : CameraSection
        Settings, patience, retakes.
    """

    def __init__(self, camera: Camera, section: CameraSection) -> None:
        self.camera = camera
        self.section = section
        self.software = trigger_is_software(section.settings)
        self.ledger = Ledger()  # of every arm that has ended
        self.discarded = 0  # frames that were written and are not wanted after all
        self._books: Bookkeeper | None = None

    def books(self, written: int) -> Ledger:
        """Books of the arms that have ended.

        Parameters
        ----------
        written : int
            Frames of this session that are on the disk; what was handed over and is not there counts as lost.
        """
        unwritten = self.ledger.written - written
        discarded = self.discarded
        return self.ledger + Ledger(written=-unwritten - discarded, unwritten=unwritten, rejected=discarded)

    def books_so_far(self, written: int) -> Ledger:
        """Books in the middle of an arm, without asking the camera; frames under way are not counted yet."""
        ledger, books = self.ledger, self._books
        if books is not None:
            ledger += Ledger(
                triggered=books.handed + books.rejected, rejected=books.rejected, written=books.handed
            )
        under_way = ledger.written - written
        discarded = self.discarded
        return ledger + Ledger(triggered=-under_way, written=-under_way - discarded, rejected=discarded)

    def set_up(self) -> dict[str, Setting]:
        """Configure the camera; return everything it can tell about its settings."""
        self.camera.configure(self.section.settings)
        return self.camera.settings()

    def frames(self, count: int) -> Iterator[tuple[int, Frame]]:
        """Yield (place in the step, frame) until a step is complete.

        Raises
        ------
        FramesLost
            A frame could not be had, or a stream has a gap.
        CameraLost
            The camera is gone; see `reopen`.
        """
        if self._books is None:
            self._arm()
        if self.software:
            for place in range(count):
                yield place, self._one()
            return
        yield from self._stream(count)

    def verify(self) -> None:
        """Make sure that the camera still has its settings.

        Raises
        ------
        SettingsChanged, CameraLost
            It has not, or does not answer; frames since the last check are in doubt.
        """
        try:
            self.camera.verify()
        except (SettingsChanged, CameraLost):
            if self._books is not None:
                self._books.in_doubt = True
            raise

    def end(self) -> None:
        """Disarm and close the books of this arm.  Harmless when repeated."""
        if self._books is not None:
            books, self._books = self._books, None
            try:
                counters = self.camera.disarm()
            except CameraError:  # gone; what it counted before is all that will ever be known
                counters = _last_counters(self.camera)
            self.ledger += books.close(counters)

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
        self.set_up()

    def _arm(self) -> None:
        self.camera.arm(self.section.buffers)
        self._books = Bookkeeper(self.software)

    def _one(self) -> Frame:
        """Trigger until a whole frame comes."""
        why: CameraError | None = None
        for _ in range(self.section.retakes + 1):
            if self._books is None:
                self._arm()
            assert self._books is not None
            self._books.triggers += 1
            try:
                self.camera.trigger()
                frame = self.camera.next_frame(self.section.timeout_s)
                self._books.handed += 1
                return frame
            except CameraTimeout as error:
                self._books.timeouts += 1
                why = error
            except FrameError as error:
                why = error
            except CameraError:
                self._books.timeouts += 1  # the frame that was under way
                self._books.in_doubt = True
                raise
            self.verify()
            self.end()
        raise FramesLost(
            f"no whole frame after {self.section.retakes + 1} triggers ({why}); look at link and trigger"
        )

    def _stream(self, count: int) -> Iterator[tuple[int, Frame]]:
        assert self._books is not None
        arrived = 0
        try:
            while True:
                try:
                    frame = self.camera.next_frame(self.section.timeout_s)
                except CameraTimeout as error:
                    self._books.timeouts += 1
                    raise FramesLost(f"the stream ended after {arrived} of {count} frames ({error})") from error
                if frame.meta.sequence >= count:
                    frame.release()
                    self._books.rejected += 1
                    break
                arrived += 1
                self._books.handed += 1
                yield frame.meta.sequence, frame
                if frame.meta.sequence == count - 1:
                    break
            self._reject_surplus()
        finally:
            before = self.ledger
            self.end()
        if arrived < count:
            raise FramesLost(f"{count - arrived} of {count} frames are gone: {_where(before, self.ledger)}")

    def _reject_surplus(self) -> None:
        """Frames that came while the last one was taken are not wanted; count them as such."""
        assert self._books is not None
        while True:
            try:
                self.camera.next_frame(SURPLUS_S).release()
            except CameraTimeout:
                return
            self._books.rejected += 1


def _last_counters(camera: Camera) -> Counters:
    try:
        return camera.counters
    except CameraError:
        return Counters()


def _where(before: Ledger, after: Ledger) -> str:
    causes = (
        ("no buffer was free (disk or computer too slow)", after.underrun - before.underrun),
        ("incomplete (link)", after.incomplete - before.incomplete),
        ("never arrived (link)", after.missing - before.missing),
    )
    return ", ".join(f"{number} {cause}" for cause, number in causes if number) or "the camera does not tell why"
