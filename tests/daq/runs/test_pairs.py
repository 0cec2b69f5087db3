"""Pairs come from what a run wrote: moved by a measured way, or a time apart; a lost partner swaps nothing."""

import numpy as np
import pytest

from daq.errors import RunUnsuitable
from daq.runs.displacement import Moved, write_displacements
from daq.runs.journal import Journal
from daq.runs.pairs import pairs_of
from daq.runs.run_folder import RunFolder
from piv.errors import PairError
from tests.daq.small_run import about_run, keep_frame, planned

PIXELS = np.full((4, 4), 7, np.uint16)
PERIOD_NS, WITHIN_NS = 66_000_000, 25_000


def stamp(place, first=0):
    """Camera's clock of a double-frame camera whose frame number `first` begins a pair."""
    pulse = place - first
    return 10**9 + PERIOD_NS * (pulse // 2) + WITHIN_NS * (pulse % 2)


def stream(path, numbers, frames=8, group=2, clock=stamp, restart=10**9):
    """A stream on the disk; from frame `restart` on the camera was armed again, and counts from 0."""
    step = planned(0, "stream_glass", frames=frames) | {"group": group}
    folder = RunFolder.create(path, "stream", about_run([step]))
    journal = Journal(folder.journal_path)
    for number in numbers:
        sequence = number - restart if number >= restart else number
        facts = {"sequence": sequence, "timestamp_ns": clock(number), "tag": "stream_glass"}
        keep_frame(folder, journal, number, PIXELS, **facts)
    journal.close()
    return folder.path


def numbers_of(found):
    return [tuple(int(frame.stem) for frame in pair.frames) for pair in found.pairs]


@pytest.mark.parametrize("lost", range(8))
def test_one_lost_frame_breaks_one_pair_only(tmp_path, lost):
    found = pairs_of(stream(tmp_path, [n for n in range(8) if n != lost]))
    broken = lost // 2
    assert numbers_of(found) == [(2 * k, 2 * k + 1) for k in range(4) if k != broken]
    assert found.alone == (lost ^ 1,)
    assert [pair.dt_s for pair in found.pairs] == [pytest.approx(25e-6)] * 3
    assert all(pair.glass and pair.measured_mm is None for pair in found.pairs)
    assert found.pairs[0].tag == f"stream_glass_{numbers_of(found)[0][0]:06d}"


def test_neighbours_within_a_group_are_pairs_and_groups_do_not_mix(tmp_path):
    found = pairs_of(stream(tmp_path, range(8), group=4, clock=lambda n: 1000 * (n + 1)))
    assert numbers_of(found) == [(0, 1), (1, 2), (2, 3), (4, 5), (5, 6), (6, 7)]


def test_a_stream_that_was_armed_again_goes_on_with_whole_pairs(tmp_path):
    found = pairs_of(stream(tmp_path, [0, 1, 2, 4, 5, 6, 7], restart=4))
    assert numbers_of(found) == [(0, 1), (4, 5), (6, 7)]
    assert found.alone == (2,)


def test_without_a_clock_there_are_pairs_but_no_time(tmp_path):
    found = pairs_of(stream(tmp_path, range(4), frames=4, clock=lambda _: 0))
    assert numbers_of(found) == [(0, 1), (2, 3)]
    assert [pair.dt_s for pair in found.pairs] == [None, None]


def test_a_camera_that_was_armed_between_two_exposures_is_found_out(tmp_path):
    with pytest.raises(PairError, match="was not the first of a pair"):
        pairs_of(stream(tmp_path, range(8), clock=lambda n: stamp(n, first=1)))


def test_a_clock_that_runs_backwards_is_refused(tmp_path):
    with pytest.raises(PairError, match="frame 1 was exposed before frame 0"):
        pairs_of(stream(tmp_path, range(8), clock=lambda n: 10**6 - n))


def test_a_shift_run_says_what_was_measured(tmp_path):
    steps = [planned(0, "a"), planned(1, "b", reference=0), planned(2, "c", "clear"),
             planned(3, "d", "clear", reference=2)]  # fmt: skip
    folder = RunFolder.create(tmp_path, "shift", about_run(steps))
    journal = Journal(folder.journal_path)
    for number, tag in enumerate("abc"):
        keep_frame(folder, journal, number, PIXELS, step=number, tag=tag)
    journal.close()
    with pytest.raises(RunUnsuitable, match="holds no displacements"):
        pairs_of(folder.path)
    way, real = (1.0, 0.0, 0.0), (1.001, 0.0, 0.0)
    ways = {"commanded_mm": way, "measured_mm": real, "true_mm": None}
    write_displacements(folder, [Moved(tag="b", frames=(0, 1), **ways), Moved(tag="d", frames=(2, 3), **ways)])
    found = pairs_of(folder.path)
    assert [(pair.tag, pair.glass, pair.commanded_mm, pair.measured_mm, pair.dt_s) for pair in found.pairs] == [
        ("b", True, way, real, None)
    ]
    assert numbers_of(found) == [(0, 1)]


@pytest.mark.parametrize(("group", "numbers", "error", "words"), [
    (1, range(4), PairError, "no frames of this run form pairs"),
    (2, [0, 3], RunUnsuitable, "no pair is complete"),
])  # fmt: skip
def test_what_has_no_pairs_is_one_sentence(tmp_path, group, numbers, error, words):
    with pytest.raises(error, match=words):
        pairs_of(stream(tmp_path, numbers, group=group))
