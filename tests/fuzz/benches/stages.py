"""Play many random sequences; each that shows something is shortened and printed on one line.

    python -m tests.fuzz.benches.stages --sequences 100000 --seed 1 --workers 2
    python -m tests.fuzz.benches.stages --replay '[[["move",{"glass_z":3.0}],[]], ...]'

Every sequence plays on the same homed bench: the process that has homed it forks, and the child plays. So
sequences know nothing of each other and a seed and a number are enough to play one again; only what two threads
do at once is decided by the machine.
"""

import argparse
import gc
import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field

from tests.fuzz.benches.bench import fuzz_bench
from tests.fuzz.benches.checkpoint import Checkpoint
from tests.fuzz.benches.play import Player
from tests.fuzz.benches.sequences import Sequence, drawn, read, written

LONGEST_S = 30  # a sequence that takes longer hangs


@dataclass
class Outcome:
    """What one sequence showed."""

    findings: list[str]
    done: list[str] = field(default_factory=list)
    told: int = 0


class Hangs(BaseException):
    """A sequence has taken longer than `LONGEST_S`."""


class Playground:
    """A homed bench on which any number of sequences can be played, each as if it were the first.

    Parameters
    ----------
    is_guarded : bool
        With keep-out.
    longest_s : int
        Wall time after which a sequence is taken to hang; 0 for whoever watches that himself.
    """

    def __init__(self, is_guarded: bool = True, longest_s: int = LONGEST_S) -> None:
        self._is_guarded, self._longest_s = is_guarded, longest_s
        self._build()

    def _build(self) -> None:
        self._stack = ExitStack()
        self.bench = self._stack.enter_context(fuzz_bench(self._is_guarded))
        self._checkpoint = Checkpoint(self.bench)

    def play(self, sequence: Sequence) -> Outcome:
        """Play a sequence, and take everything back."""
        player = Player(self.bench)
        if self._longest_s:
            signal.signal(signal.SIGALRM, _hangs)
            signal.alarm(self._longest_s)
        try:
            findings = player.play(sequence)
        except Hangs:
            findings = [f"crash of the sequence: it hangs after {player.done}"]
        if self._longest_s:
            signal.alarm(0)
        if any("hangs" in text for text in findings):  # something may hold a lock for ever
            self._build()
        else:
            self._checkpoint.go_back()
        return Outcome(findings, player.done, player.told)


def _hangs(signum: int, frame: object) -> None:
    raise Hangs


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
            tell(f"seed {seed} number {number}: {'; '.join(outcome.findings[:3])}  --replay '{written(short)}'")
            if len(tally.findings) >= enough:
                break
    gc.unfreeze()
    return tally


def _shares(count: int, workers: int) -> Iterator[range]:
    yield from (range(first, count, workers) for first in range(workers))


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequences", type=int, default=1000)
    parser.add_argument("--seed", default="1")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--enough", type=int, default=10**9, help="end a worker after so many findings")
    parser.add_argument("--only", type=int, help="play one number of the seed, and tell what happened")
    parser.add_argument("--replay", help="play a sequence as it was printed")
    parser.add_argument("--no-guard", action="store_true", help="without keep-out: the judge must see it")
    given = parser.parse_args(arguments)
    if given.replay is not None or given.only is not None:
        sequence = read(given.replay) if given.replay else drawn(given.seed, given.only)
        with fuzz_bench(not given.no_guard) as bench:
            player = Player(bench)
            findings = player.play(sequence)
        print(written(sequence), *player.done, sep="\n")
        print("\n".join(findings) or "nothing")
        return int(bool(findings))
    begun_s = time.monotonic()
    children = []
    for share in _shares(given.sequences, given.workers):
        child = os.fork()
        if child == 0:
            playground = Playground(not given.no_guard)
            tally = fuzz(given.seed, share, playground, given.enough, lambda text: print(text, flush=True))
            print(
                f"{tally.sequences} sequences, {len(tally.findings)} with findings, {tally.told} positions told, "
                f"{dict(tally.commands.most_common())}",
                flush=True,
            )
            os._exit(int(bool(tally.findings)))
        children.append(child)
    codes = [os.waitpid(child, 0)[1] for child in children]
    print(f"{time.monotonic() - begun_s:.0f} s")
    return int(any(codes))


if __name__ == "__main__":
    sys.exit(main())
