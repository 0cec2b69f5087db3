"""A link that leads to itself is one sentence, whatever verb is given it."""

from pathlib import Path

import pytest

from daq.runner.session import Request
from rtpiv.command_line.cli import USAGE, main
from tests.rtpiv.verbs.test_two_at_once import SCENE

CASES = (
    ("correct", "loop.tif", "--scene", "scene.yaml"),
    ("trace", "scene.yaml", "-o", "loop"),
    ("export", "loop.yaml", "--to", "tiff"),
    ("campaign", "plan", "loop"),
    ("campaign", "run", "loop.tif", "--scene", "scene.yaml", "--dt-us", "5"),
    ("report", "loop"),
    ("setup", "examples", "loop"),
)


@pytest.mark.posix("links, which Windows lets administrators make")
@pytest.mark.parametrize("words", CASES, ids=lambda words: "-".join(words[:2]))
def test_a_loop_is_one_sentence(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("scene.yaml").write_text(SCENE)
    for name in ("loop", "loop.yaml", "loop.tif"):
        Path(name).symlink_to(name)
    assert main(list(words)) == USAGE
    assert capsys.readouterr().err.startswith(f"rtpiv {words[0]}")


@pytest.mark.posix("links, which Windows lets administrators make")
def test_what_a_run_is_asked_for_holds_a_loop_as_a_path(tmp_path):
    loop = tmp_path / "loop.yaml"
    loop.symlink_to(loop)
    assert Request(tmp_path, tmp_path, target_clear=loop).to_dict()["target_clear"] == str(loop)
