"""Commands as the pages have them: lines of README.md and docs/*.md that begin with `rtpiv`, and their text.

Which of them no test runs, and why, stands here.
"""

import glob
import re
import shlex
from pathlib import Path

from rtpiv.options.command import commands as all_commands

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
FIRST = [ROOT / "README.md", DOCS / "commands.md"]  # what they leave is used by the pages after them
PAGES = [*FIRST, *sorted(set(DOCS.glob("*.md")) - set(FIRST))]
SITE = [ROOT / "README.md", *(page for page in sorted(DOCS.rglob("*.md")) if "_build" not in page.parts)]

COMMANDS = set(all_commands())
HARDWARE = "opens real devices: no --simulate"
CLUSTER = "needs a cluster"
REHEARSED = "in a lab of its own: tests/faces/test_rehearsal_page.py"
STEREO = "two cameras: tests/rtpiv/verbs/test_stereo.py"
CAMERAS = "two cameras: tests/rtpiv/verbs/test_calibrate_cameras.py"
BENCH = "two cameras of a bench: tests/system/test_stereo_on_a_bench.py"
BED = "a bed of 22 balls takes minutes: run by hand, with the figures of the page"
BY_HAND = "a board held by hand: tests/correction/lens/test_lens_fit.py has photographs"
NOT_RUN = {  # commands that nothing here carries out, and why; all others are run as they stand
    "calibrate --join RUN RUN/cameras/side -o fit": CAMERAS,
    "trace left.yaml --beside right.yaml": "tests/rtpiv/analysis/views/test_two_cameras.py",
    "mean --join RUN RUN/cameras/behind -o joined": STEREO,
    "acquire plan-flow.yaml --bench bench-flow.yaml --simulate --home --operator me": BENCH,
    "acquire plan-target.yaml --bench bench.yaml --simulate --home --operator me --no-correct": BED,
    "calibrate runs/*plan-target -o bedfit": BED,
    "mean runs/*plan-flow --scene bedfit/scene.yaml --final-window 24": BED,
    "mean --join RUN RUN/cameras/side -o joined": BENCH,
    "mean --join left right --scene left.yaml right.yaml --simultaneous --dt-us 500 -o joined": STEREO,
    "mean --join left right --scene left.yaml right.yaml --simultaneous --sheet -o joined": STEREO,
    "calibrate poses/ --square-mm 25 --scene scene.yaml -o lens": BY_HAND,
    "demo": "the first hour with a finer camera, step by step: `make demo` at each check of a change",
    "init lab": "asks a person: tests/rtpiv/verbs/test_init.py answers",
    "init . --yes --balls 1 --sensor-px 128 128 --pixel-pitch-um 86": REHEARSED,
    "acquire plan-target.yaml --simulate --faults faults.yaml --seed 3 --home --no-correct": REHEARSED,
    "bench live --bench bench-sim.yaml --simulate": "in the lab of examples, by its own test",
    "bench stage --bench bench.yaml": "a prompt: tests/system/test_first_day.py types what at-the-bench.md has",
    "align plan-align.yaml --bench bench.yaml --home": HARDWARE,
    "acquire plan-target.yaml --bench bench.yaml --home": HARDWARE,
    "acquire plan-shift.yaml --bench bench.yaml --scene fit/scene.yaml": HARDWARE,
    "acquire plan-shift.yaml --live": HARDWARE,
    "acquire plan-flow.yaml --bench bench-flow.yaml": HARDWARE,
    "laser off": "reaches lasers of all programs here: tests/rtpiv/verbs/test_laser_verb.py has its own",
    "laser prove --bench bench-flow.yaml": HARDWARE,
    "doctor --probe /dev/ttyUSB0": HARDWARE,
    "focus runs/*focus": "its run is one of plan-focus.yaml, with a lens of its own: tests/system/test_focus.py",
    "campaign run -o week --scheduler tcp://10.0.0.1:8786": CLUSTER,
}
NAMED = "a word for what another page gives as a whole"
BOARD = "a board that somebody has printed: tests/rtpiv/analysis/prints"
IN_TEXT = {  # with words behind the verb -> the same in a lab after its first hour, or why not
    "bench camera list": "bench camera list --simulate",
    "bench camera snap -o snap.tif": "bench camera snap -o snap.tif --simulate",
    "bench camera test": "bench camera test --simulate",
    "init lab --by-hand": "init hands --yes --by-hand",
    "init --arrangement bcc --layers 3 --plane 1.5": "init deeper --yes --arrangement bcc --layers 3 --plane 1.5",
    "init --arrangement tube --layers 5 --ball-mm 15 --glass N-BK7":
        "init tube --yes --arrangement tube --layers 5 --ball-mm 15 --glass N-BK7",
    "bench live --camera side": "of a bench with two cameras: tests/rtpiv/verbs/test_live_place.py",
    "setup target scene.yaml": "setup target scene.yaml",
    "setup target board.yaml": "setup target board.yaml",
    "correct ... --scene scene.yaml --square-mm 4 --target-clear target_clear.tif":
        "correct frames/target_glass.tif --scene scene.yaml --square-mm 4 --target-clear frames/target_clear.tif",
    "mean RUN --ensemble 16": "mean runs/*flow --scene fit/scene.yaml --ensemble 16",
    "mean SERIES --w-over-u 0": "mean runs/*flow/series --w-over-u 0",
    "mean week/runs/NAME": "mean week/runs/RUN1",
    "evaluate A B --scene scene.yaml -o FOLDER": "evaluate a.tif b.tif --scene scene.yaml -o one",
    "evaluate RUN -o FOLDER": "evaluate RUN1 -o other",
    "laser align --rate-hz 5 --for-s 10": "asks a person for a code: tests/rtpiv/verbs/test_laser_verb.py",
    "align plan-align.yaml --bench bench.yaml": NAMED,
    "acquire plan-target.yaml --bench bench.yaml --home --dry-run":
        "acquire plan-target.yaml --bench bench.yaml --home --dry-run",
    "calibrate runs/<run> -o fit": NAMED,
    "report runs/<run> --scene fit/scene.yaml": NAMED,
    "sheet runs/...flow --scene fit/scene.yaml -o sheet": NAMED,
    "sheet RUN --scene fit/scene.yaml -o sheet": NAMED,
    "mean FOLDER --at X Y -o OUT": NAMED,
    "report RUN": NAMED,
    "mean RUN": NAMED,
    "check RUN": NAMED,
    "check RUN...": NAMED,
    "check runs/<run>": NAMED,
    "check FILE...": NAMED,
    "trace scene.yaml": NAMED,
    "doctor --probe PORT": NAMED,
    "laser prove": NAMED,
    "bench stage < morning.txt": "a shell's own word: tests/system/test_stage_terminal.py",
    "bench stage move --home glass_y=-20": "tests/system/test_first_day.py",
    "acquire --resume runs/<run>": "a run that was stopped: tests/system/test_kills.py",
    "acquire --resume --home": "the same",
    "acquire --resume RUN --home": REHEARSED,
    "acquire --resume runs/<run> --retake": "a run with damage: tests/daq/runs/test_damaged_frames.py",
    "focus RUN": "tests/system/test_focus.py",
    "mean --join week/runs/BESIDE week/runs/BEHIND": "two runs, focused apart: tests/system/test_split_focus.py",
    "mean --join RUN RUN/cameras/behind": STEREO,
    "setup mask FRAME": "a page for a person: tests/rtpiv/verbs/test_masks.py",
    "setup target [SCENE]": BOARD,
    "setup target board.yaml --measured-mm X Y": BOARD,
}  # fmt: skip


def commands(page: Path) -> list[str]:
    """What stands behind `rtpiv` on a page, without comments, in order."""
    return [line.rstrip() for line in re.findall(r"^    rtpiv ([^#\n]+)", page.read_text("utf-8"), re.MULTILINE)]


def in_text(page: Path) -> list[str]:
    """What stands behind `rtpiv` in the text of a page, with words behind the verb, that no block has."""
    found = re.findall(r"`rtpiv (\w[^`]*)`", prose(page))
    plain = [" ".join(each.split()) for each in found]
    return [each for each in plain if " " in each and each not in COMMANDS and not each.startswith(("VERB", "--"))]


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)


def places(page: Path) -> set[str]:
    """What can be linked to on a page: its headings, as code forges and MyST write them."""
    headings = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def in_files(folder: Path) -> list[str]:
    """Commands that the files of a folder have in their comments, in the order of the files."""
    files = sorted(folder.glob("*.yaml"))
    return [found for file in files for found in re.findall(r"`rtpiv ([^`]*--[^`{]*)`", file.read_text("utf-8"))]


def words(command: str) -> list[str]:
    """Words of a command as a shell would hand them on from the current folder."""
    found = []
    for word in shlex.split(command):
        found += sorted(glob.glob(word)) or [word] if "*" in word else [word]  # noqa: PTH207
    return found
