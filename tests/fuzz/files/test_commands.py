"""Hostile command lines, drawn anew by number: the program answers in sentences, whatever it is asked."""

import io

import pytest

from tests.fuzz.amount import PATIENCE_S, cases, seed
from tests.fuzz.files.commands import CommandGround, hostile

pytestmark = pytest.mark.timeout(900)  # the first time kernels are compiled


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return CommandGround(tmp_path_factory.mktemp("above") / "lab")


@pytest.fixture
def ground(made, monkeypatch):
    monkeypatch.chdir(made.folder)
    monkeypatch.setattr("sys.stdin", io.StringIO())
    return made


def test_command_lines_end_with_sentences(ground):
    tally = hostile("fast", range(25), ground)
    assert not tally.findings
    assert len(tally.codes) > 1


@pytest.mark.slow
@pytest.mark.timeout(PATIENCE_S)
def test_two_thousand_command_lines_end_with_sentences(ground):
    assert not hostile(seed("slow"), range(cases(2000)), ground).findings


def test_a_verb_that_lets_an_error_through_is_found(ground, monkeypatch):
    """The judge itself."""

    def careless(*_, **__):
        raise KeyError("a")

    monkeypatch.setattr("rtpiv.verbs.check.check", careless)
    played = (hostile("judge", [number], ground, lambda text: None) for number in range(400))
    assert any("KeyError" in finding for tally in played for finding in tally.findings)  # and plays no more
