"""Laser and stages of one bench, fuzzed together: nothing moves while light leaves, and none leaves near anything.

To what happens to a laser (`laser`) comes what happens to the stages of `bench`: another thread moves and
homes them at any moment, between any two bytes that go to the timing unit; their boxes restart, are unplugged,
answer late or wrongly. Conditions are asked as a run asks them (`runner.laser_session`), by the steps of the real
supervisor.

The judge hangs on plugs and motors and believes nobody. At every pulse that can light something he knows:

========  ==========================================================================================
state     whether it may leave at all (`laser`)
motion    whether a carriage truly moves then, sent or looking for its reference
sheet     whether ball and target are truly clear of the sheet, which lies in z = 0
========  ==========================================================================================

The witness of the stages judges keep-out and limits of every motion besides.
A seed and a number of it play a story again: `Playground().tell("1-17", 14)`.
"""

from collections import Counter
from contextlib import ExitStack, contextmanager

from stages.errors import StageError
from tests.fuzz.benches.bench import fuzz_bench
from tests.fuzz.benches.checkpoint import Checkpoint
from tests.fuzz.benches.light_story import LightStory
from tests.fuzz.benches.two_threads import TwoThreads


class Playground:
    """A homed bench on which any number of stories can be told, each as if it were the first."""

    def __init__(self):
        self._stack = ExitStack()
        self.glides = []
        self.bench = self._stack.enter_context(fuzz_bench(clock=TwoThreads()))
        self._hear()
        self._let_others_in()
        self._checkpoint = Checkpoint(self.bench)

    def _hear(self):
        for name, watched in self.bench.world.witness.axes.items():
            watched.motor.watcher = self._ear(name, watched, watched.motor.watcher)

    def _ear(self, name, watched, tell):
        def hear(glide):
            tell(glide)
            if watched.line.emulator.purpose(watched.channel) != "hand" and glide[2] != glide[3]:
                self.glides.append((glide[0], glide[1], name))

        return hear

    def _let_others_in(self):
        """Who has taken the turn may be kept waiting before its first byte."""
        turn, clock = self.bench.stage._turn, self.bench.clock
        taken = turn.take

        @contextmanager
        def waits():
            with taken():
                clock.sleep_s(0.0)
                yield

        turn.take = waits

    def tell(self, seed, length):
        self.glides.clear()
        story = LightStory(seed, self.bench, self.glides)
        story.tell(length)
        other = self.bench.clock.other
        if other is not None and not other.has_ended and not story.found:
            story.found.append("the other thread hangs")
        if other is not None and other.error is not None and not isinstance(other.error, StageError):
            story.found.append(f"the other thread: {other.error!r}")
        self._checkpoint.go_back()
        return story


def play(numbers, seed, length=14, playground=None):
    """Tell stories; return their books, and the log of the first in which something was found."""
    playground, books = playground or Playground(), Counter()
    for number in numbers:
        story = playground.tell(f"{seed}-{number}", length)
        books["sequences"] += 1
        books["pulses"] += story.pulses
        books["bursts"] += story.firings
        books["pulses by knobs"] += story.by_knobs
        books["motions"] += story.moves
        if story.found:
            return books, [f"seed {seed}-{number}", *story.log, *story.found]
    return books, []
