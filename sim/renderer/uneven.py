"""Row of a ball out of round for the renderer, as `sim.renderer.kernels.uneven` reads it."""

from math import factorial, sqrt

from sim.renderer.kernels.uneven import LOWEST, UNEVEN
from tracer.bodies import Sphere
from tracer.harmonics import HIGHEST, TERMS


def uneven_numbers(ball: Sphere) -> list[float]:
    """What follows in the row of a ball out of round."""
    heights = {
        (degree, order): 1e-3 * um
        for (_, degree, order), um in zip(TERMS, ball.shape_um, strict=True)
        if um != 0.0
    }
    highest = max(degree for degree, _ in heights)
    numbers = [UNEVEN, float(highest)]
    for order in range(highest + 1):
        for degree in range(max(order, LOWEST), highest + 1):
            ratio = factorial(degree - order) / factorial(degree + order)
            norm = sqrt((1 if order == 0 else 2) * (2 * degree + 1) * ratio)
            numbers += [
                norm * heights.get((degree, order), 0.0),
                norm * heights.get((degree, -order), 0.0) * (order > 0),
            ]
    assert highest <= HIGHEST
    return numbers
