"""The pages of docs/tutorial, done as they stand: files saved, commands given, what is promised looked for.

A page saves files ("Save this as `name`:" and a block), gives commands in blocks, quotes what is printed in blocks
of ```text, and names files in backticks with their folder: each of these must be there in the end.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from rtpiv.command_line.cli import DONE, main
from rtpiv.options import parser
from tests.system.pages import DOCS, words

TUTORIALS = sorted((DOCS / "tutorial").glob("*.md"))
BLOCK = r"((?:    .*\n|\n)+)"
STEP = re.compile(rf"[Ss]ave this as `([\w.-]+)`:\n\n{BLOCK}|^(?:    (rtpiv|python|cd) (.*)\n)", re.MULTILINE)
PROMISED = re.compile(r"`(\w[\w*.-]*/[\w*./+-]+\.\w+)`")


def steps(page):
    """What the page asks for in its order: a file and its text, or a program and its words."""
    for saved, text, program, said in STEP.findall(page.read_text("utf-8")):
        yield (saved, re.sub(r"(?m)^    ", "", text)) if saved else (program, said.partition("#")[0].strip())


def quoted(page):
    """Lines that the page says are printed."""
    blocks = re.findall(r"^```text\n(.*?)^```", page.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines()]


def plain(text):
    """Text without what a terminal does to it."""
    return " ".join(text.split())


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_is_made_of_commands_that_are_taken_and_files_that_are_read(page):
    done = list(steps(page))
    assert len([step for step in done if step[0] == "rtpiv"]) >= 3
    assert quoted(page)
    for program, said in done:
        if program == "rtpiv":
            parser(words(said)).parse_args(words(said))
        elif program.endswith(".py"):
            compile(said, program, "exec")
        elif program == "python":
            assert said in {saved for saved, _ in done}
    assert PROMISED.findall(page.read_text("utf-8"))


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_does_what_it_says(page, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    printed = []
    for program, said in steps(page):
        if program == "cd":
            monkeypatch.chdir(said)
        elif program == "rtpiv":
            assert main(words(said)) == DONE, f"rtpiv {said}: {capfd.readouterr().err[-1500:]}"
        elif program == "python":
            subprocess.run([sys.executable, said], env=os.environ, check=True)
        else:
            Path(program).write_text(said, encoding="utf-8")
        printed.append(capfd.readouterr().out)
    for line in quoted(page):
        assert plain(line) in plain(" ".join(printed)), line
    for name in PROMISED.findall(page.read_text("utf-8")):
        assert list(tmp_path.rglob(name)), name
