"""No two folders of the program import each other, and each stands on the floors that its package allows."""

import re
from itertools import combinations
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("ground", "piv", "tracer", "stages", "correction", "daq", "sim", "rtpiv")
ALONE = ("piv", "tracer", "stages")  # each can be taken out and used with ground
TAKEN = re.compile(r"^[ \t]*from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)
IMPORT = re.compile(r"^[ \t]*import[ \t]+([^\n]*)", re.MULTILINE)


def modules() -> dict[str, Path]:
    """Every module of the program by its dotted name."""
    found = {}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            found[name.removesuffix(".__init__")] = path
    return found


def imported(path: Path, known: dict[str, Path]) -> set[str]:
    """Names of the program's modules that a file imports, wherever in it; by its text, as parsing takes long."""
    text, names = path.read_text(encoding="utf-8"), set()
    for module, taken in TAKEN.findall(text):
        whole = {f"{module}.{name}" for name in re.findall(r"\w+", taken)}
        names |= (whole & known.keys()) or {module}
    for line in IMPORT.findall(text):
        names |= set(re.findall(r"[\w.]+", line))
    return names & known.keys()


def test_no_two_folders_import_each_other_and_three_parts_stand_alone():
    known = modules()
    arrows: dict[tuple[Path, Path], tuple[str, str]] = {}
    for name, path in known.items():
        for other in imported(path, known):
            arrows[path.parent, known[other].parent] = (name, other)
            first, second = name.partition(".")[0], other.partition(".")[0]
            assert first not in ALONE or second in (first, "ground"), f"{name} imports {other}"
    folders = {path.parent for path in known.values()}
    both = [(arrows[a, b], arrows[b, a]) for a, b in combinations(folders, 2) if {(a, b), (b, a)} <= arrows.keys()]
    assert len(arrows) > 200  # it does read imports
    assert not both


def test_the_page_of_the_architecture_names_every_folder_and_no_file_that_is_gone():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    folders = {path.parent for package in PACKAGES for path in (ROOT / package).rglob("*.py")}
    named = set(re.findall(r"^\| `([\w/]+)/` \|", page, re.MULTILINE))
    assert {path.relative_to(ROOT).as_posix() for path in folders if "kernels" not in path.parts} <= named
    places = set(re.findall(rf"`((?:{'|'.join(PACKAGES)})/[\w/.]+)`", page))
    assert len(places) > 50  # it does find them
    homes = [(ROOT / place, (ROOT / place).with_suffix(".py")) for place in places]
    assert not [str(place) for place, module in homes if not place.exists() and not module.exists()]
