"""A person and another program at the timing unit of a rehearsal: off ends the light, wherever it falls."""

import pytest

import rtpiv
from daq.timing.conditions import Conditions
from daq.timing.pulses import PairExposures, PulseTiming
from sim.rehearsed import Rehearsed
from tests.daq.flow_bench import DIODES, LAMPS, write_flow
from tests.slow_cases import slow

GOOD = Conditions(True, True, True, 5.0, 1000)
OF_DG645 = "q_switch_1: AB, q_switch_2: CD, camera: EF"
UNITS = {
    "qc9520 with lamps": ("qc9520", LAMPS),
    "qc9520": ("qc9520", DIODES),
    "srs_dg645": ("srs_dg645", OF_DG645),
}
WORDS = {"qc9520": (":PULSE0:STAT?", ":BCO", ":PULSE0:STAT 1"), "srs_dg645": ("BURC", "TSRC", "*TRG")}


def is_fired(bench):
    """Whether three bursts of 4 pairs are fired to their end."""
    try:
        fire(bench)
    except rtpiv.ERRORS:
        return False
    return True


def fire(bench):
    laser = bench.device("laser")
    laser.warm(20.0)
    bench.simulation.clock.sleep_s(laser.warm_in_s + 0.1)
    laser.set(PulseTiming(20.0, 20.0), PairExposures(100.0, 20_000.0, 2.0))
    for _ in range(3):
        laser.arm(GOOD, laser.challenge)
        laser.fire(4)
        laser.wait()


FAST = {("qc9520 with lamps", "off"), ("qc9520", "stop"), ("srs_dg645", "off")}
CASES = [(unit, what) for unit in UNITS for what in ("off", "stop")]


@pytest.mark.parametrize(("unit", "what"), [case if case in FAST else slow(*case) for case in CASES])
def test_who_ends_the_light_of_a_rehearsal_has_ended_it(tmp_path, unit, what):
    """Before, in and behind the first of three bursts; what is pressed while nothing runs stops nothing."""
    box, channels = UNITS[unit]
    ends = 0
    for number, (word, nth) in enumerate(
        (word, nth) for word in WORDS[box] for nth in ((1, 2, 9) if what == "off" else (2, 9))
    ):
        path, _ = write_flow(tmp_path / str(number), channels=LAMPS if channels == LAMPS else DIODES)
        text = path.read_text().replace("box: qc9520", f"box: {box}")
        path.write_text(text.replace(f"channels: {{{DIODES}}}", f"channels: {{{channels}}}"))
        with Rehearsed(path, faults=[{"what": what, "of": "laser", "word": word, "nth": nth}], seed=3) as bench:
            has_ended = not is_fired(bench)
            happened = bench.event_log()
        assert not happened.violations, (word, nth)
        assert (len(happened.of_kind("light")) < 24) == has_ended
        ends += has_ended
    assert ends >= 3
