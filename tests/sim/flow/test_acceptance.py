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


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("is_pinhole", "finest_px"), [(True, None), (True, 16), (False, None), (False, 16)])
def test_sigma_holds_the_flow_itself_behind_glass(is_pinhole, finest_px):
    """The jet with all three components, not what a camera that looks aslant can see of it.

    Without the slant 38 and 31 % of single vectors at r < 0.75 R are within one sigma (32 px; pinhole, f/22), 48
    and 52 % with windows that places find.  At the rim shear of the mean is taken for a flow through it.
    Wanted are 63 to 73 %; with windows that are found sigma is a little too large.
    """
    most, most_bare = (0.73, 0.5) if finest_px is None else (0.76, 0.58)
    case = Case("two", 1008, is_pinhole=is_pinhole, finest_px=finest_px)
    found = judged(case, [moments(case, numbers) for numbers in chunks(12, 6)])
    for part, least, largest in (("beside", 0.63, most), ("centre", 0.58, most), ("rim", 0.63, 0.85)):
        told, bare = found[part]["vectors_within"], found[part]["vectors_within_no_slant"]
        print(part, told, bare, found[part]["mean_within"])
        assert least < told < largest
        assert bare < told
    assert found["centre"]["vectors_within_no_slant"] < most_bare
