"""Numbers with as many digits as their standard uncertainty allows: two of its own."""

import math

MOST_PLACES = 9  # of a number, however small its sigma


def places(sigma: float) -> int:
    """Decimals that show two digits of a sigma; all there are, if nothing is unsure."""
    if not (sigma > 0.0 and math.isfinite(sigma)):
        return MOST_PLACES
    return min(max(1 - math.floor(math.log10(sigma)), 0), MOST_PLACES)


def two_digits(sigma: float) -> str:
    """A sigma to two digits, written out; "0" for none."""
    return f"{sigma:.{places(sigma)}f}" if sigma > 0.0 else "0"


def with_sigma(value: float, sigma: float) -> str:
    """A number and its standard uncertainty; without one the number alone, with four digits."""
    if not (sigma > 0.0 and math.isfinite(sigma)):
        return f"{value:.4g}"
    digits = places(sigma)
    return f"{value:z.{digits}f} \u00b1 {sigma:.{digits}f}"
