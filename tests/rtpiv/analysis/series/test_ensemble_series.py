"""The ensemble correlation of a series: the flow, the same bits for any workers, after any interruption."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import netcdf_file

from piv.correlation.windows import window_grid
from piv.errors import SeriesError
from piv.statistics.out_of_plane import OutOfPlane
from rtpiv.analysis.pairs.piv_file import piv_choice
from rtpiv.analysis.series import ensemble_series
from rtpiv.analysis.series.ensemble_series import EnsembleFlow, ensemble_flow, part_sums, sum_part
from rtpiv.analysis.series.run_series import run_series
from rtpiv.analysis.series.series_input import series_input
from rtpiv.analysis.series.series_mean import ensemble_vectors, mean_of_series, write_statistics
from rtpiv.analysis.series.series_view import SeriesView
from tests.rtpiv.analysis.series.small_series import flow_run

PAIRS = 34  # three parts
RNG = np.random.default_rng(12)
SWAY = RNG.normal(0.0, 0.8, (PAIRS, 2))


@pytest.fixture(scope="module")
def series(tmp_path_factory):
    """A series of a flow that sways, its input and its mean."""
    folder = tmp_path_factory.mktemp("ensemble")
    run = flow_run(folder, PAIRS, shift=lambda n: (2.0 + SWAY[n, 0], -1.0 + SWAY[n, 1]))
    given = series_input(run, folder / "series", piv_choice(first_window_px=32, final_window_px=16))
    run_series(given, 1)
    return given, mean_of_series(SeriesView(given.out))


def test_pairs_keep_what_is_hardly_known(series):
    """It stands where the flow varies most; stresses without it are too small."""
    assert not series[0].method.settings.drop_uncertain


def bits(flow):
    return [getattr(flow, name).tobytes() for name in ("mean_m_s", "sigma_m_s", "stresses_m2_s2", "correlation")]


@pytest.fixture(scope="module")
def whole(series):
    given, mean = series
    return ensemble_flow(given, mean, 16, workers=1)


@pytest.mark.slow
def test_it_measures_mean_and_stresses(whole):
    assert whole.pairs == PAIRS
    found = np.nanmedian(whole.mean_m_s, axis=(0, 1)) * whole.px_per_m_s
    true = np.array((2.0, 1.0)) + SWAY.mean(axis=0) * (1, -1)
    assert found == pytest.approx(true, abs=0.03)
    stresses = np.nanmedian(whole.stresses_m2_s2, axis=(0, 1)) * whole.px_per_m_s**2
    covariance = np.cov((SWAY * (1, -1)).T)
    assert stresses == pytest.approx([covariance[0, 0], covariance[1, 1], covariance[0, 1]], abs=0.12)
    assert (np.diff(whole.y_mm) > 0.0).all()


@pytest.mark.slow
def test_two_workers_and_a_cut_off_sweep_leave_the_same_bits(series, whole, monkeypatch):
    given, mean = series
    assert bits(ensemble_flow(given, mean, 16, workers=2)) == bits(whole)
    done = []

    def cut_off(job):
        if len(done) == 2:
            raise KeyboardInterrupt
        sum_part(job)
        done.append(job)

    with monkeypatch.context() as patch:
        patch.setattr(ensemble_series, "sum_part", cut_off)
        with pytest.raises(KeyboardInterrupt):
            ensemble_flow(given, mean, 16, workers=1)
    first, second = done
    content = bytearray(second.path.read_bytes())
    content[len(content) // 2] ^= 1
    second.path.write_bytes(content)
    assert part_sums(first) is not None
    assert part_sums(second) is None
    assert bits(ensemble_flow(given, mean, 16, workers=1)) == bits(whole)
    assert not list((given.out / "ensemble").iterdir())


def test_what_cannot_be_is_one_sentence(series, tmp_path):
    given, mean = series
    pairs = list(given.given.pairs)
    pairs[3] = replace(pairs[3], dt_s=2 * pairs[3].dt_s)
    several = replace(given, given=replace(given.given, pairs=tuple(pairs)))
    with pytest.raises(SeriesError, match="has several"):
        ensemble_flow(several, mean, 16, workers=1)
    shutil.copytree(given.out, tmp_path / "copy")
    gone = replace(given, out=tmp_path / "copy")
    (tmp_path / "copy" / "chunks" / "00000.json").unlink()
    with pytest.raises(SeriesError, match="is missing, damaged"):
        ensemble_flow(gone, mean, 16, workers=1)


def test_it_is_written(whole, tmp_path):
    write_statistics(tmp_path / "mean.nc", ensemble_vectors(whole, {"run": "flow"}))
    first = (tmp_path / "mean.nc").read_bytes()
    write_statistics(tmp_path / "mean.nc", ensemble_vectors(whole, {"run": "flow"}))
    assert (tmp_path / "mean.nc").read_bytes() == first


def test_the_error_of_dt_stands_beside_it(tmp_path):
    speeds, stresses = np.array([[[3.0, -4.0]]]), np.ones((1, 1, 3))
    windows = window_grid((16, 16), 16, 0.5)
    places = np.zeros(1)
    flow = EnsembleFlow(places, places, 1.0, windows, speeds, speeds, stresses, stresses, np.ones((1, 1)), 9)
    for share, told in ((np.nan, set()), (0.01, {"dt_sigma_u", "dt_sigma_v"})):
        flow = replace(flow, dt_sigma_share=share)
        write_statistics(tmp_path / "mean.nc", ensemble_vectors(flow, {"run": "flow"}))
        with netcdf_file(tmp_path / "mean.nc", mmap=False) as file:
            assert {name for name in file.variables if name.startswith("dt_")} == told
            found = [float(file.variables[name][0, 0, 0]) for name in sorted(told)]
            assert not [name for name in file.variables if name.startswith("slant_")]
        assert found == pytest.approx([0.03, 0.04][: len(told)])


def test_a_flow_through_the_sheet_stands_beside_it():
    speeds, stresses = np.array([[[3.0, -4.0]]]), np.ones((1, 1, 3))
    windows, places = window_grid((16, 16), 16, 0.5), np.zeros(1)
    flow = EnsembleFlow(places, places, 1.0, windows, speeds, speeds, stresses, stresses, np.ones((1, 1)), 9)
    found = ensemble_vectors(flow, {}, np.array([[[0.3, -0.1]]]), OutOfPlane(2.0, 0.1))
    assert [found.by_place[name][0, 0] for name in ("dxdz", "dydz")] == [0.3, -0.1]
    of_mean = [found.fields[f"slant_sigma_{name}"][0, 0, 0] for name in "uv"]
    assert of_mean == pytest.approx([0.3 * 0.5, 0.1 * 0.5])  # a tenth of 5 m/s
    of_stresses = [found.fields[f"slant_R_{name}"][0, 0, 0] for name in ("uu", "vv", "uv")]
    assert of_stresses == pytest.approx([0.36, 0.04, -0.12])
    assert "0.1 of the speed in the plane (given)" in found.attributes["out_of_plane"]
