"""README, docs and examples: every command is run as it stands, in a lab of `init` or in one of `examples`.

What opens real devices is run on the simulated bench; what is not run is marked with the reason.
"""

import json
import re
import shutil
import signal
import subprocess
import sys
import time

import pytest
import tifffile

from daq.runs.pairs import pairs_of
from rtpiv.command_line.cli import DEVICE, DONE, main
from rtpiv.options import parser
from rtpiv.options.command import VERBS
from tests.loops import loop_over
from tests.system.pages import (
    DOCS,
    HARDWARE,
    IN_TEXT,
    NOT_RUN,
    PAGES,
    ROOT,
    SITE,
    commands,
    in_files,
    in_text,
    places,
    words,
)

README = ROOT / "README.md"
QUICK = [  # of a second or two each, on a lab that nobody has measured in
    "check .",
    "acquire plan-target.yaml --bench bench.yaml --dry-run",
    "check bench.yaml",
    "doctor",
]
SMALL = ["--sensor-px", "504", "504", "--pixel-pitch-um", "11"]
SAYS = {"doctor --bench bench.yaml": DEVICE}  # what a command ends with where no device of the bench is there
SIMULATED = {  # commands at real devices -> what makes them commands of this lab
    command: ["--simulate", "--home", "--operator", "page"] if command.startswith("acquire") else ["--simulate"]
    for command, why in NOT_RUN.items()
    if why == HARDWARE and command.startswith(("acquire", "align", "laser prove"))
}
ENDED = {
    "bench live --bench bench.yaml": ["--simulate", "--for-s", "2"],  # would last until somebody ends it
    "calibrate frames/ --scene scene.yaml --square-mm 4 -o fit": [
        "--overwrite"
    ],  # of a reader without the first hour
}
UNTIL_CTRL_C = ("setup mask a.tif -o mask.png",)  # the same, of what knows no other end
FIRST = {"report": "runs/*plan-shift/report/report.html", "mean": "runs/*flow/series/*.html"}  # through glass
FLOW = "acquire plan-flow.yaml --bench bench-flow.yaml"
FEW = ((r"\bpairs: (20|1000)\b", "pairs: 10"), (r"chunk: \d+", "chunk: 10"), (r"{pairs: \d+}", "{pairs: 4}"))
CALM = {"calibrate": "fit.light", "correct": "Traceback"}  # what must not be said
OTHER_PROGRAMS = {  # of a page, each with the test that does the same
    "README.md": ("cd", "python3"),
    "install.md": ("python3",),  # below; tests/wheel/test_installed.py
    "first-lab.md": ("cd",),  # tests/system/test_tutorials.py
    "own-frames.md": ("cd", "python"),
    "plain-piv.md": ("cd", "python"),
    "live.md": ("ssh",),  # another computer
    "rehearse.md": ("python",),  # tests/faces/test_rehearsal_page.py
    "alignment.md": ("pytest",),  # slow tests
    "add-a-stage.md": ("pytest",),
}
ALL = [(page, command) for page in PAGES for command in commands(page)]
FIRST_HOUR = commands(README)[commands(README).index("init lab") + 1 :][:7]
MADE = {  # what must be there after a command, as its page says
    "trace": ("trace/*.png",),  # "the first pictures"
    "calibrate": ("fit/scene.yaml", "fit/*.html"),
    "report": ("runs/*plan-shift/report/report.html",),
    FLOW: ("runs/*plan-flow/done.json",),
    "mean": ("runs/*flow/series/mean.nc", "runs/*flow/series/*.html"),  # "then mean and Reynolds stresses"
    "sheet": ("sheet/scene.yaml", "sheet/sheet.png"),  # "where the light sheet is"
    "campaign run": ("week/campaign.json",),
    "correct": ("corrected/*.tif",),
    "export shift/vectors.nc": ("exported*/vectors.vt*",),  # "to paraview"
    "export fit/scene.yaml": ("exported*/*.tif*",),
    "align plan-align.yaml --bench bench.yaml --home": ("runs/*plan-align/done.json",),
}
SAID = {  # what must be said
    "trace": "through glass",  # "has what is seen through glass in front"
    "check .": "through glass",
    "mean": "10 pairs",
    "mean runs/*flow --scene fit/scene.yaml": "10 of 10 pairs",  # "every pair of a flow"
    "sheet": "z",
    "campaign status": "done",
    "campaign merge": "20 pairs in the mean",  # of two runs, docs/campaigns.md
    "check runs/*": "hash",
    "mean day1": "10 of 10 pairs",
    "bench live": "look at",  # "print an address for a browser"
    "acquire plan-target.yaml --bench bench.yaml --dry-run": "steps",
}


@loop_over("command", sorted({command for _, command in ALL}))
def test_every_command_is_one_that_the_program_takes(command):
    parser(words(command)).parse_args(words(command))


def test_what_is_not_run_stands_on_a_page_and_what_is_quick_too():
    said = {command for _, command in ALL}
    assert set(NOT_RUN) <= said
    assert set(QUICK) <= said
    assert not set(QUICK) & set(NOT_RUN)
    assert len(FIRST_HOUR) == 7
    assert not [command for command in said if "..." in command]


def test_every_command_in_a_text_is_run_or_has_a_reason():
    """Those that a block of some page has too are run there."""
    said = {command for page in PAGES for command in in_text(page)} - {command for _, command in ALL}
    assert said == set(IN_TEXT) - {command for _, command in ALL}
    for page in SITE:  # verbs that a text names
        for verb in re.findall(r"`rtpiv ([a-z]\w*)[^`]*`", page.read_text("utf-8")):
            assert verb in VERBS, f"{page}: rtpiv {verb}"


def test_every_other_line_of_a_block_is_known():
    """Of shells and make: targets that there are, and what the test of the wheel does."""
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    for page in [*SITE, ROOT / "CONTRIBUTING.md"]:
        text = page.read_text("utf-8")
        assert set(re.findall(r"^    make ([a-z-]+)", text, re.MULTILINE)) <= targets
        for line in re.findall(r"^    pytest (.*)", text, re.MULTILINE):
            assert all((ROOT / word).exists() for word in line.split() if "/" in word), line
        for program in re.findall(r"^    (cd|python3?|pip|ssh|pytest|source|curl) ", text, re.MULTILINE):
            assert program in OTHER_PROGRAMS.get(page.name, ()), f"{page}: {program}"


def test_what_a_text_names_is_taken_as_well():
    for command in IN_TEXT.values():
        if command.split()[0] in VERBS:
            parser(command.split()).parse_args(command.split())


def test_every_link_leads_to_a_file_and_to_a_place_in_it():
    for page in SITE:
        links = re.findall(r"""(?:\]\(|src=")([^)"\s]+)""", page.read_text("utf-8"))
        for link in (link for link in links if "://" not in link):
            name, _, place = link.partition("#")
            there = (page.parent / name).resolve() if name else page
            assert there.exists(), f"{page}: {link}"
            assert not place or place in places(there), f"{page}: {link}"


def test_every_page_is_linked_from_another():
    links = {
        (page.parent / link).resolve()
        for page in PAGES
        for link in re.findall(r"\]\(([^)#\s]+)", page.read_text("utf-8"))
    }
    assert links >= set(PAGES[1:]) - {DOCS / name for name in ("index.md", "contributing.md", "decisions.md")}


@pytest.fixture(scope="module")
def small_lab(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages") / "lab"
    said = ["init", str(folder), "--yes", "--balls", "2", "--sensor-px", "252", "252", "--pixel-pitch-um", "88"]
    assert main(said) == DONE
    return folder


@pytest.mark.parametrize("command", QUICK)
def test_quick_commands_of_the_pages(small_lab, monkeypatch, capsys, command):
    monkeypatch.chdir(small_lab)
    assert main(words(command)) == SAYS.get(command, DONE), capsys.readouterr().err
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    if command == "check .":
        files = sorted(path.name for path in small_lab.glob("*.yaml"))
        told = re.findall(r"^(\S+\.yaml) +ok", said.out, re.MULTILINE)
        assert sorted(told) == files  # "every file, and every plan on its bench"
    if "--dry-run" in command:
        for word in ("steps", "travel", "frames"):
            assert word in said.out  # "steps, travel, time, disk, violations"
        assert not (small_lab / "runs").exists()  # "moves nothing"


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_first_hour_and_what_follows_it(tmp_path, monkeypatch, capsys):
    """The block of README as it stands; then, in the lab it leaves, every other command, flow and all."""
    monkeypatch.chdir(tmp_path)
    lab, done, missed = tmp_path / "lab", set(), []
    for number, command in enumerate(FIRST_HOUR):
        assert not (wrong := _wrong(command, lab, capsys)), wrong
        done.add(command)
        if number == 0:  # the same lab with a quarter of the pixels, for time
            shutil.rmtree(lab)
            assert main([*words(command), *SMALL]) == DONE
            capsys.readouterr()
            monkeypatch.chdir(lab)
    fit = json.loads((lab / "fit" / "calibration.json").read_text())
    assert fit["map_sigma_px"]["behind glass"]["median"] < 0.2  # px: nobody has measured the print of board.yaml
    assert all(0.8 < way["rough_square"] < 1.4 for way in fit["model"]["ways"])
    shutil.copy(ROOT / "examples" / "plan-align.yaml", lab)
    shutil.copytree(ROOT / "examples", lab / "examples")
    _few_pairs(lab)
    _frames_of_the_reader(lab)
    assert not (wrong := _wrong(FLOW, lab, capsys)), wrong  # mean, sheet and campaign stand before it on some page
    _frames_of_another_program(lab)
    for _, command in ALL:
        if command not in done | {FLOW} and (command not in NOT_RUN or command in SIMULATED):
            if "RUN1" in command:
                _two_runs(lab)
            missed += filter(None, [_wrong(command, lab, capsys)])
            done.add(command)
    for command in IN_TEXT.values():
        if command.split()[0] in VERBS and command not in done:
            missed += filter(None, [_wrong(command, lab, capsys)])
    assert not missed, "\n".join(missed)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_lab_of_examples(tmp_path, monkeypatch, capsys):
    """README on `rtpiv setup examples`, and the comments of the files, with a quarter of the view."""
    monkeypatch.chdir(tmp_path)
    lab = tmp_path / "examples"
    assert main(["setup", "examples"]) == DONE
    monkeypatch.chdir(lab)
    for check in ("check .", "trace two_spheres_500.yaml -o trace"):
        assert not (wrong := _wrong(check, lab, capsys)), wrong
    scene = lab / "two_spheres_500.yaml"
    scene.write_text(scene.read_text().replace("[2016, 2016]", "[1008, 1008]"))
    _few_pairs(lab)
    found = in_files(lab)
    assert len(found) >= 3
    assert not [wrong for command in found if (wrong := _wrong(command, lab, capsys))]
    then = (
        "calibrate runs/*plan-target -o fit",
        "acquire plan-shift.yaml --bench bench-sim.yaml --simulate --home --scene fit/scene.yaml",
        "report runs/*plan-shift --scene fit/scene.yaml",
        "mean runs/*flow --scene fit/scene.yaml",
        "check runs/*",
        "live --bench bench-sim.yaml --simulate --for-s 2",  # as docs/commands.md has it, and an end
    )
    assert not [wrong for command in then if (wrong := _wrong(command, lab, capsys))]


def test_what_the_examples_say_in_their_comments_is_taken():
    for command in in_files(ROOT / "examples"):
        parser(command.split()).parse_args(command.split())


def _wrong(command, lab, capsys):
    """What is not as its page says after a command; empty if all is."""
    if command in UNTIL_CTRL_C:
        code, out, err = _ended(words(command))
    else:
        code = main([*words(command), *SIMULATED.get(command, []), *ENDED.get(command, [])])
        out, err = capsys.readouterr()
    if code != SAYS.get(command, DONE) or "Traceback" in err:
        return f"rtpiv {command} ends with {code}: {err[-1500:]}"
    for start, patterns in MADE.items():
        if f"{command} ".startswith(f"{start} ") and (
            lack := [each for each in patterns if not list(lab.glob(each))]
        ):
            return f"rtpiv {command} has left no {' and no '.join(lack)}"
    for start, text in SAID.items():
        if f"{command} ".startswith(f"{start} ") and text not in " ".join(out.split()):
            return f"rtpiv {command} does not say {text!r}: {out[-1500:]}"
    for start, text in CALM.items():
        if f"{command} ".startswith(f"{start} ") and text in " ".join(out.split()):
            return f"rtpiv {command} says {text!r}"
    for start, pattern in FIRST.items():
        if f"{command} ".startswith(f"{start} ") and not any(
            "is seen through glass" in page.read_text() for page in lab.glob(pattern)
        ):
            return f"rtpiv {command}: its page does not say what is seen through glass"
    return ""


def _frames_of_another_program(lab):
    """day1/ with the pairs of the flow as another program names them, A.tif and B.tif."""
    (run,) = (lab / "runs").glob("*plan-flow")
    pairs = [pair.frames for pair in pairs_of(run).pairs if not pair.is_background]
    (lab / "day1").mkdir()
    for number, frames in enumerate(pairs, start=1):
        for letter, frame in zip("ab", frames, strict=True):
            pixels = tifffile.imread(frame)
            tifffile.imwrite(lab / "day1" / f"B{number:05d}_{letter}.tif", pixels)
            tifffile.imwrite(lab / f"{letter.upper()}.tif", pixels)


def _two_runs(lab):
    """RUN1 and RUN2, and no campaign of other runs in week/."""
    (run,) = (lab / "runs").glob("*plan-flow")
    for name in ("RUN1", "RUN2"):
        shutil.copytree(run, lab / name)
    (lab / "week").rename(lab / "week-of-one-run")


def _ended(words_of_it):
    """Exit code, output and errors of a command that is ended by Ctrl-C once it has said where to look."""
    out = ""
    program = [sys.executable, "-m", "rtpiv", *words_of_it]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as asked:
        while "look at http" not in out and (line := asked.stdout.readline()):
            out += line
        time.sleep(1.0)
        asked.send_signal(signal.SIGINT)
        rest, err = asked.communicate(timeout=120)
    return asked.returncode, out + rest, err


def _few_pairs(lab):
    """The flow of a plan in a tenth of its pairs."""
    plan = lab / "plan-flow.yaml"
    text = plan.read_text()
    for before, after in FEW:
        text = re.sub(before, after, text)
    plan.write_text(text)


def _frames_of_the_reader(lab):
    """frames/ with the target's frames, named by hand, a.tif and b.tif of the shift: what a reader brings."""
    (target,), (shift,) = (lab / "runs").glob("*plan-target"), (lab / "runs").glob("*plan-shift")
    (lab / "frames").mkdir()
    for step in json.loads((target / "run.json").read_text())["steps"]:
        shutil.copy(target / "frames" / f"{step['first_frame']:06d}.tif", lab / "frames" / f"{step['tag']}.tif")
    first, second = sorted((shift / "frames").glob("*.tif"))[:2]
    for source, name in ((first, "a.tif"), (second, "b.tif")):
        shutil.copy(source, lab / name)
