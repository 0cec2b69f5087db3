"""README, docs and examples: every command is run as it stands, in a lab of `init` or in one of `examples`.

What opens real devices is run on the simulated bench; what is not run is marked with the reason.
"""

import json
import re
import shutil

import pytest

from rtpiv.command_line.cli import DEVICE, DONE, main
from rtpiv.options import parser
from tests.system.pages import DOCS, HARDWARE, NOT_RUN, PAGES, ROOT, SITE, commands, in_files, places, words

README = ROOT / "README.md"
QUICK = [  # of a second or two each, on a lab that nobody has measured in
    "check .",
    "acquire plan-target.yaml --bench bench.yaml --dry-run",
    "check bench.yaml",
    "devices",
    "doctor --bench bench.yaml",
]
SMALL = ["--sensor-px", "504", "504", "--pixel-pitch-um", "11"]
SAYS = {"doctor --bench bench.yaml": DEVICE}  # what a command ends with where no device of the bench is there
SIMULATED = {  # commands at real devices -> what makes them commands of this lab
    command: ["--simulate", "--home", "--operator", "page"] if command.startswith("acquire") else ["--simulate"]
    for command, why in NOT_RUN.items()
    if why == HARDWARE and command.startswith(("acquire", "align", "laser prove"))
}
FIRST = {"report": "runs/*plan-shift/report/report.html", "mean": "runs/*flow/series/*.html"}  # through glass
FLOW = "acquire plan-flow.yaml --bench bench-flow.yaml"
FEW = ((r"\bpairs: 1\d+", "pairs: 10"), (r"chunk: \d+", "chunk: 10"), (r"{pairs: \d+}", "{pairs: 4}"))
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
    "align": ("runs/*plan-align/done.json",),
}
SAID = {  # what must be said
    "trace": "through glass",  # "has what is seen through glass in front"
    "check .": "through glass",
    "mean": "10 of 10 pairs",  # "every pair of a flow"
    "sheet": "z",
    "campaign status": "done",
    "campaign merge": "10 pairs in the mean",
    "check runs/*": "hash",
    "acquire plan-target.yaml --bench bench.yaml --dry-run": "steps",
}


@pytest.mark.parametrize("command", sorted({command for _, command in ALL}))
def test_every_command_is_one_that_the_program_takes(command):
    parser().parse_args(words(command))


def test_what_is_not_run_stands_on_a_page_and_what_is_quick_too():
    said = {command for _, command in ALL}
    assert set(NOT_RUN) <= said
    assert set(QUICK) <= said
    assert not set(QUICK) & set(NOT_RUN)
    assert len(FIRST_HOUR) == 7
    assert not [command for command in said if "..." in command]


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
    assert fit["map_sigma_px"]["behind glass"]["median"] < 0.02  # px: the scene file says what lights the target
    assert all(0.8 < way["rough_square"] < 1.4 for way in fit["model"]["ways"])
    shutil.copy(ROOT / "examples" / "plan-align.yaml", lab)
    _few_pairs(lab)
    _frames_of_the_reader(lab)
    assert not (wrong := _wrong(FLOW, lab, capsys)), wrong  # mean, sheet and campaign stand before it on some page
    for _, command in ALL:
        if command not in done | {FLOW} and (command not in NOT_RUN or command in SIMULATED):
            missed += filter(None, [_wrong(command, lab, capsys)])
            done.add(command)
    assert not missed, "\n".join(missed)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_lab_of_examples(tmp_path, monkeypatch, capsys):
    """What README says of `rtpiv examples`, and what the files say in comments, with a quarter of the view."""
    monkeypatch.chdir(tmp_path)
    lab = tmp_path / "examples"
    assert main(["examples"]) == DONE
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
    )
    assert not [wrong for command in then if (wrong := _wrong(command, lab, capsys))]


def test_what_the_examples_say_in_their_comments_is_taken():
    for command in in_files(ROOT / "examples"):
        parser().parse_args(command.split())


def _wrong(command, lab, capsys):
    """What is not as its page says after a command; empty if all is."""
    code = main([*words(command), *SIMULATED.get(command, [])])
    said = capsys.readouterr()
    if code != SAYS.get(command, DONE) or "Traceback" in said.err:
        return f"rtpiv {command} ends with {code}: {said.err[-1500:]}"
    for start, patterns in MADE.items():
        if f"{command} ".startswith(f"{start} ") and (
            lack := [each for each in patterns if not list(lab.glob(each))]
        ):
            return f"rtpiv {command} has left no {' and no '.join(lack)}"
    for start, text in SAID.items():
        if f"{command} ".startswith(f"{start} ") and text not in " ".join(said.out.split()):
            return f"rtpiv {command} does not say {text!r}: {said.out[-1500:]}"
    for start, pattern in FIRST.items():
        if f"{command} ".startswith(f"{start} ") and not any(
            "is seen through glass" in page.read_text() for page in lab.glob(pattern)
        ):
            return f"rtpiv {command}: its page does not say what is seen through glass"
    return ""


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
