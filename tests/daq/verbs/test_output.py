"""The folder for results is tried before work starts, and left as it was."""

import errno
import os
import tempfile

import pytest

from daq.cli import USAGE, main
from daq.errors import DiskError, RunUsageError
from daq.verbs import output
from daq.verbs.output import require_folder


def test_a_folder_that_can_be_is_not_made_yet(tmp_path):
    wanted = tmp_path / "a" / "b"
    assert require_folder(str(wanted)) == wanted
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("below", ["file", "file/deeper", "a\0b", "x" * 300])
def test_a_folder_that_cannot_be(tmp_path, below):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(RunUsageError, match="cannot hold results; give another folder"):
        require_folder(tmp_path / below)
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize(
    ("number", "kind"), [(errno.ENOSPC, DiskError), (errno.EROFS, RunUsageError), (errno.EACCES, RunUsageError)]
)
def test_full_read_only_and_forbidden(tmp_path, monkeypatch, number, kind):
    def refuse(dir):
        raise OSError(number, os.strerror(number), str(dir))

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    with pytest.raises(kind, match=os.strerror(number).lower()):
        output.require_folder(tmp_path / "out")


@pytest.mark.parametrize(
    "words", [["demo", "-o"], ["schema", "-o"], ["examples"], ["init", "--yes"], ["join", "a", "b", "-o"]]
)
def test_verbs_say_so_before_they_work(tmp_path, words, capsys):
    (tmp_path / "file").write_text("mine")
    assert main([*words, str(tmp_path / "file" / "out")]) == USAGE
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert "file" in said
