"""Random sequences on a stage behind a library, before the witness: limits, stops, and what is told of positions.

Left out is what docs/safety.md says that nothing can tell: a restart in mid-motion that the library never notices.
"""

import random
import threading

import pytest

from sim.mechanics.clock import VirtualClock
from stages.drivers_by_name import FOREIGN
from stages.errors import DeviceLost, StageError
from tests.slow_cases import slow

pytestmark = pytest.mark.filterwarnings("ignore:.* is moved by:RuntimeWarning")
STEPS = 12
LIES = ({}, {"done_early_s": 0.3}, {"begins_late_s": 0.4}, {"encoder": True})


class Player:
    """Does something at random, and tells the witness what was said of positions."""

    def __init__(self, made, draw):
        self.made, self.draw = made, draw
        self.lost = 0

    def play(self, steps):
        acts = [
            self.move,
            self.move,
            self.move,
            self.home,
            self.stop,
            self.person,
            self.cut,
            self.hang,
            self.off,
            self.hunt,
        ]
        acts += [self.shove] if self.made.line.emulator._encoder else []
        for _ in range(steps):
            self.draw.choice(acts)()
            self.look()

    def attempt(self, action):
        try:
            action()
        except DeviceLost:
            self.lost += 1
            self.made.stage.clear_stop()
            self.recover()
        except StageError:
            self.made.stage.clear_stop()

    def recover(self):
        self.made.line.plug_in()
        self.made.line.emulator.hangs.clear()
        if self.made.controller._calls.stuck:  # until the library has come back and been left
            self.made.controller._calls._thread.join(2.0)
        self.made.clock.sleep_s(2.0)
        try:
            self.made.stage.connect("box")
            self.made.stage.home()
        except StageError:
            self.made.stage.clear_stop()

    def look(self):
        try:
            for name, mm in self.made.stage.where_mm().items():
                if mm is not None:
                    self.made.world.witness.check_report(name, mm)
        except StageError:
            self.recover()

    def soon(self, action):
        self.made.clock.at(self.made.clock.now_s() + self.draw.uniform(0.0, 3.0), action)

    def move(self):
        targets = {name: self.draw.uniform(0.0, 125.0) for name in self.draw.choice(("a", "b", "ab", "ba"))}
        self.attempt(lambda: self.made.stage.move(targets))

    def home(self):
        self.attempt(self.made.stage.home)

    def stop(self):
        self.soon(self.draw.choice((self.made.stage.stop_quietly, self.made.stage.halt_quietly)))
        self.move()

    def person(self):
        self.soon(self.made.line.emulator.person_stops)
        self.draw.choice((self.move, self.home))()

    def cut(self):
        self.soon(self.made.line.unplug)
        self.move()

    def off(self):
        """At rest power may fail unseen; in motion it is off for so long that the library notices."""
        if self.draw.random() < 0.5:
            self.made.line.power_cycle(0.0)
        else:
            self.soon(lambda: self.made.line.power_cycle(0.3))
        self.move()

    def hunt(self):
        """A servo begins to hunt, or ends it: 2.5 um a step."""
        self.made.world.motors[self.draw.choice("ab")].noise_steps = self.draw.randint(0, 3)

    def shove(self):
        self.made.world.shove(self.draw.choice("ab"), self.draw.uniform(-3.0, 3.0))
        self.move()

    def hang(self):
        until = threading.Event()
        call = self.draw.choice(("send", "read", "busy", "home", "stop"))
        self.soon(lambda: self.made.line.emulator.hangs.update({call: until}))
        timer = threading.Timer(0.2, lambda: (self.made.line.emulator.hangs.clear(), until.set()))
        timer.start()
        self.draw.choice((self.move, self.home))()
        timer.join()


def run(bench, library, seed):
    draw = random.Random(seed)
    made = bench(library, box={"call_s": 0.1}, firmware=draw.choice(LIES))
    assert isinstance(made.clock, VirtualClock)
    player = Player(made, draw)
    player.attempt(made.stage.home)
    player.play(STEPS)
    made.clock.forget()
    assert not made.world.witness.judge()
    made.stage.close()
    return player


@pytest.mark.parametrize("count", [4, slow(200)])
@pytest.mark.parametrize("library", FOREIGN)
def test_nothing_passes_a_limit_moves_after_a_stop_or_is_told_falsely(bench, library, count):
    assert sum(run(bench, library, seed).lost for seed in range(count)) >= count // 4
