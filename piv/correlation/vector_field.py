"""The result of one pair: displacement vectors on a regular grid, each with its flag and quality.

Conventions: pixel (0, 0) is the centre of the top-left pixel.  x_px and y_px are pixel positions of the
window centres, (w - 1)/2 for the first window of a frame.  u_px points right, v_px points DOWN, along image
rows.  A view in mm with y up follows from the scale: y_mm = y0 - y_px/scale, v_mm = -v_px/scale.
Vectors belong to the time halfway between both frames, because both are deformed by half the displacement.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.short_repr import short_repr

Floats = NDArray[np.float64]


STATIC_SHARE = 0.08  # of the light; particles alone give 0.00 to 0.03
ONE_PICTURE = (
    "frames A and B are the same picture, pixel by pixel: displacements are zero everywhere and say nothing;"
    " give the two frames of one pair"
)
REPEATED = (
    "both frames are, pixel by pixel, those of an earlier pair: counted twice, they would make the mean too"
    " certain"
)
NO_BACKGROUND = "take the background off the frames of a series first (--prepare sliding-minimum)"
AT_REST_PX = 0.15  # median length of valid vectors, below which nothing tells a fluid at rest from still light
TRUSTED_SHARE = 0.7  # of the vectors outside the mask; real pairs have 0.95 and more, strangers 0.3


class VectorFlag(IntEnum):
    """Validity of a vector.  Image mask (pixels) and these flags (vectors) are kept apart."""

    VALID = 0  # measured
    MASKED = 1  # too few valid pixels in the window, or on the edge of a mask: NaN
    REPLACED = 2  # no measurement: interpolated from valid neighbours, or a vector that is hardly known
    REJECTED = 3  # rejected, or a window without texture, and no neighbour to interpolate from: NaN
    STILL = 4  # a wall or a reflection, whose light stands still beside a flow, or no particles: no vector, NaN


LENGTHS = (
    "u_px",
    "v_px",
    "sigma_u_px",
    "sigma_v_px",
    "resolution_px",
    "steady_px",
    "unfiltered_px",
    "unfiltered_sigma_px",
    "unfiltered_steady_px",
)
RESOLUTION_LENGTHS = ("resolution_px", "steady_px", "unfiltered_steady_px")
NOT_ASKED = (VectorFlag.MASKED, VectorFlag.STILL)  # where nothing could be measured


def could_be_measured(flags: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Flags (ny, nx) of places where windows saw a flow, whatever became of their vectors."""
    return np.asarray(~np.isin(flags, NOT_ASKED))


@short_repr
@dataclass(frozen=True)
class VectorField:
    """Displacements of one pair.

    Parameters
    ----------
    x_px, y_px : ndarray of float64, shapes (nx,), (ny,)
        Window centres.
    u_px, v_px : ndarray of float64, shape (ny, nx)
        Displacement right and down; NaN where flags say MASKED or REJECTED.
    flags : ndarray of uint8, shape (ny, nx)
        VectorFlag.
    peak_ratio, correlation : ndarray of float64, shape (ny, nx)
        Highest to second highest correlation peak (inf without a second; NaN where nothing spoke against the
        vector), and the correlation coefficient, of the last pass; also given for vectors that
        were replaced afterwards.
    sigma_u_px, sigma_v_px : ndarray of float64, shape (ny, nx)
        Random standard uncertainty; NaN where not estimated or not VALID.
    valid_fraction : ndarray of float64, shape (ny, nx)
        Share of valid pixels in the window, single dead ones that could be filled among them.
    window_px, step_px : int
        Size of usual windows, and spacing of the vectors.
    nan_pixels : int
        Pixels that were NaN, infinite or masked in a frame although the mask called them valid; treated as masked.
    static_share : float
        Share of the light that does not move, see `piv.correlation.pair`; NaN where not known.
    resolution_px : ndarray of float64, shape (ny, nx), optional
        Standard uncertainty of a component by what windows do not resolve (`piv.correlation.resolution`), beside
        the random part: means over pairs keep most of it. NaN where sigma is.
    steady_px : ndarray of float64, shape (ny, nx), optional
        The part of it that is the same in every pair of a steady flow; where particles lie in windows changes.
    added_passes : int
        Passes with the last windows beyond those asked for, made because vectors still moved: each shows more of
        short waves (`piv.correlation.response`).
    side_px : ndarray of int64, shape (ny, nx), optional
        Side of the window that each vector comes from: its resolution.
    unfiltered_px : ndarray of float64, shape (ny, nx, 2), optional
        Vectors before the noise filter (`piv.correlation.denoise`), NaN where not VALID; None without a filter.
    unfiltered_sigma_px, unfiltered_steady_px : ndarray of float64, shape (ny, nx), optional
        Random standard uncertainty of a component of these, and their `steady_px`, to which the filter adds what
        it takes.
    is_one_picture : bool
        Whether both frames are the same, pixel by pixel.
    common_light_px : float
        Length below which vectors are rejected because light that both frames have in common was taken off them
        (`piv.correlation.common_light`); 0 where none was.
    stretch : float
        Factor by which static light had made all vectors too short (`piv.correlation.static_light`); 1 without.
    """

    x_px: Floats
    y_px: Floats
    u_px: Floats
    v_px: Floats
    flags: NDArray[np.uint8]
    peak_ratio: Floats
    correlation: Floats
    sigma_u_px: Floats
    sigma_v_px: Floats
    valid_fraction: Floats
    window_px: int
    step_px: int
    nan_pixels: int
    static_share: float = float("nan")
    resolution_px: Floats | None = None
    steady_px: Floats | None = None
    added_passes: int = 0
    side_px: NDArray[np.int64] | None = None
    unfiltered_px: Floats | None = None
    unfiltered_sigma_px: Floats | None = None
    unfiltered_steady_px: Floats | None = None
    is_one_picture: bool = False
    common_light_px: float = 0.0
    stretch: float = 1.0

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Measured vectors, (ny, nx)."""
        valid: NDArray[np.bool_] = self.flags == VectorFlag.VALID
        return valid

    @property
    def lengths(self) -> dict[str, Floats]:
        """Displacements and their uncertainties by name, arrays (ny, nx) or (ny, nx, 2) [px], as far as known."""
        found = {name: getattr(self, name) for name in LENGTHS}
        return {name: part for name, part in found.items() if part is not None}

    @property
    def valid_share(self) -> float:
        """Measured vectors of those that could be measured, 0 to 1."""
        return self.counts["valid"] / max(int(np.count_nonzero(self.asked)), 1)

    @property
    def total_sigma_px(self) -> Floats:
        """Standard uncertainty (ny, nx, 2) of u and v: the random part and what windows do not resolve."""
        random = np.stack((self.sigma_u_px, self.sigma_v_px), axis=-1)
        return random if self.resolution_px is None else np.hypot(random, self.resolution_px[..., None])

    @property
    def counts(self) -> dict[str, int]:
        """Number of vectors by flag, {"valid": ..., "masked": ..., "replaced": ..., "rejected", "still": ...}."""
        return {flag.name.lower(): int(np.count_nonzero(self.flags == flag)) for flag in VectorFlag}

    @property
    def asked(self) -> NDArray[np.bool_]:
        """True (ny, nx) where a vector could be measured: neither masked nor in light that stands still."""
        return could_be_measured(self.flags)

    @property
    def warning(self) -> str:
        """Warning about the field as a whole, a sentence; empty if nothing speaks against it."""
        asked = int(np.count_nonzero(self.asked))
        share = self.valid_share
        if self.is_one_picture:
            return ONE_PICTURE
        if self.common_light_px:
            return (
                f"{100.0 * self.static_share:.0f} % of the light does not move; it was taken off both frames, and"
                f" vectors shorter than {self.common_light_px:.1f} px are not valid; a background of a series is"
                " more exact"
            )
        if np.isinf(self.stretch):
            return (
                f"light that does not move outshines the particles and draws every vector to zero; {NO_BACKGROUND}"
            )
        if self.static_share > STATIC_SHARE:
            return (
                f"{100.0 * self.static_share:.0f} % of the light does not move and draws every vector to zero;"
                f" {NO_BACKGROUND}"
            )
        if share and np.median(np.hypot(self.u_px, self.v_px)[self.valid]) < AT_REST_PX:
            return (
                f"most vectors are shorter than {AT_REST_PX:g} px, as in a fluid at rest, and as still light that"
                f" outshines the particles makes them; if there is a flow, {NO_BACKGROUND}"
            )
        if share >= TRUSTED_SHARE or not asked:
            return ""
        if not share:
            return (
                "the frames match no better than unrelated pictures, so no vector is valid; check that they are"
                " one pair, the time between them, focus and seeding"
            )
        return (
            f"only {100.0 * share:.0f} % of the vectors were measured, the rest are guesses from their neighbours;"
            " check that the frames are one pair, the time between them, focus and seeding; where particles are"
            " few or dim, larger last windows measure more"
        )

    @property
    def grid_px(self) -> NDArray[np.float64]:
        """Window centres as points u, v of shape (ny, nx, 2)."""
        grid: NDArray[Any] = np.stack(np.meshgrid(self.x_px, self.y_px), -1)
        return grid
