"""The face: eight things, light to import, each where the type checker says it is."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import rtpiv

ROOT = Path(__file__).resolve().parents[2]
EIGHT = {"load_scene", "trace", "acquire", "calibrate", "correct", "evaluate", "mean", "report"}


def test_importing_it_loads_nothing_heavy():
    code = (
        "import sys, rtpiv; print(*{m.partition('.')[0] for m in sys.modules} & {'numpy', 'numba', 'daq', 'rich'})"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.split() == []


def test_eight_things_that_are_there_and_documented():
    assert set(rtpiv.__all__) == {*EIGHT, "ERRORS"} <= set(dir(rtpiv))
    for name in EIGHT:
        assert getattr(rtpiv, name).__doc__, name
        assert f"    {name} " in rtpiv.__doc__


def test_a_name_that_is_not_there_is_answered_with_those_that_are():
    with pytest.raises(AttributeError, match=r"no 'flow'; it has load_scene, trace"):
        rtpiv.flow  # noqa: B018


def test_the_stub_names_the_same():
    tree = ast.parse((ROOT / "rtpiv" / "__init__.pyi").read_text(encoding="utf-8"))
    named = {
        alias.name: node.module for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert named == rtpiv._HOMES


def test_every_error_root_is_caught():
    from ground.errors import ConfigError

    assert len(rtpiv.ERRORS) == 5
    with pytest.raises(rtpiv.ERRORS):
        raise ConfigError("scene.yaml", [])
