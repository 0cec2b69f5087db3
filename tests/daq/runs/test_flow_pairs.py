"""Pairs of a flow know dt, its sigma and when they were; lines that contradict one another are named."""

import numpy as np
import pytest

from daq.errors import RunDamaged
from daq.runs.journal import Journal
from daq.runs.pairs import pairs_of
from daq.runs.run_folder import RunFolder
from piv.errors import PairError
from tests.daq.small_run import about_run, keep_frame, planned
from tests.loops import loop_over

PIXELS = np.full((4, 4), 7, np.uint16)
PERIOD_NS = 100_000_000
SESSION = {"versions": {}, "steps_left": 1}


def flow(path, change=lambda number, facts: facts, numbers=range(8), sessions=((0, 0, 0),), background=2):
    """A flow of four pairs, the first `background` frames of it without seeding, as the runner leaves it.

    A session is (first frame, seconds after the run began, the camera's clock then less what it would be).
    """
    pulses = {"dt_us": 80.0, "group": 2}
    steps = [planned(0, "background_glass", frames=background) | pulses | {"background": True},
             planned(1, "flow_glass", frames=8 - background, first_frame=background) | pulses]  # fmt: skip
    folder = RunFolder.create(path, "flow", about_run(steps))
    journal = Journal(folder.journal_path)
    begun = {first: (after_s, shift_ns) for first, after_s, shift_ns in sessions}
    after_s = shift_ns = 0
    for number in numbers:
        if number in begun:
            after_s, shift_ns = begun[number]
            utc = f"2026-01-01T00:{after_s // 60:02d}:{after_s % 60:02d}.000+00:00"
            journal.append("session", utc=utc, monotonic_ns=10**9, **SESSION)
        first = max(place for place in begun if place <= number)
        exposed_ns = PERIOD_NS * (number // 2) + PERIOD_NS // 2 * (number % 2)
        since_ns = exposed_ns - PERIOD_NS * (first // 2)
        before = number < background
        said = {"background": True} if before else {}
        pair = {"exposure": "AB"[number % 2], "chunk": 0, "dt_us": 80.0, "dt_measured_us": 80.2,
                "dt_sigma_us": 0.05, "marker": "line_status", **said}  # fmt: skip
        facts = {"sequence": number, "timestamp_ns": 5 * 10**9 + exposed_ns + shift_ns, "step": int(not before),
                 "received_ns": 10**9 + since_ns, "tag": steps[not before]["tag"], "pair": pair}  # fmt: skip
        keep_frame(folder, journal, number, PIXELS, **change(number, facts))
    journal.close()
    return folder.path


def test_a_pair_knows_its_time_its_sigma_and_when_it_was(tmp_path):
    found = pairs_of(flow(tmp_path))
    assert found.alone == ()
    assert [pair.is_background for pair in found.pairs] == [True, False, False, False]
    assert [pair.time_s for pair in found.pairs] == pytest.approx([0.0, 0.1, 0.2, 0.3], abs=1e-12)
    assert {(pair.dt_s, pair.dt_sigma_s) for pair in found.pairs} == {(80.2e-6, 0.05e-6)}
    assert [pair.tag for pair in found.pairs][:2] == ["background_glass_000000", "flow_glass_000002"]
    assert [[int(path.stem) for path in pair.frames] for pair in found.pairs] == [[0, 1], [2, 3], [4, 5], [6, 7]]


def test_without_a_measurement_the_commanded_time_stands_and_nobody_knows_its_sigma(tmp_path):
    def commanded(number, facts):
        pair = {k: v for k, v in facts["pair"].items() if k not in ("dt_measured_us", "dt_sigma_us")}
        return facts | {"pair": pair}

    found = pairs_of(flow(tmp_path, commanded))
    assert [(pair.dt_s, pair.dt_sigma_s) for pair in found.pairs] == [(pytest.approx(80e-6), None)] * 4


@pytest.mark.parametrize("shift_ns", [0, -4 * 10**9], ids=["clock goes on", "camera restarted"])
def test_time_goes_on_across_sessions(tmp_path, shift_ns):
    found = pairs_of(flow(tmp_path, sessions=((0, 0, 0), (4, 60, shift_ns))))
    assert [pair.time_s for pair in found.pairs] == pytest.approx([0.0, 0.1, 60.0, 60.1], abs=1e-9)


def test_a_camera_that_restarts_within_a_session_does_not_turn_time_back(tmp_path):
    def restarted(number, facts):
        return facts | ({"timestamp_ns": facts["timestamp_ns"] - 5 * 10**9} if number >= 4 else {})

    found = pairs_of(flow(tmp_path, restarted))
    assert [pair.time_s for pair in found.pairs] == pytest.approx([0.0, 0.1, 0.2, 0.3], abs=1e-9)


def test_a_camera_without_clock_says_no_time(tmp_path):
    assert {p.time_s for p in pairs_of(flow(tmp_path, lambda n, f: f | {"timestamp_ns": 0})).pairs} == {None}


def test_a_frame_without_its_partner_is_in_no_pair_and_counted(tmp_path):
    found = pairs_of(flow(tmp_path, numbers=[0, 1, 2, 3, 5, 6, 7]))
    assert found.alone == (5,)
    assert len(found.pairs) == 3


def of_pair(number, **more):
    def change(at, facts):
        return facts | {"pair": facts["pair"] | more} if at == number else facts

    return change


def without(number, key):
    def change(at, facts):
        return facts | {"pair": {k: v for k, v in facts["pair"].items() if k != key}} if at == number else facts

    return change


@loop_over("change, line, words", [
    (of_pair(3, exposure="A"), 5, "says exposure A where the run keeps exposure B"),
    (of_pair(2, exposure="B"), 4, "says exposure B where the run keeps exposure A"),
    (of_pair(4, dt_us=90.0), 6, "says dt_us 90 and the plan says 80"),
    (of_pair(5, dt_measured_us=80.3), 7, "says dt_measured_us 80.3 and frame 4 of its pair 80.2"),
    (of_pair(5, chunk=1), 7, "says chunk 1 and frame 4 of its pair 0"),
    (of_pair(5, marker="spacing"), 7, "says marker spacing"),
    (of_pair(2, background=True), 4, "something else about the background than the plan"),
    (lambda n, f: f | {"timestamp_ns": 1} if n == 5 else f, 7, "was exposed before frame 4 of its pair"),
    (lambda n, f: {k: v for k, v in f.items() if k != "pair"} if n == 5 else f, 7, "does not say which exposure"),
    (lambda n, f: f | {"exposure_us": 90.0} if n == 5 else f, 7, "says 90 us of exposure and frame 3 100 us"),
    (of_pair(5, dt_us=float(0)), 7, "dt_us should be greater than 0"),
    (of_pair(5, exposure="C"), 7, "exposure should be 'A' or 'B'"),
    (of_pair(5, marker="guess"), 7, "marker should be"),
    (without(5, "dt_us"), 7, "dt_us is missing"),
])  # fmt: skip
def test_lines_that_contradict_one_another_are_named_with_file_and_line(tmp_path, change, line, words):
    with pytest.raises(RunDamaged, match=words) as caught:
        pairs_of(flow(tmp_path, change))
    assert f"steps.jsonl:{line}: " in str(caught.value)


def test_a_background_with_another_exposure_does_not_belong_to_the_pairs(tmp_path):
    def change(number, facts):
        return facts | ({"exposure_us": 90.0} if number < 2 else {})

    with pytest.raises(PairError, match=r"jsonl:4: exposure A took 100 us and that of frame 0 90 us"):
        pairs_of(flow(tmp_path, change))
