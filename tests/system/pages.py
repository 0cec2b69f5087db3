"""Commands as the pages have them: indented lines of README.md and docs/*.md that begin with `rtpiv`."""

import glob
import re
import shlex
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
FIRST = [ROOT / "README.md", DOCS / "commands.md"]  # what they leave is used by the pages after them
PAGES = [*FIRST, *sorted(set(DOCS.glob("*.md")) - set(FIRST))]
SITE = [ROOT / "README.md", *(page for page in sorted(DOCS.rglob("*.md")) if "_build" not in page.parts)]

HARDWARE = "opens real devices: no --simulate"
LASTS = "lasts until somebody ends it"
CLUSTER = "needs a cluster"
OTHERS = "frames of another program, which no lab has"
NAMES = "names stand for folders of the reader"
LONG = "takes many minutes, and has a test of its own"
REHEARSED = "in a lab of its own: tests/faces/test_rehearsal_page.py"
NOT_RUN = {  # commands that nothing here carries out, and why; all others are run as they stand
    "demo": LONG,
    "live --bench bench-sim.yaml --simulate": LASTS,
    "live --bench bench.yaml": LASTS,
    "init lab": "asks a person",
    "init . --yes --balls 1 --sensor-px 128 128 --pixel-pitch-um 86": REHEARSED,
    "acquire plan-target.yaml --simulate --faults faults.yaml --seed 3 --home --no-correct": REHEARSED,
    "benchmark scene.yaml": LONG,
    "stage --bench bench.yaml": HARDWARE,
    "align plan-align.yaml --bench bench.yaml --home": HARDWARE,
    "acquire plan-target.yaml --bench bench.yaml --home": HARDWARE,
    "acquire plan-shift.yaml --bench bench.yaml --scene fit/scene.yaml": HARDWARE,
    "acquire plan-shift.yaml --live": HARDWARE,
    "acquire plan-flow.yaml --bench bench-flow.yaml": HARDWARE,
    "laser off": HARDWARE,
    "laser prove --bench bench-flow.yaml": HARDWARE,
    "probe /dev/ttyUSB0": HARDWARE,
    "focus runs/*focus": "its run is one of plan-focus.yaml, with a lens of its own: tests/system/test_focus.py",
    "campaign run RUN1 RUN2 --scene fit/scene.yaml -o week": NAMES,
    "campaign run -o week --scheduler tcp://10.0.0.1:8786": CLUSTER,
    "campaign run -o week --slurm 64 --slurm-set slurm_partition=long timeout_min=120 mem_gb=4": CLUSTER,
    "evaluate 'day1/B%05d_a.tif' --scene fit/scene.yaml --dt-us 500 -o day1/series": OTHERS,
    "mean day1 --scene fit/scene.yaml --dt-us 500 --ensemble 16": OTHERS,
    "evaluate A.tif B.tif --scene fit/scene.yaml --dt-us 500": OTHERS,
}


def commands(page: Path) -> list[str]:
    """What stands behind `rtpiv` on a page, without comments, in order."""
    return [line.rstrip() for line in re.findall(r"^    rtpiv ([^#\n]+)", page.read_text("utf-8"), re.MULTILINE)]


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
