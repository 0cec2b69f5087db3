"""Names that would be commands, formulas or ways out, and files with more in them than any bench has."""

import json
import shutil
import subprocess
import sys
from itertools import product

import pytest

from daq.bench.bench_file import load_bench
from daq.errors import RunUnsuitable
from daq.plans.plan import load_plan
from daq.runs.run_folder import RunFolder
from ground.config import load_yaml
from ground.errors import ConfigError
from ground.terminal import console, error_console, printable
from rtpiv.command_line.cli import USAGE, main
from tests.daq.small_bench import write_bench
from tests.daq.whole_run import make_whole_run
from tests.rtpiv.test_cli import SMALL
from tracer.scene.scene_file import load_scene


def test_escape_sequences_never_reach_a_terminal(tmp_path, capsys):
    name = "\x1b[2J\x07 ä ü 微 [px].yaml"
    assert main(["trace", str(tmp_path / name), "-o", str(tmp_path / "\x1b]0;x\x07")]) == USAGE
    console().print(f"[b]{name}")
    error_console().print(name)
    said = "".join(capsys.readouterr())
    assert "\x1b" not in said
    assert "\x07" not in said
    assert "\\x1b[2J\\x07 ä ü 微 [px].yaml" in said


def test_printable_leaves_what_can_be_read():
    assert printable("a\tb\nç 微 °") == "a\tb\nç 微 °"
    assert printable("\x1b[0m\x9b\u202e\r") == "\\x1b[0m\\x9b\\u202e\\r"


MORE_NAMES = [pytest.param(name, marks=pytest.mark.slow) for name in ("\\", "a$b", "100 %", "$\\alpha$", "_^{}")]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["$x_{", *MORE_NAMES])
def test_pictures_bear_any_name(tmp_path, name):
    text = SMALL.replace("name: ball", f"name: '{name}'")
    (tmp_path / f"{name}.yaml").write_text(text)
    assert main(["trace", str(tmp_path / f"{name}.yaml"), "-o", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "scene.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("name: ball", f"name: {'a' * 101}", "scene.yaml:3: .* should have at most 100 characters"),
        ("name: ball", f"name: {'a' * 100_000}", "scene.yaml:3: a text of 100000 characters; at most 4096"),
        ("name: ball", f"{'a' * 101}: ball", "scene.yaml:3: a text of 101 characters; at most 100"),
        ("name: ball", 'name: "\\e[2J"', "scene.yaml:3: '\\\\x1b\\[2J' holds characters that cannot be printed"),
        ("name: ball", 'name: "a\\0b"', "cannot be printed"),
    ],
)
def test_names_are_bounded_and_can_be_said(tmp_path, old, new, words):
    (tmp_path / "scene.yaml").write_text(SMALL.replace(old, new))
    with pytest.raises(ConfigError, match=words) as caught:
        load_scene(tmp_path / "scene.yaml")
    assert all(len(problem.text) < 300 for problem in caught.value.problems)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "words"), [(1001, "1000"), (10_000, "at most 50000")])
def test_more_bodies_than_any_bed_has_are_refused(tmp_path, count, words):
    ball = "{kind: sphere, centre_mm: [%d.0, 0.0, 9.0], radius_mm: 0.4, material: N-BK7}"
    bodies = "".join(f"  - {ball % number}\n" for number in range(count))
    (tmp_path / "scene.yaml").write_text(f"{SMALL.splitlines()[1]}\nbodies:\n{bodies}")
    with pytest.raises(ConfigError, match=words):
        load_scene(tmp_path / "scene.yaml")


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        ("experiment: [1]\n", r"plan.yaml:1: experiment should be one of .*, not \[1\]"),
        ("experiment: {a: 1}\n", "plan.yaml:1: experiment should be one of"),
        ("experiment: shift\nviews: [clear]\ndisplacements: [{along: [1.0, 0.0, 0.0], px: 0.0}]\n", "length"),
        ("experiment: shift\nviews: [clear]\ndisplacements: [{along: [1.0, 0.0, 0.0], mm: 0.0}]\n", "length"),
        ("experiment: target\nclear: {z_mm: [0.0, -10.0, -10.0]}\n", r"plan.yaml:2: .*the height -10 twice"),
        ("experiment: target\nclear: {z_mm: [5.0, 5.0000000001]}\n", "the height 5 twice"),
    ],
)
def test_plans_that_make_no_sense(tmp_path, plan, words):
    bench = load_bench(write_bench(tmp_path))
    (tmp_path / "plan.yaml").write_text(plan)
    with pytest.raises(ConfigError, match=words):
        load_plan(tmp_path / "plan.yaml", bench)


@pytest.fixture(scope="module")
def whole_run(tmp_path_factory):
    return make_whole_run(tmp_path_factory.mktemp("linked"))


@pytest.mark.parametrize(("verb", "name"), [("report", "report"), ("report", "frames"), ("evaluate", "corrected")])
def test_a_link_out_of_a_run_is_not_followed(whole_run, tmp_path, verb, name, capsys):
    place, elsewhere = whole_run.path / name, tmp_path / "elsewhere"
    elsewhere.mkdir()
    kept = place.rename(tmp_path / "kept") if place.exists() else None
    place.symlink_to(elsewhere)
    try:
        assert (
            main([verb, str(whole_run.path), *(["-o", str(tmp_path / "out")] if verb == "evaluate" else [])])
            == USAGE
        )
        said = capsys.readouterr().err
        assert f"{name!r} is outside the run" in said
        assert len(said.splitlines()) == 1
        assert not list(elsewhere.iterdir())
    finally:
        place.unlink()
        if kept is not None:
            kept.rename(place)


def test_a_link_to_itself_is_one_sentence(whole_run):
    (whole_run.path / "report").symlink_to("report")
    try:
        with pytest.raises(RunUnsuitable):
            RunFolder(whole_run.path).own("report")
    finally:
        (whole_run.path / "report").unlink()


def test_a_run_may_lie_behind_a_link(whole_run, tmp_path):
    """Only links inside a run matter."""
    (tmp_path / "latest").symlink_to(whole_run.path)
    assert RunFolder.open(tmp_path / "latest").own("report") == tmp_path / "latest" / "report"


@pytest.mark.parametrize("text", ["[" * 5000, "{a: " * 5000, "- " * 5000 + "a"])
def test_deep_nesting_is_refused_at_once(tmp_path, text):
    (tmp_path / "deep.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"nested too deeply|not valid YAML"):
        load_yaml(tmp_path / "deep.yaml")


# One process checks the run once for each case, and puts its file back: starting it is what is dear.
CHECKED = """
import contextlib, io, json, os, sys
from pathlib import Path
from rtpiv.command_line import cli
run, kept, cases = Path(sys.argv[1]), Path(sys.argv[2]), json.loads(sys.argv[3])
for name, kind in cases:
    place = run / name
    place.rename(kept)
    {"pipe": os.mkfifo, "device": lambda at: at.symlink_to("/dev/zero"), "folder": Path.mkdir}[kind](place)
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        code = cli.main(["check", str(run)])
    print(json.dumps([name, kind, code, out.getvalue() + err.getvalue()]), flush=True)
    place.rmdir() if kind == "folder" else place.unlink()
    kept.rename(place)
"""
RECORDS, KINDS = ("run.json", "done.json", "steps.jsonl", "displacements.json"), ("pipe", "device", "folder")
FIRST = [("run.json", "pipe"), ("done.json", "device"), ("steps.jsonl", "folder"), ("displacements.json", "pipe")]
OTHERS = [case for case in product(RECORDS, KINDS) if case not in FIRST]


@pytest.mark.parametrize("cases", [FIRST, pytest.param(OTHERS, marks=pytest.mark.slow)], ids=["some", "others"])
def test_records_that_are_no_files_are_refused_at_once(whole_run, tmp_path, cases):
    """A reader of a pipe waits for ever, one of /dev/zero never ends."""
    place = shutil.copytree(whole_run.path, tmp_path / "run")
    done = subprocess.run(
        [sys.executable, "-c", CHECKED, str(place), str(tmp_path / "kept"), json.dumps(cases)],
        capture_output=True, text=True, check=True, timeout=200,
    )  # fmt: skip
    seen = [json.loads(line) for line in done.stdout.splitlines()]
    assert [tuple(case) for *case, _, _ in seen] == cases
    for name, kind, code, said in seen:
        assert code == 3, (name, kind, said)
        assert "Traceback" not in said
        assert name in said, (name, kind, said)
