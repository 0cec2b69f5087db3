"""Random sequences of what people and programs do at a bench, and of what goes wrong meanwhile.

A sequence is plain data: a list of commands, each with the traps that are set before it.

    ["move", {"glass_x": 12.5, "rail_z": -3.0}]         ["home", ["glass_x"]]       ["restart", "portal", 0.3]
    trap: [controller, "byte" | "answer" | "answer byte" | "write" | "seconds", number, action]

So it can be printed, played again, and shortened by leaving commands out.
"""

import json
import random
from dataclasses import dataclass, field
from typing import Any

from tests.fuzz.benches.bench import AXES, TABLE

Trap = list[Any]
CONTROLLERS = tuple(TABLE.controllers)
TURNED = ("glass_x", "glass_z", "target_x")  # axes with a knob or a wheel
LONGEST_TRAPS = {"byte": 160, "answer": 16, "answer byte": 260, "write": 16}
WEIGHTS = {
    "move": 26, "several": 8, "move_one": 6, "jog": 8, "home": 6, "home all": 4, "stop": 3, "halt": 2, "clear": 6,
    "where": 4, "connect": 4, "program": 2, "wait": 3, "restart": 4, "unplug": 2, "plug": 3, "person": 2,
    "slip": 2, "shove": 2, "block": 1, "beside": 2, "resume": 3, "reset": 1, "turn": 2, "noise": 1, "bounce": 1,
    "echo": 0.5,
}  # fmt: skip
FOLLOWS = 0.3
FOLLOW_UPS = {
    "unplug": ("plug", "plug", "stop"), "plug": ("connect",), "connect": ("home", "where", "move"),
    "restart": ("where", "move", "home"), "person": ("stop", "resume", "clear", "move"),
    "stop": ("clear", "resume", "move"), "resume": ("where", "move"), "clear": ("move", "several"),
    "kill": ("where", "move", "home"),
    "turn": ("stop", "clear", "move", "where"), "replug": ("connect", "home", "where"), "bounce": ("home", "move"),
    "reset": ("move", "home"), "halt": ("move",), "slip": ("home",), "home": ("move", "several"),
}  # fmt: skip


@dataclass
class Command:
    """One command, and what shall happen in the middle of it."""

    do: list[Any]
    traps: list[Trap] = field(default_factory=list)


Sequence = list[Command]


def written(sequence: Sequence) -> str:
    """One line."""
    return json.dumps([[command.do, command.traps] for command in sequence], separators=(",", ":"))


def read(line: str) -> Sequence:
    """Back from one line."""
    return [Command(do, traps) for do, traps in json.loads(line)]


def drawn(seed: int | str, number: int) -> Sequence:
    """The sequence of a seed and a number, the same everywhere."""
    rng = random.Random(f"{seed}:{number}")
    sequence: Sequence = []
    for _ in range(rng.randint(3, 8)):
        follows = _follow_ups(sequence[-1]) if sequence else []
        sequence.append(_command(rng, rng.choice(follows) if follows and rng.random() < FOLLOWS else _kind(rng)))
    return sequence


def _follow_ups(last: Command) -> list[str]:
    """What somebody is likely to do next: chance alone seldom strings together what belongs together."""
    happened = {last.do[0], *(trap[3][0] for trap in last.traps)}
    return [kind for event in sorted(happened) for kind in FOLLOW_UPS.get(event, ())]


def _command(rng: random.Random, kind: str) -> Command:
    do = _do(rng, kind)
    traps = [_trap(rng, do) for _ in range(rng.choices((0, 1, 2), (45, 45, 10))[0])]
    if do[0] not in ("move", "move_one", "jog", "home", "where", "connect", "beside"):
        traps = []
    if do[0] == "beside":  # which of two threads would die is not for one of them to say
        traps = [trap for trap in traps if trap[3] != ["kill"]]
    return Command(do, traps)


def _kind(rng: random.Random) -> str:
    return rng.choices(list(WEIGHTS), list(WEIGHTS.values()))[0]


def _do(rng: random.Random, kind: str) -> list[Any]:
    axis, controller = rng.choice(list(AXES)), rng.choice(CONTROLLERS)
    match kind:
        case "move":
            return ["move", {axis: _target(rng, axis)}]
        case "several":
            return ["move", {name: _target(rng, name) for name in rng.sample(list(AXES), rng.choice((2, 2, 3)))}]
        case "move_one":
            return ["move_one", axis, _target(rng, axis)]
        case "jog":
            return ["jog", axis, _round(rng.choice((0.1, 1.0, 5.0, 20.0)) * rng.uniform(-1.0, 1.0))]
        case "home":
            return ["home", [axis for axis, table in AXES.items() if table["controller"] == controller]]
        case "home all":
            return ["home", None]
        case "wait":
            return ["wait", rng.choice((0.01, 0.1, 0.5, 3.0))]
        case "restart":
            return ["restart", controller, _off_s(rng)]
        case "connect" | "unplug" | "plug" | "person":
            return [kind, controller]
        case "resume" | "reset":
            return [kind, "portal"]
        case "turn":
            return ["turn", rng.choice(TURNED), _round(rng.uniform(-3.0, 3.0))]
        case "noise":
            return ["noise", axis, rng.choice((0, 1))]
        case "bounce":
            return ["bounce", axis]
        case "echo":
            return ["echo", controller, rng.random() < 0.4]
        case "slip":
            return ["slip", axis, _round(rng.uniform(-5.0, 5.0))]
        case "shove" | "block":
            encoded = [name for name, table in AXES.items() if table["controller"] in ("glass", "target")]
            return [kind, rng.choice(encoded), _round(rng.uniform(-5.0, 5.0))]
        case "beside":
            other = ["stop"] if rng.random() < 0.4 else ["move", {axis: _target(rng, axis)}]
            return ["beside", other, ["move", {name: _target(rng, name) for name in rng.sample(list(AXES), 2)}]]
        case _:
            return [kind]


def _target(rng: random.Random, axis: str) -> float:
    low, high = AXES[axis]["limits_mm"]
    return _round(rng.uniform(low - 0.02 * (high - low), high + 0.02 * (high - low)))


def _trap(rng: random.Random, do: list[Any]) -> Trap:
    controller = rng.choice(CONTROLLERS)
    moved = _moved(do)
    if moved and rng.random() < 0.7:
        controller = AXES[rng.choice(moved)]["controller"]
    kind = rng.choice(("late", "lost", "cut", "doubled", "garbled", "split"))
    action = rng.choices(
        (["restart", _off_s(rng)], ["unplug"], ["person"], ["stop"], ["halt"], ["kill"], ["resume"], ["reset"],
         ["fault", kind, rng.choice((0.2, 0.55, 2.0)), rng.choice((1, 1, 1, 2, 5, 30))],
         ["turn", rng.choice(TURNED), _round(rng.uniform(-3.0, 3.0))], ["replug", rng.choice((0.0, 0.05, 0.3))],
         ["bounce", rng.choice(moved or list(AXES))]),
        (20, 5, 14, 18, 5, 6, 4, 4, 22, 6, 4, 2),
    )[0]  # fmt: skip
    if action[0] in ("resume", "reset"):
        controller = "portal"
    if action[0] in ("turn", "bounce"):
        controller = AXES[action[1]]["controller"]
    if action[0] == "fault":
        return [controller, "answer", rng.randint(1, LONGEST_TRAPS["answer"]), action]
    if rng.random() < 0.35:
        return [controller, "seconds", _round(rng.uniform(0.0, 1.2) ** 2), action]
    what = rng.choice(list(LONGEST_TRAPS))
    return [controller, what, rng.randint(1, LONGEST_TRAPS[what]), action]


def _moved(do: list[Any]) -> list[str]:
    match do:
        case ["move", dict(targets)]:
            return list(targets)
        case ["move_one" | "jog", str(axis), _]:
            return [axis]
        case ["home", list(axes)]:
            return axes
        case ["beside", _, other]:
            return _moved(other)
    return []


def _off_s(rng: random.Random) -> float:
    return rng.choice((0.0, 0.01, 0.1, 0.3, 1.0))


def _round(number: float) -> float:
    return round(number, 3)
