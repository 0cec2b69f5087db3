"""At every place in the traffic of a move and of a reference run: what can happen there, happens."""

import itertools

import pytest

from tests.fuzz.benches.play import Player
from tests.fuzz.benches.sequences import Command, written
from tests.fuzz.benches.stages import Playground
from tests.loops import loop_over

BEFORE = [["move", {"glass_z": 25.0}], ["move", {"glass_x": 0.0}]]  # the ball stands between target and lens
DURING = {
    "portal": [["move", {"camera_x": 5.0}], ["home", ["camera_x", "camera_y"]]],
    "glass": [["move", {"glass_z": 30.0}], ["home", ["glass_z"]]],
    "target": [["move", {"target_z": 5.0}], ["home", ["target_z"]]],
    "rail": [["move", {"rail_z": 10.0}], ["home", ["rail_z"]]],
    "side": [["move", {"target_x": 20.0}], ["home", ["target_x"]]],
}
AFTER = [["where"], ["move", {"rail_z": -25.0}], ["move", {"target_z": 8.0}], ["clear"], ["resume", "portal"],
         ["move", {"glass_z": 2.0}]]  # fmt: skip
ACTIONS = [["restart", 0.0], ["restart", 0.3], ["person"], ["stop"], ["halt"], ["kill"], ["unplug"],
           ["replug", 0.05], ["fault", "garbled", 0.0, 5]]  # fmt: skip
OF_THE_BOX = {
    "portal": [["reset"], ["resume"], ["bounce", "camera_x"]],
    "glass": [["turn", "glass_z", 2.0], ["turn", "glass_z", -2.0], ["bounce", "glass_z"]],
    "side": [["turn", "target_x", 2.0], ["turn", "target_x", -2.0], ["bounce", "target_x"]],
    "target": [["bounce", "target_z"]],
    "rail": [["bounce", "rail_z"]],
}
CASES = [(controller, number) for controller in DURING for number in range(2)]


def traffic(playground, controller, do):
    """What passes on the line of a controller during a command."""
    player = Player(playground.bench)
    hooks = playground.bench.lines[controller].hooks
    for command in BEFORE:
        player._try(command)
    before = dict(hooks.passed)
    player._try(do)
    passed = {what: count - before[what] for what, count in hooks.passed.items()}
    playground.play([])  # back to the beginning
    return passed


def played(playground, controller, do, what, number, action):
    sequence = [
        *(Command(command) for command in BEFORE),
        Command(do, [[controller, what, number, action]]),
        *(Command(command) for command in AFTER),
    ]
    findings = playground.play(sequence).findings
    assert not findings, f"{findings[0]}  {written(sequence)}"


@pytest.mark.slow
@loop_over("controller, number", CASES)
def test_at_some_places(controller, number):
    playground, do = Playground(), DURING[controller][number]
    half = (ACTIONS + OF_THE_BOX[controller])[number::2]  # the slow test plays each of them in both commands
    for place, action in zip(itertools.cycle((1, 7) if number else (3, 9)), half):
        played(playground, controller, do, "byte", 7 * place, action)


@pytest.mark.slow
@pytest.mark.parametrize(("controller", "number"), CASES)
def test_at_every_place(controller, number):
    playground, do = Playground(), DURING[controller][number]
    count = traffic(playground, controller, do)
    assert count["byte"] > 5
    for what, most in count.items():
        for place in range(1, most + 1, max(1, most // 50)):
            for action in ACTIONS + OF_THE_BOX[controller]:
                played(playground, controller, do, what, place, action)
