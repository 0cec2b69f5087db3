"""A series: the same bytes however it is cut, whoever works on it, and whatever happens in between."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import netcdf_file

from correction.fitted.map_sigma import SigmaLimit
from correction.fitted.scene_sigma import SceneSigma
from daq.errors import DiskError, RunDamaged, RunUnsuitable
from daq.runs.run_folder import RunFolder
from piv.errors import PairError, SeriesError
from rtpiv.analysis.series import clean_frames as clean
from rtpiv.analysis.series import workers
from rtpiv.analysis.series.chunk import evaluate_chunk
from rtpiv.analysis.series.mean_flow import mean_flow
from rtpiv.analysis.series.run_series import run_series
from rtpiv.analysis.series.series_folder import Chunks, SeriesFolder, marker_path
from rtpiv.analysis.series.series_mean import mean_vectors, write_statistics
from rtpiv.analysis.series.series_plan import chunk_path, jobs_of, usual_chunk
from rtpiv.analysis.series.workers import worker_processes
from tests.rtpiv.analysis.series.small_series import (
    DT_US,
    PX_PER_MM,
    SETTINGS,
    content_of,
    flow_run,
    given_of,
    markers,
    method_of,
    series_of,
)
from tests.slow_cases import slow_but
from tracer.strategies.sensitivity import CAMERA

PAIRS = 11
SHIFT_PX = (2.0, -1.0)  # right, down


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("flow")


@pytest.fixture(scope="module")
def run(folder):
    """Pairs 3 and 7 cannot be used: one is damaged on the disk, in the other the first flash failed."""

    def blind(a, b):
        return np.full_like(a, 40), b

    path = flow_run(folder, PAIRS, spoiled={7: blind})
    damaged = RunFolder(path).frame_path(6)
    damaged.write_bytes(damaged.read_bytes()[:-40] + bytes(40))
    return path


@pytest.fixture(scope="module")
def made(folder, run):
    """The series in chunks of 4, made here without any worker."""
    return run_series(series_of(folder / "made", given_of(run), method_of(folder, "sliding-minimum")), 1, 4)


def test_a_series_is_its_vectors_in_m_s_by_time(made):
    assert (made.pairs, made.kept) == (PAIRS, 0)
    with netcdf_file(chunk_path(made.series.path, 0), mmap=False) as file:
        u, v, x_px = (np.array(file.variables[name][:]) for name in ("u", "v", "displacement_x"))
        good = file.variables["chc"][:] == 1
        unresolved = np.array(file.variables["resolution"][:])
        assert file.variables["resolution"].units == b"m s-1"
        assert file.variables["u"].dimensions == ("t", "y", "x")
        assert [file.variables[name].units.decode() for name in ("t", "y", "u")] == ["s", "mm", "m s-1"]
        assert file.variables["t"][:] == pytest.approx(0.1 * np.arange(4))
        assert file.variables["delta_t"][:] == pytest.approx(DT_US * 1e-6)
        assert np.isnan(file.variables["sigma_delta_t"][:]).all()
        assert (np.diff(file.variables["y"][:]) > 0.0).all()
        assert file.Conventions == b"CF-1.8"
        assert json.loads(file.failures)[3]
        assert file.variables["failed"][:].tolist() == [0, 0, 0, 1]
    m_s = 1e-3 / PX_PER_MM / (DT_US * 1e-6)
    assert np.median(u[good]) == pytest.approx(SHIFT_PX[0] * m_s, rel=0.01)
    assert np.median(v[good]) == pytest.approx(-SHIFT_PX[1] * m_s, rel=0.01)  # up
    assert np.median(x_px[good]) == pytest.approx(SHIFT_PX[0], rel=0.01)
    assert np.isnan(u[3]).all()
    assert np.isnan(unresolved[~good]).all()
    assert 1e-5 * m_s < np.median(unresolved[good]) < 0.1 * m_s  # nothing is curved here
    assert not good[3].any()


def test_bad_pairs_are_named_left_out_and_counted(made, run):
    tags = [pair.tag for pair in given_of(run).pairs]
    assert set(made.failed) == {tags[3]}
    assert "does not agree with its checksum" in made.failed[tags[3]]
    mean = mean_flow(Chunks.of(made.series.path))
    assert (mean.used, [tag for tag, _ in mean.left_out]) == (PAIRS - 2, [tags[3], tags[7]])
    assert "of its vectors were measured, and 100 % is usual" in mean.left_out[1][1]
    assert mean.count.max() == PAIRS - 2
    assert not mean.warnings
    (warning,) = replace(mean, usual_share=0.2).warnings
    assert "only 20 % of the vectors of a usual pair" in warning
    assert np.nanmedian(mean.mean_px, axis=(0, 1)) == pytest.approx((SHIFT_PX[0], -SHIFT_PX[1]), abs=0.02)


def test_the_mean_is_that_of_unfiltered_vectors_where_files_have_them(made):
    settings, chunks = SETTINGS, list(Chunks.of(made.series.path))
    mean, plain = mean_flow(chunks, settings), mean_flow(chunks)
    fields = [field for chunk in chunks for field in chunk.fields if field.tag not in dict(mean.left_out)]
    good = np.stack([field.valid for field in fields])[..., None]
    vectors = np.where(good, np.stack([field.unfiltered_m_s[..., :2] for field in fields]), 0.0)
    known = mean.count > 0
    rough = (vectors.sum(axis=0) / np.maximum(good.sum(axis=0), 1))[known]
    np.testing.assert_allclose(mean.denoised.unfiltered.mean_uv[known], rough, rtol=1e-12)
    # A uniform flow: the filter takes noise, and no more than noise.
    off = [np.std(part, axis=0) for part in (mean.mean_m_s[known], rough)]
    assert (off[0] < 0.8 * off[1]).all()
    assert (mean.sigma_m_s[known] >= plain.sigma_m_s[known]).all()
    for name in ("stresses_m2_s2", "noisy_stresses_m2_s2"):
        np.testing.assert_array_equal(getattr(mean, name), getattr(plain, name))
    # Of files without them, or where no filter was asked for, it is that of the vectors of pairs, bit for bit.
    old = [
        replace(chunk, fields=tuple(replace(field, unfiltered_m_s=None, is_usual=None) for field in chunk.fields))
        for chunk in chunks
    ]
    for same in (mean_flow(old, settings), mean_flow(chunks, replace(settings, denoise=0.0))):
        assert same.denoised is None
        for name in ("mean_m_s", "sigma_m_s", "resolution_m_s", "total_sigma_m_s"):
            assert getattr(same, name).tobytes() == getattr(plain, name).tobytes()


def test_a_pair_between_damaged_ones_has_no_background_and_is_a_row(tmp_path):
    """All frames within reach of pair 4 are damaged: that costs nine pairs, and not the chunk."""
    run = flow_run(tmp_path, 12)
    for pair in (0, 1, 2, 3, 5, 6, 7, 8):
        damaged = RunFolder(run).frame_path(2 * pair)
        damaged.write_bytes(damaged.read_bytes()[:-40] + bytes(40))
    books = run_series(series_of(tmp_path / "out", given_of(run), method_of(tmp_path, "sliding-minimum")), 1, 16)
    tags = [pair.tag for pair in given_of(run).pairs]
    assert sorted(books.failed) == tags[:9]
    assert "no frame within 4 pairs of it can be read" in books.failed[tags[4]]
    mean = mean_flow(Chunks.of(books.series.path))
    assert (mean.used, len(mean.left_out)) == (3, 9)


def test_errors_that_no_number_of_pairs_makes_smaller_are_kept_apart(made, tmp_path):
    """Of dt one factor for all vectors, of resolution what bends in the same way in all pairs."""
    bare = mean_flow(Chunks.of(made.series.path))
    assert np.isnan(bare.dt_sigma_share)
    told = []
    for content in Chunks.of(made.series.path):
        fields = [replace(field, dt_sigma_s=0.02 * field.dt_s) for field in content.fields]
        told.append(replace(content, fields=tuple(fields)))
    mean, twice = mean_flow(told), mean_flow(told + told)
    known = mean.count > 0
    assert mean.dt_sigma_share == pytest.approx(0.02)
    assert mean.sigma_m_s.tobytes() == bare.sigma_m_s.tobytes()
    assert mean.dt_sigma_m_s[known] == pytest.approx(0.02 * np.abs(mean.mean_m_s[known]))
    for name in ("dt_sigma_m_s", "resolution_m_s"):
        assert getattr(twice, name)[known] == pytest.approx(getattr(mean, name)[known], rel=1e-9)
    parts = mean.sigma_m_s**2 + mean.dt_sigma_m_s**2 + mean.resolution_m_s[..., None] ** 2
    assert mean.total_sigma_m_s[known] == pytest.approx(np.sqrt(parts)[known])
    write_statistics(tmp_path / "mean.nc", mean_vectors(replace(mean, no_map_sigma="not asked"), {}))
    with netcdf_file(tmp_path / "mean.nc", mmap=False) as file:
        assert file.delta_t_sigma_share == pytest.approx(0.02)
        assert file.variables["dt_sigma_v"][0] == pytest.approx(mean.dt_sigma_m_s[..., 1], nan_ok=True)
        assert file.variables["resolution"][0] == pytest.approx(mean.resolution_m_s, nan_ok=True)
        assert file.variables["total_sigma_u"][0] == pytest.approx(mean.total_sigma_m_s[..., 0], nan_ok=True)
        assert {"resolution_R_uu", "resolution_R_vv", "resolution_R_uv"} <= set(file.variables)
    write_statistics(tmp_path / "bare.nc", mean_vectors(bare, {}))
    with netcdf_file(tmp_path / "bare.nc", mmap=False) as file:
        assert "dt_sigma_u" not in file.variables


@pytest.mark.parametrize("chunk", [1, 16])
def test_no_vector_depends_on_where_the_series_is_cut(folder, run, made, chunk):
    """A chunk reads the frames around it: the sliding minimum is that of the series, not of the chunk."""
    out = folder / f"cut{chunk}"
    run_series(series_of(out, given_of(run), method_of(folder, "sliding-minimum")), 1, chunk)
    fields = [
        [field for content in Chunks.of(path) for field in content.fields] for path in (out, made.series.path)
    ]
    assert len(fields[0]) == len(fields[1]) == PAIRS
    for one, other in zip(*fields, strict=True):
        assert one.tag == other.tag
        for name in ("velocity_m_s", "sigma_m_s", "displacement_px", "correlation", "flags"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
    mean, same = (mean_flow(Chunks.of(path)) for path in (out, made.series.path))
    for name, values in mean.moments.to_arrays().items():
        assert values.tobytes() == same.moments.to_arrays()[name].tobytes()


@pytest.mark.parametrize(("pairs", "steps", "cut"), [
    (1, (), 1), (7, (), 1), (8, (), 1), (24, (), 2), (63, (), 4), (64, (), 8), (1_000_000, (), 16),
    (5, ("sliding-minimum",), 2), (24, ("sliding-minimum",), 2), (129, ("sliding-minimum",), 16),
])  # fmt: skip
def test_chunks_are_so_many_that_cores_end_together(tmp_path, pairs, steps, cut):
    assert usual_chunk(pairs, method_of(tmp_path, *steps)) == cut


def test_a_series_that_is_there_stays_cut_as_it_is(folder, run, made):
    again = series_of(made.series.path, given_of(run), method_of(folder, "sliding-minimum"))
    assert (again.chunk, len(again.jobs())) == (4, 3)
    assert run_series(again, 1).kept == PAIRS
    other = series_of(folder / "new", given_of(run), method_of(folder, "sliding-minimum"))
    assert (other.chunk, len(other.jobs())) == (2, 6)


@pytest.mark.slow
def test_processes_write_the_same_bytes_as_none(folder, run, made, monkeypatch):
    """Of several that are asked for one is started: it stands for all of them."""
    started = []

    def one(count):
        started.append(count)
        return worker_processes(1)

    monkeypatch.setattr(workers, "worker_processes", one)
    run_series(series_of(folder / "two", given_of(run), method_of(folder, "sliding-minimum")), 2, 4)
    assert started == [2]
    assert content_of(folder / "two") == content_of(made.series.path)


@pytest.fixture
def copy(made, tmp_path):
    """A copy of the series, to be spoiled, and what it held."""
    shutil.copytree(made.series.path, tmp_path / "copy")
    return tmp_path / "copy", content_of(tmp_path / "copy")


def again(out, folder, run, *steps, chunk=4, **changed):
    method = method_of(folder, *(steps or ("sliding-minimum",)))
    return run_series(series_of(out, given_of(run), replace(method, **changed)), 1, chunk)


def test_what_is_there_is_kept(copy, folder, run):
    out, before = copy
    times = {file: file.stat().st_mtime_ns for file in (out / "chunks").iterdir()}
    assert again(out, folder, run).kept == PAIRS
    assert {file: file.stat().st_mtime_ns for file in (out / "chunks").iterdir()} == times
    assert content_of(out) == before


def flipped(path, at):
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


@pytest.mark.slow
@pytest.mark.parametrize(
    "harm", ["no marker", "no file", "one bit", "cut short", "marker", "marker of another", "part"]
)
def test_what_is_damaged_is_made_anew(copy, folder, run, harm):
    out, before = copy
    path = chunk_path(out, 1)
    match harm:
        case "no marker":
            marker_path(path).unlink()
        case "no file":
            path.unlink()
        case "one bit":
            flipped(path, path.stat().st_size // 2)
        case "cut short":
            path.write_bytes(path.read_bytes()[:-1])
        case "marker":
            marker_path(path).write_text("{")
        case "marker of another":
            shutil.copy(marker_path(chunk_path(out, 0)), marker_path(path))
        case "part":
            marker_path(path).unlink()
            path.with_name(path.name + ".part").write_bytes(b"CDF")
    if harm != "part":
        with pytest.raises(SeriesError, match="is missing, damaged or made with other settings"):
            mean_flow(Chunks.of(out))
    assert again(out, folder, run).kept == PAIRS - 4
    assert content_of(out) == before


def test_other_settings_are_never_mixed(copy, folder, run, capsys):
    """With chunks of two settings nothing can be averaged; given again, all are of the new ones."""
    out, before = copy
    (out / "mean.nc").write_text("of the chunks that were there")
    assert again(out, folder, run, "minimum").kept == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "3 finished chunks will be made again: prepare sliding-minimum there, minimum now" in said
    assert not (out / "mean.nc").exists()
    keys = {marker["key"] for marker in markers(out).values()}
    assert not keys & {
        json.loads(content)["key"]
        for name, content in before.items()
        if "chunks" in name and name.endswith("json")
    }
    shutil.copy(folder / "made" / "chunks" / "00001.nc", chunk_path(out, 1))
    shutil.copy(folder / "made" / "chunks" / "00001.json", marker_path(chunk_path(out, 1)))
    with pytest.raises(SeriesError, match="made with other settings"):
        mean_flow(Chunks.of(out))
    assert again(out, folder, run, "minimum").kept == PAIRS - 4


def test_vectors_of_another_run_are_not_replaced(copy, folder, tmp_path):
    out, before = copy
    other = flow_run(tmp_path, 2, shift=lambda n: (1.0, 0.0))
    with pytest.raises(SeriesError, match="3 finished chunks of another run, flow; choose another folder with -o"):
        run_series(series_of(out, given_of(other), method_of(folder, "sliding-minimum"), "other"), 1, 4)
    assert content_of(out) == before


def test_what_the_map_is_too_unsure_of_is_left_out_of_every_pair(copy, folder, run):
    """A camera known to 1 mm along x: 0.8 px everywhere, more than one limit allows and less than another."""
    out, _ = copy
    usual = method_of(folder, "sliding-minimum")
    root = np.zeros((len(CAMERA), 1))
    root[0] = 1.0
    sigma = SceneSigma(usual.scene.content_hash(), root)
    strict, lax = (replace(usual, limit=SigmaLimit(sigma, px)) for px in (0.5 * PX_PER_MM, 2.0 * PX_PER_MM))
    with pytest.raises(PairError, match="no pair gave a vector"):
        run_series(series_of(out, given_of(run), strict), 1, 4)
    assert run_series(series_of(out, given_of(run), lax), 1, 4).kept == 0
    with_limit, without = (mean_flow(Chunks.of(where)) for where in (out, folder / "made"))
    np.testing.assert_array_equal(with_limit.mean_m_s, without.mean_m_s)


def test_longer_chunks_leave_no_old_ones_behind_and_nothing_else_is_touched(copy, folder, run):
    out, _ = copy
    (out / "chunks" / "my notes.txt").write_text("mine")
    again(out, folder, run, chunk=8)
    assert sorted(markers(out)) == [0, 1]
    assert len(list((out / "chunks").iterdir())) == 5
    assert (out / "chunks" / "my notes.txt").read_text() == "mine"


def test_a_chunk_is_made_from_the_frames_that_its_key_names_and_from_no_others(run, folder):
    """Frame and journal may be replaced after the key was made: the vectors would be those of another key."""
    job = jobs_of(folder / "promised", given_of(run).pairs, method_of(folder), None, 2)[0]
    stranger = replace(job.pairs[0], crc32=("00000000", job.pairs[0].crc32[1]))
    marker = evaluate_chunk(replace(job, pairs=(stranger, job.pairs[1])))
    assert list(marker.failed) == [stranger.tag]


@pytest.mark.parametrize("steps", [("sliding-minimum",), ()])
def test_each_frame_is_announced_once_and_before_its_turn(run, folder, monkeypatch, steps):
    job = jobs_of(folder / "ahead", given_of(run).pairs, method_of(folder, *steps), None, 8)[0]
    said = []
    monkeypatch.setattr(clean, "_announce", lambda path: said.append(("soon", path.name)))
    monkeypatch.setattr(clean, "_read", lambda pair, *_: said.append(("now", pair.frames[1].name)) or "no frame")
    assert len(list(clean.clean_frames(job, 1))) == 8
    read = [name for what, name in said if what == "now"]
    assert read == [pair.frames[1].name for pair in (*job.pairs, *job.after)][: len(read)]
    for number, name in enumerate(read[1:], start=1):
        assert said.count(("soon", name)) == 1
        assert said.index(("soon", name)) < said.index(("now", read[max(0, number - 2)]))


def test_other_frames_or_times_are_another_series(run, folder):
    method, given = method_of(folder, "sliding-minimum"), given_of(run)
    jobs = jobs_of(folder, given.pairs, method, None, 4)
    for changed in (
        {"crc32": ("00000000", given.pairs[5].crc32[1])},
        {"dt_s": 2e-5},
        {"dt_sigma_s": 1e-9},
        {"time_s": 0.7},
    ):
        pairs = list(given.pairs)
        pairs[5] = replace(pairs[5], **changed)
        differ = [a.key != b.key for a, b in zip(jobs, jobs_of(folder, pairs, method, None, 4), strict=True)]
        assert differ == ([True, True, True] if "crc32" in changed else [False, True, False])
    other = replace(method, settings=replace(method.settings, overlap=0.25))
    assert all(a.key != b.key for a, b in zip(jobs, jobs_of(folder, given.pairs, other, None, 4), strict=True))


def test_two_at_once_do_not_write_into_one_folder(made, folder, run):
    with made.series.lock(), pytest.raises(RunUnsuitable, match="another process evaluates into it"):
        again(made.series.path, folder, run)


STEPS = [("minimum",), ("mean", "cap"), ("pod", "min-max"), ("unseeded",), ()]


@pytest.mark.slow
@pytest.mark.parametrize("steps", slow_but(STEPS, *STEPS[2:4]))
def test_every_preparation_measures_the_flow(tmp_path, steps):
    run = flow_run(tmp_path, 13, unseeded=3)
    given = given_of(run)
    assert (len(given.pairs), len(given.unseeded)) == (13, 3)
    books = run_series(series_of(tmp_path / "out", given, method_of(tmp_path, *steps)), 1)
    assert not books.failed
    mean = mean_flow(Chunks.of(tmp_path / "out"))
    found = np.nanmedian(mean.mean_px, axis=(0, 1))
    assert found == pytest.approx((SHIFT_PX[0], -SHIFT_PX[1]), abs=0.03)
    worst = np.nanmax(np.abs(mean.mean_px - (SHIFT_PX[0], -SHIFT_PX[1])))
    assert worst < 0.5  # without any step, too: the reflection is found and belongs to no window


def test_backgrounds_that_a_run_cannot_give_are_one_sentence(tmp_path):
    run = flow_run(tmp_path, 1)
    for steps, words in (
        (("sliding-minimum",), "the run has one"),
        (("unseeded",), "took no pairs without seeding"),
    ):
        with pytest.raises(PairError, match=words):
            run_series(series_of(tmp_path / "out", given_of(run), method_of(tmp_path, *steps)), 1)
    with pytest.raises(SeriesError, match="need 12 frames"):
        run_series(series_of(tmp_path / "out", given_of(run), method_of(tmp_path, "pod")), 1)


def test_a_run_without_one_good_pair_is_refused_with_a_reason(tmp_path):
    def blind(a, b):
        return np.full_like(a, 40), np.full_like(b, 40)

    run = flow_run(tmp_path, 2, spoiled={0: blind, 1: blind})
    with pytest.raises(PairError, match="no pair gave a vector; the first: frame A is constant"):
        run_series(series_of(tmp_path / "out", given_of(run), method_of(tmp_path)), 1)
    with pytest.raises(SeriesError, match="no pair of this series has a vector"):
        mean_flow(Chunks.of(tmp_path / "out"))


def test_pairs_of_different_exposure_are_refused_by_name(tmp_path):
    exposed = {"exposure_us": lambda number: 100.0 if number < 4 else 200.0}
    with pytest.raises(RunDamaged, match="says 200 us of exposure and frame 0 100 us"):
        given_of(flow_run(tmp_path / "a", 4, **exposed))
    with pytest.raises(PairError, match="exposure A of flow_000004 took 200 us and that of flow_000000 100 us"):
        given_of(flow_run(tmp_path / "b", 4, stream=True, **exposed))
    with pytest.raises(PairError, match="so the background does not belong to the pairs"):
        given_of(flow_run(tmp_path / "c", 2, unseeded=2, **exposed))
    of_b = {"exposure_us": lambda number: 100.0 + 3e4 * (number % 2)}  # the second of a double frame lasts longer
    assert len(given_of(flow_run(tmp_path / "d", 4, unseeded=1, **of_b)).pairs) == 4


def test_runs_that_are_no_series_are_one_sentence(tmp_path):
    with pytest.raises(PairError, match="leave that out"):
        given_of(flow_run(tmp_path / "b", 2), dt_us=60.0)
    assert given_of(flow_run(tmp_path / "b", 2), dt_us=50.0).pairs[0].dt_s == pytest.approx(50e-6)
    with pytest.raises(RunUnsuitable, match="is no series"):
        _ = SeriesFolder(tmp_path).about
    (tmp_path / "series.json").write_text("{}")
    with pytest.raises(SeriesError, match="is damaged"):
        _ = SeriesFolder(tmp_path).about


def test_a_folder_that_cannot_be_one_is_one_sentence(tmp_path, folder, run):
    (tmp_path / "file").write_text("")
    with pytest.raises(DiskError, match="choose another folder"):
        again(tmp_path / "file", folder, run)
