"""The driver on firmware: what it believes, what it refuses, and what any one fault makes of it."""

import itertools

import pytest

from daq.errors import DaqError
from daq.timing.conditions import Rules
from daq.timing.errors import LaserDoubt, LaserStopped, PulsesRefused, TimingUsageError, WrongBox
from daq.timing.low_energy import LowEnergyRules
from daq.timing.pulses import LaserHead, PairExposures, PulseTiming, Role
from daq.timing.states import LaserState
from sim.emulators.faults import KINDS, Fault, FaultSchedule
from stages.errors import CommandRejected, StageError
from tests.daq.timing.armed_laser import conditions_with
from tests.daq.timing.quantum_desk import EXPOSURES, GOOD, HEAD, PUMPED, WIRING, desk


@pytest.mark.parametrize(("step_s", "firmware"), [
    (5e-9, {}), (1e-11, {"echo": True}), (1e-8, {}), (1e-8, {"arms": "run all"}), (5e-9, {"arms": "state"}),
    (1e-8, {"model": "BNC,575-8"}), (5e-9, {"needs_s": 0.03}),
])  # fmt: skip
def test_pulses_leave_where_they_were_placed(step_s, firmware):
    with desk(step_s=step_s, **firmware) as d:
        d.burst()
        last_s = {pulse.output: pulse.rises_s for pulse in d.emulator.outputs.recent}
        for early, late, us in (("B", "D", 20.0), ("A", "B", 180.0), ("C", "D", 185.0)):
            assert ((last_s[late] - last_s[early]) % 0.1) * 1e6 == pytest.approx(us, abs=0.011)
        assert d.pulses(Role.Q_SWITCH_1) == d.pulses(Role.Q_SWITCH_2) == 5
        assert d.pulses(Role.CAMERA) == 5
        assert d.laser.dt_us == pytest.approx(20.0, abs=0.011)


@pytest.mark.parametrize("arms", ["run", "run all", "state"])
@pytest.mark.parametrize(("wiring", "head"), [(WIRING, HEAD), (PUMPED, LaserHead(max_rate_hz=15.0))])
def test_a_burst_of_n_is_n_whatever_arms_it(arms, wiring, head):
    """On a box that arms by RUN (9530 manual p. 14) an output that is switched on while T0 runs gives nothing."""
    exposures = PairExposures(900.0, 9000.0, 100.0, two_triggers=wiring is PUMPED)
    with desk(wiring=wiring, head=head, arms=arms) as d:
        d.to_armed(200.0, 10.0, exposures)
        for pairs in (20, 1, 7):
            before = d.pulses(Role.Q_SWITCH_1)
            d.laser.fire(pairs)
            d.laser.wait()
            d.clock.sleep_s(2.0)
            assert d.pulses(Role.Q_SWITCH_1) - before == pairs
            d.laser.arm(GOOD, d.laser.challenge)
        assert d.pulses(Role.Q_SWITCH_2) == 28
        assert d.pulses(Role.CAMERA) == 28 * (2 if wiring is PUMPED else 1)
        d.laser.safe()
        assert d.laser.state is LaserState.SAFE


def test_another_run_at_the_keys_after_a_burst_gives_nothing():
    with desk() as d:
        d.burst()
        d.emulator.set_inside(0, "STAT", "1")
        d.clock.sleep_s(2.0)
        assert d.pulses(Role.Q_SWITCH_1) == d.pulses(Role.Q_SWITCH_2) == 5


@pytest.mark.parametrize("has_lamps", [True, False])
def test_a_burst_that_somebody_ended_at_the_keys_is_not_taken_for_a_whole_one(has_lamps):
    with desk(**({} if has_lamps else {"wiring": PUMPED, "head": LaserHead(max_rate_hz=100.0)})) as d:
        d.to_armed(200.0, 10.0, PairExposures(900.0, 9000.0, 100.0, two_triggers=not has_lamps))
        d.laser.fire(20)
        d.clock.sleep_s(1.0)
        d.emulator.person_stops()
        with pytest.raises(LaserDoubt, match="not run to the end of its burst"):
            d.laser.wait()


@pytest.mark.parametrize("model", ["BNC,575-8", "QC,9518", "QC,9528", "QC,9538", "BNC,577-8", "QC,9999"])
@pytest.mark.parametrize("said", ["own", "external"])
def test_the_clock_has_two_words(model, said):
    """On a 575 and a 952x it is one word (575 manual v5.6 p. 8-38), on a 953x a mode; others are asked."""
    with desk(model=model) as d:
        word, value = next((word, value) for word, value in d.emulator._t0.words.items() if "ICL" in word)
        if said == "external":
            value = {"INT": "EXT", "SYS": "EXT10"}[value]
            d.emulator.set_inside(0, word, value)
        d.laser.open("sim://desk")
        assert d.laser.state is LaserState.SAFE
        d.emulator.set_inside(0, word, "XPL?")
        with pytest.raises(WrongBox, match=r"its clock says 'XPL\?'"):
            d.laser.open("sim://desk")


def test_a_box_without_any_word_for_its_clock_is_refused():
    with desk() as d:
        for word in [word for word in d.emulator._t0.words if "ICL" in word]:
            del d.emulator._t0.words[word]
        with pytest.raises(WrongBox, match="does not report its clock"):
            d.laser.open("sim://desk")


def test_a_box_that_loses_lines_that_come_too_soon_is_asked_more_slowly():
    """A program for the 575 waits 50 ms between commands."""
    with desk(needs_s=0.045) as d:
        d.firing()
        before = d.pulses(Role.Q_SWITCH_1)
        d.laser.stop("now")  # of what is written at once such a box hears the first line
        d.clock.sleep_s(2.0)
        assert d.pulses(Role.Q_SWITCH_1) == before > 0
        assert d.laser.confirm_off()
    with desk() as d:
        d.to_armed()
        assert d.box._pause_s == 0.0


def test_every_line_but_off_and_the_start_waits_for_the_answer_to_the_one_before():
    """One command in a string, then its response is read, and so on (9500 Plus manual, p. 38)."""
    with desk() as d:
        log, send, receive = [], d.line.send, d.line.receive

        def read(*words):
            got = receive(*words)
            log.extend(["read"] if got else [])
            return got

        d.line.send, d.line.receive = lambda data: (log.append(data), send(data))[1], read
        d.burst(3)
        d.laser.safe()
        (off,) = d.box.off_bytes()
        starts = [data for data in log if data not in ("read", off) and data.count(b"\n") > 1]
        assert [data.count(b"\n") for data in starts] == [7]  # T0 asked, off, four outputs, RUN
        strings = ("read", off, *starts)
        assert all(data.count(b"\n") == 1 for data in log if data not in strings)
        assert not [late for soon, late in itertools.pairwise(log) if soon != "read" and late not in strings]
        assert len(log) > 500


def test_a_refusal_says_why():
    with desk() as d:
        d.laser.open("sim://desk")
        with pytest.raises(CommandRejected, match=r"out of bounds \(\?9\)"):
            d.box._set(1, "WIDT", "5000")


def test_every_lit_period_is_seen_by_the_camera():
    with desk() as d:
        d.burst(7)
        seen = [pulse.rises_s for pulse in d.emulator.outputs.recent if pulse.output == "E"]
        lit = [pulse.rises_s for pulse in d.emulator.outputs.recent if pulse.output in "BD"]
        assert all(any(0.0 <= light_s - camera_s < 0.05 for camera_s in seen) for light_s in lit)


def test_without_lamps_a_burst_begins_together_and_t0_runs_on_behind_it():
    exposures = PairExposures(900.0, 900.0, 100.0, two_triggers=True)
    with desk(wiring=PUMPED, head=LaserHead(max_rate_hz=400.0), outputs=4) as d:
        d.to_armed(200.0, 300.0, exposures)
        d.laser.fire(30)
        d.laser.wait()
        assert d.pulses(Role.Q_SWITCH_1) == d.pulses(Role.Q_SWITCH_2) == 30
        assert d.pulses(Role.CAMERA) == 60  # both triggers come out at one plug
        assert d.emulator.is_on_at(0)  # any off is seen by it
        d.laser.safe()
        assert not d.emulator.is_on_at(0)


def test_lamps_run_on_from_chunk_to_chunk_and_start_anew_with_each():
    with desk() as d:
        d.burst()
        d.laser.set(PulseTiming(30.0, 10.0), EXPOSURES)
        d.laser.arm(GOOD, d.laser.challenge)
        d.laser.fire(5)
        d.laser.wait()
        beats = [pulse.rises_s for pulse in d.emulator.outputs.recent if pulse.output == "A"]
        off_beat = [late - soon for soon, late in itertools.pairwise(beats) if not 0.0999 < late - soon < 0.1001]
        assert len(off_beat) <= 2  # one before each chunk, as long as it takes to switch the outputs on
        assert all(seconds < 0.2 for seconds in off_beat)


def test_what_ran_before_us_is_off_before_a_word_is_asked():
    with desk() as d:
        d.emulator.set_inside(2, "CMOD", "NORM")
        for number in (2, 7, 0):
            d.emulator.set_inside(number, "STAT", "1")
        d.clock.sleep_s(1.0)
        before = d.pulses(Role.Q_SWITCH_1)
        assert before > 0
        d.laser.open("sim://desk")
        d.clock.sleep_s(1.0)
        assert d.laser.state is LaserState.SAFE
        assert d.pulses(Role.Q_SWITCH_1) <= before + 1
        assert not any(d.emulator.is_on_at(number) for number in range(9))


@pytest.mark.parametrize(
    ("firmware", "words"),
    [
        ({"autorun": True}, "set to run by itself"),
        ({"outputs": 4}, "marker is on output F|camera is on output E"),
    ],
)
def test_a_box_that_must_not_be_used(firmware, words):
    with desk(**firmware) as d, pytest.raises(WrongBox, match=words):
        d.laser.open("sim://desk")
    assert d.laser.state is LaserState.UNKNOWN
    assert not any(d.emulator.is_on_at(number) for number in range(len(d.emulator._all)))


def test_a_clock_that_is_not_locked_is_refused_at_opening_and_before_arming():
    with desk() as d:
        d.emulator.set_inside(0, "ICL:MOD", "XPL")
        d.emulator.locked = False
        with pytest.raises(WrongBox, match="XPL"):
            d.laser.open("sim://desk")
        d.emulator.locked = True
        d.to_ready()
        d.emulator.locked = False
        with pytest.raises(WrongBox, match="XPL"):
            d.laser.arm(GOOD, d.laser.challenge)
        assert d.pulses(Role.Q_SWITCH_1) == 0


@pytest.mark.parametrize(
    ("number", "keyword", "value"),
    [(0, "PER", "0.05"), (2, "DEL", "0.001"), (2, "WIDT", "0.001"), (2, "MUX", "3"), (4, "POL", "COMP"),
     (4, "CMOD", "NORM"), (2, "SYNC", "CHA"), (5, "CGAT", "OUTP"), (1, "STAT", "0"), (4, "STAT", "1")],
)  # fmt: skip
def test_somebody_at_its_keys_is_found_before_it_is_armed(number, keyword, value):
    with desk() as d:
        d.to_ready()
        d.emulator.set_inside(number, keyword, value)
        with pytest.raises(LaserDoubt):
            d.laser.arm(GOOD, d.laser.challenge)
        assert d.laser.confirm_off()
        assert d.laser.state is LaserState.FAULT


def keys_make_the_burst_endless(d):
    """In its middle somebody takes the count away from both Q-switches."""
    d.firing(20)
    for number in (2, 4):
        d.emulator.set_inside(number, "CMOD", "NORM")


def test_a_burst_made_endless_at_the_keys_ends_with_its_time_and_is_found():
    with desk() as d:
        keys_make_the_burst_endless(d)
        d.laser.wait()
        ended_s = d.clock.now_s()
        d.clock.sleep_s(60.0)
        assert 20 <= d.pulses(Role.Q_SWITCH_1) <= 21  # one period may begin until off is said
        assert d.emulator.outputs.recent[-1].rises_s > ended_s  # lamps run on
        with pytest.raises(LaserDoubt, match="CMOD is NORM"):
            d.laser.arm(GOOD, d.laser.challenge)


def test_a_burst_made_endless_at_the_keys_ends_with_its_time_though_no_answer_comes():
    with desk() as d:
        keys_make_the_burst_endless(d)
        d.clock.sleep_s(0.9)
        d.line.faults = FaultSchedule(Fault("lost", number) for number in range(40))
        with pytest.raises(StageError):
            d.laser.wait()
        assert 20 <= d.pulses(Role.Q_SWITCH_1) <= 21
        assert 20 <= d.pulses(Role.Q_SWITCH_2) <= 22  # it is told 0.1 s later


def test_a_stop_between_two_words_of_a_beginning_burst_lets_none_of_the_others_switch_on():
    begun = 0
    for words in range(1, 60, 6):
        with desk() as d:
            d.to_armed()
            d.line.hooks.press(words, "write", lambda d=d: d.laser.stop("a person"), lambda: False)
            try:
                d.laser.fire(20)
                begun += 1  # the stop waits for a later word
            except LaserStopped:
                d.clock.sleep_s(10.0)
                assert d.pulses(Role.Q_SWITCH_1) == d.pulses(Role.Q_SWITCH_2) == 0
                assert not d.emulator.is_on_at(0)
    assert begun < 5


def test_a_stop_while_the_outputs_of_an_alignment_are_read_is_seen():
    """T0 was asked before them, and is stopped next in any case: the laser was SAFE as if nothing had been."""
    for output in range(2):
        with desk(wiring=PUMPED, head=LaserHead(max_rate_hz=100.0, pulse_us=50.0)) as d:
            d.laser.rules = Rules(align=LowEnergyRules(pulse_us=5.0))
            d.laser.open("sim://desk")
            d.laser.safe()
            d.laser.align(d.laser.challenge, 5.0, 1.0)
            d.clock.sleep_s(1.5)
            ask, asked = d.box._flag, itertools.count()

            def press(number, keyword, d=d, ask=ask, asked=asked, output=output):
                answer = ask(number, keyword)
                if next(asked) == output:
                    d.emulator.person_stops()
                return answer

            d.box._flag = press
            with pytest.raises(LaserDoubt, match="was stopped at its keys"):
                d.laser.wait()
            assert d.laser.state is not LaserState.SAFE


def test_a_start_whose_first_answer_is_0_is_switched_off_at_once():
    """STOP is pressed after the last question, and before the string that begins the burst."""
    with desk() as d:
        d.to_armed()
        start = d.box._start

        def stopped(burst):
            d.emulator.person_stops()
            start(burst)

        d.box._start = stopped
        with pytest.raises(LaserDoubt, match="T0 is off"):
            d.laser.fire(50)
        d.clock.sleep_s(10.0)
        assert d.pulses(Role.Q_SWITCH_1) <= 1


def test_a_burst_made_endless_at_the_keys_while_the_cable_is_out_is_off_with_the_first_word():
    """Only the person at the keys can end it before that: no word of ours reaches the box."""
    with desk() as d:
        keys_make_the_burst_endless(d)
        d.line.unplug()
        with pytest.raises(StageError):
            d.laser.wait()
        d.clock.sleep_s(5.0)
        assert d.pulses(Role.Q_SWITCH_1) > 50
        d.line.plug_in()
        before = d.pulses(Role.Q_SWITCH_1)
        assert d.laser.confirm_off()
        d.clock.sleep_s(60.0)
        assert d.pulses(Role.Q_SWITCH_1) == before
        assert d.laser.state is LaserState.FAULT


@pytest.mark.parametrize("off_s", [0.2, 1.0])
def test_a_restart_while_it_fires_is_not_taken_for_the_end(off_s):
    with desk() as d:
        d.firing()
        d.line.power_cycle(off_s)
        d.clock.sleep_s(6.0)
        with pytest.raises(LaserDoubt, match=r"stopped at its keys .* or lost power"):
            d.laser.wait()
        assert d.laser.state is LaserState.UNKNOWN


def answers_of_a_burst():
    with desk() as d:
        d.burst(3)
        return d.line.faults._count


@pytest.mark.slow
@pytest.mark.parametrize("every", [61, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_one_fault_at_any_answer(kind, every):
    """Whatever one fault does, light is that of the burst or none, and dt is right or it is not armed."""
    for answer in range(1, answers_of_a_burst(), every):
        with desk(faults=[Fault(kind, answer, delay_s=1.5)]) as d:
            try:
                d.burst(3)
                assert d.laser.dt_us == pytest.approx(20.0, abs=0.011)
                assert d.pulses(Role.Q_SWITCH_1) == d.pulses(Role.Q_SWITCH_2) == 3
            except (DaqError, StageError):
                d.clock.sleep_s(5.0)
                assert d.pulses(Role.Q_SWITCH_1) <= 3
                assert d.laser.state in (LaserState.UNKNOWN, LaserState.FAULT)
                if not d.line.dead:
                    d.laser.safe()
                    assert d.laser.state is LaserState.SAFE


def test_a_number_without_all_its_digits_is_not_believed(mocker):
    with desk() as d:
        d.to_armed()
        whole = d.emulator._format_value
        mocker.patch.object(d.emulator, "_format_value", lambda *words: whole(*words)[:-4])
        with pytest.raises((LaserDoubt, StageError)):
            d.box.confirm(d.laser.schedule, lamps=True)


def test_off_is_written_while_another_thread_waits_for_an_answer():
    """The stop comes in the middle of a conversation, and is the next thing that the box hears."""
    with desk() as d:
        d.firing()
        d.line.faults.strike(Fault("lost"))
        d.line.hooks.press(1, "write", lambda: d.laser.stop("another thread"), lambda: False)
        with pytest.raises((DaqError, StageError)):
            d.laser.box.require_lamps(True)
        with pytest.raises(LaserStopped, match="another thread"):
            d.laser.wait()
        d.clock.sleep_s(10.0)
        assert d.pulses(Role.Q_SWITCH_1) <= 11
        assert d.laser.state is LaserState.UNKNOWN


BAD_REQUESTS = {  # one for each verb and judge; the others are those of test_pulses and test_laser
    "a dt longer than the period": lambda laser: laser.set(PulseTiming(120_000.0, 10.0), EXPOSURES),
    "another rate than that of the lamps": lambda laser: laser.set(PulseTiming(20.0, 5.0), EXPOSURES),
    "something moves": lambda laser: laser.arm(conditions_with(at_rest=False), laser.challenge),
    "nobody's word": lambda laser: laser.arm(GOOD, "yes"),
    "fire without arming": lambda laser: laser.fire(10),
    "warm what is warm": lambda laser: laser.warm(10.0),
    "alignment from the warm": lambda laser: laser.align(laser.challenge, 5.0, 1.0),
}


@pytest.mark.parametrize("what", BAD_REQUESTS)
def test_bad_input_is_one_sentence_and_nothing_fires(what):
    with desk() as d:
        d.to_ready()
        sent = d.line.hooks.passed["write"]
        with pytest.raises(TimingUsageError) as caught:
            BAD_REQUESTS[what](d.laser)
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) > 25
        assert d.line.hooks.passed["write"] == sent  # not a byte
        assert d.laser.state is LaserState.READY
        d.clock.sleep_s(5.0)
        assert d.pulses(Role.Q_SWITCH_1) == d.pulses(Role.Q_SWITCH_2) == d.pulses(Role.CAMERA) == 0


def test_a_pulse_without_an_output_is_refused_and_not_left_out():
    straddling = PairExposures(900.0, 900.0, 100.0, two_triggers=True)
    with desk() as d:  # whose camera has one trigger
        d.laser.open("sim://desk")
        d.laser.warm(10.0)
        d.clock.sleep_s(1.1)
        with pytest.raises(PulsesRefused, match="camera_b"):
            d.laser.set(PulseTiming(200.0, 10.0), straddling)
        assert d.laser.state is LaserState.READY
