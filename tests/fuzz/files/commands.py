"""Random command lines, most of them wrong: each ends with an exit code and sentences, none with a traceback.

A case is a verb with flags, values and files drawn by its number and the seed: values of the wrong type, huge, of
other alphabets; files that are missing, damaged, folders, or of another kind.  What the program offers is asked of
its own parser, so that a new option is tried without a line here.  Left out are what waits for Ctrl-C or a person,
looks beyond the lab's folder, or computes for minutes; no word names a place outside it, for some are written to.
"""

import contextlib
import io
import random
import shutil
import traceback
from dataclasses import dataclass, field
from pathlib import Path

from rtpiv.command_line.cli import DEVICE, DONE, INTERRUPTED, USAGE, main
from rtpiv.options import parser_of
from rtpiv.options.command import commands
from tests.daq.small_bench import FILES_CAMERA, SHIFT, TARGET, write_bench
from tests.fuzz.files.damage import damaged_text, spoil_file
from tests.fuzz.files.damaged_files import Hung, alarm
from tests.fuzz.files.originals import write_originals

LEFT_OUT = {
    "demo",
    "setup warm",
    "bench emulate",
    "bench live",
    "setup mask",
    "doctor",
    "doctor --probe",
    "laser",
    "bench camera",
}
LONGEST_S = 60
WORDS = (
    "", " ", "-", "--", "0", "-1", "1e999", "nan", "-inf", "1" * 5000, "9" * 25, "20,5", "٣", "½", "x" * 5000,
    "é\u202e", "\ud800", "\x1b[31m", "a\nb", "*", "..", "%05d.tif", "%n", "target_x=", "=", "target_x=1e309",
    "scene.yaml", "bench.yaml", "no/such/file.yaml", "None", "true", "1:2", "{}", "[1, 2", "@bench.yaml",
)  # fmt: skip
USUAL = ("1", "2", "0.5", "532", "glass", "near", "out", "504", "none", "8")
COSTLY = ("--simulate", "--live")  # a world of its own, and a page


@dataclass
class Tally:
    """What many command lines showed."""

    codes: dict[int, int] = field(default_factory=dict)
    findings: list[str] = field(default_factory=list)


class CommandGround:
    """A folder with a lab, a run and damaged copies of their files, in which command lines are tried."""

    def __init__(self, folder):
        self.folder = folder
        folder.mkdir(parents=True)
        write_originals(folder)
        write_bench(folder, camera=FILES_CAMERA)
        (folder / "plan-target.yaml").write_text(TARGET)
        (folder / "plan-shift.yaml").write_text(SHIFT)
        (folder / "endless.yaml").symlink_to("/dev/zero")
        (folder / "nothing.tif").symlink_to("/dev/null")
        self.files = [str(p.relative_to(folder)) for p in sorted(folder.rglob("*"))] + [".", "no/such/file"]
        self.texts = {path: path.read_text() for path in folder.glob("[bpsr]*.yaml")}
        self.verbs = _verbs()

    def play(self, seed, number, tally):
        """Play one case."""
        rng = random.Random(f"{seed} {number}")
        for path, text in self.texts.items():  # a verb may have written there
            path.write_text(text)
        words = self.command(rng)
        said, code = io.StringIO(), None
        try:
            with alarm(LONGEST_S), contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                code = main(words)
        except SystemExit as end:  # of argparse
            code = end.code
        except Hung:
            tally.findings.append(f"case {number}: {words!r:.500}: hangs")
        except BaseException as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            what = f"{type(error).__name__}: {error!s:.200} ({where.filename}:{where.lineno})"
            tally.findings.append(f"case {number}: {words!r:.500}: {what}")
        if "Traceback" in said.getvalue() or (code is not None and code not in (DONE, USAGE, DEVICE, INTERRUPTED)):
            tally.findings.append(f"case {number}: {words!r:.500}: ends with {code}: {said.getvalue()[-500:]}")
        tally.codes[code] = tally.codes.get(code, 0) + 1

    def command(self, rng):
        """A verb with what may stand behind it."""
        verb, wild = rng.choice(list(self.verbs)), rng.choice((0.02, 0.02, 0.2, 0.6))
        words = verb.split()
        for action in self.verbs[verb]:
            flag = action.option_strings[-1:]
            wanted = not flag or action.required or rng.random() < 0.2
            if not wanted or (flag and flag[0] in COSTLY and rng.random() < 0.9):
                continue
            words += flag
            if action.nargs != 0:
                many = action.nargs if isinstance(action.nargs, int) else 1
                words += [self.value(rng, action, wild) for _ in range(many)]
                if rng.random() < 0.2 * wild:
                    words.append(self.value(rng, action, wild))
        if rng.random() < 0.3 * wild:
            words.insert(rng.randrange(len(words) + 1), rng.choice((*WORDS, "--nonsense", "--threads")))
        if any(action.dest == "pictures" for action in self.verbs[verb]) and "--no-pictures" not in words:
            words.append("--no-pictures")  # their process would take longer than all else
        return words

    def value(self, rng, action, wild):
        """One word: of a kind that the option wants, or in a share `wild` of them not."""
        if rng.random() < wild:
            return rng.choice(WORDS)
        if action.choices is not None:
            return str(rng.choice(list(action.choices)))
        if action.type is not Path and rng.random() > wild:
            return rng.choice(USUAL)
        fitting = [name for name in self.files if action.dest in name]  # scene, bench, plan, run
        name = rng.choice(fitting if fitting and rng.random() > wild else self.files)
        whole = self.folder / name
        if not name.endswith(".yaml") or rng.random() < 0.5 or not whole.is_file():
            return name
        if rng.random() < 0.1:
            spoilt = self.folder / "none.yaml"
            if spoilt.is_dir() and not spoilt.is_symlink():
                shutil.rmtree(spoilt)
            spoilt.unlink(missing_ok=True)
            spoil_file(spoilt, whole.read_bytes(), rng)
            return "none.yaml"
        damaged = self.folder / "damaged.yaml"
        damaged.write_text(damaged_text(whole.read_text(), rng))
        return damaged.name


def _verbs():
    """Verb -> its actions, but for help."""
    kept = {verb: parser_of(verb)._actions for verb in commands() if verb not in LEFT_OUT}
    return {
        verb: [a for a in actions if a.dest not in ("help", "trust", "variant")] for verb, actions in kept.items()
    }


def hostile(seed, numbers, ground, tell=print):
    """Play the cases of a seed, and tell each finding at once."""
    tally = Tally()
    for number in numbers:
        told = len(tally.findings)
        ground.play(seed, number, tally)
        for finding in tally.findings[told:]:
            tell(finding)
    return tally
