"""The thread of a library by itself: order, deadlines, and what is never begun."""

import threading
import time

import pytest

from stages.errors import DeviceLost
from stages.foreign import calls as module
from stages.foreign.calls import Calls


class Library:
    """Notes what it is asked; its first call lasts until it is let go."""

    def __init__(self, longest_s=10.0, hurried=lambda: False):
        self.order, self.go, self.inside = [], threading.Event(), threading.Event()
        self.calls = Calls("box", longest_s, hurried, lambda: self.order.append("last"))
        self.threads, self.errors = [], []

    def first(self):
        self.inside.set()
        self.go.wait(10.0)
        self.order.append("first")

    def ask(self, word, function=None):
        """From a thread of its own."""

        def run():
            try:
                self.calls.ask(word, function or (lambda: self.order.append(word)))
            except BaseException as error:
                self.errors.append(error)

        self.threads.append(threading.Thread(target=run))
        self.threads[-1].start()

    def hold(self):
        self.ask("first", self.first)
        assert self.inside.wait(5.0)

    def end(self):
        self.go.set()
        for thread in self.threads:
            thread.join(5.0)
        self.calls.end()


@pytest.fixture
def library():
    made = []

    def make(**options):
        made.append(Library(**options))
        return made[-1]

    yield make
    for one in made:
        one.end()


def waits(library, count):
    end_s = time.monotonic() + 5.0
    while len(library.calls._waiting) < count:
        assert time.monotonic() < end_s
        time.sleep(0.001)


def test_a_stop_overtakes_what_waits(library):
    one = library()
    one.hold()
    one.ask("move")
    waits(one, 1)
    begun_s = time.monotonic()
    one.calls.next(lambda: one.order.append("stop"))
    assert time.monotonic() - begun_s < 0.5
    one.end()
    assert one.order == ["first", "stop", "move", "last"]


def test_what_waits_behind_a_call_that_is_given_up_is_never_begun(library):
    one = library(longest_s=0.2)
    one.hold()
    one.ask("move")
    for thread in one.threads:
        thread.join(5.0)
    assert [type(error) for error in one.errors] == [DeviceLost, DeviceLost]
    assert one.calls.stuck == "first"
    one.calls.next(lambda: one.order.append("stop"))
    one.end()
    one.calls._thread.join(5.0)
    assert one.order == ["first", "stop", "last"]
    assert not one.calls.alive


def test_who_is_interrupted_while_waiting_begins_nothing(library):
    """Ctrl-C falls where a move waits for the library to come back."""
    one = library()
    one.hold()

    def interrupted():
        raise KeyboardInterrupt

    one.calls._hurried = interrupted  # looked at by whoever waits, the first one too
    one.ask("move")
    end_s = time.monotonic() + 5.0
    while len(one.errors) < 2:
        assert time.monotonic() < end_s
        time.sleep(0.001)
    one.end()
    assert one.order == ["first", "last"]


def test_patience_is_short_after_a_stop(library, monkeypatch):
    monkeypatch.setattr(module, "AFTER_STOP_S", 0.1)
    one = library(hurried=lambda: True)
    one.hold()
    begun_s = time.monotonic()
    one.threads[0].join(5.0)
    assert time.monotonic() - begun_s < 1.0
    assert isinstance(one.errors[0], DeviceLost)


def test_what_a_stop_raises_is_raised_where_it_was_said(library):
    def fails():
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        library().calls.next(fails)


def test_nothing_is_asked_after_the_end(library):
    one = library()
    one.calls.end()
    with pytest.raises(DeviceLost, match="closed"):
        one.calls.ask("move", lambda: one.order.append("move"))
    one.calls.next(lambda: one.order.append("stop"))
    assert one.order == ["last"]
