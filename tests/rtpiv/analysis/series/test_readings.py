"""What gauges showed is in the files of vectors, over the steps that their frames are of and no other."""

import json
from dataclasses import replace

import numpy as np
import pytest

from daq.runs.displacement import Moved, write_displacements
from daq.runs.journal import Journal
from daq.runs.lab_readings import merge_readings, reading_statistics
from daq.runs.run_folder import RunFolder
from piv.files.vector_file import read_vectors
from rtpiv.analysis.campaign.campaign_plan import plan_runs
from rtpiv.analysis.campaign.merge import merge_campaign
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.report.run import readings_chapter, readings_figure
from rtpiv.analysis.series.chunk import evaluate_chunk
from rtpiv.analysis.series.series_input import tasks_of
from rtpiv.analysis.series.series_mean import mean_of_series, write_mean
from rtpiv.analysis.series.series_plan import SeriesPair, jobs_of
from rtpiv.analysis.series.series_view import SeriesView
from rtpiv.verbs.evaluate import EvaluationOutput, evaluate
from rtpiv.verbs.mean import mean
from tests.daq.small_run import about_run, keep_frame, planned
from tests.rtpiv.analysis.campaign.small_campaign import planned as planned_campaign
from tests.rtpiv.analysis.campaign.small_campaign import two_runs
from tests.rtpiv.analysis.series.gauged_run import gauged, showed
from tests.rtpiv.analysis.series.small_series import SCENE, flow_run, frames_of, method_of

LATER = "2026-01-01T00:30:00.000+00:00"
WINDOWS = {"first_window_px": 32, "final_window_px": 16, "workers": 1}


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
    assert in_file(tmp_path / "out" / "chunks" / "00000.nc") == wanted


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
    moved = [
        Moved(tag=tag, frames=(0, frame), commanded_mm=way, measured_mm=way, true_mm=None)
        for frame, tag in ((1, "moved"), (2, "later"))
    ]
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
    shown = reading_statistics([{"flow": showed(5.0)}, {"flow": showed(None)}, {}, {"flow": showed(6.0)}])
    assert shown["flow"] == {
        "unit": "l/min",
        "steps": 2,
        "missing": 1,
        "mean": 5.5,
        "std": pytest.approx(0.5**0.5),
    }


# ---- chunks, campaigns, joined means ---------------------------------------------------------------


def test_a_chunk_says_it_of_its_own_steps_and_is_another_chunk_if_they_differ(tmp_path):
    pairs = [
        SeriesPair(
            str(n), (tmp_path / "a", tmp_path / "b"), ("0", "1"), 1e-4, gauges={n // 2: {"flow": showed(n // 2)}}
        )
        for n in range(8)
    ]  # two pairs a step, as a burst is
    first, second = jobs_of(tmp_path, pairs, method_of(tmp_path), None, 4)
    assert first.readings["flow"] == {"unit": "l/min", "steps": 2, "missing": 0, "mean": 0.5, "std": 0.5**0.5}
    assert second.readings["flow"]["mean"] == 2.5
    bare = [replace(pair, gauges={}) for pair in pairs]
    others = [replace(pair, gauges={0: {"flow": showed(9.0)}}) for pair in pairs]
    keys = {jobs_of(tmp_path, each, method_of(tmp_path), None, 4)[0].key for each in (pairs, bare, others)}
    assert len(keys) == 3


def test_several_runs_together_are_as_one():
    rng = np.random.default_rng(1)
    steps = [{"flow": showed(None if n % 5 == 0 else float(rng.normal(5.0, 1.0)))} for n in range(40)]
    for cuts in ((3, 4, 30), (1, 2, 3), (6, 16, 26)):
        parts = [reading_statistics(part) for part in np.split(np.array(steps, object), cuts)]
        whole = reading_statistics(steps)["flow"]
        assert merge_readings(parts)["flow"] == whole | {
            "mean": pytest.approx(whole["mean"], rel=1e-12), "std": pytest.approx(whole["std"], rel=1e-12),
        }  # fmt: skip
    assert merge_readings([]) == {}
    assert merge_readings([reading_statistics([{"flow": showed(None)}])]) == reading_statistics(
        [{"flow": showed(None)}]
    )
    two = merge_readings(
        [reading_statistics([{"flow": showed(1.0)}]), reading_statistics([{"flow": showed(2.0, "m3/h")}])]
    )
    assert {name: shown["mean"] for name, shown in two.items()} == {"flow [l/min]": 1.0, "flow [m3/h]": 2.0}


def test_a_campaign_says_it_of_all_steps_and_of_each_run(tmp_path):
    runs = two_runs(tmp_path, (2, 2))
    for run, value in zip(runs, (4.0, 6.0), strict=True):
        gauged(run, (0, {"flow": showed(value)}))
    folder = planned_campaign(tmp_path / "week", runs)
    for run in plan_runs(folder):
        run.given.still()
        for job in run.jobs:
            evaluate_chunk(job)
    merge_campaign(folder)
    both = {"unit": "l/min", "steps": 2, "missing": 0, "mean": 5.0, "std": pytest.approx(2.0**0.5)}
    merged = read_vectors(tmp_path / "week" / "campaign.nc").attributes
    assert json.loads(merged["readings"])["flow"] == both
    each = {name: shown["flow"]["mean"] for name, shown in json.loads(merged["readings_of_runs"]).items()}
    assert each == {"one": 4.0, "two": 6.0}
    assert in_file(folder.series("two").path / "mean.nc")["flow"]["mean"] == 6.0
    assert in_file(folder.series("one").path / "chunks" / "00000.nc")["flow"]["mean"] == 4.0


# ---- the picture -------------------------------------------------------------------------------------


def test_readings_are_drawn_over_their_time_each_with_its_own_unit():
    found = {
        "flow": [("a", showed(5.0)), ("b", showed(None)), ("c", showed(6.0, utc=LATER))],
        "room": [("a", showed(20.0, "\u00b0C")), ("c", showed(21.0, "\u00b0C", utc=LATER))],
        "once": [("a", showed(1.0))],
    }
    figure = readings_figure(found)
    assert [axes.get_ylabel() for axes in figure.axes] == ["flow [l/min]", "room [\u00b0C]"]
    (line,) = figure.axes[0].lines
    times_min, values = line.get_data()
    assert list(times_min) == [0.0, 0.0, 30.0]
    assert [value for value in values if value == value] == [5.0, 6.0]
    assert "[min]" in figure.axes[-1].get_xlabel()
    assert readings_figure({"once": found["once"], "silent": [("a", showed(None))] * 3}) is None
    late = "2026-01-01T05:00:00.000+00:00"
    assert "[h]" in readings_figure({"flow": [*found["flow"], ("d", showed(7.0, utc=late))]}).axes[-1].get_xlabel()


def test_the_report_of_a_run_has_the_picture_only_where_gauges_were_read(tmp_path):
    with_gauge = gauged(
        flow_run(tmp_path / "a", 1, unseeded=1), (0, {"flow": showed(1.0)}), (1, {"flow": showed(2.0)})
    )
    bare = flow_run(tmp_path / "b", 1, unseeded=1)
    texts = []
    for run in (with_gauge, bare):
        page = Page("run", "page")
        readings_chapter(page, RunFolder.open(run))
        page.write(run / "page.html")
        texts.append((run / "page.html").read_text())
    assert "Gauge readings" in texts[0]
    assert 'alt="What each gauge showed' in texts[0]
    assert "Gauge readings" not in texts[1]
