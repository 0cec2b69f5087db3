"""A campaign: the same bytes whoever works and whatever happens; nothing is believed that should not be."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import netcdf_file

from correction.maps.correction_map import STORED_BYTES
from daq.errors import DiskError, RunUnsuitable, Unfinished
from ground.errors import ConfigError
from piv.correlation.settings import PivSettings
from piv.errors import SeriesError
from piv.files.vector_file import read_vectors
from piv.statistics.out_of_plane import OutOfPlane
from rtpiv.analysis.campaign import campaign_plan
from rtpiv.analysis.campaign.campaign_folder import CampaignFolder, campaign_status, choice_of
from rtpiv.analysis.campaign.campaign_plan import CampaignSettings, ask_for, forecast, forecasts, plan_runs
from rtpiv.analysis.campaign.merge import merge_campaign, merge_means
from rtpiv.analysis.campaign.run_campaign import run_campaign
from rtpiv.analysis.pairs.piv_file import PivChoice
from rtpiv.analysis.series.chunk import evaluate_chunk
from rtpiv.analysis.series.series_folder import SeriesFolder, marker_path
from rtpiv.analysis.series.series_mean import mean_of_series
from rtpiv.analysis.series.series_plan import chunk_path
from rtpiv.analysis.series.series_view import SeriesView
from tests.rtpiv.analysis.campaign.small_campaign import carried_out, content_of, planned, two_runs
from tests.rtpiv.analysis.series.small_series import DT_US, PX_PER_MM, SCENE, flow_run

CHUNKS = 6  # of two pairs: three of run one, three of run two


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Frame 4 of both runs, of pair 2, is damaged."""
    found = two_runs(tmp_path_factory.mktemp("runs"))
    for run in found:
        damaged = run / "frames" / "000004.tif"
        damaged.write_bytes(damaged.read_bytes()[:-40] + bytes(40))
    return found


@pytest.fixture(scope="module")
def whole(runs, tmp_path_factory):
    """The campaign made and merged by one worker."""
    folder = planned(tmp_path_factory.mktemp("whole"), runs)
    assert carried_out(folder) == (0, CHUNKS)
    merge_campaign(folder)
    return folder


@pytest.fixture
def copy(whole, tmp_path):
    """A copy that may be spoiled, and what it held."""
    shutil.copytree(whole.path, tmp_path / "copy")
    return CampaignFolder(tmp_path / "copy"), content_of(whole.path)


@pytest.mark.slow
def test_two_workers_write_the_same_bytes_as_one(runs, whole, tmp_path):
    folder = planned(tmp_path / "two", runs)
    assert carried_out(folder, 2) == (0, CHUNKS)
    merge_campaign(folder)
    assert content_of(folder.path) == content_of(whole.path)
    assert len(content_of(whole.path)) == 2 * CHUNKS + 2 * 5 + 3  # series, scene, map, still light and mean a run


def test_statistics_are_of_all_runs_and_say_what_was_left_out(whole):
    with netcdf_file(whole.path / "campaign.nc", mmap=False) as file:
        found = {name: np.array(each[:]) for name, each in file.variables.items()}
        assert (file.pairs_used, file.runs) == (9, b"one two")
        assert set(json.loads(file.left_out)) == {"one: flow_000004", "two: flow_000004"}
    m_s = 1e-3 / PX_PER_MM / (DT_US * 1e-6)
    assert np.nanmedian(found["u"]) == pytest.approx(2.0 * m_s, rel=0.01)
    assert found["n"].max() == 9
    means = []
    for name in ("one", "two"):
        with netcdf_file(whole.series(name).path / "mean.nc", mmap=False) as file:
            means.append({n: np.array(file.variables[n][:]) for n in ("u", "n", "noise_uu", "n_effective_u")})
    both, noise = (
        sum(mean["n"] * np.nan_to_num(mean[each]) for mean in means) / found["n"] for each in ("u", "noise_uu")
    )
    several = found["n"] > 8
    assert found["noise_uu"][several] == pytest.approx(noise[several], rel=3e-7)  # float32
    # The mean of all is filtered anew, by less noise than that of each run.
    off = (found["u"] - both)[several]
    assert 0.0 < np.sqrt(np.mean(off**2)) < np.sqrt(np.mean(found["sigma_u"][several] ** 2))
    effective = sum(np.nan_to_num(mean["n_effective_u"]) for mean in means)
    assert found["n_effective_u"][several] == pytest.approx(effective[several])


def test_the_index_names_every_chunk_with_its_hash(whole):
    lines = (whole.path / "index.csv").read_text().splitlines()
    assert lines[0] == "run,chunk,pairs,without_vectors,file,bytes,sha256,key"
    assert len(lines) == 1 + CHUNKS
    run, chunk, pairs, without, file, size, *_ = lines[2].split(",")
    assert (run, chunk, pairs, without) == ("one", "1", "2", "1")
    assert (whole.path / file).stat().st_size == int(size)


def test_what_is_not_what_was_written_is_made_anew(copy):
    """Status compares keys and lengths, run and merge hashes; other damage: `test_run_series`."""
    folder, before = copy
    path, other = (chunk_path(folder.series("two").path, number) for number in (1, 0))
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    for flipped, done, error in ((True, 3, SeriesError), (False, 2, Unfinished)):
        if flipped:
            path.write_bytes(content)
        else:  # those of another chunk: nothing is wrong with the two but their place
            shutil.copy(marker_path(other), marker_path(path))
            shutil.copy(other, path)
        assert campaign_status(folder)[1].done == done
        with pytest.raises(error, match=r"missing"):
            merge_campaign(folder)
        assert carried_out(folder) == (CHUNKS - 1, 1)
        merge_campaign(folder)
        assert content_of(folder.path) == before


def test_moved_runs_keep_what_was_done(copy, runs, tmp_path):
    folder, _ = copy
    moved = [shutil.copytree(run, tmp_path / run.name) for run in runs]
    planned(folder.path, moved)
    assert carried_out(folder) == (CHUNKS, 0)


def test_a_scene_for_each_run(runs, tmp_path):
    scenes = []
    for number in range(2):
        scenes.append(tmp_path / f"{number}.yaml")
        scenes[-1].write_text(SCENE.replace("500.0]", f"{500 + number}.0]"))
    folder = planned(tmp_path / "out", runs, scenes=scenes)
    camera = [each.given.method.scene.camera.position_mm[2] for each in plan_runs(folder)]
    assert camera == [500.0, 501.0]
    with pytest.raises(SeriesError, match="2 scenes for 1 runs"):
        planned(tmp_path / "other", runs[:1], scenes=scenes)
    with pytest.raises(SeriesError, match="named twice"):
        planned(tmp_path / "other", [runs[0], runs[0]])


def test_days_with_cameras_of_their_own_fits_meet_on_one_grid(runs, tmp_path):
    """The second day's camera stands 1 mm farther away: the same frames are 1/500 faster, at the same places."""
    scenes = []
    for number in range(2):
        scenes.append(tmp_path / f"{number}.yaml")
        scenes[-1].write_text(SCENE.replace("0.0, 500.0]", f"0.0, {500 + number}.0]"))
    folder = planned(tmp_path / "out", runs, scenes=scenes, chunk=8)
    carried_out(folder)
    merged = merge_campaign(folder)
    assert merged.mean.used == 9
    places = [mean_of_series(SeriesView(folder.series(name).path)) for name in ("one", "two")]
    for name in ("x_mm", "y_mm"):
        np.testing.assert_array_equal(getattr(places[0], name), getattr(places[1], name))
    faster = np.nanmedian(places[1].mean_m_s[..., 0]) / np.nanmedian(places[0].mean_m_s[..., 0])
    assert faster == pytest.approx(501.0 / 500.0, abs=5e-4)
    alone = planned(tmp_path / "alone", runs[:1], scenes=scenes[:1], chunk=8)
    assert alone.series("one").about["keys"] == folder.series("one").about["keys"]  # the first keeps its own grid


def test_the_forecast_counts_what_is_left(copy):
    folder, _ = copy
    marker_path(chunk_path(folder.series("one").path, 0)).unlink()
    one, two = (forecast(folder, each) for each in plan_runs(folder))
    assert (one.pairs, one.chunks, one.done, two.done, two.left_s) == (6, 3, 2, 3, 0.0)
    assert one.left_s == pytest.approx(2 * 96 * 96 * 0.5e-6)
    assert one.read_bytes == 2 * 2 * 96 * 96 * (2 + 4)  # two pairs, and the four behind them
    size = chunk_path(folder.series("one").path, 0).stat().st_size
    maps = folder.series("one").path / "maps"
    for stored in maps.glob("*.map"):
        stored.unlink()
    with_map = forecast(folder, next(iter(plan_runs(folder)))).write_bytes
    maps.mkdir(exist_ok=True)
    (maps / "made.map").touch()
    without = forecast(folder, next(iter(plan_runs(folder)))).write_bytes
    assert with_map - without == STORED_BYTES * 96 * 96  # it is made once
    assert 0.7 * size < without < size


def test_long_journals_are_planned_side_by_side_with_the_same_keys(runs, whole, tmp_path, monkeypatch):
    monkeypatch.setattr(campaign_plan, "LONG_BYTES", 0)
    monkeypatch.setattr(campaign_plan, "worker_processes", ThreadPoolExecutor)
    folder = planned(tmp_path / "out", runs)
    for name in ("one", "two"):
        (folder.series(name).path / "series.json").unlink()
    assert [each.chunks for each in forecasts(folder, 2)] == [3, 3]
    for name in ("one", "two"):
        assert folder.series(name).about["keys"] == whole.series(name).about["keys"]
    shutil.rmtree(folder.series("two").path)
    with pytest.raises(ConfigError, match=r"scene\.yaml"):
        forecasts(folder, 2)


def test_status_counts_finished_chunks_and_pairs_without_vectors(copy):
    folder, _ = copy
    for number in (0, 1):
        marker_path(chunk_path(folder.series("one").path, number)).unlink()
    state, other = campaign_status(folder)
    assert (state.done, state.chunks, state.done_pairs, state.pairs) == (1, 3, 2, 6)
    assert (other.done, other.chunks) == (3, 3)
    ((reason, count),) = other.without_vectors.items()
    assert count == 1
    assert "does not agree with its checksum" in reason


class OneFails:
    """Evaluates chunks; that of one number raises."""

    def __init__(self, number):
        self.number = number

    def __call__(self, job):
        if job.number == self.number:
            raise DiskError("is full", place=job.path)
        return evaluate_chunk(job)


def test_a_chunk_that_cannot_be_written_ends_the_call_and_costs_no_other(copy):
    folder, before = copy
    for name in ("one", "two"):
        shutil.rmtree(folder.series(name).path / "chunks")
    with pytest.raises(DiskError, match="is full"):
        run_campaign(folder, None, OneFails(2))
    assert [state.done for state in campaign_status(folder)] == [2, 0]
    assert carried_out(folder) == (2, CHUNKS - 2)
    merge_campaign(folder)
    assert content_of(folder.path) == before


def test_two_clients_do_not_work_on_one_campaign(copy):
    folder, _ = copy
    with SeriesFolder(folder.path).lock(), pytest.raises(RunUnsuitable, match="another process"):
        carried_out(folder)


def test_what_is_no_campaign_is_one_sentence(tmp_path):
    with pytest.raises(RunUnsuitable, match="begin with: rtpiv campaign run"):
        campaign_status(CampaignFolder(tmp_path))
    (tmp_path / "campaign.json").write_text("{}")
    with pytest.raises(SeriesError, match="is damaged"):
        campaign_status(CampaignFolder(tmp_path))


@pytest.mark.slow
def test_further_cameras_are_averaged_among_themselves(tmp_path):
    """The side camera sees another displacement: it is no part of the mean of the first, and fits no worse."""
    runs = two_runs(tmp_path / "taken", (3, 2))
    for run in runs:
        side = flow_run(run / "cameras", 2, shift=lambda n: (3.0, 1.0))
        side.rename(run / "cameras" / "side")
    every = [runs[0], *(run / "cameras" / "side" for run in runs), runs[1]]
    folder = planned(tmp_path / "out", every, chunk=8)
    assert [run["name"] for run in folder.about["runs"]] == ["one", "one-side", "two-side", "two"]
    carried_out(folder)
    merged = merge_campaign(folder)
    beside = merged.cameras["side"]
    assert (merged.mean.used, beside.mean.used) == (5, 4)
    assert set(merged.apart) == {"one", "two"}
    assert set(beside.apart) == {"one-side", "two-side"}
    px = [np.nanmedian(each.mean.mean_m_s[..., 0]) * each.mean.px_per_m_s for each in (merged, beside)]
    assert px == pytest.approx([2.0, 3.0], abs=0.05)
    kept = read_vectors((folder.path / "campaign-side.nc").read_bytes())
    np.testing.assert_allclose(kept.fields["u"][0], beside.mean.mean_m_s[..., 0], rtol=1e-5)
    np.testing.assert_array_equal(beside.mean.x_mm, merged.mean.x_mm)  # one grid: `mean --join` takes their series


def test_a_campaign_keeps_the_names_it_began_with(tmp_path):
    """Earlier versions named a further camera `side`, where it is `one-side` now: its chunks are found."""
    runs = two_runs(tmp_path / "taken", (1, 1))
    (runs[0] / "cameras").mkdir()
    side = runs[1].rename(runs[0] / "cameras" / "side")
    used, asked = planned(tmp_path / "used", [side], chunk=1), tmp_path / "again"
    assert used.about["runs"][0]["name"] == "one-side"
    file = used.path / "campaign.json"
    file.write_text(file.read_text().replace('"one-side"', '"side"'))
    choice = PivChoice(PivSettings(), None, OutOfPlane())
    ask_for(CampaignFolder(asked), [runs[0], side], choice, CampaignSettings(), used)
    assert [run["name"] for run in CampaignFolder(asked).about["runs"]] == ["one", "side"]


def test_runs_that_saw_another_flow_are_told_apart(tmp_path):
    """Ten pairs of one flow and six of one that is faster by 0.3 px."""
    one, two = two_runs(tmp_path / "same", (6, 6))
    three = two_runs(tmp_path / "other", (6, 6), shift=lambda n: (2.3, -1.0))[0].rename(tmp_path / "three")
    folder = planned(tmp_path / "out", [one, two, three], chunk=8)
    carried_out(folder)
    means = [mean_of_series(SeriesView(folder.series(name).path)) for name in ("one", "two", "three")]
    apart = merge_means(("one", "three"), [means[0], means[2]]).apart
    assert min(apart.values()) > 3.0
    same = merge_means(("one", "two"), [means[0], means[1]])
    assert max(same.apart.values()) < 1e-6  # the very same frames
    assert same.mean.used == 12
    assert merge_means(("one",), means[:1]).mean is means[0]
    with pytest.raises(SeriesError, match="the vectors of two lie on another grid than those of one"):
        merge_means(("one", "two"), [means[0], replace(means[1], x_mm=means[1].x_mm + 0.1)])


def test_what_is_told_of_the_flow_through_the_sheet_reaches_every_run(tmp_path):
    run = flow_run(tmp_path, 2)
    folder, known = CampaignFolder(tmp_path / "campaign"), OutOfPlane(0.2, 0.0)
    ask_for(folder, [run], PivChoice(PivSettings(), None, known), CampaignSettings())
    assert choice_of(folder.about["how"]).out_of_plane == known
    how = {name: value for name, value in folder.about["how"].items() if name != "out_of_plane"}
    assert choice_of(how).out_of_plane == OutOfPlane()  # asked for before it could be told
