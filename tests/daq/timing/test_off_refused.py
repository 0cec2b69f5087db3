"""Off to a Quantum Composers box that refuses it, answers it late, or loses it."""

from contextlib import suppress

import pytest

from daq.errors import DaqError
from daq.timing.drivers.quantum_composers import OUTPUTS
from daq.timing.errors import LaserDoubt, TimingUsageError
from daq.timing.pulses import Q_SWITCHES, LaserHead, PulseTiming, Role
from daq.timing.states import LaserState
from sim.emulators.faults import Fault
from sim.timing_boxes.quantum_composers import RESET
from stages.errors import CommandRejected, StageError
from tests.daq.timing.quantum_desk import EXPOSURES, GOOD, PUMPED, desk


@pytest.mark.parametrize("times", [3, 5, 10**6])
def test_a_box_that_refuses_to_stop_t0_is_off_before_fire_returns(times):
    """Its outputs come on in the string that begins the burst, while T0 runs on."""
    with desk() as d:
        d.to_armed()
        d.emulator.refuses_off.update(dict.fromkeys(range(5), times))
        begun_s = d.clock.now_s()
        with pytest.raises(CommandRejected, match=r":PULSE0:STAT 0"):
            d.laser.fire(50)
        assert d.laser.state is LaserState.FAULT  # off, and a person has to look
        given = d.pulses(Role.Q_SWITCH_1)
        assert d.clock.now_s() - begun_s < (1.0 if times < 10 else 3.0)
        d.clock.sleep_s(10.0)
        assert d.pulses(Role.Q_SWITCH_1) == given <= 1  # reset at once
        d.emulator.refuses_off.clear()
        d.laser.safe()
        d.laser.warm(10.0)
        d.clock.sleep_s(1.1)
        d.laser.set(PulseTiming(20.0, 10.0), EXPOSURES)  # what the reset has taken is loaded again
        d.laser.arm(GOOD, d.laser.challenge)
        d.laser.fire(5)
        d.laser.wait()
        assert d.pulses(Role.Q_SWITCH_1) == given + 5


def test_a_refusal_while_it_begins_switches_off():
    with desk() as d:
        d.to_armed()
        d.line.hooks.after(33, "write", lambda: setattr(d.emulator, "refuse", 1))
        for _ in range(3):  # wherever the refusal falls
            if d.laser.state is LaserState.ARMED:
                with pytest.raises(CommandRejected, match="not in this state"):
                    d.laser.fire(5)
        d.clock.sleep_s(3.0)
        assert d.laser.state is LaserState.FAULT
        assert not d.emulator.is_on_at(0)


def test_a_slow_box_that_refuses_t0_loses_its_q_switches_though_no_answer_comes():
    """Found by the fuzz: of each write such a box hears the first line, which was always that of T0."""
    with desk(needs_s=0.04, echo=True) as d:
        d.firing(50, 0.5)
        d.emulator.refuses_off[0] = 99
        stopped_s = d.clock.now_s()
        d.line.faults.mute()
        d.laser.stop("now")
        d.clock.sleep_s(5.0)
        d.emulator.advance()
        plugs = [d.box.wiring[role] for role in Q_SWITCHES]
        light_s = [pulse.rises_s for pulse in d.emulator.outputs.recent if pulse.output in plugs]
        assert light_s
        assert max(light_s) - stopped_s < 0.3


@pytest.mark.parametrize("role", Q_SWITCHES)
@pytest.mark.parametrize("times", [3, 5, 99])
def test_a_slow_box_that_refuses_t0_and_a_q_switch_is_reset_before_anything_is_asked(role, times):
    """Found by the fuzz: light left for a second more while it was asked what it is, and what is on."""
    with desk(needs_s=0.04) as d:
        d.firing(50, 0.5)
        number = 1 + OUTPUTS.index(d.box.wiring[role])
        d.emulator.refuses_off.update({0: 99, number: times})
        stopped_s = d.clock.now_s()
        d.laser.stop("now")
        d.clock.sleep_s(5.0)
        d.emulator.advance()
        last_s = max(pulse.rises_s for pulse in d.emulator.outputs.recent if pulse.output == d.box.wiring[role])
        assert stopped_s - 0.2 < last_s < stopped_s + 0.4


def test_off_is_said_twice_to_a_box_that_refuses_it():
    """Found by the fuzz: every line of off was answered by ?8, and the burst went on."""
    with desk(wiring=PUMPED, head=LaserHead(max_rate_hz=100.0), outputs=4) as d:
        d.firing(50, 0.5)
        before = d.pulses(Role.Q_SWITCH_1)
        d.emulator.refuse = 5
        d.laser.stop("now")
        d.clock.sleep_s(5.0)
        assert d.pulses(Role.Q_SWITCH_1) == before > 0


@pytest.mark.parametrize("refused", [1, 2, 5])
def test_off_reaches_a_box_that_loses_lines_and_refuses_those_that_it_hears(refused):
    """Found by the fuzz: off was said twice, then it was asked who answers, and pulses left for two seconds."""
    with desk(wiring=PUMPED, head=LaserHead(max_rate_hz=100.0), outputs=4, needs_s=0.04) as d:
        d.firing(90, 0.5)
        d.emulator.refuse = refused
        told_s = d.clock.now_s()
        d.laser.stop("now")
        d.clock.sleep_s(5.0)
        last_s = max(pulse.rises_s for pulse in d.emulator.outputs.recent)
        assert told_s - 0.2 < last_s < told_s + 0.4
        assert not d.emulator.is_on_at(0)


@pytest.mark.parametrize("refuse", [0, 5])
@pytest.mark.parametrize("kind", ["doubled", "late", "lost", "cut", "garbled"])
def test_a_burst_made_endless_ends_though_its_off_is_refused_and_the_answer_is_damaged(kind, refuse):
    """Found by the fuzz: off was said twice in 0.3 s, then it was asked who answers, for a second."""
    pumped = {**PUMPED, Role.MARKER: PUMPED[Role.CAMERA_B]}
    del pumped[Role.CAMERA_B]
    with desk(wiring=pumped, head=LaserHead(max_rate_hz=100.0), outputs=4, needs_s=0.04) as d:
        d.to_armed()
        d.laser.fire(3)
        d.emulator.set_inside(1, "CMOD", "NORM")
        d.emulator.refuses_off.update({1: 2, 3: 2} if refuse == 0 else {})
        d.emulator.refuse = refuse
        d.line.faults.strike(Fault(kind, 0))
        with suppress(DaqError, StageError):
            d.laser.wait()
        d.clock.sleep_s(2.0)
        d.emulator.advance()
        light_s = [pulse.rises_s for pulse in d.emulator.outputs.recent if pulse.output == "A"]
        assert len(light_s) > 3
        assert light_s[-1] - light_s[0] < (1.05 if refuse else 0.85)  # 0.3 s, grace, LATE_S; refused


@pytest.mark.parametrize("number", [0, 1, 2, 4, 5])
def test_an_output_that_can_never_be_switched_off_is_named_and_nothing_is_armed(number):
    """Whatever a box answers to "off", the state of an output is what reads back."""
    with desk() as d:
        d.emulator.set_inside(number, "STAT", "1")
        d.emulator.refuses_off[number] = d.emulator.refuses_off[RESET] = 10**6
        d.laser.open("sim://desk")
        assert d.laser.state is LaserState.UNKNOWN
        name = "T0" if number == 0 else f"output {'ABCDEFGH'[number - 1]}"
        with pytest.raises(LaserDoubt, match=rf"{name} of the box cannot be switched off .*not in this state"):
            d.laser.safe()
        with pytest.raises(TimingUsageError, match="only safe"):
            d.laser.warm(10.0)
        assert [number] == [n for n in range(9) if d.emulator.is_on_at(n)]
        d.box.may_be_on = True
        with pytest.raises(LaserDoubt, match="may still give light"):
            d.laser.close()


@pytest.mark.parametrize("number", [0, 2, 4])
@pytest.mark.parametrize("times", [1, 2, 3, 4])
def test_a_refusal_of_off_does_not_let_light_go_on(number, times):
    """T0 is refused: the Q-switches are off.  A Q-switch is refused: T0 is.  Said again it is all off."""
    with desk() as d:
        d.firing()
        before = d.pulses(Role.Q_SWITCH_1)
        d.emulator.refuses_off[number] = times
        d.laser.stop("now")
        d.clock.sleep_s(1.0)
        assert d.pulses(Role.Q_SWITCH_1) == d.pulses(Role.Q_SWITCH_2) == before > 0
        assert d.laser.state is LaserState.UNKNOWN
        assert d.laser.confirm_off()
        assert d.laser.state is LaserState.FAULT
        assert not any(d.emulator.is_on_at(n) for n in range(9))


@pytest.mark.parametrize("number", [1, 2, 4])
@pytest.mark.parametrize("needs_s", [0.0, 0.045])
def test_what_refuses_off_again_and_again_is_off_after_one_reading_back(number, needs_s):
    """Found by the fuzz: on a slow box each attempt takes two seconds, and who left the bench gave up before."""
    with desk(needs_s=needs_s) as d:
        d.firing()
        d.emulator.refuses_off[number] = 7 if needs_s else 11
        d.laser.stop("now")
        assert d.laser.confirm_off()
        assert not any(d.emulator.is_on_at(n) for n in range(9))


def test_a_box_that_refuses_every_off_ends_with_its_count_and_stays_in_doubt():
    with desk() as d:
        d.firing(30)
        for number in (RESET, *range(9)):
            d.emulator.refuses_off[number] = 10**6
        d.laser.stop("now")
        assert not d.laser.confirm_off()
        d.clock.sleep_s(10.0)
        assert d.pulses(Role.Q_SWITCH_1) == d.pulses(Role.Q_SWITCH_2) == 30
        assert not d.laser.confirm_off()
        assert d.laser.state is LaserState.UNKNOWN


@pytest.mark.parametrize("answers", [range(40), range(0, 40, 2), (0,), (3, 4, 5)])
def test_off_that_is_answered_late_is_dark_at_once_and_believed_when_it_reads_back(answers):
    with desk() as d:
        d.firing()
        before = d.pulses(Role.Q_SWITCH_1)
        heard = d.line.faults._count
        for number in answers:
            d.line.faults._by_answer[heard + number] = Fault("late", heard + number, delay_s=1.5)
        d.laser.stop("now")
        tries = 0
        while not d.laser.confirm_off():
            tries += 1
            assert d.laser.state is LaserState.UNKNOWN
            assert tries < 20
        assert d.pulses(Role.Q_SWITCH_1) == before > 0
        assert d.laser.state is LaserState.FAULT
