"""Where the pulses of a pair fall, and what is refused in a sentence."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.timing.errors import PulsesRefused
from daq.timing.pulses import LaserHead, PairExposures, PulseTiming, Role, schedule_of
from tests.loops import loop_over

LAMPS = LaserHead(
    max_rate_hz=15.0, lamp_to_q_switch_us=[180.0, 185.0], q_switch_to_light_us=[0.1, 0.2], min_dt_us=1.0
)
DOUBLE = PairExposures(exposure_a_us=100.0, exposure_b_us=60_000.0, gap_us=1.5, start_delay_us=3.0, margin_us=1.0)


def lights(schedule):
    return [
        schedule.pulses[role].delay_us + schedule.light_delay_us[n]
        for n, role in enumerate((Role.Q_SWITCH_1, Role.Q_SWITCH_2))
    ]


@given(
    dt_us=st.floats(0.1, 1e5),
    rate_hz=st.floats(0.5, 20.0),
    a_us=st.floats(1.0, 5e4),
    b_us=st.floats(1.0, 5e4),
    gap_us=st.floats(0.1, 1e3),
    delay_us=st.floats(0.0, 1e3),
    margin_us=st.floats(0.0, 50.0),
)
def test_light_falls_into_both_exposures_or_is_refused(dt_us, rate_hz, a_us, b_us, gap_us, delay_us, margin_us):
    exposures = PairExposures(a_us, b_us, gap_us, delay_us, margin_us)
    try:
        schedule = schedule_of(PulseTiming(dt_us, rate_hz), LAMPS, exposures)
    except PulsesRefused:
        return
    first_us, second_us = lights(schedule)
    begin_us = schedule.pulses[Role.CAMERA].delay_us + delay_us
    tiny = 1e-6
    assert begin_us + margin_us - tiny <= first_us <= begin_us + a_us - margin_us + tiny
    begin_b_us = begin_us + a_us + gap_us
    assert begin_b_us + margin_us - tiny <= second_us <= begin_b_us + b_us - margin_us + tiny
    assert math.isclose(second_us - first_us, dt_us, abs_tol=tiny)
    assert math.isclose(schedule.dt_us, dt_us, abs_tol=tiny)
    assert min(pulse.delay_us for pulse in schedule.pulses.values()) == 0.0
    assert max(pulse.end_us for pulse in schedule.pulses.values()) < schedule.period_us


def test_each_lamp_leads_its_q_switch():
    pulses = schedule_of(PulseTiming(20.0, 10.0), LAMPS, DOUBLE).pulses
    assert pulses[Role.Q_SWITCH_1].delay_us - pulses[Role.LAMP_1].delay_us == pytest.approx(180.0)
    assert pulses[Role.Q_SWITCH_2].delay_us - pulses[Role.LAMP_2].delay_us == pytest.approx(185.0)


def test_the_marker_covers_exposure_a_and_not_b():
    schedule = schedule_of(PulseTiming(20.0, 10.0), LAMPS, DOUBLE)
    marker, camera = schedule.pulses[Role.MARKER], schedule.pulses[Role.CAMERA]
    begin_us = camera.delay_us + DOUBLE.start_delay_us
    assert marker.delay_us <= begin_us
    assert begin_us + 100.0 < marker.end_us < begin_us + 100.0 + DOUBLE.gap_us


def test_a_second_trigger_begins_exposure_b():
    straddling = PairExposures(9900.0, 9900.0, 100.0, two_triggers=True)
    pulses = schedule_of(PulseTiming(500.0, 10.0), LaserHead(max_rate_hz=100.0), straddling).pulses
    assert pulses[Role.CAMERA_B].delay_us - pulses[Role.CAMERA].delay_us == pytest.approx(10_000.0)


@loop_over("timing, head, exposures, words",
    [
        ((200_000.0, 10.0), LAMPS, DOUBLE, "longer than the 100000 us from pair to pair"),
        ((90_000.0, 10.0), LAMPS, DOUBLE, "does not fit into the two exposures of the camera: 3.5 to"),
        ((2.0, 10.0), LAMPS, DOUBLE, "does not fit into the two exposures"),
        ((20.0, 16.0), LAMPS, DOUBLE, "more than the laser's 15"),
        ((20.0, 12.0), LaserHead(max_rate_hz=50.0), PairExposures(100.0, 1e3, 2.0, max_rate_hz=11.5), "camera's"),
        ((20.0, 15.0), LAMPS, PairExposures(1e4, 60_000.0, 2.0), "two exposures take"),
        ((0.5, 10.0), LAMPS, DOUBLE, "laser's 1 to"),
        ((math.nan, 10.0), LAMPS, DOUBLE, "use a number above 0"),
        ((20.0, 0.0), LAMPS, DOUBLE, "use a number above 0"),
        ((20.0, -1.0), LAMPS, DOUBLE, "use a number above 0"),
        ((20.0, math.inf), LAMPS, DOUBLE, "use a number above 0"),
        ((20.0, 9.0), LaserHead(max_rate_hz=15.0, lamp_rate_hz=10.0), DOUBLE, "run at 10 Hz and at no other"),
        ((20.0, 10.0), LaserHead(max_rate_hz=15.0, pulse_us=30.0), DOUBLE, "run into each other"),
        ((400.0, 800.0), LaserHead(max_rate_hz=1e3, pulse_us=350.0), PairExposures(6e2, 6e2, 2.0), "more than 50"),
    ],
)  # fmt: skip
def test_what_does_not_go_together_is_refused(timing, head, exposures, words):
    with pytest.raises(PulsesRefused, match=words):
        schedule_of(PulseTiming(*timing), head, exposures)
