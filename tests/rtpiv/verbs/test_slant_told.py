"""What is told of the flow through the sheet: it changes sigma, no vector, and needs no pair evaluated again."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import netcdf_file

from piv.errors import PairError
from piv.files.vector_file import read_vectors
from piv.statistics.derived import rates
from rtpiv.analysis.pairs.evaluation import PairDetails
from rtpiv.command_line.cli import USAGE, main
from rtpiv.verbs.evaluate import EvaluationOutput, evaluate
from rtpiv.verbs.mean import MeanOutput, mean
from tests.rtpiv.analysis.series.small_series import flow_run

WINDOWS = {"first_window_px": 32, "final_window_px": 16, "workers": 1}
FIGURES = MeanOutput(files=False)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return flow_run(tmp_path_factory.mktemp("flow"), 2)


def test_a_mean_is_told_afterwards_what_flows_through_its_sheet(run):
    series = run / "series"
    assumed = mean(run, output=FIGURES, **WINDOWS)
    (chunk,) = (series / "chunks").glob("*.nc")
    slopes = read_vectors(chunk).by_place
    stored = np.stack([slopes[name] for name in ("dxdz", "dydz")], axis=-1)
    np.testing.assert_array_equal(stored, assumed.slope.astype(np.float32))
    made_ns, asked = chunk.stat().st_mtime_ns, json.loads((series / "series.json").read_text())
    assert "assumed, isotropic" in assumed.out_of_plane.sentence
    assert "out_of_plane" not in asked["content"]

    told = mean(series, output=FIGURES, w_over_u=0.5)
    for name in ("mean_m_s", "sigma_m_s", "stresses_m2_s2", "slope"):
        np.testing.assert_array_equal(getattr(told, name), getattr(assumed, name))
    speed = np.linalg.norm(told.mean_m_s, axis=-1, keepdims=True)
    assert told.slant_sigma_m_s == pytest.approx(0.5 * speed * np.abs(told.slope), nan_ok=True)

    both = mean(run, output=FIGURES, sigma_w_m_s=0.02, w_over_u=0.0, **WINDOWS)
    assert chunk.stat().st_mtime_ns == made_ns  # nothing is evaluated again
    asked = json.loads((series / "series.json").read_text())
    assert asked["content"]["out_of_plane"] == {"sigma_w_m_s": 0.02, "w_over_u": 0.0}
    assert np.nanmax(both.slant_sigma_m_s) == 0.0
    flat, slanted = (rates(each.field)["shear"][1] for each in (both, told))
    assert np.nanmedian(slanted) > 1.1 * np.nanmedian(flat)
    blind = rates(replace(told.field, through=None))["shear"][1]
    np.testing.assert_array_equal(flat, blind)
    assert both.perspective_stresses.bias[..., 0] == pytest.approx((0.02 * both.slope[..., 0]) ** 2, nan_ok=True)
    again = mean(series, output=FIGURES)  # as it was told when it was evaluated
    np.testing.assert_array_equal(again.perspective_stresses.bias, both.perspective_stresses.bias)
    with pytest.raises(PairError, match="its vectors are made"):
        mean(series, output=FIGURES, w_over_u=0.0, final_window_px=32)
    assert main(["mean", str(series), "--w-over-u", "-1"]) == USAGE


def test_single_pairs_have_slopes_and_their_part_of_sigma_in_every_file(run, tmp_path):
    output = EvaluationOutput(vtk=True, pictures=False)
    first, _ = evaluate(run, tmp_path / "out", output=output, sigma_w_m_s=0.5, **WINDOWS).details
    folder = first.task.out
    pair = read_vectors(folder / "vectors.nc")
    measured = pair.fields["flag"] == 0
    for letter in "uv":
        slope = pair.by_place["dxdz" if letter == "u" else "dydz"][measured[0]]
        assert pair.fields[f"slant_sigma_{letter}"][measured] == pytest.approx(0.5 * np.abs(slope), rel=1e-5)
        parts = [
            pair.fields[name][measured] for name in (f"sigma_{letter}", "resolution", f"slant_sigma_{letter}")
        ]
        total = np.sqrt(np.square(parts).sum(axis=0))
        assert pair.fields[f"total_sigma_{letter}"][measured] == pytest.approx(total, rel=1e-5)
        assert pair.units[f"slant_sigma_{letter}"] == pair.units[f"total_sigma_{letter}"] == "m s-1"
    up, along = (np.gradient(pair.by_place[name], pair.y_mm, pair.x_mm) for name in ("dydz", "dxdz"))
    steady = 1e3 * 0.5 * np.abs(along[1] + up[0])[1:-1, 1:-1]  # of a divergence [1/s], by a w that is everywhere
    spread = pair.fields["sigma_divergence"][0, 1:-1, 1:-1]
    known = np.isfinite(spread)
    assert known.any()
    assert (spread[known] > steady[known]).all()
    assert "0.5 m/s (given)" in pair.attributes["out_of_plane"]
    with netcdf_file(folder / "vectors.nc", mmap=False) as file:
        assert file.variables["dxdz"].long_name == b"slope dX/dz of the rays at the plane"
        assert file.variables["dxdz"].units == b"1"
        assert file.variables["dxdz"].dimensions == ("y", "x")
    text = (folder / "vectors.vtk").read_text()
    assert "SCALARS dxdz double 1" in text
    assert "SCALARS slant_sigma_v double 1" in text


def test_what_was_moved_by_a_known_way_has_no_slant(run, tmp_path):
    output, moved = EvaluationOutput(pictures=False), PairDetails((0.2, 0.1))
    first, _ = evaluate(run, tmp_path / "out", details=moved, output=output, w_over_u=0.3, **WINDOWS).details
    assert first.slant is None
    assert not first.vectors.by_place
    assert "out_of_plane" not in first.vectors.attributes
