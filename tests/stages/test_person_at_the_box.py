"""A person stops a box at its own keys, at any byte of a move or a reference run: nothing moves until released.

Every box and variant; what ends a motion truly short of its end is a stop of the whole bench.
"""

import math
from itertools import cycle

import pytest

from sim.emulators.foreign_box import ForeignBox
from stages.errors import MotionStopped, StageError
from stages.protocols import grbl
from tests.stages.killed import places

pytestmark = pytest.mark.filterwarnings("ignore:.* is moved by:RuntimeWarning")
SHORT_MM = 0.1  # a stop so close before the end leaves no trace
VARIANTS = {
    "zaber": ("zaber_ascii", {}),
    "zaber 6": ("zaber_ascii", {"firmware": "6.32"}),
    "zaber without checksums": ("zaber_ascii", {"checksums": False}),
    "pi": ("pi_gcs2", {}),
    "apt stepper": ("thorlabs_apt", {}),
    "apt servo": ("thorlabs_apt", {"model": "BBD203"}),
    "grbl": ("grbl", {}),
    "grbl by its reset": ("grbl", {}),
    "isel": ("isel_dnc", {}),
    "c142": ("isel_dnc", {"model": None}),
    "micromanager": ("micromanager", {}),
    "micromanager with encoder": ("micromanager", {"encoder": True}),
    "micromanager that begins late": ("micromanager", {"begins_late_s": 0.4}),
    "positioners": ("positioners", {}),
    "positioners done early": ("positioners", {"done_early_s": 0.3}),
}


class Hand:
    """Presses the box's stop once, and knows whether that ended anything short."""

    def __init__(self, made, variant):
        self._made, self.has_stopped = made, False
        emulator = made.line.emulator
        self._act = (lambda: emulator.button(grbl.RESET)) if "reset" in variant else emulator.person_stops

    def press(self):
        emulator, witness = self._made.line.emulator, self._made.world.witness
        emulator.advance()
        targets = {name: motor.target for name, motor in emulator.motors.items() if motor.running}
        self._act()
        for name, target in targets.items():
            motor = emulator.motors[name]
            if motor.target == target:  # the board obeys when its reference run has ended
                continue
            built = motor.mechanics
            short_mm = abs(target - motor.target) * built.lead_mm / built.steps_per_rev
            if math.isinf(target):  # it looks for a switch
                edges_mm = (built.low_switch_mm, built.high_switch_mm, built.index_mm)
                rest_mm = motor.carriage_mm
                if isinstance(emulator, ForeignBox):  # brakes, and rests without a word at a switch on that way
                    rest_mm += (motor.target - motor.steps) * built.lead_mm / built.steps_per_rev
                    rest_mm = min(max(rest_mm, built.low_switch_mm), built.high_switch_mm)
                short_mm = min(abs(rest_mm - edge_mm) for edge_mm in edges_mm)
            if short_mm > SHORT_MM and not self.has_stopped:
                self.has_stopped = True
                witness.note_stop()


def play(made, variant, do, place, what):
    """Do something, with a press at a place; then try on, as a program would that does not understand."""
    hand = Hand(made, variant)
    if what == "seconds":
        made.clock.at(made.clock.now_s() + place, hand.press)
    else:
        made.line.hooks.after(place, what, hand.press)
    heard = ""
    for action in (do, lambda: made.stage.move({"a": 60.0}), made.stage.home):
        try:
            action()
        except MotionStopped as stopped:
            heard = heard or str(stopped)
        except StageError:
            continue
        if hand.has_stopped and not heard:
            heard = "nothing"
        if not hand.has_stopped:
            break
    made.line.hooks.clear()
    made.clock.sleep_s(60.0)
    assert made.world.witness.judge() == []
    if hand.has_stopped:
        assert heard != "nothing"
        assert made.stage.is_held
    return hand.has_stopped


def doings(made):
    return {"move": lambda: made.stage.move({"a": 42.0, "b": 46.0}), "home": made.stage.home}


def brisk_bench(bench, variant):
    kind, firmware = VARIANTS[variant]
    return bench(kind, firmware=firmware).homed({"a": 40.0, "b": 45.0})


def play_all(bench, variant, doing, number):
    stopped = 0
    idle = brisk_bench(bench, variant)
    for place, what in places(idle, doings(idle)[doing], number):
        made = brisk_bench(bench, variant)
        try:
            stopped += play(made, variant, doings(made)[doing], place, what)
        except AssertionError as error:
            raise AssertionError(f"{variant}, {doing}, after {place} {what}: {error}") from error
        made.stage.close()
    return stopped


@pytest.mark.parametrize(("variant", "doing"), [*zip(VARIANTS, cycle(("move", "home", "move")))])
def test_a_stop_at_some_places_holds(bench, variant, doing):
    """One doing of each box; the slow test has both."""
    assert play_all(bench, variant, doing, 3) >= (doing == "move")


@pytest.mark.slow
@pytest.mark.parametrize("doing", ["move", "home"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_stop_at_every_place_holds(bench, variant, doing):
    # a library that begins late moves for a tenth of the time; a feed hold waits for the end of homing
    assert play_all(bench, variant, doing, 60) >= 5 or (variant, doing) == ("grbl", "home")
