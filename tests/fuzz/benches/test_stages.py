"""Some 75 random sequences every time; and without any one protection the judge must see what it prevents.

The sequences of each protection begin with the first that shows it: those before it take most of the time.

`make fuzz` plays many more.
"""

import random

import pytest

from stages.axis import Axis
from stages.controller import Controller
from stages.drivers.grbl import GrblController
from stages.drivers.isel_dnc import IselController
from stages.drivers.pi_gcs2 import PiController
from stages.drivers.thorlabs_apt import AptController
from stages.drivers.zaber_ascii import ZaberController
from stages.stop_latch import StopLatch
from tests.fuzz.amount import PATIENCE_S, seed, sequences
from tests.fuzz.benches.sequences import Command, drawn, read, written
from tests.fuzz.benches.stages import Playground, fuzz, shortened

DRIVERS = (AptController, GrblController, IselController, PiController, ZaberController)


def quiet(text):
    return


def test_random_sequences_show_nothing():
    told = []
    tally = fuzz("fast", range(75), Playground(), tell=told.append)
    assert not told, "\n".join(told)
    assert tally.told > 1000
    ends = {"done", "MotionStopped", "NotReferenced", "Obstructed", "DeviceLost", "Killed"}
    assert ends <= tally.commands.keys()


FORGETFUL = [(each, "_forget_references", lambda self: None) for each in (Controller, GrblController)]
TRUSTING = [(each, "_still_referenced", lambda self, channel: True) for each in DRIVERS]
WITHOUT = {  # protection -> what it is taken away with, stories, and the finding
    "keep-out": ([], "guard", range(16, 200), "keep-out"),
    "latch": ([(StopLatch, "stop", lambda self, why="": self.halt())], "latch", range(7, 300), "stop"),
    "asking for references": (TRUSTING + FORGETFUL, "reference", range(24, 300), "told"),
    "limits": ([(Axis, "check", lambda self, target_mm: None)], "limits", range(1, 300), "limit"),
}


@pytest.mark.slow
@pytest.mark.parametrize("protection", WITHOUT)
def test_without_a_protection_what_it_prevents_is_found(monkeypatch, protection):
    patches, of, numbers, kind = WITHOUT[protection]
    for patch in patches:
        monkeypatch.setattr(*patch)
    playground = Playground(is_guarded=protection not in ("keep-out", "limits"))
    ((_, _, findings),) = fuzz(of, numbers, playground, enough=1, tell=quiet).findings
    assert kind in {text.split(" of ")[0] for text in findings}


class NoTurn:
    """A lock that keeps nobody away."""

    def __enter__(self):
        return True

    def __exit__(self, *args):
        return None


def two_at_once(rng):
    """Moves of two threads that are harmless one by one, often enough."""
    moves = [("target_z", 0.0, 25.0), ("glass_z", -25.0, 40.0), ("rail_z", -60.0, 30.0), ("camera_x", -30.0, 30.0)]
    one, other, third, fourth = (["move", {axis: round(rng.uniform(low, high), 2)}] for axis, low, high in moves)
    apart = [Command(["move", {"glass_z": rng.uniform(12.0, 40.0)}]), Command(["move", {"glass_x": 0.0}])]
    return [*apart, Command(["beside", one, other]), Command(["beside", third, fourth])]


@pytest.mark.slow
@pytest.mark.parametrize("takes_turns", [True, False])
def test_two_threads_meet_only_if_they_need_not_take_turns(takes_turns):
    playground, rng, seen = Playground(), random.Random(3), []
    for _ in range(12 if takes_turns else 1500):  # mostly a few; what two threads meet is the machine's business
        if not takes_turns:
            playground.bench.stage._turn.lock = NoTurn()
        seen += playground.play(two_at_once(rng)).findings
        if seen:
            break
    assert bool(seen) is not takes_turns, seen


@pytest.mark.slow
def test_sequences_know_nothing_of_each_other():
    playground, numbers = Playground(), range(10)
    sequences = [
        (number, drawn("order", number)) for number in numbers if "beside" not in written(drawn("order", number))
    ]
    forwards = {number: playground.play(sequence) for number, sequence in sequences}
    backwards = {number: playground.play(sequence) for number, sequence in reversed(sequences)}
    assert forwards == backwards


def test_a_finding_is_shortened_to_what_shows_it():
    playground = Playground(is_guarded=False)
    sequence = read(
        '[[["wait",0.1],[]],[["move",{"target_z":1.0}],[]],[["where"],[]],[["clear"],[["rail","byte",3,["halt"]]]],'
        '[["move",{"glass_x":0.0}],[["glass","answer",2,["fault","late",0.2]]]]]'
    )
    assert written(read(written(sequence))) == written(sequence)
    short = shortened(playground, sequence, {"keep-out"})
    assert written(short) == '[[["move",{"glass_x":0.0}],[]]]'
    assert playground.play(short).findings


@pytest.mark.slow
@pytest.mark.timeout(PATIENCE_S)
def test_many_random_sequences_show_nothing():
    told = []
    fuzz(seed("slow"), range(sequences(3000)), Playground(), tell=told.append)
    assert not told, "\n".join(told)
