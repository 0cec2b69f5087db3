"""Real pairs, where they are at hand."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from piv.correlation.pair import evaluate_pair

PAIRS = Path(__file__).resolve().parents[4] / "shared" / "piv_pairs"

# benchmarks/piv.py compares these fields with those of other evaluators.
CASES = {
    "vortex": ("pivch2001A_1.tif", "pivch2001A_2.tif"),
    "standard images": ("pivch2001B_1.tif", "pivch2001B_2.tif"),
    "Karman street": ("pivlab_karman_01.bmp", "pivlab_karman_02.bmp"),
}


@pytest.mark.parametrize("name", CASES)
def test_a_real_pair_and_its_reverse_agree(name):
    files = [PAIRS / file for file in CASES[name]]
    if not all(file.exists() for file in files):
        pytest.skip(f"{files[0].name} is not at hand")
    a, b = (cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files)
    there, back = evaluate_pair(a, b), evaluate_pair(b, a)
    assert there.valid.mean() > 0.9
    both = there.valid & back.valid
    gap = np.hypot((there.u_px + back.u_px)[both], (there.v_px + back.v_px)[both])
    assert np.median(gap) < 0.02
    assert 0.003 < np.nanmedian(there.sigma_u_px) < 0.15
    # Neighbours share half their pixels and see the same flow; what remains between them is noise.
    rough = np.abs(there.u_px[:, 1:-1] - 0.5 * (there.u_px[:, 2:] + there.u_px[:, :-2]))
    assert np.nanmedian(rough) < 0.1
