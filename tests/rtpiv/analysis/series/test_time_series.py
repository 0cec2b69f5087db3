"""Velocities over time at places, against series whose truth is known."""

import json

import numpy as np
import pytest
from scipy.io import netcdf_file

from piv.files.vector_file import Vectors
from rtpiv.analysis.series.time_series import MIN_SPECTRUM_PAIRS, _between, _uneven, spectrum_of
from rtpiv.command_line.cli import DONE, USAGE, main
from tests.rtpiv.analysis.series.small_series import SCENE, flow_run

X_MM, Y_MM = np.array([-3.0, -1.0, 1.0, 3.0]), np.array([0.0, 2.0, 4.0])


def grid(values):
    """Vectors of one time with these values (ny, nx, 2)."""
    u, v = np.moveaxis(values[None], -1, 0)
    return Vectors(X_MM, Y_MM, np.array([0.0]), {"u": u, "v": v})


def at(values, *places):
    return _between(grid(values), values[None], np.array(places, float))[0]


def test_between_vectors_what_is_linear_is_exact_and_a_missing_neighbour_is_missing():
    x, y = np.meshgrid(X_MM, Y_MM)
    values = np.stack((2.0 + 3.0 * x - y, x * y), axis=-1)
    found = at(values, (0.5, 1.0), (-3.0, 4.0), (3.0, 4.0), (2.0, 4.0))
    assert found[:, 0] == pytest.approx([2.5, -11.0, 7.0, 4.0])
    assert found[0, 1] == pytest.approx(0.5)
    values[1, 2] = np.nan
    found = at(values, (0.5, 1.0), (1.0, 0.0), (-1.0, 2.0), (-1.0, 1.0), (0.0, 2.0))
    assert np.isnan(found[:, 0]).tolist() == [True, False, False, False, True]


def test_the_integral_of_a_spectrum_is_the_variance_and_a_wave_stands_at_its_frequency():
    rng = np.random.default_rng(4)
    step_s, count = 2e-3, 4096
    t = step_s * np.arange(count)
    wave = 0.3 * np.sin(2.0 * np.pi * 60.0 * t)
    values = np.stack((wave, 0.1 * rng.normal(size=count)), axis=-1)[:, None]
    found = spectrum_of(values, np.full(values.shape, 0.1), step_s)
    width = found.frequency_hz[1] - found.frequency_hz[0]
    assert found.density.sum(axis=0)[0] * width == pytest.approx([0.045, 0.01], rel=0.05)
    assert found.frequency_hz[found.density[:, 0, 0].argmax()] == pytest.approx(60.0, abs=width)
    assert np.mean(found.density[:, 0, 1]) == pytest.approx(found.noise[0, 1], rel=0.05)  # all of v is noise


def test_ninety_five_of_a_hundred_densities_lie_within_what_is_said():
    rng = np.random.default_rng(6)
    found = spectrum_of(rng.normal(size=(512, 200, 2)), np.ones((512, 200, 2)), 1.0)
    inner = found.density[2:-2]  # white: 2 everywhere; the ends lose to the mean, or have one side
    inside = (inner * found.least < 2.0) & (inner * found.most > 2.0)
    assert 0.93 < inside.mean() < 0.97


def test_few_gaps_are_filled_and_many_leave_no_spectrum():
    rng = np.random.default_rng(8)
    values = np.sin(0.3 * np.arange(256))[:, None, None] + 0.01 * rng.normal(size=(256, 2, 2))
    whole = spectrum_of(values, np.full(values.shape, 0.01), 1.0)
    values[rng.choice(256, 12, replace=False), 0], values[:40, 1] = np.nan, np.nan
    found = spectrum_of(values, np.full(values.shape, 0.01), 1.0)
    assert np.isnan(found.density[:, 1]).all()
    assert found.density[:, 0].sum(axis=0) == pytest.approx(whole.density[:, 0].sum(axis=0), rel=0.03)


@pytest.mark.parametrize(
    ("time", "unit", "why"),
    [
        (np.arange(100.0), "pair", "bear no times"),
        (np.arange(20.0), "s", "too few"),
        (np.arange(100.0) + 5.0 * (np.arange(100) >= 50), "s", "not always the same"),
        (np.zeros(100), "s", "not always the same"),
        (np.arange(float(MIN_SPECTRUM_PAIRS)) + 0.01 * np.sin(np.arange(MIN_SPECTRUM_PAIRS)), "s", ""),
    ],
)
def test_pairs_that_are_no_even_sampling_have_no_spectrum(time, unit, why):
    said = _uneven(time, unit)
    assert why in said
    assert bool(said) == bool(why)


@pytest.mark.slow
def test_a_series_says_what_moved_at_places_and_along_a_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = flow_run(tmp_path, 12, shift=lambda n: (2.0 + 0.1 * (-1) ** n, -1.0))
    (tmp_path / "scene.yaml").write_text(SCENE)
    quick = ["--final-window", "32", "--workers", "1"]
    assert main(["evaluate", str(run), "--scene", "scene.yaml", "-o", "series", *quick]) == DONE
    middle = ["--at", "0", "0", "-20", "10", "--line", "-20", "0", "20", "0"]
    assert main(["mean", "series", *middle, "-o", "found"]) == DONE
    assert "12 pairs at" in capsys.readouterr().out
    with netcdf_file(tmp_path / "found" / "time_series.nc", mmap=False) as file:
        u, v, sigma = (np.array(file.variables[name][:]) for name in ("u", "v", "sigma_u"))
        unit, on_line = file.variables["u"].units.decode(), np.array(file.variables["on_line"][:])
        assert "density_u" not in file.variables  # 12 pairs are too few
    assert unit == "m s-1"
    assert on_line[:3].tolist() == [0, 0, 1]
    scale = 1e-3 / 0.8 / 50e-6  # m/s a pixel a pair
    for place in range(2):
        assert u[:, place] == pytest.approx(scale * (2.0 + 0.1 * (-1.0) ** np.arange(12)), abs=0.05 * scale)
        assert v[:, place] == pytest.approx(np.full(12, scale), abs=0.05 * scale)
    assert (sigma[np.isfinite(u)] > 0.0).all()
    page = (tmp_path / "found" / "time_series.html").read_text("utf-8")
    assert "12 pairs are too few" in page
    capsys.readouterr()
    for words, said in (
        (["--at", "0"], "give x and y of each point"),
        (["--at", "0", "900"], "(0, 900) mm: vectors reach from"),
    ):
        assert main(["mean", "series", *words, "-o", "other"]) == USAGE
        assert said in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "other").exists()
    assert json.loads((tmp_path / "series" / "series.json").read_text())["pairs"] == 12
