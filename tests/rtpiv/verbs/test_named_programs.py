"""A bench file of somebody else that names programs: asked about once, by name, before any of it has run."""

import shutil
import sys

import pytest
import yaml

from ground.named_program import trust_file
from rtpiv.command_line.cli import DONE, USAGE, main
from rtpiv.verbs.init import GivenLab, init

NAME = "strange_axes:Axis"
PROGRAM = """\
from pathlib import Path
Path(__file__).with_suffix(".ran").touch()
class Axis:
    position = 0.0
    def set(self, mm): ...
    def stop(self): ...
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    init(folder, GivenLab(balls=1))
    return folder


@pytest.fixture
def bench(lab, tmp_path, monkeypatch):
    """A bench whose target is moved by objects of a module that leaves a trace when it is imported."""
    shutil.copytree(lab, tmp_path / "lab")
    (tmp_path / "strange_axes.py").write_text(PROGRAM)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "strange_axes", raising=False)
    monkeypatch.delenv("RTPIV_TRUST")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    path = tmp_path / "lab" / "bench.yaml"
    tree = yaml.safe_load(path.read_text())
    axes = {axis["channel"]: {"object": NAME} for axis in tree["stages"]["axes"].values()
            if axis["controller"] == "target"}  # fmt: skip
    tree["stages"]["controllers"]["target"] = {"driver": "positioners", "homing": "hand", "objects": axes}
    path.write_text(yaml.safe_dump(tree))
    return path


def ran(bench):
    return (bench.parent.parent / "strange_axes.ran").exists()


class Terminal:
    """A person at a terminal who types one line."""

    def __init__(self, line):
        self.line, self.asked = line, 0

    def isatty(self):
        return True

    def readline(self):
        self.asked += 1
        return self.line


@pytest.mark.parametrize("words", [["check"], ["bench", "stage", "home", "--bench"]])
def test_without_a_person_it_is_refused_with_the_cure(bench, capsys, words):
    assert main([*words, str(bench)]) == USAGE
    said = capsys.readouterr().err
    assert NAME in said
    assert f"--trust {NAME}" in said
    assert str(trust_file()) in said
    assert not ran(bench)


def test_a_name_of_the_command_line_is_trusted(bench, capsys):
    assert main(["check", str(bench), "--trust", NAME]) == DONE
    assert not ran(bench)  # nothing is opened
    assert not trust_file().exists()


def test_a_person_is_asked_once(bench, monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    for line, code in (("no\n", USAGE), ("", USAGE), ("yes\n", DONE)):
        person = Terminal(line)
        monkeypatch.setattr(sys, "stdin", person)
        assert main(["check", str(bench)]) == code
        assert person.asked == 1
        assert NAME in capsys.readouterr().err
    assert trust_file().read_text() == f"{NAME}\n"
    person = Terminal("no\n")
    monkeypatch.setattr(sys, "stdin", person)
    assert main(["check", str(bench)]) == DONE
    assert person.asked == 0


@pytest.mark.parametrize("driver", ["strange_axes:Axis", "strange_axes.more:Axis"])
def test_reading_a_bench_file_imports_no_driver(bench, capsys, driver):
    """As the analysis of somebody's run does; the file was enough to run what it names."""
    from daq.bench.bench_file import load_bench

    tree = yaml.safe_load(bench.read_text())
    tree["stages"]["controllers"]["target"] = {"driver": driver, "port": "/dev/none"}
    bench.write_text(yaml.safe_dump(tree))
    load_bench(bench)
    assert not ran(bench)


def test_rtpiv_alone_shows_its_help(capsys):
    assert main([]) == USAGE
    said = capsys.readouterr()
    assert "usage: rtpiv" in said.out
    assert "acquire" in said.out
    assert said.err == ""
