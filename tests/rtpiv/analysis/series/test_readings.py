"""What gauges showed is in the files of vectors, over the steps that their frames are of and no other."""

import json

import numpy as np
import pytest

from daq.runs.displacement import Displacement, write_displacements
from daq.runs.journal import Journal
from daq.runs.lab_readings import shown_over
from daq.runs.run_folder import RunFolder
from piv.files.vector_file import read_vectors
from rtpiv.analysis.series.series_input import tasks_of
from rtpiv.analysis.series.series_mean import mean_of_series, write_mean
from rtpiv.analysis.series.series_view import SeriesView
from rtpiv.verbs.evaluate import EvaluationOutput, evaluate
from rtpiv.verbs.mean import mean
from tests.daq.small_run import about_run, keep_frame, keep_step, planned
from tests.rtpiv.analysis.series.small_series import SCENE, flow_run, frames_of

UTC = "2026-01-01T00:00:00.000+00:00"
WINDOWS = {"first_window_px": 32, "final_window_px": 16, "workers": 1}


def showed(value, unit="l/min"):
    return {"utc": UTC, "unit": unit} | ({"missing": "it is silent"} if value is None else {"value": value})


def gauged(run, *steps):
    """The run with lines of its steps, each with what the gauges showed; a step may be taken again."""
    journal = Journal(RunFolder(run).journal_path)
    for step, readings in steps:
        keep_step(journal, step, readings=readings)
    journal.close()
    return run


def averaged(series):
    view = SeriesView(series)
    write_mean(view, mean_of_series(view))
    return series / "mean.nc"


def in_file(path):
    return json.loads(read_vectors(path).attributes["readings"])


def test_a_mean_and_each_pair_of_a_flow_say_what_gauges_showed_while_it_was_seeded(tmp_path):
    """Not what they showed before, with the background, nor at a step that was taken again."""
    run = flow_run(tmp_path, 2, unseeded=1)
    silent = {"room": showed(None, "\u00b0C")}
    gauged(
        run,
        (0, {"flow": showed(1.0)}),
        (1, {"flow": showed(2.0)} | silent),
        (1, {"flow": showed(5.5), "swirl": showed(0.25, "")} | silent),
    )
    wanted = {
        "flow": {"unit": "l/min", "steps": 1, "missing": 0, "mean": 5.5},
        "swirl": {"unit": "", "steps": 1, "missing": 0, "mean": 0.25},
        "room": {"unit": "\u00b0C", "steps": 0, "missing": 1},
    }
    done = evaluate(run, out=tmp_path / "out", output=EvaluationOutput(vtk=True, pictures=False), **WINDOWS)
    assert len(done.details) == 2
    for pair in done.details:
        assert in_file(tmp_path / "out" / pair.task.name / "vectors.nc") == wanted
        assert json.loads((pair.task.out / "evaluation.json").read_text())["readings"] == wanted
    assert in_file(averaged(tmp_path / "out")) == wanted  # by the folder alone, wherever its run may be


@pytest.mark.slow
def test_an_ensemble_mean_says_it_too(tmp_path):
    run = gauged(flow_run(tmp_path, 2), (0, {"flow": showed(5.5)}))
    mean(run, out=tmp_path / "out", ensemble=16, **WINDOWS)
    for name in ("mean.nc", "mean_ensemble.nc"):
        assert in_file(tmp_path / "out" / name)["flow"]["mean"] == 5.5


def test_a_pair_that_a_stage_moved_has_the_readings_of_both_its_steps(tmp_path):
    steps = [planned(0), planned(1, "moved", reference=0), planned(2, "later", reference=0)]
    folder = RunFolder.create(tmp_path, "shift", about_run(steps) | {"scene": SCENE})
    journal = Journal(folder.journal_path)
    for step, pixels in zip(steps, [*frames_of(np.random.default_rng(3), (2.0, 1.0))] * 2, strict=False):
        keep_frame(folder, journal, step["index"], pixels, step=step["index"], tag=step["tag"])
    journal.close()
    way = (1.0, 0.0, 0.0)
    moved = [Displacement(tag, (0, frame), way, way, None) for frame, tag in ((1, "moved"), (2, "later"))]
    write_displacements(folder, moved)
    gauged(folder.path, *((number, {"flow": showed(value)}) for number, value in enumerate((4.0, 5.0, 9.0))))
    first, second = (task.readings["flow"] for task in tasks_of([folder.path], tmp_path / "out").tasks)
    assert first == {"unit": "l/min", "steps": 2, "missing": 0, "mean": 4.5, "std": pytest.approx(0.5**0.5)}
    assert (second["mean"], second["std"]) == (6.5, pytest.approx(12.5**0.5))


def test_where_there_are_no_gauges_nothing_is_said(tmp_path):
    run = flow_run(tmp_path, 2)
    evaluate(run, out=tmp_path / "out", output=EvaluationOutput(pictures=False), **WINDOWS)
    assert "readings" not in read_vectors(averaged(tmp_path / "out")).attributes
    assert "readings" not in json.loads((tmp_path / "out" / "series.json").read_text())


def test_a_gauge_that_was_silent_at_some_steps_is_averaged_over_the_others():
    shown = shown_over([{"flow": showed(5.0)}, {"flow": showed(None)}, {}, {"flow": showed(6.0)}])
    assert shown["flow"] == {
        "unit": "l/min",
        "steps": 2,
        "missing": 1,
        "mean": 5.5,
        "std": pytest.approx(0.5**0.5),
    }
