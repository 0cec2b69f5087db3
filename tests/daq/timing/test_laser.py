"""The state machine on a fake box: what may be asked when, and what ends it."""

import threading

import pytest

from daq.timing.conditions import Conditions, Rules
from daq.timing.errors import LaserDoubt, LaserStopped, NotArmed, NotNow, PulsesRefused, TimingUsageError
from daq.timing.laser import Laser
from daq.timing.pulses import LaserHead, Pulse, PulseTiming, Role, Schedule
from daq.timing.states import LaserState
from sim.mechanics.clock import VirtualClock
from stages.errors import DeviceLost, NoReply
from tests.daq.timing.armed_laser import (
    EXPOSURES,
    GOOD,
    HEAD,
    RULES,
    TIMING,
    armed,
    conditions_with,
    laser_on,
    ready,
)
from tests.daq.timing.fake_box import FakeBox


def test_a_chunk_from_opening_to_the_end():
    laser, box, clock = laser_on()
    assert laser.state is LaserState.SAFE
    assert box.said == ["connect fake://", "drop"]
    laser.warm(10.0)
    assert laser.state is LaserState.WARM
    clock.sleep_s(59.0)
    assert laser.state is LaserState.WARM
    assert laser.warm_in_s == pytest.approx(1.0)
    clock.sleep_s(1.1)
    assert laser.state is LaserState.READY
    assert laser.set(TIMING, EXPOSURES).dt_us == pytest.approx(20.0)
    assert laser.dt_us == pytest.approx(20.0)
    laser.arm(GOOD, laser.challenge)
    assert laser.state is LaserState.ARMED
    laser.fire(30)
    assert laser.state is LaserState.FIRING
    laser.watch(GOOD)
    laser.wait()
    assert (laser.state, box.count()) == (LaserState.READY, 30)
    laser.arm(GOOD, laser.challenge)  # the word holds for the chunks of one run
    laser.fire(7)
    laser.wait()
    assert box.count() == 37
    laser.safe()
    assert laser.state is LaserState.SAFE


def test_without_lamps_it_is_ready_at_once():
    laser, box, _ = laser_on(head=LaserHead(max_rate_hz=100.0))
    laser.warm()
    assert laser.state is LaserState.READY
    assert not box.lamps


def test_what_cannot_be_read_is_unknown_and_only_safe_is_left():
    clock = VirtualClock()
    box = FakeBox(clock)
    box.unreadable = True
    laser = Laser("laser", box, HEAD, RULES, clock)
    laser.open("fake://")
    assert laser.state is LaserState.UNKNOWN
    for verb in (
        laser.warm,
        lambda: laser.set(TIMING, EXPOSURES),
        lambda: laser.arm(GOOD, laser.challenge),
        lambda: laser.fire(1),
        lambda: laser.align("", 1.0, 1.0),
        laser.disarm,
    ):
        with pytest.raises(NotNow, match="only safe"):
            verb()
    with pytest.raises(NoReply):
        laser.safe()
    assert laser.state is LaserState.UNKNOWN
    box.unreadable = False
    laser.safe()
    assert laser.state is LaserState.SAFE


MISSING = {
    "does not wait for triggers": {"camera_armed": False},
    "older frames": {"buffers_empty": False},
    "moves": {"at_rest": False},
    "3.9 mm from the sheet": {"sheet_clearance_mm": 3.9},
    "nan mm from the sheet": {"sheet_clearance_mm": float("nan")},
    "distance of glass and target": {"sheet_clearance_mm": None},
    "room for 0 pairs": {"frames_fit": 0},
}


@pytest.mark.parametrize("words", MISSING)
def test_a_condition_that_is_not_met_does_not_arm(words):
    laser, box, clock = ready()
    with pytest.raises(NotArmed, match=words):
        laser.arm(conditions_with(**MISSING[words]), laser.challenge)
    with pytest.raises(NotNow, match="set\\(\\) and arm\\(\\) come first"):
        laser.fire(1)
    clock.sleep_s(10.0)
    assert (laser.state, box.count()) == (LaserState.READY, 0)


def test_nothing_stated_is_not_met():
    assert Conditions().missing(1) is not None


@pytest.mark.parametrize("words", [w for w in MISSING if w not in ("older frames", "room for 0 pairs")])
def test_a_condition_that_is_lost_switches_off(words):
    laser, box, clock = armed()
    laser.fire(50)
    clock.sleep_s(1.0)
    with pytest.raises(LaserStopped, match=words):
        laser.watch(conditions_with(**MISSING[words]))
    clock.sleep_s(10.0)
    assert box.count() == 10
    assert laser.state is LaserState.UNKNOWN
    assert laser.confirm_off()
    assert laser.state is LaserState.FAULT
    with pytest.raises(NotNow, match=words):
        laser.warm()
    laser.safe()
    assert laser.state is LaserState.SAFE


@pytest.mark.parametrize("word", ["", "yes", "fire", "0000 ", "12345"])
def test_only_the_word_that_is_asked_for_arms(word):
    laser, _, _ = ready()
    with pytest.raises(NotArmed, match="type the code"):
        laser.arm(GOOD, word)


def test_every_safe_asks_for_another_word():
    laser, _, _ = laser_on()
    words = set()
    for _ in range(20):
        laser.safe()
        words.add(laser.challenge)
    assert len(words) > 10


def test_a_stop_holds_until_safe():
    laser, box, clock = armed()
    laser.fire(50)
    clock.sleep_s(0.5)
    laser.stop("somebody came in")
    clock.sleep_s(5.0)
    assert box.count() == 5
    with pytest.raises(LaserStopped, match="somebody came in"):
        laser.wait()
    laser.confirm_off()
    assert laser.state is LaserState.FAULT
    assert laser.challenge == ""
    laser.safe()
    laser.warm(10.0)


def test_a_lost_link_leaves_it_unknown_and_the_box_counts_on():
    laser, box, clock = armed()
    laser.fire(20)
    clock.sleep_s(1.0)
    box.is_gone = True
    with pytest.raises(DeviceLost):
        laser.stop("anything")
    assert laser.state is LaserState.UNKNOWN
    clock.sleep_s(20.0)
    assert box.count() == 20
    assert not laser.confirm_off()
    box.is_gone = False
    assert laser.confirm_off()
    assert laser.state is LaserState.FAULT


def test_a_box_that_would_go_on_beyond_its_count_is_ended_with_its_time():
    laser, box, _clock = armed()
    laser.fire(5)
    begun_s, _, rate_hz = box.burst
    box.burst = (begun_s, 1000, rate_hz)
    laser.wait()
    assert box.burst is None
    assert box.fired == 5
    assert laser.state is LaserState.READY


def test_a_restart_of_the_box_is_found_before_arming():
    laser, box, _ = ready()
    box.lamps = False
    with pytest.raises(LaserDoubt):
        laser.arm(GOOD, laser.challenge)


@pytest.mark.parametrize("pairs", [0, -1, 101])
def test_a_chunk_is_at_most_ten_seconds(pairs):
    laser, box, _ = armed()
    with pytest.raises(TimingUsageError, match="1 to 100 fit"):
        laser.fire(pairs)
    assert box.burst is None


def test_a_chunk_that_the_disk_cannot_take_is_not_begun():
    laser, box, _ = ready()
    laser.arm(conditions_with(frames_fit=10), laser.challenge)
    with pytest.raises(NotArmed, match="room for 10 pairs, not for 11"):
        laser.fire(11)
    assert box.burst is None


def test_a_box_that_cannot_count_needs_a_word_in_the_bench_file():
    laser, box, _ = ready()
    box.counts = False
    with pytest.raises(NotArmed, match="uncounted"):
        laser.arm(GOOD, laser.challenge)


def test_what_was_armed_long_ago_does_not_fire():
    laser, box, clock = armed()
    clock.sleep_s(11.0)
    with pytest.raises(NotArmed, match="11 s ago"):
        laser.fire(1)
    assert box.burst is None
    laser.disarm()
    laser.arm(GOOD, laser.challenge)
    laser.fire(1)


def test_whoever_watches_does_not_wait_for_another_verb():
    laser, box, _ = armed()
    laser.fire(50)
    held, done = threading.Event(), threading.Event()

    def holds():
        with laser._lock:
            held.set()
            done.wait(30.0)

    thread = threading.Thread(target=holds)
    thread.start()
    held.wait()
    assert laser.look()
    with pytest.raises(LaserStopped):
        laser.watch(Conditions())
    assert thread.is_alive()  # the verb has not given the lock back
    assert box.burst is None
    done.set()
    thread.join()


def test_an_exposure_that_is_too_long_for_the_room_is_refused():
    laser, _, _ = ready(rules=Rules(warmup_s=1.0, dark_us=5_000.0))
    with pytest.raises(NotArmed, match="exposure B of 20000 us is longer"):
        laser.arm(GOOD, laser.challenge)


def test_dt_changes_only_when_ready():
    laser, _, clock = armed()
    with pytest.raises(NotNow):
        laser.set(TIMING, EXPOSURES)
    laser.fire(10)
    with pytest.raises(NotNow):
        laser.set(TIMING, EXPOSURES)
    clock.sleep_s(2.0)
    laser.wait()
    laser.set(PulseTiming(30.0, 10.0), EXPOSURES)
    with pytest.raises(PulsesRefused, match="another warm-up"):
        laser.set(PulseTiming(30.0, 12.0), EXPOSURES)


def test_alignment_is_weak_short_and_goes_through_safe():
    laser, box, _clock = laser_on()
    with pytest.raises(NotArmed):
        laser.align("no", 5.0, 2.0)
    with pytest.raises(PulsesRefused, match="at most 10 Hz and 10 s"):
        laser.align(laser.challenge, 11.0, 2.0)
    with pytest.raises(PulsesRefused):
        laser.align(laser.challenge, 5.0, float("nan"))
    word = laser.challenge
    laser.align(word, 5.0, 2.0)
    assert laser.state is LaserState.ALIGNING
    with pytest.raises(NotNow, match="end it with safe"):
        laser.fire(1)
    laser.wait()
    assert (laser.state, box.count(), box.lamps) == (LaserState.SAFE, 10, False)
    laser.warm(10.0)
    with pytest.raises(NotNow):
        laser.align(laser.challenge, 5.0, 2.0)


def test_without_rules_there_is_no_alignment():
    laser, _, _ = laser_on(rules=Rules())
    with pytest.raises(NotNow, match="no alignment mode"):
        laser.align(laser.challenge, 1.0, 1.0)


def test_closing_switches_off():
    laser, box, _clock = armed()
    laser.fire(50)
    laser.close()
    assert box.burst is None
    assert laser.state is LaserState.FAULT


def cable_back_after(box, clock, seconds):
    """Pull the cable of a box now; whoever opens the port again later than that finds it plugged in."""
    box.is_gone, back_s = True, clock.now_s() + seconds

    def reconnect():
        if clock.now_s() < back_s:
            raise DeviceLost("fake is gone")
        box.is_gone = False

    box.reconnect = reconnect


@pytest.mark.parametrize("seconds", [0.0, 3.0])
def test_leaving_goes_on_to_switch_off_until_the_cable_is_back(seconds):
    """A box that does not count gives pulses for as long as nobody reaches it."""
    laser, box, clock = armed()
    laser.fire(50)
    cable_back_after(box, clock, seconds)
    with pytest.raises(DeviceLost):
        laser.stop("asked")
    laser.close()
    assert box.burst is None
    assert not box.lamps
    assert laser.state is LaserState.FAULT


def test_leaving_a_laser_that_is_out_of_reach_says_that_it_may_still_give_light():
    laser, box, clock = armed()
    laser.fire(50)
    cable_back_after(box, clock, 1e6)
    begun_s = clock.now_s()
    with pytest.raises(LaserDoubt, match=r"may still give light.*key"):
        laser.close()
    assert 5.0 < clock.now_s() - begun_s < 20.0
    laser.close()  # has been said; nobody waits twice
    assert clock.now_s() - begun_s < 20.0


def test_leaving_a_laser_that_is_off_waits_for_no_cable():
    laser, box, clock = laser_on()
    cable_back_after(box, clock, 1e6)
    begun_s = clock.now_s()
    laser.close()
    assert clock.now_s() == begun_s


def test_a_stop_that_comes_while_off_is_read_back_is_not_lost():
    """`safe` clears the last stop; the one that comes behind that holds, although everything reads back as off."""
    laser, box, _ = laser_on()
    silence = box.silence

    def stopped_meanwhile():
        silence()
        laser.stop("a hand on the key")

    box.silence = stopped_meanwhile
    with pytest.raises(LaserStopped, match="a hand on the key"):
        laser.safe()
    assert laser.state is LaserState.UNKNOWN
    box.silence = silence
    laser.safe()
    assert laser.state is LaserState.SAFE


@pytest.mark.parametrize("off_us", [1.0, -1.0])
def test_a_dt_that_reads_back_as_another_is_found_and_switched_off(off_us):
    laser, box, clock = laser_on()
    laser.warm(10.0)
    clock.sleep_s(60.1)
    load = box.load

    def load_another(schedule):
        second = schedule.pulses[Role.Q_SWITCH_2]
        late = Pulse(second.delay_us + off_us, second.width_us)
        return load(Schedule(schedule.period_us, {**schedule.pulses, Role.Q_SWITCH_2: late}))

    box.load = load_another
    with pytest.raises(LaserDoubt, match=r"was set to dt = 20.0 us and reads (21|19)"):
        laser.set(TIMING, EXPOSURES)
    assert laser.state is LaserState.UNKNOWN
    assert not box.lamps
