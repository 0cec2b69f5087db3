"""Sentences on what is most likely wrong with a model, each with its size and what to do about it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.ball_shape import SHAPES
from correction.fit.solve.unknowns import unit_of

NAMED_TERM_SIGMAS = 4.0  # sigmas from which a lens term is named


def describe_held_number(name: str, was: float, value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    """Sentence on a number of camera or glass that was held."""
    unit, factor = unit_of(name)
    text = f"{name} was held at {was * factor:.6g}{f' {unit}' if unit else ''} and seems to be off by"
    cure = "free it in the fit section" if name.startswith("camera.") else "free it, or measure it"
    return f"{text} {float(value[0]) * factor:+.2g} +- {float(sigma[0]) * factor:.1g}; {cure}"


def lens_terms(terms: Sequence[str], value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    """Sentence on lens terms that were held."""
    far = np.abs(value) / sigma
    named = [
        f"{name} {v:+.2g} +- {s:.1g}"
        for name, v, s, many in zip(terms, value, sigma, far, strict=True)
        if many > NAMED_TERM_SIGMAS or many == far.max()
    ]
    return f"a lens term is missing: the lens seems to have {', '.join(named)}; free it in fit.camera"


def place_of_ball(ball: str, value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    """Sentence on a ball that was held in a wrong place."""
    by = ", ".join(f"{axis} {v:+.3f}" for axis, v in zip("xyz", value, strict=True))
    return f"the ball `{ball}` does not stand where it was held: it seems to be off by {by} mm"


def index_of_glass(was: float, value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    """Sentence on an index that was held."""
    return (
        f"the glass was held at n = {was:.5f} and seems to have {was + value[0]:.5f} +- {sigma[0]:.1g}; check the"
        " glass, and the light of the target frames"
    )


def shape_of_ball(ball: str, value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    """Sentence on a ball that is no sphere."""
    radii = np.linalg.eigvalsh(np.tensordot(value, np.array(SHAPES), axes=1))
    differ = f"its radii seem to differ by {1e3 * (radii[-1] - radii[0]):.0f} um"
    cure = "give its fit.named.out_of_round_um, and the fit finds its shape"
    return f"the ball `{ball}` is not the sphere of the file: {differ}; {cure}"


def finer_shape(ball: str, degree: int, value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    """Sentence on a ball with harmonics that were held."""
    height = f"{1e3 * float(np.linalg.norm(value)):.1f} um rms in harmonics up to degree {degree}"
    return (
        f"the ball `{ball}` is out of round by {height} that were held; raise its out_of_round_degree to {degree}"
    )


def describe_moved_board(value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    """Sentence on a board or camera that has moved."""
    by = ", ".join(f"{axis} {v:+.3f}" for axis, v in zip("xyz", value[:3], strict=True))
    return (
        f"board or camera seem to have moved between the bare frames and those with glass, by {by} mm; fix both"
        " and take all frames again"
    )


def describe_refocused_lens(value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    """Sentence on a lens that was focused between frames."""
    return (
        "the lens seems to have been focused or zoomed between the bare frames and those with glass: focal_px"
        f" changed by {float(value[0]):+.2g} +- {float(sigma[0]):.1g} px; lock the focus and take all frames again"
    )


def describe_bent_board(
    nodes_mm: NDArray[np.float64], value: NDArray[np.float64], sigma: NDArray[np.float64]
) -> str:
    """Sentence on a bend over the corners (N, 2) that are seen, without the plane nearest to it."""
    x, y = (nodes_mm / np.abs(nodes_mm).max(initial=1.0)).T
    z = value[0] * x * x + value[1] * x * y + value[2] * y * y
    plane = np.stack((np.ones_like(x), x, y), axis=1)
    z -= plane @ np.linalg.lstsq(plane, z, rcond=None)[0]
    return f"the board is not flat: over what is seen of it, it seems to bend by {1e3 * np.ptp(z):.0f} um"


def tight_number(
    name: str, given: float, known: float, value: NDArray[np.float64], sigma: NDArray[np.float64]
) -> str:
    """Sentence on a free number that is off by many of the sigmas that it was given."""
    unit, factor = unit_of(name)
    off, in_unit = float(value[0]), f" {unit}" if unit else ""
    return (
        f"{name} was given as {given * factor:.6g} +- {known * factor:.2g}{in_unit} and seems to be off by"
        f" {off * factor:+.2g} +- {float(sigma[0]) * factor:.1g}{in_unit}, {abs(off) / known:.0f} of these sigmas;"
        " measure it again, or allow more in the fit section"
    )


def target_heights(value: NDArray[np.float64], sigma: NDArray[np.float64]) -> str:
    """Sentence on heights of the target that are all off by one factor."""
    return (
        f"heights of the target seem to be {100.0 * abs(float(value[0])):.2g} +- {100.0 * float(sigma[0]):.1g} %"
        f" too {'small' if value[0] > 0.0 else 'large'}: check the pitch or gear of the stage, and the heights of"
        " the frames"
    )
