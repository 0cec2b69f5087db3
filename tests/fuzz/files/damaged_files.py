"""Random damage to every file that is read: each case is read, or refused in one sentence, soon, in little memory.

A case is one file of `originals`, damaged once as its number and the seed say; `--only` plays one again and shows
what came of it.  Findings are errors that nobody raised on purpose, sentences of several lines (a configuration
file may have several problems, each in its line), more than LONGEST_S seconds of computing and more than MOST_MB
beside what the process had before.
"""

import os
import random
import resource
import signal
import time
import traceback
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from ground.errors import ConfigError
from rtpiv.command_line.exit_codes import exit_code, sentence
from tests.fuzz.files.damage import spoil_file
from tests.fuzz.files.originals import ORIGINALS, WARM, scene_read, write_originals

LONGEST_S = 2.0
MOST_MB = 500.0
HUNG_S = 60
LONGEST_SENTENCE = 2000  # characters of one problem
SPOILT = 0.03  # share of cases whose file is none


@dataclass
class Tally:
    """What many cases showed."""

    cases: int = 0
    refused: int = 0
    longest_s: float = 0.0
    most_mb: float = 0.0
    findings: list[str] = field(default_factory=list)
    by_file: Counter = field(default_factory=Counter)


class Hung(BaseException):
    """A reader does not come back."""


class Playground:
    """A folder with all originals.

    Parameters
    ----------
    folder : Path
        Empty.
    """

    def __init__(self, folder):
        self.folder = folder
        write_originals(folder)
        self.whole = {each.path: (folder / each.path).read_bytes() for each in ORIGINALS}
        for text in WARM:  # what is compiled for other scenes than the whole one takes longer than any reader may
            (folder / "scene.yaml").write_text(text)
            scene_read(folder)
        (folder / "scene.yaml").write_bytes(self.whole["scene.yaml"])
        for each in ORIGINALS:
            each.read(folder)  # whole files are read

    def play(self, seed, number, tally):
        """Play one case, and add what it showed."""
        rng = random.Random(f"{seed} {number}")
        original = rng.choices(ORIGINALS, [each.share for each in ORIGINALS])[0]
        path, whole = self.folder / original.path, self.whole[original.path]
        if rng.random() < SPOILT:
            path.unlink()
            spoil_file(path, whole, rng)
        else:
            path.write_bytes(rng.choice(original.damages)(whole, rng))
        begun_s, before_mb = time.process_time(), _peak_mb(reset=True)
        found = _read(original, self.folder)
        taken_s, taken_mb = time.process_time() - begun_s, _peak_mb() - before_mb
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        elif path.is_symlink() or not path.is_file():
            path.unlink(missing_ok=True)
        path.write_bytes(whole)
        tally.cases += 1
        tally.by_file[original.path] += 1
        tally.refused += found != ""
        tally.longest_s, tally.most_mb = max(tally.longest_s, taken_s), max(tally.most_mb, taken_mb)
        if found.startswith("!"):
            tally.findings.append(f"case {number}, {original.path}: {found[1:]}")
        if taken_s > LONGEST_S or taken_mb > MOST_MB:
            tally.findings.append(f"case {number}, {original.path}: {taken_s:.1f} s, {taken_mb:.0f} MB")


def _read(original, folder):
    """What a reader says: "" if it reads, a sentence if it refuses, "!" and a finding otherwise."""
    try:
        with alarm(HUNG_S):
            original.read(folder)
    except Hung:
        return "!hangs"
    except Exception as error:
        code, said = exit_code(error), sentence(error)
        if code is None:
            where = traceback.extract_tb(error.__traceback__)[-1]
            return f"!{type(error).__name__}: {str(error)[:200]} ({where.filename}:{where.lineno})"
        problems = said.split("\n") if isinstance(error, ConfigError) else [said]
        for problem in problems:
            if "\n" in problem or len(problem) > LONGEST_SENTENCE or any(ord(c) < 32 for c in problem):
                return f"!no sentence: {problem[:200]!r}, {len(problem)} characters"
        return said
    return ""


@contextmanager
def alarm(seconds):
    """Raise Hung in the block after so many seconds."""

    def ring(number, frame):
        raise Hung

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _peak_mb(reset=False):
    """Most memory that this process had since the last reset (on Linux; elsewhere since it began)."""
    if reset and os.path.exists("/proc/self/clear_refs"):  # noqa: PTH110
        Path("/proc/self/clear_refs").write_text("5")
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def fuzz(seed, numbers, playground, enough=10**9, tell=print):
    """Play the cases of a seed, and tell each finding at once; stop after `enough` of them."""
    tally = Tally()
    for number in numbers:
        told = len(tally.findings)
        playground.play(seed, number, tally)
        for finding in tally.findings[told:]:
            tell(finding)
        if len(tally.findings) >= enough:
            break
    return tally
