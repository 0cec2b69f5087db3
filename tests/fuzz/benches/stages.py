"""Play many random sequences; each that shows something is shortened and printed on one line.

Every sequence plays on the same homed bench, which is put back afterwards. So sequences know nothing of each other
and the line that is printed is enough to play one again, `Playground().play(read(line))`; only what two threads do
at once is decided by the machine.
"""

import gc
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field

from tests.fuzz.benches.bench import fuzz_bench
from tests.fuzz.benches.checkpoint import Checkpoint
from tests.fuzz.benches.play import Player
from tests.fuzz.benches.sequences import Sequence, drawn, written


@dataclass
class Outcome:
    """What one sequence showed."""

    findings: list[str]
    done: list[str] = field(default_factory=list)
    told: int = 0


class Playground:
    """A homed bench on which any number of sequences can be played, each as if it were the first.

    Parameters
    ----------
    is_guarded : bool
        With keep-out.
    """

    def __init__(self, is_guarded: bool = True) -> None:
        self._is_guarded = is_guarded
        self._build()

    def _build(self) -> None:
        self._stack = ExitStack()
        self.bench = self._stack.enter_context(fuzz_bench(self._is_guarded))
        self._checkpoint = Checkpoint(self.bench)

    def play(self, sequence: Sequence) -> Outcome:
        """Play a sequence, and take everything back."""
        player = Player(self.bench)
        findings = player.play(sequence)
        if any("hangs" in text for text in findings):  # something may hold a lock for ever
            self._build()
        else:
            self._checkpoint.go_back()
        return Outcome(findings, player.done, player.told)


def shortened(playground: Playground, sequence: Sequence, kinds: set[str]) -> Sequence:
    """Leave commands and traps out as long as something of the same kind shows."""

    def still(shorter: Sequence) -> bool:
        return bool(kinds & {_kind(text) for text in playground.play(shorter).findings})

    is_shorter = True
    while is_shorter:
        is_shorter = False
        for place in reversed(range(len(sequence))):
            without = sequence[:place] + sequence[place + 1 :]
            if without and still(without):
                sequence, is_shorter = without, True
        for place, command in enumerate(sequence):
            for trap in list(command.traps):
                less = [other for other in command.traps if other is not trap]
                without = [*sequence[:place], type(command)(command.do, less), *sequence[place + 1 :]]
                if still(without):
                    sequence, is_shorter = without, True
                    command = sequence[place]
    return sequence


def _kind(text: str) -> str:
    return text.split(" of ")[0]


@dataclass
class Tally:
    """What many sequences showed."""

    sequences: int = 0
    commands: Counter[str] = field(default_factory=Counter)
    told: int = 0
    findings: list[tuple[int, Sequence, list[str]]] = field(default_factory=list)


def fuzz(
    seed: int | str,
    numbers: range,
    playground: Playground,
    enough: int = 10**9,
    tell: Callable[[str], None] = print,
) -> Tally:
    """Play the sequences of a seed; stop after `enough` findings."""
    tally = Tally()
    gc.collect()
    gc.freeze()  # what stands before need not be looked through again and again
    for number in numbers:
        sequence = drawn(seed, number)
        outcome = playground.play(sequence)
        tally.sequences += 1
        tally.told += outcome.told
        tally.commands.update(outcome.done)
        if outcome.findings:
            tally.findings.append((number, sequence, outcome.findings))
            short = shortened(playground, sequence, {_kind(text) for text in outcome.findings})
            tell(f"seed {seed} number {number}: {'; '.join(outcome.findings[:3])}  {written(short)}")
            if len(tally.findings) >= enough:
                break
    gc.unfreeze()
    return tally
