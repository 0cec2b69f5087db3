"""Whoever repeats a run names both of them by the same star."""

import pytest

from daq.errors import RunUsageError
from daq.runs.run_folder import RunFolder
from rtpiv.command_line.cli import USAGE, main
from rtpiv.verbs.paths import one_of
from tests.daq.small_run import about_run, planned


def begun(folder, name, plan="shift", done=False):
    run = RunFolder.create(folder, plan, about_run([planned(0)], name=plan))
    run.path.rename(folder / name)
    if done:
        (folder / name / "done.json").touch()
    return folder / name


def test_the_newest_finished_run_is_taken_and_said(tmp_path, capsys):
    older, newest = (
        begun(tmp_path, name, done=True) for name in ("20260101T000000Z_shift", "20260102T000000Z_shift")
    )
    stopped = begun(tmp_path, "20260103T000000Z_shift")
    assert one_of([older, newest, stopped, tmp_path / "maps"]) == newest
    said = capsys.readouterr().out
    assert said == f"3 runs of shift are given; using the newest finished one: {newest}\n"


def test_one_is_taken_as_it_is(tmp_path, capsys):
    assert one_of(str(tmp_path / "any")) == one_of([tmp_path / "any"]) == tmp_path / "any"
    assert capsys.readouterr().out == ""


def test_runs_of_several_plans_and_other_folders_are_no_choice(tmp_path):
    runs = [begun(tmp_path, f"2026010{day}T000000Z", plan) for day, plan in ((1, "shift"), (2, "target"))]
    with pytest.raises(RunUsageError, match=r"of several plans \(shift, target\); give one: .*20260102"):
        one_of(runs)
    with pytest.raises(RunUsageError, match="one folder is wanted, not 2: "):
        one_of([runs[0], tmp_path])


def test_cameras_of_one_run_are_no_choice(tmp_path):
    """The first is in no way older than the second, and their views are not repetitions of each other."""
    first = begun(tmp_path, "20260101T000000Z_flow", "flow", done=True)
    side = begun(first / "cameras", "side", "flow", done=True)
    with pytest.raises(RunUsageError, match=f"cameras of one run.*mean --join {first} {side}"):
        one_of([first, side])


@pytest.mark.parametrize("verb", ["report", "mean", "calibrate", "focus"])
def test_verbs_of_one_run_take_several(verb, tmp_path, capsys):
    words = [str(begun(tmp_path, f"run{n}", plan)) for n, plan in enumerate(("shift", "target"))]
    assert main([verb, *words]) == USAGE
    assert "of several plans" in capsys.readouterr().err


def test_what_is_too_much_is_said_with_the_usage_of_the_verb(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["acquire", "--resume", str(tmp_path), str(tmp_path)])
    said = capsys.readouterr().err
    assert said.startswith("usage: rtpiv acquire --resume")
    assert f"one is wanted here, and more are given: {tmp_path}" in said
