"""A wheel says for whom it is: with machine code for one Python on Linux, without for everybody."""

import sys

import pytest

pytest.importorskip("hatchling", reason="hatchling is not installed: no wheel can be built")
from release.hook import MachineCodeHook


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
