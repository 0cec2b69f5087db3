"""The whole way with a flow that is known, without a bench: images through glass, correction, vectors, mean."""

import numpy as np
import pytest

from benchmarks.flow import Case, chunks, judged, moments


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", ["two", "three"])
def test_the_mean_of_a_jet_is_found_beside_and_behind_glass(name):
    """Errors of a turbulent mean are those of its few pairs: fluctuations as large as the view behind glass."""
    case = Case(name, 1008, is_pinhole=True)
    found = judged(case, [moments(case, numbers) for numbers in chunks(12, 6)])
    for part, limit_px in (("beside", 0.06), ("centre", 0.15)):
        assert found[part]["rms_px"] < limit_px
        assert found[part]["rms_px"] < 1.6 * found[part]["sampling_px"]
        assert np.abs(found[part]["bias_px"]).max() < found[part]["sampling_px"]
