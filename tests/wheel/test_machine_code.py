"""A wheel says for whom it is: with machine code for one Python on Linux, without for everybody."""

import re
import sys
from pathlib import Path

import pytest

pytest.importorskip("hatchling", reason="hatchling is not installed: no wheel can be built")
from ground.jit.shipped import KINDS
from release import machine_code
from release.hook import MachineCodeHook

ROOT = Path(__file__).resolve().parents[2]


def hooked(root, target="wheel"):
    made = {"force_include": {}, "pure_python": True}
    MachineCodeHook(str(root), {}, None, None, str(root / "dist"), target).initialize("standard", made)
    return made


def test_without_machine_code_it_is_plain_python(tmp_path):
    assert hooked(tmp_path) == {"force_include": {}, "pure_python": True}


def test_with_machine_code_it_has_a_tag_and_the_folders_that_are_looked_for(tmp_path):
    for kind in ("x86-64-v3", "x86-64-v4"):
        (tmp_path / "build/machine_code/numba-1.2.3" / kind / "rtpiv" / "0123456789abcdef").mkdir(parents=True)
    (tmp_path / "build/machine_code/here/rtpiv").mkdir(parents=True)  # what this computer has compiled for itself
    made = hooked(tmp_path)
    places = {f"ground/jit/machine_code/numba-1.2.3/{kind}" for kind in ("x86-64-v3", "x86-64-v4")}
    assert set(made["force_include"].values()) == places
    assert not made["pure_python"]
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert made["tag"] == f"{python}-{python}-manylinux2014_x86_64"
    assert hooked(tmp_path, "sdist")["force_include"] == {}


def test_commands_that_work_in_other_folders_compile_for_the_wheel_too(tmp_path, monkeypatch):
    asked = []

    class Done:
        args = ()

        def __init__(self, words, **options):
            asked.append(options["env"])

        def wait(self):
            return 0

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["machine_code", "build/machine_code"])
    monkeypatch.setattr(machine_code, "_run", lambda *words, **environment: asked.append(environment))
    monkeypatch.setattr(machine_code.subprocess, "Popen", Done)
    machine_code.main()
    assert len(asked) == 1 + len(KINDS)
    for environment in asked:
        assert tmp_path / "build" / "machine_code" in Path(environment["RTPIV_CACHE"]).parents


def test_the_day_that_is_compiled_has_the_first_hour_of_the_readme():
    block = (ROOT / "README.md").read_text(encoding="utf-8").partition("## The first hour")[2].partition("## ")[0]
    commands = [line.partition("#")[0].split() for line in re.findall(r"^    rtpiv ([^\n]*)", block, re.MULTILINE)]
    made = [command.split() for command in machine_code.FIRST_HOUR]
    assert len(commands) > 6
    for command in commands[1:]:  # the first asks a person
        assert [word if word != "lab" else "." for word in command] in made
