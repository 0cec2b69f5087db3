"""Assignment of frames to triggers by the camera's clock, never by the order of arrival.

A frame that is later than our timeout arrives in the place of another.  Taken for the answer to the next trigger
it would show the stop before, and so would every frame after it.  So a frame is taken only if it was exposed
between its trigger and its arrival, and everything else is rejected, counted, and waited past.

**Latch.**  The camera's clock is read right before each trigger.  A frame is ours if its stamp lies between that
reading and the reading plus the host's time until the frame was there.  Nothing about the two clocks has to be
known but that they tick alike (DRIFT), and a stamp may be rounded (COARSE_NS, FINE_NS).

**Offset.**  A camera whose clock cannot be read: a frame that was taken says that its exposure lay between its
trigger and its arrival, so host minus camera lies in the interval [trigger - stamp, arrival - stamp].  The
intervals of all frames that were taken must have a point in common (each widened by DRIFT since).  A frame is
stale if its exposure, at the latest, was before its trigger; or, at the earliest, more than half our timeout
before it.  The first finds frames older than the quickest frame took to arrive; the second those that were left
behind by a timeout, however slow frames are, for such a one is older than the whole of our timeout.

**ClockCalibration.**  What is left to be settled: a first frame whose stamp contradicts the latch (another clock,
other units, or really stale), a first frame after a timeout, a stamp that contradicts those before it.  A few
triggers with unequal pauses tell (see clock_calibration).  It costs nothing while nothing is odd.  If it shows
that the first frame was exposed before its trigger, the run ends; but of frames that have agreed with each
other for a few times our timeout it is believed that the camera's clock was set anew.  What no offset can show is
a session whose every frame is late by the same time, the first one's trigger having been an earlier process's; a
latch shows it.

**Ids.**  A camera without time stamps, or whose stamps follow no clock (one that has to be settled again and again
is none): without a timeout, one trigger is one frame.  After one, a frame is ours if its id has moved as often as
triggers were sent, and ids were seen to count by ones.  A camera that tells neither has nothing to go by after a
timeout: the frame is ambiguous.
"""

from dataclasses import dataclass
from enum import Enum

from daq.cameras.frame import FrameMeta
from daq.runner.clock_calibration import DRIFT, ClockCalibration, Shot

# Times our timeout; over that even stamps in another unit would have contradicted each other
CONFIRMED = 3.0
MAX_CLOCK_TRIALS = 3  # after which a clock is none that has not agreed with us for a while
AGREED_NS = 60_000_000_000
UNCONFIRMED = "nothing has confirmed that the first frame was exposed for its trigger"
RESTART_NS = 50_000_000  # by which a camera's clock has to go wrong to be called restarted


@dataclass(frozen=True, slots=True)
class Offset:
    """Host's clock minus the camera's: an interval [ns] that held at a time of the host."""

    low_ns: float
    high_ns: float
    at_ns: int

    def until(self, now_ns: int) -> "Offset":
        """The interval at another time, wider by what the clocks may have drifted."""
        drift_ns = DRIFT * abs(now_ns - self.at_ns)
        return Offset(self.low_ns - drift_ns, self.high_ns + drift_ns, now_ns)

    def intersection_with(self, other: "Offset") -> "Offset":
        """Intersection of both, at the time of the other; empty (low above high) if they contradict each other."""
        mine = self.until(other.at_ns)
        return Offset(max(mine.low_ns, other.low_ns), min(mine.high_ns, other.high_ns), other.at_ns)


class Place(Enum):
    """Assignment of a frame."""

    OURS = "exposed for this trigger"
    STALE = "exposed before this trigger"
    UNKNOWN = "nothing tells"


class TriggerMatch:
    """Follows the triggers and frames of one session.

    Parameters
    ----------
    timeout_ns : float
        How long a frame is waited for.
    """

    def __init__(self, timeout_ns: float) -> None:
        self._timeout_ns = timeout_ns
        self._first: Shot | None = None
        self._shot: Shot | None = None
        self._before: Shot | None = None
        self._latch_is_the_stamps: bool | None = None  # None: not shown yet
        self._offset: Offset | None = None
        self._ns_per_unit = 1.0
        self._is_confirmed = False  # frames taken over a while agree with each other
        self._unanswered = 0  # triggers that were waited for in vain, and whose frames have not come since
        self.waits = False  # the last trigger has had no answer yet, of whatever kind
        # something came, or did not, that leaves a first frame unconfirmed
        self._is_odd = self._was_odd = False
        self._stale_here = 0  # since the last trigger
        self._only_stale = 0  # windows in a row that brought nothing else
        self._shots = 0
        self._first_taken: tuple[FrameMeta, Shot] | None = None
        self._last_taken: FrameMeta | None = None  # of this arm
        self._id_taken: tuple[int, int] | None = None  # of this arm's last frame: sequence, number of triggers
        self._ids_count_by_ones = False
        self.by_time = True  # frames are identified by their time, until one tells none
        self._is_clock = True  # what the stamps follow, until trials show the contrary
        self._trials, self._last_trial_ns = 0, 0

    @property
    def has_taken(self) -> bool:
        """True if any frame of this session was taken."""
        return self._first_taken is not None

    @property
    def owes_one_frame(self) -> bool:
        """True if what arrives now incomplete can only be the frame of the last trigger."""
        return self._unanswered == 0

    @property
    def needs_trial(self) -> bool:
        """True if, after a wait in vain, stamps have to be settled before anything is triggered again."""
        if not self.by_time or self._latch_is_the_stamps:
            return False
        return self._only_stale > (1 if self._is_confirmed else 0) or (self.has_taken and not self._is_confirmed)

    @property
    def first_is_unconfirmed(self) -> bool:
        """True if something odd has come before enough frames could agree with the first one."""
        is_sure = self._latch_is_the_stamps or self._is_confirmed or not self.by_time
        return self.has_taken and self._is_odd and not is_sure

    @property
    def has_restarted(self) -> bool:
        """True if the camera's clock has not run on between the last two triggers: it lost power, or was set."""
        now, then = self._shot, self._before
        if not self._latch_is_the_stamps or now is None or then is None:
            return False
        if now.clock_ns is None or then.clock_ns is None:
            return False
        host_ns, camera_ns = now.before_ns - then.before_ns, now.clock_ns - then.clock_ns
        calls_ns = (now.after_ns - now.before_ns) + (then.after_ns - then.before_ns)
        return abs(camera_ns - host_ns) > calls_ns + DRIFT * host_ns + RESTART_NS

    def begin(self) -> None:
        """Note that a trigger is about to be sent."""
        self._shots += 1
        self.waits = True
        self._stale_here = 0

    def note_trigger(self, shot: Shot) -> None:
        """Note the trigger that was sent; frames are judged against it from now on."""
        self._before, self._shot = self._shot, shot
        if self._before is not None and shot.clock_ns is not None and shot.clock_ns == self._before.clock_ns:
            self._latch_is_the_stamps = False  # it stands
        self._first = self._first or shot

    def note_arming(self) -> None:
        """Note that the acquisition was started anew: ids may count from anywhere."""
        self._last_taken, self._id_taken, self._ids_count_by_ones = None, None, False

    def gave_up(self) -> None:
        """Note that the last trigger was waited for in vain; its frame may come later."""
        self._unanswered += 1
        self.waits = False
        self._note_odd()
        self._only_stale = self._only_stale + 1 if self._stale_here else 0

    def answers_pending_trigger(self, meta: FrameMeta) -> bool:
        """True if a frame that is rejected may be owed to a trigger that was waited for; call it once a frame."""
        return not self._is_foreign(meta) and self._settle_pending(1) > 0

    def not_owed(self, frames: int) -> int:
        """Number of frames, of those that were not examined, that answer no trigger of ours."""
        return frames - self._settle_pending(frames)

    def note_reopening(self) -> None:
        """Note that the camera was closed and opened: one that tells no time has nothing under way any more."""
        if not self.by_time:
            self._unanswered = 0

    def came_unasked(self, meta: FrameMeta) -> str:
        """Note a frame too many, between two triggers; return what is ambiguous by that, or ""."""
        self._note_odd()  # two frames for one trigger: was the first one its own?
        if self._has_time(meta) or not self.has_taken:
            return ""
        return "a frame came that no trigger asked for, and nothing tells which one it was"

    def came_incomplete(self) -> None:
        """Note that a frame came with pixels missing; as long as nothing is confirmed it was perhaps another's."""
        self.waits = False
        self._note_odd()

    def came_unusable(self) -> None:
        """Note that a frame came that the camera's library could not read; it answers the last trigger."""
        if self.waits:
            self._unanswered += 1
        self.waits = False
        self._note_odd()

    def place(self, meta: FrameMeta) -> Place:
        """Judge a whole frame; one that is OURS is taken to be handed over."""
        assert self._shot is not None
        self.by_time = self._has_time(meta)
        place = self._by_time(meta, self._shot) if self.by_time else self._by_id(meta)
        if place is Place.OURS:
            self._take(meta, self._shot)
            self._unanswered, self.waits = 0, False  # frames keep their order
        self._stale_here += place is Place.STALE
        return place

    def is_of_arm(self, meta: FrameMeta, arm: Shot) -> bool:
        """Return whether a frame of a stream was exposed after its arming; True where nothing tells.

        A clock that calls every frame stale for longer than we are patient is not the clock of the stamps.
        """
        is_early = meta.received_ns - arm.before_ns < self._timeout_ns
        if not self._has_time(meta):
            return True
        if arm.clock_ns is not None and self._latch_is_the_stamps is not False:
            if arm.could_have_made(meta.timestamp_ns, meta.received_ns):
                self._latch_is_the_stamps = True
            is_older = arm.is_after(meta.timestamp_ns)
            if self._latch_is_the_stamps or (is_older and is_early):
                return not is_older
            self._latch_is_the_stamps = False
        if is_early and self._is_before(meta, arm.before_ns):
            return False
        self._take(meta, arm)
        return True

    def note_failed_trial(self) -> None:
        """Note that a trial was disturbed: what was unconfirmed before it stays so."""
        self._note_odd()

    def learn(self, trial: ClockCalibration | None) -> str:
        """Take over what a trial has shown; return what is ambiguous now, or "".

        Parameters
        ----------
        trial : ClockCalibration or None
            None if every trigger had its frame, time and again, and no clock explains their stamps.
        """
        self._only_stale = 0
        self._is_odd = False
        self._trials += 1
        if trial is None or self._trials > MAX_CLOCK_TRIALS:
            self._is_clock = self.by_time = False
            self._unanswered = 0
            return UNCONFIRMED if self._was_odd and self.has_taken else ""
        self._last_trial_ns = trial.pairs[-1][2]
        agrees = [shot.could_have_made(stamp_ns, received_ns) for shot, stamp_ns, received_ns in trial.pairs]
        self._latch_is_the_stamps = all(agrees) and trial.ns_per_unit == 1.0
        other_unit, self._ns_per_unit = trial.ns_per_unit != self._ns_per_unit, trial.ns_per_unit
        was_confirmed, self._is_confirmed = self._is_confirmed and not other_unit, True
        self._offset = Offset(trial.low_ns, trial.high_ns, trial.pairs[-1][2])
        if self._first_taken is not None and not was_confirmed:
            meta, shot = self._first_taken
            if self._is_before(meta, shot.before_ns):
                return "the first frame of the session was exposed before its trigger"
        return ""

    # ---- by what -------------------------------------------------------------------------------

    def _by_time(self, meta: FrameMeta, shot: Shot) -> Place:
        # The latch of this very trigger says most; the offset of earlier frames only where there is no latch.
        if shot.clock_ns is not None and self._latch_is_the_stamps is not False:
            if shot.could_have_made(meta.timestamp_ns, meta.received_ns):
                self._latch_is_the_stamps = True
                return Place.OURS
            # a stamp above the latched clock was made before that clock was set back: as stale as one below it
            is_older = meta.timestamp_ns < shot.clock_ns
            return Place.STALE if self._latch_is_the_stamps or is_older else Place.UNKNOWN
        if self._is_odd and not self._is_confirmed:
            return Place.UNKNOWN
        if self._offset is None:
            return Place.OURS
        if self._went_back(meta):
            return Place.UNKNOWN
        if self._is_before(meta, shot.before_ns):
            return Place.STALE
        both = self._offset.intersection_with(self._interval(meta, shot))
        return Place.OURS if both.low_ns <= both.high_ns else Place.UNKNOWN

    def _went_back(self, meta: FrameMeta) -> bool:
        """Return whether the clock that identifies frames has gone back between two of them."""
        if self._last_taken is None or not meta.id_told:
            return False
        return meta.sequence > self._last_taken.sequence and meta.timestamp_ns < self._last_taken.timestamp_ns

    def _by_id(self, meta: FrameMeta) -> Place:
        if not self._unanswered:
            return Place.OURS
        if not meta.id_told or self._id_taken is None or not self._ids_count_by_ones:
            return Place.UNKNOWN
        sequence, shots = self._id_taken
        ahead = meta.sequence - sequence - (self._shots - shots)
        if ahead == 0:  # every trigger since has made its frame, and this is the last one's
            return Place.OURS
        return Place.STALE if ahead < 0 else Place.UNKNOWN

    def _note_odd(self) -> None:
        self._is_odd = self._was_odd = True

    def _settle_pending(self, frames: int) -> int:
        """Take some frames off what triggers of ours are owed; return how many of them may have been owed."""
        if not (self._latch_is_the_stamps or self._is_confirmed):
            return frames
        owed = min(frames, self._unanswered)
        self._unanswered -= owed
        return owed

    def _is_foreign(self, meta: FrameMeta) -> bool:
        """Return whether a frame was exposed before the first trigger of this session."""
        first = self._first
        if first is None:
            return True
        if self._latch_is_the_stamps and first.clock_ns is not None:
            return first.is_after(meta.timestamp_ns)
        return self._is_before(meta, first.before_ns)

    def _take(self, meta: FrameMeta, shot: Shot) -> None:
        self._first_taken, self._last_taken = self._first_taken or (meta, shot), meta
        self._is_confirmed |= meta.received_ns - self._first_taken[0].received_ns > CONFIRMED * self._timeout_ns
        self._only_stale = 0
        if self._id_taken is not None:
            sequence, shots = self._id_taken
            self._ids_count_by_ones |= meta.sequence - sequence == self._shots - shots
        self._id_taken = (meta.sequence, self._shots)
        if self._has_time(meta):
            if meta.received_ns - self._last_trial_ns > AGREED_NS:
                self._trials = 0
            mine = self._interval(meta, shot)
            both = mine if self._offset is None else self._offset.intersection_with(mine)
            self._offset = both if both.low_ns <= both.high_ns else mine

    def _has_time(self, meta: FrameMeta) -> bool:
        return self._is_clock and meta.timestamp_ns != 0

    def _interval(self, meta: FrameMeta, shot: Shot) -> Offset:
        stamp_ns = meta.timestamp_ns * self._ns_per_unit
        return Offset(shot.before_ns - stamp_ns, meta.received_ns - stamp_ns, meta.received_ns)

    def _is_before(self, meta: FrameMeta, moment_ns: int) -> bool:
        """Return whether a stamp lies before a moment of the host, by what is known of the offset."""
        if self._offset is None or not self._has_time(meta):
            return False
        stamp_ns, offset = meta.timestamp_ns * self._ns_per_unit, self._offset.until(meta.received_ns)
        is_surely = stamp_ns + offset.high_ns < moment_ns
        return is_surely or stamp_ns + offset.low_ns < moment_ns - self._timeout_ns / 2
