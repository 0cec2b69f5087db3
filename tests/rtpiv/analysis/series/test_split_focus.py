"""Two means become one by where a vector is seen; its origin is told."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import netcdf_file

from correction.evaluate.regions import Region
from piv.errors import SeriesError
from piv.statistics.effective_samples import EffectiveSamples
from piv.statistics.moments import Moments
from rtpiv.analysis.series.mean_flow import MeanFlow
from rtpiv.analysis.series.split_focus import BEHIND, BESIDE, join_means
from rtpiv.command_line.cli import DONE, USAGE, main
from tests.rtpiv.analysis.series.gauged_run import gauged, showed
from tests.rtpiv.analysis.series.small_series import flow_run

SHAPE = (3, 4)


def mean_of(speed, spread, seed, pairs=40):
    """A mean on a grid of 3 x 4 vectors, all around one speed."""
    rng = np.random.default_rng(seed)
    moments = Moments.nothing(SHAPE)
    for _ in range(pairs):
        moments = moments.add(speed + spread * rng.standard_normal((*SHAPE, 2)))
    effective = EffectiveSamples(np.full((*SHAPE, 2), float(pairs)), "all", True)
    x, y = np.arange(4.0), np.arange(3.0)
    missing, dt_share = np.full(SHAPE, 0.01 * (seed + 1)), 1e-3
    unresolved = (missing, np.repeat(missing[..., None], 3, axis=-1), dt_share)
    out = ((f"pair {seed}", "dark"),)
    return MeanFlow(x, y, 10.0, 32, 16, 1e-3, moments, effective, pairs, 1.0, *unresolved, out)


REGION = np.array(
    [[Region.DIRECT] * 4, [Region.GLASS] * 4, [Region.RIM, Region.RIM, Region.NONE, Region.DIRECT]], np.uint8
)


def test_vectors_come_from_the_run_that_was_focused_on_them():
    first, second = mean_of(1.0, 0.1, 0), mean_of(1.0, 0.01, 1)
    joined = join_means(first, second, REGION)
    assert (joined.source[0] == BESIDE).all()
    assert (joined.source[1] == BEHIND).all()
    assert (joined.source[2, :2] == BEHIND).all()  # the surer one at a rim
    for name, mine in joined.mean.moments.to_arrays().items():
        theirs, others = first.moments.to_arrays()[name], second.moments.to_arrays()[name]
        np.testing.assert_array_equal(mine[joined.source == BESIDE], theirs[joined.source == BESIDE])
        np.testing.assert_array_equal(mine[joined.source == BEHIND], others[joined.source == BEHIND])
    assert joined.mean.used == 80
    assert np.unique(joined.mean.resolution_m_s[joined.source == BEHIND]) == [0.02]
    assert np.isnan(joined.mean.stress_resolution_m2_s2[joined.source == 0]).all()
    assert joined.mean.dt_sigma_share == pytest.approx(1e-3)
    assert joined.mean.left_out == (("beside: pair 0", "dark"), ("behind: pair 1", "dark"))
    assert joined.apart_in_sigma == pytest.approx(1.0, abs=0.45)


def test_another_flow_is_seen_as_another():
    assert join_means(mean_of(1.0, 0.1, 0), mean_of(1.2, 0.1, 1), REGION).apart_in_sigma > 5.0


def test_a_vector_that_its_run_has_not_is_none():
    first, second = mean_of(1.0, 0.1, 0), mean_of(1.0, 0.1, 1)
    joined = join_means(first, replace(second, moments=Moments.nothing(SHAPE)), REGION)
    assert (joined.source[1] == 0).all()
    assert np.isnan(joined.mean.mean_m_s[1]).all()
    assert (joined.mean.count[0] == 40).all()


def test_other_grids_are_refused():
    first = mean_of(1.0, 0.1, 0)
    with pytest.raises(SeriesError, match="different grids"):
        join_means(first, replace(first, x_mm=first.x_mm + 0.1), REGION)


@pytest.mark.slow
@pytest.mark.usefixtures("no_mean_page")
def test_the_verb_writes_one_mean_with_its_sources(tmp_path, capsys):
    windows = ("--first-window", "32", "--final-window", "16", "--workers", "1")
    runs = [flow_run(tmp_path / name, pairs) for name, pairs in (("one", 4), ("two", 5))]
    for run, value in zip(runs, (4.0, 6.0), strict=True):
        gauged(run, (0, {"flow": showed(value)}))
        assert main(["mean", str(run), *windows]) == DONE
    series, out = [str(run / "series") for run in runs], tmp_path / "joined"
    capsys.readouterr()
    shutil.copytree(series[0], tmp_path / "copy")
    for twice in (series[0], str(tmp_path / "copy")):
        assert main(["mean", "--join", series[0], twice, "-o", str(out)]) == USAGE
        assert "are the same vectors" in capsys.readouterr().err
    assert not out.exists()
    assert main(["mean", "--join", *series, "-o", str(out)]) == DONE
    assert "where both have a mean they differ by" in capsys.readouterr().out
    with netcdf_file(out / "mean.nc", mmap=False) as file:
        source, n = (np.array(file.variables[name][0]) for name in ("source", "n"))
        assert json.loads(file.left_out) == {}
        assert json.loads(file.readings)["flow"]["mean"] == 5.0
        each = (file.beside_readings, file.behind_readings)
        assert [json.loads(said)["flow"]["mean"] for said in each] == [4.0, 6.0]
    assert set(np.unique(source)) <= {0, BESIDE, BEHIND}
    np.testing.assert_array_equal(source > 0, n > 1)
