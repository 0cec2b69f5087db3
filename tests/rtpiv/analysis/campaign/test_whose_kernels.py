"""Compiled kernels in a folder that others may write are no code that a worker runs."""

import os
from pathlib import Path

import pytest

from rtpiv.analysis.campaign.worker_setup import is_only_mine, pack_kernels


def test_what_is_packed_is_mine_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o000)
    try:
        pack_kernels(tmp_path / "kernels.zip")
    finally:
        os.umask(before)
    assert is_only_mine(tmp_path / "kernels.zip")


@pytest.mark.posix("owners and rights of files")
@pytest.mark.parametrize("mode", [0o664, 0o646, 0o666])
def test_what_others_may_write_is_not(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "kernels.zip"
    path.write_bytes(b"PK")
    path.chmod(mode)
    assert not is_only_mine(path)


@pytest.mark.posix("owners and rights of files")
def test_a_link_is_not(tmp_path: Path) -> None:
    (tmp_path / "real.zip").write_bytes(b"PK")
    (tmp_path / "kernels.zip").symlink_to(tmp_path / "real.zip")
    assert not is_only_mine(tmp_path / "kernels.zip")
