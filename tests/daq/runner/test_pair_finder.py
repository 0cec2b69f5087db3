"""Whatever a camera does, two frames of different pulses are never a pair, and every frame is accounted for."""

import random

import pytest

from daq.bench.pairs_section import PairsSection
from daq.runner.pair_finder import (
    ALONE,
    DOUBLED,
    NO_CLOCK,
    UNMARKED,
    UNSURE,
    MarkerPolarity,
    PairFinder,
    longest_gap,
)
from tests.daq.runner.frame_trains import RATE_HZ, SECTIONS, Faults, arms, gap_us, train
from tests.loops import loop_over
from tests.slow_cases import slow

KIND = Faults(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def found_in(section, frames, rate_hz=RATE_HZ):
    """Pairs of one arm, as pulses and letters, and its finder; what was rejected is in its `items`."""
    rejected = []
    finder = PairFinder(section, rate_hz, gap_us(section), rejected.append)
    found = [pair for meta, shows in frames if (pair := finder.add(meta, shows))]
    found += [pair] if (pair := finder.end()) else []
    assert len(rejected) == sum(finder.rejected.values())
    assert 2 * len(found) + len(rejected) == len(frames)
    return found, finder


def swapped(pairs):
    return [pair for pair in pairs if pair[0][0] != pair[1][0] or (pair[0][1], pair[1][1]) != ("A", "B")]


def judged(name, pairs, seed, faults=None):
    """Pairs fired, found and swapped."""
    section, fired, right, wrong = SECTIONS[name], 0, 0, 0
    for number, frames in arms(section, pairs, faults or Faults(), seed):
        found, _ = found_in(section, frames)
        wrong += len(swapped(found))
        right += len({pair[0][0] for pair in found})
        assert len(found) == len({pair[0][0] for pair in found})  # no pulse twice
        fired += number
    return fired, right, wrong


@pytest.mark.parametrize(("count", "seed"), [(5000, 1), slow(100_000, 2)])
@pytest.mark.parametrize("name", SECTIONS)
def test_no_pair_is_ever_swapped(name, count, seed):
    fired, found, wrong = judged(name, count, seed)
    print(f"{name}: {fired} fired, {found} pairs, {wrong} swapped, {fired - found} lost and counted")
    assert (fired, wrong) == (count, 0)
    assert found > 0.8 * fired  # and it is not by finding none


@pytest.mark.parametrize("name", SECTIONS)
def test_a_kind_camera_loses_nothing(name):
    assert judged(name, 500, seed=3, faults=KIND) == (500, 500, 0)


@loop_over("name", SECTIONS)
@loop_over("first", [1, 2, 3])
def test_first_frames_that_were_skipped_cost_their_pairs_and_no_other(name, first):
    section = SECTIONS[name]
    frames = list(train(section, 40, KIND, random.Random(0)))
    frames = frames[2 * first if section.shape == "double_height" else first :]
    found, _ = found_in(section, frames)
    lost = first if section.shape == "double_height" else -(-first // 2)
    assert [pair[0][0] for pair in found] == list(range(lost, 40))
    assert not swapped(found)


@pytest.mark.parametrize("name", [name for name in SECTIONS if "line" in name or "counter" in name])
def test_a_frame_without_its_marker_is_in_no_pair(name):
    section = SECTIONS[name]
    unmarked = 0
    for _, frames in arms(section, 2000, Faults(unmarked=0.02), seed=5):
        found, finder = found_in(section, [(meta, (meta, shows)) for meta, shows in frames])
        assert all(meta.chunks for pair in found for meta, _ in pair)
        assert not swapped([(one[1], two[1]) for one, two in found])
        unmarked += finder.rejected[UNMARKED]
    assert unmarked > 20


@pytest.mark.parametrize(
    "name", ["straddling, line", "straddling, counter", "straddling, spacing", "burst, spacing"]
)
def test_half_the_train_at_another_rate_is_no_pair(name):
    """A box that runs at twice the rate, and a camera that misses every second and third trigger."""
    section = SECTIONS[name]
    frames = list(train(section, 60, KIND, random.Random(0)))
    picked = [frame for place, frame in enumerate(frames) if place % 4 in (0, 3)]
    numbers = [(type(meta)(**{**_fields(meta), "sequence": n}), shows) for n, (meta, shows) in enumerate(picked)]
    found, _ = found_in(section, numbers, rate_hz=RATE_HZ / 2)
    assert not found


def _fields(meta):
    return {name: getattr(meta, name) for name in meta.__slots__}


def test_even_frames_are_no_pairs_by_their_spacing():
    even = PairsSection(shape="straddling", marker="spacing", dead_us=46_000.0)
    found, finder = found_in(even, list(train(even, 50, KIND, random.Random(0))))
    assert not found
    assert finder.rejected[ALONE] == 100


def test_a_marker_that_is_stuck_gives_no_pairs():
    section = SECTIONS["straddling, line"]
    for bits in (0, 1):
        frames = [(_with(meta, chunks={"LineStatusAll": bits}), shows)
                  for meta, shows in train(section, 50, KIND, random.Random(0))]  # fmt: skip
        found, _ = found_in(section, frames)
        assert not found


EVEN = [name for name in SECTIONS if name in ("straddling, line", "straddling, counter")]


def wired_to_b(section, meta, shows):
    """The same frame, seen by a marker that is high during B, or by a counter that the trigger of B resets."""
    if section.effective_marker == "counter":
        return _with(meta, chunks={section.counter: 1 if shows[1] == "B" else 2})
    return _with(meta, chunks={"LineStatusAll": (1 << section.line) * (shows[1] == "B")})


def sensed(name, pairs, seed, is_wrong, faults=None):
    """Chunks after which the sense of a marker was doubted, None if never; and pairs that were swapped."""
    section, wrong, after = SECTIONS[name], 0, None
    sense = MarkerPolarity(section)
    for number, (_, frames) in enumerate(arms(section, pairs, faults or Faults(), seed)):
        if is_wrong:
            frames = [(wired_to_b(section, meta, shows), shows) for meta, shows in frames]
        found, finder = found_in(section, frames)
        wrong += len(swapped(found))
        sense.chunk_ended(finder.last)
        after = number + 1 if after is None and sense.objection(False) else after
    return after or (number + 1 if sense.objection(True) else None), wrong


@pytest.mark.parametrize("name", EVEN)
def test_a_marker_on_exposure_b_of_even_frames_ends_the_run(name):
    for seed in range(8):
        after, wrong = sensed(name, 500, seed, is_wrong=True)
        assert wrong > 300  # no single pair shows it
        assert after <= 5
        assert sensed(name, 50, seed, is_wrong=True, faults=KIND)[0] == 1  # a run of one chunk
        assert sensed(name, 500, seed, is_wrong=False) == (None, 0)


@pytest.mark.slow
@pytest.mark.parametrize("name", EVEN)
def test_a_right_marker_is_trusted_and_a_wrong_one_found_in_a_hundred_thousand_pairs(name):
    assert sensed(name, 100_000, seed=4, is_wrong=False) == (None, 0)
    found = [sensed(name, 500, seed, is_wrong=True)[0] for seed in range(200)]
    print(f"{name}: found after {sum(found) / len(found):.2f} chunks, at most {max(found)}")
    assert max(found) <= 10


@pytest.mark.parametrize("name", [name for name in SECTIONS if name not in EVEN])
def test_the_ends_of_chunks_tell_nothing_where_the_frames_themselves_do(name):
    sense = MarkerPolarity(SECTIONS[name])
    for _ in range(10):
        sense.chunk_ended("A")
    assert sense.objection(True) is None


@pytest.mark.parametrize("name", [name for name in SECTIONS if name not in EVEN and SECTIONS[name].chunks])
def test_a_marker_on_exposure_b_of_uneven_frames_gives_no_pairs(name):
    section = SECTIONS[name]
    for _, frames in arms(section, 500, KIND, seed=8):
        assert not found_in(section, [(wired_to_b(section, meta, shows), shows) for meta, shows in frames])[0]


def test_a_camera_without_a_clock_gives_no_pairs():
    section = SECTIONS["straddling, line"]
    frames = [(_with(meta, timestamp_ns=0), shows) for meta, shows in train(section, 5, KIND, random.Random(0))]
    found, finder = found_in(section, frames)
    assert (found, finder.rejected[NO_CLOCK]) == ([], 10)


def test_a_doubled_frame_costs_no_pair():
    section = SECTIONS["two_blocks, line"]
    for _, frames in arms(section, 500, Faults(0, 0.0, 0.0, 0.1, 0.05, 0.0, 0.0), seed=7):
        found, finder = found_in(section, frames)
        assert len(found) == 50
        assert finder.rejected[DOUBLED] == len(frames) - 100


def test_halves_of_a_camera_without_a_clock_are_pairs_and_one_that_comes_twice_is_doubled():
    section = SECTIONS["double_height"]
    frames = [(_with(meta, timestamp_ns=0), shows) for meta, shows in train(section, 5, KIND, random.Random(0))]
    found, finder = found_in(section, [each for each in frames for _ in "ab"])
    assert [pair[0][0] for pair in found] == [0, 1, 2, 3, 4]
    assert finder.rejected == {DOUBLED: 10}


def _with(meta, **more):
    return type(meta)(**{**_fields(meta), **more})


@pytest.mark.parametrize(("keys", "words"), [
    ({"shape": "straddling"}, "A and B need a marker"),
    ({"shape": "burst"}, "A and B need a marker"),
    ({"shape": "two_blocks", "marker": "halves"}, "A and B need a marker"),
    ({"shape": "double_height", "marker": "spacing"}, "leave the marker out"),
    ({"shape": "straddling", "marker": "line_status"}, "line_status needs line"),
    ({"shape": "straddling", "marker": "counter"}, "counter needs counter"),
    ({"shape": "straddling", "marker": "spacing", "second_exposure_us": 3.0}, "have one exposure"),
])  # fmt: skip
def test_what_cannot_be_told_apart_is_refused(keys, words):
    with pytest.raises(ValueError, match=words):
        PairsSection(dead_us=1.0, **keys)


def test_the_longest_gap_leaves_ten_per_cent():
    spaced = longest_gap(SECTIONS["straddling, spacing"])
    assert (1 - spaced) / spaced == pytest.approx(1.1)


@loop_over("name", [name for name in SECTIONS if SECTIONS[name].shape != "double_height"])
@loop_over("lost", [True, False])
def test_a_frame_between_a_and_b_is_noticed_by_its_id_although_it_never_came(name, lost):
    """The right marks, at the right distance; but the camera has counted one more in between."""
    section = SECTIONS[name]
    frames = list(train(section, 6, KIND, random.Random(0)))
    numbers = [place + (place >= 5 and lost) for place in range(len(frames))]  # before the B of pulse 2
    found, finder = found_in(
        section, [(_with(meta, sequence=n), shows) for n, (meta, shows) in zip(numbers, frames, strict=True)]
    )
    assert [pair[0][0] for pair in found] == ([0, 1, 3, 4, 5] if lost else [0, 1, 2, 3, 4, 5])
    assert finder.rejected[UNSURE] == (2 if lost else 0)
