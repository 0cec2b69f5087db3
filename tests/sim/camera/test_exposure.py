"""The shutter's rules, on a time line of microseconds written out by hand."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from sim.camera.exposure import Shutter


def test_exposure_overlaps_the_readout_before_it_but_does_not_end_in_it():
    shutter = Shutter()
    assert shutter.fire(0, 100, 1000)[0].read_ns == 1100
    assert not shutter.fire(50, 100, 1000)  # still exposing
    assert not shutter.fire(999, 100, 1000)  # would end at 1099, one before the readout does
    (second,) = shutter.fire(1000, 100, 1000)
    assert (second.start_ns, second.end_ns, second.read_ns) == (1000, 1100, 2100)
    assert shutter.missed == 2


def test_a_long_exposure_does_not_wait_for_the_readout():
    shutter = Shutter()
    shutter.fire(0, 5000, 1000)
    assert shutter.earliest_ns(5000) == 5000
    assert shutter.fire(5000, 5000, 1000)


def test_double_frame_second_image_is_exposed_until_the_first_is_read():
    first, second = Shutter().fire(0, 100, 1000, 150)
    assert (first.start_ns, first.end_ns, first.read_ns) == (0, 100, 1100)
    assert (second.start_ns, second.end_ns, second.read_ns) == (150, 1100, 2100)


def test_second_image_never_starts_before_the_first_has_ended():
    _, second = Shutter().fire(0, 100, 1000, 10)
    assert second.start_ns == 100


@given(st.lists(st.integers(0, 3000), min_size=1, max_size=40), st.integers(1, 2000), st.integers(1, 2000))
def test_one_sensor_never_exposes_or_reads_two_images_at_once(steps, exposure, readout):
    shutter, now, taken = Shutter(), 0, []
    for step in steps:
        now += step
        taken += shutter.fire(now, exposure, readout)
    for before, after in itertools.pairwise(taken):
        assert after.start_ns >= before.end_ns
        assert after.read_ns - readout >= before.read_ns
    assert len(taken) + shutter.missed == len(steps)
