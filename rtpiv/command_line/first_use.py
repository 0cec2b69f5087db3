"""The first command on a computer compiles its kernels: on all cores, and with a word on how long that takes.

What each verb calls for scenes of balls is written down in ``first_use.json`` (kernel, types of its arguments,
seconds that it took), made anew by ``python -m benchmarks.first_use``.  A verb compiles what it needs in the
order in which it calls it.  As soon as the first kernel is missing, and it is one of those, further processes
compile the same list from its other end: both find in the cache what the other has left there, and meet in the
middle.  Nothing depends on them: whatever they do not reach, the verb compiles itself.
"""

import json
import subprocess
import sys
import threading
import time
from importlib.resources import files
from typing import Any

from daq.child import child
from ground.rows import thread_count

TRUST_S = 10.0
MOST_HELPERS = 3  # beside the verb's own process; kernels share callees, and each compiles those it needs first
ALSO = {  # verbs that call what others call
    "init": ("trace",),
    "demo": ("calibrate", "correct", "evaluate"),
    "report": ("evaluate",),
    "mean": ("evaluate",),
    "acquire": ("correct",),
    "resume": ("correct",),
    "warm": ("trace", "correct", "evaluate", "calibrate"),
}
Call = tuple[str, Any, float]  # kernel as "module:name", types of its arguments, seconds


def calls_of(verb: str) -> list[Call]:
    """What a verb calls for a scene of balls, in its order."""
    kept = json.loads(files("rtpiv.command_line").joinpath("first_use.json").read_text(encoding="utf-8"))
    calls = [call for name in ALSO.get(verb, (verb,)) for call in kept.get(name, ())]
    return list({json.dumps(call[:2]): (call[0], call[1], call[2]) for call in calls}.values())


class FirstUse:
    """Watches a verb compile; starts helpers, says how long it will take, and ends them.

    Parameters
    ----------
    verb : str
        Its name.
    """

    def __init__(self, verb: str) -> None:
        self._verb = verb
        self._last_s = 0.0  # when the last kernel was compiled
        self._left: dict[str, float] = {}  # kernels that are not compiled yet -> their share of the seconds
        self._whole = 0.0
        self._begun_s = 0.0
        self._helpers: list[subprocess.Popen[bytes]] = []

    def begun(self, place: str, form: object) -> None:
        """One kernel is missing: the first one that is starts the helpers."""
        if self._begun_s:
            return
        calls = calls_of(self._verb)
        missing = next((number for number, call in enumerate(calls) if call[:2] == (place, form)), None)
        if missing is None:
            return
        self._begun_s = time.monotonic()
        self._left = {name: seconds for name, _, seconds in calls[missing:]}
        self._whole = sum(self._left.values())
        helpers = max(0, min(thread_count() - 1, MOST_HELPERS, len(self._left) - 1))
        for number in range(helpers):
            command, environment = child("rtpiv.command_line.first_use", self._verb, str(number), str(helpers))
            self._helpers.append(
                subprocess.Popen(
                    command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL, start_new_session=True,
                )
            )  # fmt: skip

    def done(self, place: str) -> None:
        """One kernel is compiled."""
        if self._left.pop(place, None) is not None:
            self._last_s = time.monotonic()

    def seconds_left(self) -> float | None:
        """How long the list will take still, to which a scene may add kernels; None before the first is compiled.

        The first kernels wait for the compiler itself, and one of a tenth of a second says nothing of those of
        ten: what was measured weighs as much as the list when it comes to `TRUST_S`.
        """
        share = self._whole / (len(self._helpers) + 1)
        through = self._whole - sum(self._left.values())
        if not through or through >= share:
            return None
        pace = (self._last_s - self._begun_s + TRUST_S) / (through + TRUST_S)
        whole_s, since_s = pace * (share - through), time.monotonic() - self._last_s
        return whole_s - min(since_s, 0.9 * whole_s)

    def end(self) -> None:
        """Let the helpers go: each ends as soon as its other end is closed."""
        for helper in self._helpers:
            assert helper.stdin is not None
            helper.stdin.close()
            helper.terminate()
            helper.wait()


def compile_from_the_end(verb: str, first: int, step: int) -> None:
    """Compile every `step`-th call of a verb, the last ones first; those in the cache take no time."""
    import ground.jit.compiler as compiler

    compiler.use_shipped = verb != "warm"
    for call in calls_of(verb)[::-1][first::step]:
        compile_call(call)


def compile_call(call: Call) -> None:
    """Compile a kernel for the arguments of a call, or find that it is."""
    from ground.jit.signatures import entry, typed

    place, form, _ = call
    entry(place).compiled.compile(tuple(typed(each) for each in form))


def _end_with_parent() -> None:
    """End when whoever started this process ends, however it does."""
    import os

    def watch() -> None:
        sys.stdin.buffer.read()
        os._exit(0)

    threading.Thread(target=watch, daemon=True, name="parent").start()


if __name__ == "__main__":
    _end_with_parent()
    compile_from_the_end(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
