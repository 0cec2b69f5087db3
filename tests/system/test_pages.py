"""README and docs: every command is run as it stands, in a lab of `init`, or marked with the reason why not."""

import re
import shutil

import pytest

from daq.cli import DEVICE, DONE, main
from daq.options import parser
from tests.system.pages import NOT_RUN, PAGES, ROOT, commands, words

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
LATER = ["campaign", "mean", "sheet"]  # what a flow run is needed for
ALL = [(page, command) for page in PAGES for command in commands(page)]
FIRST_HOUR = commands(README)[commands(README).index("init lab") + 1 :][:7]
MADE = {  # what must be there after a command of the first hour
    "trace": ("trace/*.png",),
    "calibrate": ("fit/scene.yaml", "fit/*.html"),
    "report": ("runs/*plan-shift/report/report.html",),
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
@pytest.mark.timeout(1800)
def test_the_first_hour_and_what_follows_it(tmp_path, monkeypatch, capsys):
    """The block of README as it stands; then, in the lab it leaves, every other command that needs no flow."""
    monkeypatch.chdir(tmp_path)
    done = set()

    def run(command):
        code = main(words(command))
        said = capsys.readouterr()
        assert code == SAYS.get(command, DONE), f"rtpiv {command}: {said.err}"
        assert "Traceback" not in said.err
        for pattern in MADE.get(command.split()[0], ()):
            if command in FIRST_HOUR:
                assert list(lab.glob(pattern)), f"rtpiv {command} has left no {pattern}"
        done.add(command)

    lab = tmp_path / "lab"
    for number, command in enumerate(FIRST_HOUR):
        run(command)
        if number == 0:  # the same lab with a quarter of the pixels, for time
            shutil.rmtree(lab)
            assert main([*words(command), *SMALL]) == DONE
            capsys.readouterr()
            monkeypatch.chdir(lab)
    shutil.copy(ROOT / "examples" / "plan-align.yaml", lab)
    _frames_of_the_reader(lab)
    missed = []
    for _, command in ALL:
        if command in done or command in NOT_RUN or command.split()[0] in LATER:
            continue
        try:
            run(command)
        except AssertionError as error:
            missed.append(str(error))
    assert not missed, "\n".join(missed)


def _frames_of_the_reader(lab):
    """frames/ with the target run's frames, a.tif and b.tif of the shift run: what a reader brings along."""
    (target,), (shift,) = (lab / "runs").glob("*plan-target"), (lab / "runs").glob("*plan-shift")
    shutil.copytree(target / "frames", lab / "frames")
    first, second = sorted((shift / "frames").glob("*.tif"))[:2]
    for source, name in ((first, "a.tif"), (second, "b.tif")):
        shutil.copy(source, lab / name)
