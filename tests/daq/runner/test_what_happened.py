"""`world.jsonl` of a rehearsal is written whole or not at all, on the disk before the run ends."""

import errno
import os
from types import SimpleNamespace

import pytest

from daq.errors import DiskError
from daq.runner.session import HAPPENED, _keep_what_happened


def keep(folder, text):
    simulation = SimpleNamespace(event_log=lambda: SimpleNamespace(text=lambda: text))
    _keep_what_happened(simulation, SimpleNamespace(path=folder))


def test_sessions_stand_one_behind_the_other(tmp_path):
    keep(tmp_path, "one\n")
    keep(tmp_path, "")
    keep(tmp_path, "two\n")
    assert (tmp_path / HAPPENED).read_bytes() == b"one\ntwo\n"


def test_a_disk_that_is_full_leaves_the_sessions_before_as_they_were(tmp_path, monkeypatch):
    keep(tmp_path, "one\n")

    def full(descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DiskError, match=r"No space left on device; make room"):
        keep(tmp_path, "two\n")
    assert (tmp_path / HAPPENED).read_bytes() == b"one\n"
    assert [path.name for path in tmp_path.iterdir()] == [HAPPENED]
