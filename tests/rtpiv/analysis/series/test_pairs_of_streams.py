"""A series of pairs of a stream, with a clock and without, and pairs of unknown time."""

import numpy as np
import pytest
from scipy.io import netcdf_file

from daq.runs.pairs import pairs_of
from piv.errors import PairError
from rtpiv.analysis.series.mean_flow import mean_flow
from rtpiv.analysis.series.run_series import run_series
from rtpiv.analysis.series.series_folder import Chunks
from rtpiv.analysis.series.series_pairs import is_flow, is_one_series
from rtpiv.analysis.series.series_plan import chunk_path
from tests.rtpiv.analysis.series.small_series import (
    DT_US,
    PX_PER_MM,
    flow_run,
    given_of,
    method_of,
    series_of,
)


def test_a_stream_whose_camera_has_no_clock_needs_to_be_told_the_time(tmp_path):
    run = flow_run(tmp_path, 11, stream=True, timestamp_ns=lambda _: 0)
    assert is_one_series(pairs_of(run))
    assert not is_flow(pairs_of(run))
    assert not given_of(run, timed=False).is_timed
    with pytest.raises(PairError, match="say it with --dt-us"):
        given_of(run)
    given = given_of(run, DT_US)
    assert (given.pairs[0].dt_s, given.pairs[0].time_s) == (pytest.approx(DT_US * 1e-6), None)
    run_series(series_of(tmp_path / "out", given, method_of(tmp_path, "sliding-minimum"), "stream"), 1, 16)
    with netcdf_file(chunk_path(tmp_path / "out", 0), mmap=False) as file:
        assert file.variables["t"].units == b"pair"
        assert file.variables["t"][:].tolist() == list(range(11))


@pytest.mark.parametrize("count", [1, 10, 11])
def test_a_stream_is_a_series_of_one_as_of_many(tmp_path, count):
    """No background is taken off few pairs of a stream unasked: what stands still in so few may be particles."""
    run = flow_run(tmp_path, count, stream=True)
    assert is_one_series(pairs_of(run))
    assert given_of(run).usual_background == (count == 11)


def test_pairs_of_an_unknown_time_have_displacements_and_a_mean_of_these(tmp_path):
    run = flow_run(tmp_path, 2, stream=True, timestamp_ns=lambda _: 0)
    found = run_series(series_of(tmp_path / "out", given_of(run, timed=False), method_of(tmp_path), "stream"), 1)
    vectors = found.vectors
    assert (vectors.kind, vectors.units["u"]) == ("displacement", "mm")
    assert np.nanmedian(vectors.fields["u"]) == pytest.approx(2.0 / PX_PER_MM, rel=0.02)
    mean = mean_flow(Chunks.of(tmp_path / "out"))
    assert (mean.is_timed, mean.unit, mean.unit_squared, mean.rate_unit) == (False, "mm", "mm\u00b2", "1")
    assert np.nanmedian(mean.mean_m_s[..., 0]) == pytest.approx(2.0 / PX_PER_MM, rel=0.02)
    assert np.nanmedian(mean.mean_px[..., 0]) == pytest.approx(2.0, rel=0.02)
