"""Compilation of kernels on first use, on all cores, with the remaining time.

The kernels that each verb calls for scenes of balls are listed in ``first_use.json`` (kernel, types of its
arguments, seconds of compilation), updated by ``python -m benchmarks.first_use``.  A verb compiles its kernels in
the order of its calls.  When the first one of the list is missing, further processes compile the list from its
end: each finds in the cache what the others have compiled, and they meet in the middle.  Nothing depends on them:
the verb compiles itself what they do not reach.
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
# Beside the verb's own process; kernels share callees, and each compiles those it needs first
MOST_HELPERS = 3
ALSO = {  # verbs that call the kernels of others
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
    """Return the kernels that a verb calls for a scene of balls, in order."""
    kept = json.loads(files("rtpiv.command_line").joinpath("first_use.json").read_text(encoding="utf-8"))
    calls = [call for name in ALSO.get(verb, (verb,)) for call in kept.get(name, ())]
    return list({json.dumps(call[:2]): (call[0], call[1], call[2]) for call in calls}.values())


class FirstUse:
    """Helper processes of a verb that compiles, and the time that is left.

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

    def start(self, place: str, form: object) -> None:
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
                    command,
                    env=environment,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    start_new_session=True,
                )
            )

    def finish(self, place: str) -> None:
        """One kernel is compiled."""
        if self._left.pop(place, None) is not None:
            self._last_s = time.monotonic()

    def seconds_left(self) -> float | None:
        """Return the remaining seconds of the list; None before its first kernel is compiled.

        A scene may add kernels.  The first kernels include the start of the compiler, and short ones predict long
        ones badly: measured times have the same weight as those of the list when they reach `TRUST_S`.
        """
        share = self._whole / (len(self._helpers) + 1)
        through = self._whole - sum(self._left.values())
        if not through or through >= share:
            return None
        pace = (self._last_s - self._begun_s + TRUST_S) / (through + TRUST_S)
        whole_s, since_s = pace * (share - through), time.monotonic() - self._last_s
        return whole_s - min(since_s, 0.9 * whole_s)

    def end(self) -> None:
        """End the helpers: each ends when its standard input is closed."""
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
    from ground.jit.signatures import entry, to_type

    place, form, _ = call
    entry(place).dispatcher.compile(tuple(to_type(each) for each in form))


def _end_with_parent() -> None:
    """End this process when its parent ends."""
    import os

    def watch() -> None:
        sys.stdin.buffer.read()
        os._exit(0)

    threading.Thread(target=watch, daemon=True, name="parent").start()


if __name__ == "__main__":
    _end_with_parent()
    compile_from_the_end(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
