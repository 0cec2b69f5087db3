"""What a person reads while a run goes on."""

import re
from types import SimpleNamespace

import pytest

from daq.runner import progress as progress_module
from daq.runner.progress import Progress, line
from daq.runs.frame_accounting import FrameAccounting
from daq.timing.states import LaserState


@pytest.mark.parametrize(
    ("laser", "counts", "words"),
    [
        (LaserState.FIRING, {"triggered": 16, "rejected": 16}, "waiting for light, 16 dark frames so far"),
        (
            LaserState.FIRING,
            {"triggered": 20, "rejected": 16, "written": 4},
            "20 triggered = 4 written + 16 dark or surplus",
        ),
        (None, {"triggered": 5, "rejected": 1, "written": 4}, "5 triggered = 4 written + 1 rejected"),
    ],
)
def test_frames_without_light_are_no_alarm(laser, counts, words):
    made = Progress(steps=2, tag="flow", laser=laser, accounting=FrameAccounting(**counts))
    assert line(made).split("; ")[-1] == words


class Watch:
    """A clock that tests turn."""

    def __init__(self, monkeypatch):
        self.now_s = 1000.0
        monkeypatch.setattr(progress_module.time, "monotonic", lambda: self.now_s)


def steps_of(*frames):
    """Steps with so many frames each."""
    return [SimpleNamespace(index=number, frames=count) for number, count in enumerate(frames)]


def seconds(said):
    """What `left` says, in seconds."""
    hours, minutes, rest = re.fullmatch(r"about (?:(\d+) h ?)?(?:(\d+) min ?)?(?:(\d+) s)? ?left", said).groups()
    return 3600 * int(hours or 0) + 60 * int(minutes or 0) + int(rest or 0)


@pytest.mark.parametrize("slower", [1.0, 0.5, 3.0])
def test_the_time_left_is_true_from_the_first_frame_on_and_never_leaps(monkeypatch, slower):
    """Bare steps are quick and those behind glass slow; compiling comes once, before the first frame."""
    expected_s = [2.0] * 5 + [9.0] * 5
    took_s = [slower * each for each in expected_s]
    watch = Watch(monkeypatch)
    made = Progress(steps=10)
    made.expect(steps_of(*[1] * 10), [1] * 10, expected_s)
    assert made.time_left() == ""
    watch.now_s += 90.0  # homing, compiling
    before = None
    for number, each_s in enumerate(took_s[:-1]):
        watch.now_s += each_s
        made.took(1, number)
        true_s, said_s = sum(took_s[number + 1 :]), seconds(made.time_left())
        assert 0.3 * true_s - 2 <= said_s <= 3.0 * true_s + 2, (number, said_s, true_s)
        if number > 2:
            assert 0.5 * true_s - 2 <= said_s <= 2.0 * true_s + 2, (number, said_s, true_s)
        if before is not None and number > 2:
            assert said_s <= 1.35 * before + 2
        before = said_s
    watch.now_s += took_s[-1]
    made.took(1, 9)
    assert made.time_left() == ""


def test_a_person_who_opens_the_seeding_takes_no_time_of_a_frame(monkeypatch):
    watch = Watch(monkeypatch)
    made = Progress(steps=2)
    made.expect(steps_of(4, 100), [4, 100], [4.0, 100.0])
    for _ in range(4):
        watch.now_s += 1.0
        made.took(1, 0)
    with made.aside():
        watch.now_s += 600.0
    watch.now_s += 1.0
    made.took(1, 1)
    assert seconds(made.time_left()) == pytest.approx(99, abs=2)


def test_what_is_taken_again_is_ahead_once_more(monkeypatch):
    watch = Watch(monkeypatch)
    made = Progress(steps=1)
    made.expect(steps_of(10), [10], [10.0])
    for _ in range(5):
        watch.now_s += 1.0
        made.took(1, 0)
    made.took(-5, 0)
    assert made.frames == 0
    watch.now_s += 1.0
    made.took(1, 0)
    assert seconds(made.time_left()) == pytest.approx(9, abs=2)
