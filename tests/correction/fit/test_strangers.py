"""Labs that resemble none of ours: right ones raise no alarm, one sigma is one sigma, wrong ones are named.

``make labs LABS=300`` draws so many of them; some are photographed as well.
"""

import os

import numpy as np
import pytest

from tests.correction.fit.drawn_labs import Drawn, drawn_lab
from tests.correction.fit.lab_table import KNOWN_PX, Row, fitted
from tests.correction.fit.strangers import stranger

LABS = int(os.environ.get("LABS", "20"))
FIRST = 52000
COSTLY_PX = 0.05
FAULTS = ("index", "ball off", "lens term", "bent board")


@pytest.fixture(scope="module")
def right() -> list[Drawn]:
    return [drawn_lab(FIRST + n, draw=stranger) for n in range(LABS)]


def squares(error_px, sigma_px):
    """Squares of error over sigma of the well-known points of one region of one lab, mean; None without any."""
    known = sigma_px.max(axis=1, initial=0.0) < KNOWN_PX
    return np.mean((error_px[known] / sigma_px[known]) ** 2) if known.sum() > 10 else None


@pytest.mark.slow
@pytest.mark.timeout(14400)
def test_right_labs_raise_no_alarm(right):
    assert sum(not lab.fit.verdict.is_right for lab in right) <= max(1, 0.02 * len(right))


@pytest.mark.slow
@pytest.mark.timeout(14400)
@pytest.mark.parametrize("region", ["behind", "beside"])
def test_one_sigma_is_one_sigma_by_region(right, region):
    """Errors of one lab belong together, so each lab counts once."""
    parts = [(lab.error_px, lab.sigma_px) if region == "behind" else lab.beside[1:] for lab in right]
    found = [square for part in parts if (square := squares(*part)) is not None]
    assert len(found) > 0.4 * len(right)
    assert 0.8 <= np.sqrt(np.mean(found)) <= 1.25


@pytest.mark.slow
@pytest.mark.timeout(14400)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_lab_that_costs_something_is_named_or_held_by_its_sigma(fault):
    for n in range(max(LABS // 4, 4)):
        lab = drawn_lab(FIRST + 5000 + n, fault, draw=stranger)
        inside = np.abs(lab.error_px) < 2.0 * lab.sigma_px
        held = np.sum(lab.error_px**2 * inside) / np.sum(lab.error_px**2)
        assert lab.cost_px < COSTLY_PX or not lab.fit.verdict.is_right or held > 0.95, lab.fit.verdict.sentences


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_photographed_labs_are_right_or_refused_and_never_wrong_in_silence():
    rows = [fitted(Row("stranger", "", FIRST + n)) for n in range(LABS // 2)]
    assert not [row for row in rows if row.said == "error" or row.is_silent]
    assert sum(row.said == "right" for row in rows) >= len(rows) // 2
