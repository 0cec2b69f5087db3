"""What is compiled ahead is what is called: the list against what a command asks for, and what helpers do."""

import inspect
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytest
import tifffile

import ground.jit.compile_news as compile_news
from correction.target.kernels import corner_fit
from ground.jit.signatures import entry, plain, to_type
from rtpiv.command_line import first_use
from rtpiv.command_line.first_use import ALSO, FirstUse, calls_of
from tests.loops import loop_over

ROOT = Path(__file__).resolve().parents[2]
VERBS = ("trace", "correct", "evaluate", "calibrate")
SMALL = """
camera: {focal_px: 400.0, sensor_px: [96, 96], position_mm: [0.0, 0.0, 500.0]}
bodies: [{name: ball, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 25.0, material: N-BK7}]
"""
ASKED = """
import json, sys
import numba.core.caching as caching
from ground.jit.signatures import plain
asked, before = [], caching.Cache._load_overload
def watched(self, signature, context):
    kinds = signature if isinstance(signature, tuple) else signature.args
    asked.append((self._py_func.__module__ + ":" + self._py_func.__qualname__, [plain(kind) for kind in kinds]))
    return before(self, signature, context)
caching.Cache._load_overload = watched
from rtpiv.command_line.cli import main
assert main(sys.argv[1:]) == 0
print(json.dumps(asked))
"""


@loop_over("verb", VERBS)
def test_every_kernel_of_the_list_is_there_and_its_types_are_read_as_they_were_written(verb):
    calls = calls_of(verb)
    assert len(calls) > 10
    for place, form, seconds in calls:
        assert len(inspect.signature(entry(place).py_func).parameters) == len(form), place
        assert [plain(to_type(each)) for each in form] == form
        assert seconds >= 0.0


def test_the_scratch_of_a_corner_fit_is_of_the_types_listed():
    """The list names how many arrays there are; a fit that takes one more would be compiled for nobody."""
    [form] = [form for place, form, _ in calls_of("calibrate") if place.endswith("corner_fit:fit_corners")]
    names = list(inspect.signature(corner_fit.fit_corners.py_func).parameters)
    assert form[names.index("scratch")] == plain(numba.typeof(corner_fit.new_scratch()))


def test_verbs_that_call_others_have_their_kernels_once():
    for verb, others in ALSO.items():
        places = [json.dumps(call[:2]) for call in calls_of(verb)]
        assert len(places) == len(set(places))
        assert set(places) == {json.dumps(call[:2]) for other in others for call in calls_of(other)}
    assert calls_of("stage") == []


@pytest.mark.slow
def test_the_list_is_what_a_command_asks_for(tmp_path):
    (tmp_path / "scene.yaml").write_text(SMALL)
    tifffile.imwrite(tmp_path / "frame.tif", np.full((96, 96), 100, np.uint16))
    words = ["correct", "frame.tif", "--scene", "scene.yaml", "--no-pictures"]
    ran = subprocess.run(
        [sys.executable, "-c", ASKED, *words], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    asked = json.loads(ran.stdout.strip().splitlines()[-1])
    listed = [json.dumps(call[:2]) for call in calls_of("correct")]
    found = [call for call in asked if json.dumps(call) in listed]
    assert len(found) > 8
    assert len(found) >= 0.6 * len(asked)  # one ball alone has kernels that three have not
    listed_places = {place for place, *_ in calls_of("correct")}
    asked_otherwise = {place for place, _ in asked if place in listed_places} - {place for place, _ in found}
    assert not asked_otherwise  # of other types than those compiled ahead: for nobody


def test_helpers_start_at_the_first_kernel_that_is_listed_and_go_with_the_verb(monkeypatch):
    monkeypatch.setattr(first_use, "MOST_HELPERS", 1)
    monkeypatch.setattr(first_use, "thread_count", lambda: 2)
    monkeypatch.setattr(
        first_use, "child", lambda *words: ([sys.executable, "-c", "import sys; sys.stdin.read()"], None)
    )
    watched = FirstUse("correct")
    watched.start("nobody:knows", ["int64"])
    assert watched._helpers == []
    place, form, _ = calls_of("correct")[0]
    watched.start(place, form)
    assert len(watched._helpers) == 1
    assert watched.seconds_left() is None
    time.sleep(0.01)
    watched.finish(place)
    left = watched.seconds_left()
    assert left is None or left > 0.0
    watched.end()
    assert watched._helpers[0].returncode is not None


def test_a_missing_kernel_is_told_with_its_types(monkeypatch):
    import numba

    import ground.jit.compiler  # noqa: F401 - listens

    told = []

    class Told:
        def start(self, place, form):
            told.append((place, form))

        def finish(self, place):
            told.append(place)

    monkeypatch.setattr(compile_news, "make_helper", Told)
    monkeypatch.setattr(compile_news, "helper", None)
    numba.njit(lambda x, y: x[0] + y[1])(np.zeros((2, 2), np.float32), (1, 2.0))
    assert told[0][1] == [["array", "float32", 2, "C", True], ["tuple", "int64", "float64"]]
    assert told[-1] == told[0][0]
