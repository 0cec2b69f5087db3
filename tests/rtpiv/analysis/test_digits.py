"""Digits as their sigma gives them."""

import pytest

from rtpiv.analysis.digits import places, two_digits, with_sigma


@pytest.mark.parametrize(
    ("value", "sigma", "said"),
    [
        (1.28349, 0.01234, "1.283 \u00b1 0.012"),
        (500.3704, 0.1004, "500.37 \u00b1 0.10"),
        (12345.6, 210.0, "12346 \u00b1 210"),
        (-0.000156, 0.000093, "-0.000156 \u00b1 0.000093"),
        (0.25, float("nan"), "0.25"),
        (0.25, 0.0, "0.25"),
        (-0.001, 0.12, "0.00 \u00b1 0.12"),
    ],
)
def test_a_number_has_two_digits_of_its_sigma(value, sigma, said):
    assert with_sigma(value, sigma) == said


def test_places_end_somewhere():
    assert [places(sigma) for sigma in (1e-30, 0.0, float("inf"), 3e4)] == [9, 9, 9, 0]


def test_a_sigma_is_written_out_with_two_digits():
    assert [two_digits(sigma) for sigma in (0.19342, 0.0000312, 0.0, 12.34)] == ["0.19", "0.000031", "0", "12"]
