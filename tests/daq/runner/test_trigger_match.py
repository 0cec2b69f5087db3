"""Whatever a camera does, no frame is filed under a trigger it does not show, or the books say that one may be.

Sessions are played in a time of their own (scripted_camera), so that hypothesis can try thousands of them.
"""

from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daq.bench.bench_table import CameraSection
from daq.cameras.frame import Frame, FrameMeta
from daq.errors import CameraLost, FrameDoubt, FramesLost, SettingsChanged
from daq.runner import camera_session as session_module
from daq.runner import exposures as exposures_module
from daq.runner.camera_session import CameraSession
from daq.runner.clock_calibration import Shot
from daq.runner.trigger_match import Place, TriggerMatch
from stages.errors import MotionStopped
from stages.stop_latch import StopLatch
from tests.daq.runner.scripted_camera import FakeTime, Script, ScriptedCamera

TIMEOUT_S = 0.3
SECTION = CameraSection(
    backend="any", settings={"TriggerMode": "On", "TriggerSource": "Software"}, timeout_s=TIMEOUT_S
)
STOPS = 8


class Session:
    """What the runner does with the camera, without stage and disk."""

    def __init__(self, time, script, frames_per_stop, stops=STOPS, pause_ms=0):
        self.time, self.camera = time, ScriptedCamera(script, time)
        self.filed = []  # (stop, trigger that the frame shows)
        self.exposures = CameraSession(self.camera, SECTION)
        self.exposures.set_up()
        self.discarded = 0
        self.why = "finished"
        try:
            for stop in range(stops):
                self.camera.stop = stop
                self._stop(stop, frames_per_stop)
                self.time.sleep(pause_ms * 1e-3)
        except (CameraLost, SettingsChanged, FramesLost, FrameDoubt) as error:
            self.why = error
        self.books = self.exposures.conclude(len(self.filed) + self.discarded)

    def _stop(self, stop, count):
        for attempt in range(3):
            taken = []
            try:
                for _, frame in self.exposures.frames(count):
                    taken.append((stop, int(frame.pixels[0, 0])))
                    frame.release()
                self.exposures.verify()
                self.filed += taken
                return
            except (CameraLost, SettingsChanged):
                self.discarded += len(taken)
                self.exposures.discarded += len(taken)
                if attempt == 2:
                    raise
                self.exposures.reopen()
            except (FramesLost, FrameDoubt):
                self.filed += taken
                raise

    @property
    def misfiled(self):
        sent = self.camera.sent
        return [(stop, shown) for stop, shown in self.filed if shown >= len(sent) or sent[shown] != stop]

    @property
    def is_in_doubt(self):
        return bool(self.exposures.ambiguities)


@pytest.fixture
def play(monkeypatch):
    """Play a session in a time of its own; one session begins where the one before has ended."""
    time = FakeTime()
    for module in (session_module, exposures_module):
        monkeypatch.setattr(module, "time", time)
    return lambda script, frames_per_stop=1, **options: Session(time, script, frames_per_stop, **options)


few = st.frozensets(st.integers(0, 20), max_size=4)
faults = {
    "late_ms": st.dictionaries(st.integers(0, 20), st.sampled_from([50, 290, 310, 500, 900, 2000]), max_size=4),
    "dropped": few,
    "incomplete": few,
    "ignored": few,
    "lost_at": st.none() | st.integers(0, 20),
    "reset_at": st.none() | st.integers(0, 20),
    "survive": st.booleans(),
    "leftover_ms": st.sampled_from([(), (), (5,), (100, 150), (400,), (700, 710)]),
    "call_us": st.sampled_from([(300,), (200, 900, 40_000), (5000,)]),
    "latency_us": st.sampled_from([(100,), (100, 15_000), (20_000, 50)]),
}
many = settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True
)


def check_books(session):
    assert min(value for name, value in session.books.to_dict().items() if name != "imbalance") >= 0
    for written in range(len(session.filed) + session.discarded + 1):
        live = session.exposures.accounting_so_far(written).to_dict()
        assert live["imbalance"] == session.books.imbalance or session.is_in_doubt
    assert session.books.written == len(session.filed)


@many
@given(script=st.builds(Script, **faults), frames_per_stop=st.integers(1, 3))
def test_a_camera_whose_clock_can_be_read_is_never_misunderstood(play, script, frames_per_stop):
    session = play(script, frames_per_stop)
    assert not session.misfiled
    assert not session.is_in_doubt, (session.exposures.ambiguities, session.books.sentence(), session.why)
    check_books(session)


def check_never_silently_wrong(session):
    assert not session.misfiled or session.is_in_doubt, (session.misfiled, session.books.sentence(), session.why)
    check_books(session)


odd_clocks = st.sampled_from(["none", "other", "frozen"])


@many
@given(script=st.builds(Script, latch=odd_clocks, **faults), frames_per_stop=st.integers(1, 3))
def test_a_clock_that_cannot_be_read_or_is_another_is_settled_or_the_doubt_is_said(play, script, frames_per_stop):
    check_never_silently_wrong(play(script, frames_per_stop))


@many
@given(
    script=st.builds(Script, latch=st.sampled_from(["same", "none"]), stamps=st.just("ticks"), **faults),
    frames_per_stop=st.integers(1, 3),
)
def test_stamps_in_another_unit_are_settled_or_the_doubt_is_said(play, script, frames_per_stop):
    check_never_silently_wrong(play(script, frames_per_stop))


without_leftovers = faults | {"leftover_ms": st.just(())}


@many
@given(
    script=st.builds(Script, latch=odd_clocks, stamps=st.just("seconds"), **without_leftovers),
    frames_per_stop=st.integers(1, 3),
)
def test_stamps_that_follow_no_clock_are_found_out_or_the_doubt_is_said(play, script, frames_per_stop):
    check_never_silently_wrong(play(script, frames_per_stop))


@many
@given(
    script=st.builds(
        Script, latch=st.just("none"), stamps=st.just("none"), tells_id=st.booleans(),
        **without_leftovers,
    ),
    frames_per_stop=st.integers(1, 3),
)  # fmt: skip
def test_without_any_time_a_frame_after_a_wait_in_vain_is_told_by_its_id_or_is_a_doubt(
    play, script, frames_per_stop
):
    check_never_silently_wrong(play(script, frames_per_stop))


@pytest.mark.slow
@settings(many, max_examples=20_000)
@given(
    script=st.builds(
        Script,
        latch=st.sampled_from(["same", "none", "other", "frozen"]),
        stamps=st.sampled_from(["ns", "ns", "ticks"]),
        **faults,
    ),
    frames_per_stop=st.integers(1, 3),
)
def test_twenty_thousand_sessions(play, script, frames_per_stop):
    check_never_silently_wrong(play(script, frames_per_stop))


@pytest.mark.parametrize("latch", ["same", "none", "other", "frozen"])
@pytest.mark.parametrize("stamps", ["ns", "ticks", "none"])
def test_nothing_odd_costs_nothing_and_everything_else_a_trial_at_most(play, latch, stamps):
    session = play(Script(latch=latch, stamps=stamps), 2)
    assert session.why == "finished"
    assert not session.is_in_doubt
    assert not session.misfiled
    assert len(session.filed) == 2 * STOPS
    free = stamps == "none" or (stamps == "ns" and latch in ("same", "none"))
    assert session.books.rejected <= (0 if free else 6)
    assert session.books.triggered == session.books.written + session.books.rejected


@pytest.mark.parametrize("latch", ["same", "none", "other", "frozen"])
@pytest.mark.parametrize("pause_ms", [0, 170])
def test_a_producer_that_stamps_with_the_nanoseconds_of_the_second_gets_its_frames(play, latch, pause_ms):
    session = play(Script(latch=latch, stamps="seconds"), 2, stops=40, pause_ms=pause_ms)
    assert session.why == "finished"
    assert not session.is_in_doubt
    assert not session.misfiled
    assert len(session.filed) == 80
    assert session.books.rejected <= 24


def test_a_late_frame_turns_silence_into_a_rejected_frame(play):
    before = play(Script(late_ms={2: 500}, survive=False)).books
    after = play(Script(late_ms={2: 500}, survive=True)).books
    assert (before.silent, before.rejected) == (1, 0)
    assert (after.silent, after.rejected) == (0, 1)
    assert before.triggered == after.triggered == STOPS + 1


def test_a_frame_of_an_earlier_process_is_triggered_and_rejected(play):
    session = play(Script(leftover_ms=(5, 6)))
    assert (session.books.triggered, session.books.rejected) == (STOPS + 2, 2)
    assert session.books.imbalance == 0


def test_without_time_and_id_a_frame_after_a_wait_in_vain_ends_the_session_with_a_doubt(play):
    session = play(Script(late_ms={3: 310}, latch="none", stamps="none", tells_id=False))
    assert isinstance(session.why, FrameDoubt)
    assert not session.misfiled
    assert "neither its time nor its id" in session.exposures.ambiguities[0]


def test_ids_alone_tell_a_late_frame_from_the_next(play):
    session = play(Script(late_ms={3: 310}, latch="none", stamps="none"))
    assert session.why == "finished"
    assert not session.misfiled
    assert session.books.rejected == 1


def test_a_first_frame_of_somebody_else_is_found_by_the_second(play):
    """A clock that cannot be read: the first frame is taken on trust, the second shows that it was not ours."""
    session = play(Script(latch="none", leftover_ms=(20,)))
    assert session.misfiled
    assert "first frame of the session" in session.exposures.ambiguities[0]
    assert len(session.filed) == 1


def test_a_stop_while_a_frame_is_waited_for_leaves_the_books_whole(play):
    """The frame under way comes later, or never; either way nothing is in doubt, and the run can be resumed."""
    for survive in (True, False):
        session = play(Script(), stops=0)
        latch, camera = StopLatch(), ScriptedCamera(Script(late_ms={1: 5000}, survive=survive), session.time)
        exposures = CameraSession(camera, SECTION, latch)
        real, polls = camera.poll, []

        def poll(timeout_s, real=real, polls=polls, latch=latch):
            polls.append(timeout_s)
            if len(polls) == 4:
                latch.stop()
            return real(timeout_s)

        camera.poll = poll
        with pytest.raises(MotionStopped):
            list(exposures.frames(2))
        assert len(camera.sent) == 2
        accounting = exposures.conclude(1)
        assert not exposures.ambiguities
        assert (accounting.triggered, accounting.written, accounting.silent, accounting.imbalance) == (2, 1, 1, 0)


def test_a_clock_that_does_not_run_on_is_a_camera_that_restarted():
    second = 1_000_000_000
    for clock_ns, restarted in ((101, False), (101.02, False), (100.9, True), (1, True), (101.2, True)):
        match = TriggerMatch(1e9)
        first = Shot(100 * second, 50 * second, 50 * second + 1000)
        match.begin()
        match.note_trigger(first)
        assert not match.has_restarted
        stamp_ns, received_ns = first.clock_ns + 5000, first.before_ns + 10_000
        assert match.place(FrameMeta(1, 0, stamp_ns, received_ns, 1.0, "Mono12", 12)) is Place.OURS
        match.begin()
        match.note_trigger(Shot(round(clock_ns * second), 51 * second, 51 * second + 1000))
        assert match.has_restarted == restarted


def test_the_matching_is_needed(play, monkeypatch):
    """With the judge switched off and nothing drained the same sessions are wrong: these tests can see."""
    monkeypatch.setattr(TriggerMatch, "place", lambda self, meta: Place.OURS)
    monkeypatch.setattr(CameraSession, "drain", lambda self: [])
    session = play(Script(late_ms={2: 310}))
    assert len(session.misfiled) > 2


SECOND = 1_000_000_000
MS = 1_000_000


def taken(match, before_ns, stamp_ns, received_ns, sequence=0):
    """A trigger without a clock, and the frame that came."""
    match.begin()
    match.note_trigger(Shot(None, before_ns, before_ns + 1000))
    return match.place(FrameMeta(sequence, sequence, stamp_ns, received_ns, 1.0, "Mono12", 12))


def test_a_frame_that_was_left_behind_by_a_timeout_is_stale_however_slow_frames_are():
    """Frames take 1.9 of the 2 s that we wait; one was exposed 0.3 s late and given up, and arrives next."""
    match = TriggerMatch(2 * SECOND)
    for number in range(6):
        at_ns = number * 10 * SECOND
        assert taken(match, at_ns, at_ns + MS, at_ns + 1900 * MS, number) is Place.OURS
    given_up_ns = 60 * SECOND
    match.begin()
    match.note_trigger(Shot(None, given_up_ns, given_up_ns + 1000))
    match.gave_up()
    next_ns = given_up_ns + 2 * SECOND
    assert taken(match, next_ns, given_up_ns + 300 * MS, given_up_ns + 2200 * MS, 6) is Place.STALE
    ours = FrameMeta(7, 7, next_ns + MS, next_ns + 1900 * MS, 1.0, "Mono12", 12)
    assert match.place(ours) is Place.OURS


def test_clocks_that_drift_apart_for_ten_minutes_leave_a_frame_its_trigger():
    """By 0.1 in a thousand, 60 ms, where the quickest frame took 2 ms from trigger to arrival."""
    for drift in (1e-4, -1e-4):
        match = TriggerMatch(2 * SECOND)
        for at_ns in (0, SECOND, 601 * SECOND):
            stamp_ns = round((at_ns + MS) * (1 + drift))
            assert taken(match, at_ns, stamp_ns, at_ns + 2 * MS, at_ns // SECOND) is Place.OURS


def test_a_frame_that_is_older_than_the_quickest_took_is_stale():
    """By 3 ms before its trigger, where the quickest frame took 2 ms from trigger to arrival."""
    match = TriggerMatch(2 * SECOND)
    for number in range(5):
        at_ns = number * SECOND
        assert taken(match, at_ns, at_ns + MS, at_ns + 2 * MS, number) is Place.OURS
    at_ns = 5 * SECOND
    assert taken(match, at_ns, at_ns - 3 * MS, at_ns + 10 * MS, 5) is Place.STALE


@pytest.mark.parametrize(("sequence", "place"), [(4, Place.STALE), (5, Place.OURS), (6, Place.UNKNOWN)])
def test_without_a_time_a_late_frame_is_told_by_its_id(sequence, place):
    """Frames 0 to 3 were ours; one trigger was waited for in vain, and another one was sent."""
    match = TriggerMatch(2 * SECOND)
    for number in range(4):
        assert taken(match, number * SECOND, 0, number * SECOND + MS, number) is Place.OURS
    match.begin()
    match.note_trigger(Shot(None, 4 * SECOND, 4 * SECOND + 1000))
    match.gave_up()
    assert taken(match, 5 * SECOND, 0, 5 * SECOND + MS, sequence) is place


def test_a_stream_hands_over_nothing_that_was_exposed_before_its_arming():
    """By the latched clock, and without one by frames of arms before."""
    latched = TriggerMatch(2 * SECOND)
    arm = Shot(100 * SECOND, 50 * SECOND, 50 * SECOND + 1000)
    frame = FrameMeta(0, 0, 100 * SECOND + MS, 50 * SECOND + 2 * MS, 1.0, "Mono12", 12)
    assert latched.is_of_arm(frame, arm)
    for back_ns in (2 * MS, SECOND):
        left = FrameMeta(1, 1, 100 * SECOND - back_ns, 50 * SECOND + 3 * MS, 1.0, "Mono12", 12)
        assert not latched.is_of_arm(left, arm)
    mute = TriggerMatch(2 * SECOND)
    assert mute.is_of_arm(FrameMeta(0, 0, 100 * SECOND + MS, 50 * SECOND + 2 * MS, 1.0, "Mono12", 12),
                          Shot(None, 50 * SECOND, 50 * SECOND + 1000))  # fmt: skip
    again = Shot(None, 60 * SECOND, 60 * SECOND + 1000)
    left = FrameMeta(1, 1, 108 * SECOND, 60 * SECOND + 3 * MS, 1.0, "Mono12", 12)
    assert not mute.is_of_arm(left, again)


@pytest.mark.parametrize("reset_at", [1, 4])
def test_a_camera_that_lost_power_between_two_triggers_is_verified_before_its_frame_is_handed_over(play, reset_at):
    """Its clock has begun anew and its settings are gone; its frames look as they always do."""
    session = play(Script(), stops=0)
    camera = ScriptedCamera(Script(reset_at=reset_at), session.time)
    clock_ns = camera.clock_ns
    camera.clock_ns = lambda: clock_ns() - (10 * SECOND if len(camera.sent) >= reset_at else 0)
    stamped = camera._frame

    def from_the_new_clock(coming):
        frame = stamped(coming)
        if coming.trigger >= reset_at:
            meta = replace(frame.meta, timestamp_ns=frame.meta.timestamp_ns - 10 * SECOND)
            return Frame(frame.pixels, meta)
        return frame

    camera._frame = from_the_new_clock
    exposures, frames = CameraSession(camera, SECTION), []
    exposures.set_up()
    with pytest.raises(SettingsChanged):
        frames.extend(int(frame.pixels[0, 0]) for _, frame in exposures.frames(8))
    assert frames == list(range(reset_at))
